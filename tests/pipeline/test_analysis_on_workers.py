import signal
import threading

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import wavefield as wf
from wavefield.commands.cli import cli
from wavefield.errors import RunStopped

SEGMENT = 16


def sea(steps=240):
    """Waves of all directions with noise, in several runs, and errors to count."""
    rng = np.random.default_rng(3)
    axes = {"time": np.arange(steps) * 0.05, "y": np.arange(20) * 0.02, "x": np.arange(24) * 0.02}
    attrs = {"z": {"units": "m"}} | {name: {"units": "m s-1"} for name in ("z_t", "u", "v", "w")}
    attrs |= {"eps_y": {"units": "m"}, "eps_piv": {"units": "pixel"}}
    t, y, x = axes["time"][:, None, None], axes["y"][:, None], axes["x"]
    wave = 0.01 * np.cos(12.3 * x + 4 * y - 10.98 * t)
    fields = {name: wave + 0.001 * rng.standard_normal(wave.shape) for name in attrs}
    cube = xr.Dataset(
        {name: (("time", "y", "x"), fields[name].astype("f4"), attrs[name]) for name in attrs}, axes
    )
    cube["z"][120:125] = np.nan  # two runs
    cube["z"][90, 3, 4] = np.nan
    return cube.assign_attrs(water_depth=0.7)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("sea") / "cube.zarr"
    sea().to_zarr(path, consolidated=False, encoding={"z": {"chunks": (32, 20, 24)}})
    return path


@pytest.fixture(scope="module")
def expected(store, tmp_path_factory):
    """As one process writes it."""
    path = tmp_path_factory.mktemp("one") / "waves.zarr"
    wf.analyze(store, path, segment=SEGMENT)
    return path


def unlike(one, other):
    """Files in which two stores of waves differ in any bit."""
    one, other = (
        {file.relative_to(path): file.read_bytes() for file in path.rglob("*") if file.is_file()}
        for path in (one, other)
    )
    assert len(one) > 200
    assert set(one) == set(other)
    return [file for file in one if one[file] != other[file]]


def test_workers_find_what_one_process_finds_to_the_bit(store, expected, tmp_path):
    assert xr.open_datatree(expected, engine="zarr").attrs["segments"] > 3 * 8  # several chains
    file = tmp_path / "workflow.yaml"
    file.write_text("{cluster: local, workers: 2}")
    out = tmp_path / "waves.zarr"
    wf.analyze_on_workers(store, out, file, segment=SEGMENT)
    assert unlike(out, expected) == []
    assert not list(tmp_path.glob(".*partial")), "sums on their way go with the analysis"


def test_the_command_analyses_where_its_workflow_states(reference, tmp_path):
    out, file = tmp_path / "waves.zarr", tmp_path / "workflow.yaml"
    file.write_text("cluster: none")
    words = ["analyze", str(reference), "--segment", "8", "-o", str(out), "--workflow", str(file)]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 0, result.output
    assert "/spectra" in xr.open_datatree(out, engine="zarr").groups
    assert (tmp_path / "waves.log").exists(), "what was done on workers is in a log"


@pytest.mark.slow
def test_a_signal_stops_the_analysis_and_leaves_nothing_behind(store, tmp_path):
    def stop(done, total):
        signal.pthread_kill(threading.main_thread().ident, signal.SIGTERM)

    workflow = wf.Workflow(cluster="local", workers=2)
    with pytest.raises(RunStopped, match="stopped by SIGTERM; nothing was written"):
        wf.analyze_on_workers(store, tmp_path / "waves.zarr", workflow, segment=SEGMENT, progress=stop)
    assert [path.name for path in tmp_path.iterdir()] == ["waves.log"]
