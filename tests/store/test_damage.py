"""Whatever happens to any file of a cube or of its waves: no other values in silence, no unforeseen error.

Draws are the same every time; more by hand: ``WAVEFIELD_DRAWS=3000 pytest tests/store/test_damage.py``.
"""

import contextlib
import hashlib
import io
import json
import os
import shutil
import warnings

import dask
import numpy as np
import pytest
import xarray as xr
from cube_cases import FOURS
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from wavefield.atomic_write import MARK_ATTRIBUTE
from wavefield.commands.cli import main
from wavefield.errors import StoreError, WavefieldError
from wavefield.explorer.record import CubeRecord
from wavefield.pipeline import open_cube, open_run, run, status
from wavefield.store.layout import CHUNKED

pytestmark = pytest.mark.slow
DRAWS = int(os.environ.get("WAVEFIELD_DRAWS", "20"))
PRODUCTS = ("cube.zarr", "waves.zarr", "verdict.json")


@pytest.fixture(scope="session")
def files(measured):
    """All files that can be damaged, the largest groups not outweighing the small ones."""
    found = [path for name in PRODUCTS for path in (measured / name, *(measured / name).rglob("*"))]
    found = sorted(path for path in found if path.is_file())
    return lambda: found  # of short words where it is printed


def digest(*datasets):
    out = hashlib.sha256()
    for dataset in datasets:
        for name, variable in sorted(dataset.variables.items()):
            values = np.asarray(variable.values)
            out.update(
                f"{name} {variable.dims} {values.dtype} {sorted(map(str, variable.attrs.items()))}".encode()
            )
            out.update(str(values.tolist()).encode() if values.dtype == object else values.tobytes())
        out.update(str(sorted(map(str, dataset.attrs.items()))).encode())
    return out.hexdigest()


def command(*words):
    """Output of a command; whatever is not foreseen is an error of the test."""
    out, complaints = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(complaints):
        code = main(["-q", *map(str, words)])
    if code == 1:
        words = complaints.getvalue() or out.getvalue().replace("\n", " ")  # `verify` answers
        assert "did not foresee" not in words, words
        assert "Traceback" not in words
        raise StoreError(words)
    return f"{code} {out.getvalue()}"


def by_export(folder):
    target = folder / "out.nc"
    try:
        code = command("export", folder / "cube.zarr", target)
        with xr.open_dataset(target, engine="h5netcdf") as dataset:
            return code + digest(dataset.load())
    finally:
        target.unlink(missing_ok=True)


def by_analyze(folder):
    target = folder / "out.zarr"
    try:
        command("analyze", folder / "cube.zarr", "-o", target, "--segment", 8)
        mark = json.loads((target / "zarr.json").read_text())["attributes"][MARK_ATTRIBUTE]
        return mark["digest"]  # of all files of the store
    finally:
        shutil.rmtree(target, ignore_errors=True)


def by_report(folder):
    found = open_run(folder / "cube.zarr")
    groups = [found.wave_group(name) for name in sorted(found.waves.children)]
    return digest(*dask.compute(found.cube, *groups)) + str(status(found.store).bad_frames)


def by_look(folder):
    record = CubeRecord(folder / "cube.zarr")
    record.preview.load()
    if not record.preview.complete:
        raise StoreError(record.preview.trouble)
    fields = [
        record.field(name, step).tobytes() for name in record.stored for step in range(record.layout.steps)
    ]
    axes = [
        axis.tobytes() for axis in (record.time, record.y, record.x, record.ledger, record.preview.fields)
    ]
    return hashlib.sha256(b"".join([*fields, *axes])).hexdigest() + str(record.frame_rate)


READERS = {
    "open_cube": lambda folder: digest(open_cube(folder / "cube.zarr").load()),
    "status": lambda folder: command("status", folder / "cube.zarr"),
    "verify": lambda folder: command("verify", folder / "cube.zarr"),
    "export": by_export,
    "report": by_report,
    "look": by_look,
    "analyze": by_analyze,
}
OFTEN = [name for name in READERS if name != "analyze" for _ in range(3)] + ["analyze"]


@pytest.fixture(scope="session")
def before(measured):
    """What every reader gives of the sound files."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = {name: read(measured) for name, read in READERS.items()}
    return found.get


def flip(data, where):
    out = bytearray(data)
    if out:
        out[int(where * len(out))] ^= 1 << int(where * 1e6) % 8
    return bytes(out)


DAMAGES = {
    "flip": flip,
    "cut": lambda data, where: data[: int(where * len(data))],
    "zeros": lambda data, where: data[: int(where * len(data))] + bytes(len(data) - int(where * len(data))),
    "empty": lambda data, where: b"",
    "longer": lambda data, where: data + b"\0",
    "remove": lambda data, where: None,
}


@contextlib.contextmanager
def damaged(folder, file, content):
    """A file replaced, and everything as it was afterwards."""
    kept = {file: file.read_bytes()}
    kept |= {path: path.read_bytes() for path in (folder / "cube.zarr").rglob("*") if path.is_file()}
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content)
    try:
        yield
    finally:
        for path, data in kept.items():
            if not path.exists() or path.read_bytes() != data:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)


@settings(max_examples=DRAWS, suppress_health_check=list(HealthCheck), phases=[Phase.generate])
@given(
    number=st.integers(0, 10**6),
    where=st.floats(0, 1, exclude_max=True),
    kind=st.sampled_from(list(DAMAGES)),
    reader=st.sampled_from(OFTEN),
)
def test_damage_is_never_passed_on_in_silence(measured, files, before, number, where, kind, reader):
    stores = [[f for f in files() if f.relative_to(measured).parts[0] == name] for name in PRODUCTS]
    store = (0, 0, 0, 0, 1, 2)[number % 6]
    file = stores[store][number // 6 % len(stores[store])]
    content = DAMAGES[kind](file.read_bytes(), where)
    with damaged(measured, file, content), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            now = READERS[reader](measured)
        except WavefieldError as error:
            words = str(error).removeprefix("wavefield: ").strip()
            assert "\n" not in words, words
            assert "`wavefield " in words or "run the same command" in words or "copy the cube" in words, (
                words
            )
            return
        same = now == before(reader)
        assert same or "verdict: none" in now, f"{kind} of {file}: {reader} gave other values"


@settings(max_examples=max(DRAWS // 20, 4), suppress_health_check=list(HealthCheck), phases=[Phase.generate])
@given(
    number=st.integers(0, 10**6), where=st.floats(0, 1, exclude_max=True), kind=st.sampled_from(list(DAMAGES))
)
def test_what_verify_found_damaged_the_next_run_puts_right(measured, files, before, number, where, kind):
    of_cube = [
        f for name in CHUNKED for f in files() if f.is_relative_to(measured / "cube.zarr" / name / "c")
    ]
    file = of_cube[number % len(of_cube)]
    content = DAMAGES[kind](file.read_bytes(), where)
    kept = measured.parent / f"{measured.name}_kept"
    shutil.rmtree(kept, ignore_errors=True)
    shutil.copytree(measured / "cube.zarr", kept)
    try:
        with damaged(measured, file, content), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(WavefieldError):
                READERS["verify"](measured)
            run(measured / "experiment.yaml", workflow=FOURS)
            assert READERS["open_cube"](measured) == before("open_cube"), f"{kind} of {file}"
            assert status(measured / "cube.zarr").complete
    finally:
        shutil.rmtree(measured / "cube.zarr")
        shutil.copytree(kept, measured / "cube.zarr")
