"""A cube with what belongs to it: what is there is opened, of what is absent the reason is given."""

import shutil

import numpy as np
import pytest
import xarray as xr

import wavefield as wf
from wavefield.errors import StoreError


def test_a_run_has_all_that_its_cube_was_made_from(measured):
    found = wf.open_run(measured / "cube.zarr")
    assert xr.Dataset.identical(found.cube, wf.open_cube(measured / "cube.zarr"))
    assert found.recipe["experiment"] == "small-tank"
    assert list(found.rig) == ["cam1", "cam2", "cam3"]
    np.testing.assert_allclose(found.grid.x_nodes, found.cube.x)
    assert found.experiment.path == measured / "experiment.yaml"
    assert {name: len(one) for name, one in found.frames.items()} == dict.fromkeys(found.rig, 10)
    assert "spectra" in found.waves.children
    assert found.probes is None
    assert found.truth is None
    names = ("rig", "experiment", "frames", "waves", "pair_statistics")
    assert not any(found.reason(name) for name in names)
    assert found.reason("probes") == "the experiment names no probes"
    assert "not simulated" in found.reason("truth")


def test_what_is_absent_has_a_reason(measured, tmp_path):
    shutil.copytree(measured / "cube.zarr", tmp_path / "cube.zarr")
    found = wf.open_run(tmp_path / "cube.zarr", experiment=tmp_path / "gone.yaml")
    assert found.experiment is None
    assert found.frames == {}
    assert found.waves is None
    for name, words in (("experiment", "gone.yaml"), ("frames", "gone.yaml"), ("waves", "wavefield analyze")):
        assert words in found.reason(name)
    with pytest.raises(StoreError):
        wf.open_run(tmp_path / "none.zarr")


def test_masks_and_probes_come_with_the_experiment(measured, tmp_path):
    shutil.copytree(measured, tmp_path, dirs_exist_ok=True)
    file, probes = tmp_path / "experiment.yaml", tmp_path / "probes.csv"
    file.write_text(
        file.read_text() + "mask: {cam1: [{polygon: [[0, 0], [9, 0], [9, 9]]}]}\nprobes: probes.csv\n"
    )
    found = wf.open_run(tmp_path / "cube.zarr", experiment=file)
    assert found.frames["cam1"].covered(0).any()
    assert found.probes is None
    assert "which does not exist" in found.reason("probes")
    probes.write_text("neither times\nnor elevations\n")
    with pytest.raises(wf.errors.ExperimentError):
        _ = wf.open_run(tmp_path / "cube.zarr", experiment=file).probes
