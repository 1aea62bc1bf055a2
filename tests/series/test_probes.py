"""The one documented table of wave probes; anything else is refused with what was found."""

import numpy as np
import pytest

from wavefield.errors import ExperimentError
from wavefield.series.probes import read_probes

TIMES = 0.05 * np.arange(43)
HEIGHTS = 0.01 * np.sin(3 * TIMES)


def table(rows, header="time,WG1"):
    return "\n".join([header, *(",".join(map(str, row)) for row in rows), ""])


def test_the_documented_table_is_read_with_unit_sign_clock_and_places(tmp_path):
    path = tmp_path / "probes.csv"
    path.write_text("# gauge 7\ntime, p1 ,p2\n0,10,-5\n\n0.1,,nan\n0.2,-10,5\n", encoding="utf-8-sig")
    found = read_probes(path, unit="mm", factor=-1, clock=3.0, places={"p1": (0.2, -0.1)})
    np.testing.assert_allclose(found.elevation, [[-0.01, np.nan, 0.01], [0.005, np.nan, -0.005]])
    np.testing.assert_allclose(found.time, [3.0, 3.1, 3.2])
    assert list(found.probe.values) == ["p1", "p2"]
    np.testing.assert_array_equal(found.probe_x, [0.2, np.nan])
    np.testing.assert_array_equal(found.probe_y, [-0.1, np.nan])


@pytest.mark.parametrize(("height", "period"), [(0.004, 0.5), (2.1, 5.0), (15.0, 15.0)])
def test_waves_of_tanks_and_of_the_open_sea_are_read(tmp_path, height, period):
    times = np.arange(0, 60, 0.5)
    np.savetxt(tmp_path / "b.csv", np.c_[times, height / 2 * np.sin(2 * np.pi * times / period + 0.3)],
               delimiter=",", header="time,heave", comments="")  # fmt: skip
    assert np.ptp(read_probes(tmp_path / "b.csv").elevation.values) <= height


REFUSED = {
    "milliseconds": (table(zip(1000 * TIMES, HEIGHTS)), "the times are 50 apart, too slow for waves"),
    "named milliseconds": (table(zip(TIMES, HEIGHTS), "time [ms],WG1"), "first line must be `time,NAME"),
    "dates": (
        table((f"2024-05-03 10:31:{38 + t:06.3f}", z) for t, z in zip(TIMES, HEIGHTS)),
        "line 2: '2024-05-03 10:31:38.000,.* is not 2 numbers; times are in seconds",
    ),
    "sentinel": (table((t, -99.99 if k == 7 else z) for k, (t, z) in enumerate(zip(TIMES, HEIGHTS))),
                 "varies by 100 m, more than any wave; state `unit:`.*leave cells without a value empty"),
    "a word": (table((t, "x" if k == 3 else z) for k, (t, z) in enumerate(zip(TIMES, HEIGHTS))),
               "line 5: .*,x' is not 2 numbers"),
    "inf": (table((t, "inf" if k == 3 else z) for k, (t, z) in enumerate(zip(TIMES, HEIGHTS))),
            "line 5: .*,inf' is not 2 numbers"),
    "temperature": (table(((t, z, 21.5) for t, z in zip(TIMES, HEIGHTS)), "time,WG1,T [°C]"),
                    "first line must be .* no brackets"),
    "semicolons": ("Zeit [s];WG1 [mm]\n0,00;1,5\n", "and it is 'Zeit"),
    "logger": ('"TOA5","flume"\n"TIMESTAMP","RECORD","WG1"\n', "line 1: the first line must be"),
    "no header": (table(zip(TIMES, HEIGHTS), "# none"), "line 2: the first line must be"),
    "millimetres": (table(zip(TIMES, 1e4 * HEIGHTS)), "varies by 200 m, more than any wave; state `unit:`"),
    "short line": ("time,p1,p2\n0,1,2\n1,2\n", "line 3: '1,2' is not 3 numbers"),
    "backwards": ("time,p1\n0,0\n2,1\n1,1\n", "line 4: time is not increasing"),
    "twice": ("time,p1,p1\n0,0,1\n1,1,1\n", "first line must be `time,NAME,NAME,...`"),
    "empty": ("", "fewer than two lines"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_anything_else_is_refused_with_what_was_found(tmp_path, kind):
    text, sentence = REFUSED[kind]
    (tmp_path / "probes.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ExperimentError, match=sentence) as error:
        read_probes(tmp_path / "probes.csv")
    assert "probes.csv" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("encoding", "sentence"),
    [("utf-16", "line 1: byte 0xff is not UTF-8"), ("cp1252", "line 1: byte 0xb0 is not UTF-8")],
)
def test_other_encodings_are_named(tmp_path, encoding, sentence):
    (tmp_path / "probes.csv").write_bytes(("# 21 °C\n" + table(zip(TIMES, HEIGHTS))).encode(encoding))
    with pytest.raises(ExperimentError, match=sentence):
        read_probes(tmp_path / "probes.csv")


def test_a_place_of_an_unknown_probe_and_a_missing_file_are_named(tmp_path):
    (tmp_path / "probes.csv").write_text(table(zip(TIMES, HEIGHTS)))
    with pytest.raises(ExperimentError, match=r"`places` names 'p9', but the probes of .* are WG1"):
        read_probes(tmp_path / "probes.csv", places={"p9": (0, 0)})
    with pytest.raises(ExperimentError, match="cannot read the probes"):
        read_probes(tmp_path / "none.csv")
