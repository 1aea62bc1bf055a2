import signal
import threading

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from cube_cases import linear_sea

import wavefield as wf
from wavefield.commands.cli import cli
from wavefield.errors import RunStopped

SEGMENT = 16


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("sea") / "cube.zarr"
    cube = linear_sea(240, (20, 24))
    cube["z"][120:125] = np.nan  # two runs
    cube["z"][90, 5, 4] = np.nan
    cube.to_zarr(path, consolidated=False, encoding={"z": {"chunks": (32, 20, 24)}})
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
    wf.analyze(store, out, workflow=file, segment=SEGMENT)
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
        wf.analyze(store, tmp_path / "waves.zarr", workflow=workflow, segment=SEGMENT, progress=stop)
    assert [path.name for path in tmp_path.iterdir()] == ["waves.log"]
