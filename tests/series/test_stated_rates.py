"""What a recording states of its rate and its axes, against its own time stamps and the rig."""

import h5py
import numpy as np
import pytest
from test_series_recordings import COUNT, images, note, write_cine, write_seq

from wavefield.errors import ExperimentError, RigError
from wavefield.rig import Camera, Rig
from wavefield.series import Experiment
from wavefield.series.readers import close_files

STEPS = 40


def hdf5(path, times):
    with h5py.File(path, "w") as file:
        file["images"] = images(8)[np.arange(len(times)) % COUNT]
        file["time"] = times
        file["time"].attrs["units"] = "s"


def stamps(path, times):
    hdf5(path.with_suffix(".h5"), np.zeros(len(times)))
    path.write_text("".join(f"{t:.6f}\n" for t in times))


FORMATS = {
    "seq": ("a.seq", lambda p, t: write_seq(p, 8, 1e9 + t)),
    "cine": ("a.cine", lambda p, t: write_cine(p, 8, times=1e9 + t[:COUNT])),
    "h5": ("a.h5", hdf5),
    "nc": ("a.nc", hdf5),
    "times": ("a.txt", stamps),
}


@pytest.mark.parametrize("kind", FORMATS)
def test_a_rate_that_time_stamps_contradict_is_refused_with_both_numbers(tmp_path, kind):
    name, write = FORMATS[kind]
    chance = np.random.default_rng(7)
    text = "a: {images: a.h5, times: a.txt}" if kind == "times" else f"a: {name}"
    for factor in (10 ** chance.uniform(-1, 1, 20)[:6]).tolist():
        if abs(factor - 1) < 0.02:
            continue
        write(tmp_path / name, np.arange(STEPS) / 20.0)
        experiment = Experiment.load(note(tmp_path, text, f"frame_rate: {20 * factor!r}\n"))
        with pytest.raises(ExperimentError, match=r"at 20 Hz.*, but frame_rate is .* set `frame_rate: 20`"):
            experiment.open_frames()
        close_files()
    jitter = chance.uniform(-0.05, 0.05, STEPS)
    write(tmp_path / name, (1 + np.arange(STEPS) + jitter) / 20.0)
    assert Experiment.load(note(tmp_path, text, "frame_rate: 20\n")).open_frames()
    close_files()


def test_a_header_that_its_stamps_contradict_is_refused(tmp_path):
    write_seq(tmp_path / "a.seq", 8, 1e9 + np.arange(STEPS) / 500.0)  # its header: 2000 Hz
    experiment = Experiment.load(note(tmp_path, "a: a.seq"))
    with pytest.raises(
        ExperimentError, match="stamps are at 500 Hz, its header 2000 Hz, but frame_rate is 2000"
    ):
        experiment.open_frames()
    assert Experiment.load(note(tmp_path, "a: a.seq", "frame_rate: 500\n")).open_frames()
    close_files()


def test_the_unit_of_time_stamps_is_named_where_it_explains_their_rate_and_not_elsewhere(tmp_path):
    units = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
    chance = np.random.default_rng(8)
    hdf5(tmp_path / "a.h5", np.zeros(STEPS))
    for _ in range(4):
        rate, off = float(10 ** chance.uniform(0, 3)), float(chance.uniform(0.97, 1.03))
        factors = {name: factor * off for name, factor in units.items()}
        factors["seconds"] = float(10 ** chance.uniform(0.1, 2.9) * 1e3 ** chance.integers(-1, 4))
        experiment = Experiment.load(
            note(tmp_path, "a: {images: a.h5, times: a.txt}", f"frame_rate: {rate}\n")
        )
        frames = np.cumsum(chance.choice([1, 1, 1, 2], STEPS))
        for name, factor in factors.items():
            (tmp_path / "a.txt").write_text("".join(f"{factor * t / rate!r}\n" for t in frames.tolist()))
            with pytest.raises(ExperimentError) as error:
                experiment.open_frames()
            named = [unit for unit in units if f"these look like {unit}; write seconds" in str(error.value)]
            assert named == ([] if name == "seconds" else [name]), (name, factor)
            assert ("set `frame_rate" in str(error.value)) == (name == "seconds")
    close_files()


@pytest.mark.parametrize(
    ("order", "sentence"),
    [((0, 2, 1), "they are transposed: .*permute"), ((2, 1, 0), "time is their last axis")],
)
def test_arrays_with_their_axes_in_another_order_are_named(tmp_path, order, sentence):
    stack = np.random.default_rng(1).integers(0, 255, (STEPS, 6, 8)).astype("u1")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["images"] = stack.transpose(order)
    down = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    Rig({"a": Camera(10, 10, 3.5, 2.5, down, (0, 0, 4), (8, 6))}).save(tmp_path / "rig.yaml")
    experiment = Experiment.load(note(tmp_path, "a: a.h5", "frame_rate: 20\n"))
    with pytest.raises(RigError, match=sentence):
        experiment.load_rig(series=experiment.open_frames())
    close_files()


def test_a_header_that_claims_more_images_than_anybody_records_is_refused_at_once(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("images", (10**12, 6, 8), "u1", chunks=(1, 6, 8))
        data[10**12 - 1] = np.arange(48, dtype="u1").reshape(6, 8)
    with pytest.raises(ExperimentError, match=r"has 1e\+12 images by its header"):
        Experiment.load(note(tmp_path, "a: a.h5", "frame_rate: 20\n")).open_frames()
    close_files()


def test_cameras_in_one_place_are_refused(tmp_path):
    down = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    camera = Camera(10, 10, 3.5, 2.5, down, (0, 0, 4), (8, 6))
    Rig({"a": camera, "b": camera}).save(tmp_path / "rig.yaml")
    experiment = Experiment.load(note(tmp_path, "a: a.h5, b: b.h5", "frame_rate: 20\n"))
    with pytest.raises(RigError, match="a and b are in one place"):
        experiment.load_rig()


def test_names_that_no_file_system_takes_are_refused(tmp_path):
    for key, text in (("images", f"a: {'x' * 300}.h5"), ("images", f"a: '{'x' * 300}/{{frame}}.tif'")):
        with pytest.raises(ExperimentError, match=f"{key}.*a name of more than 255 characters"):
            Experiment.load(note(tmp_path, text, "frame_rate: 20\n"))
    with pytest.raises(ExperimentError, match="frame_rate is missing"):
        Experiment.load(note(tmp_path, f"a: {'x' * 300}.h5"))
