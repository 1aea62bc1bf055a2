"""The workflow files and catalogs that are shipped: they load, and they do what they state."""

import re
import shutil
from pathlib import Path

import intake
import numpy as np
import pytest
import xarray as xr
from cube_cases import different

import wavefield as wf
from wavefield.execution.slurm import count_jobs, slurm_cluster
from wavefield.pipeline import Workflow, open_cube, run, run_catalog
from wavefield.pipeline.catalog import find_experiment
from wavefield.reports import errors_against
from wavefield.variables import FrameStatus

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / "workflows").glob("*.yaml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=[path.stem for path in WORKFLOWS])
def test_every_workflow_loads_also_with_its_options_switched_on(path, tmp_path):
    Workflow.load(path)
    switched_on = tmp_path / path.name
    # an option that is commented out begins with a key right after the mark
    switched_on.write_text(re.sub(r"(?m)^( *)# ?( *[a-z_]+: )", r"\1\2", path.read_text()))
    Workflow.load(switched_on)


def test_the_local_workflow_makes_the_same_cube(tank, reference, tmp_path):
    workflow = Workflow.load(ROOT / "workflows" / "local.yaml")
    state = run(tank, out=tmp_path / "cube.zarr", workflow=workflow)
    assert state.complete
    assert different(tmp_path / "cube.zarr", reference) == []


def test_the_slurm_workflow_asks_for_jobs_that_end_after_the_run_does(tmp_path):
    workflow = Workflow.load(ROOT / "workflows" / "slurm.yaml")
    assert count_jobs(workflow) == (4, 4)
    with slurm_cluster(workflow, tmp_path) as jobs:
        script = jobs.job_script()
    assert "#SBATCH -t 04:00:00" in script
    assert workflow.time_limit_seconds < 4 * 3600


@pytest.mark.real_data
def test_real_images_run_from_the_catalog_with_their_place_as_a_parameter(shared, tmp_path):
    catalog = ROOT / "catalogs" / "d_specimen.yaml"
    folder = str(shared / "data" / "d_specimen")
    experiment = find_experiment(catalog, {"run": "loads", "location": folder})
    assert experiment.frame_rate == 1.0
    assert {one.shape for one in experiment.open_frames().values()} == {(1200, 1920)}
    assert "frames" in intake.open_catalog(str(catalog))
    # two load states are run as the six are
    two = tmp_path / "two"
    (two / "images").mkdir(parents=True)
    for name in ("cal.xml", *(f"images/GT4-000{number}_{side}.tif" for number in (0, 1) for side in (0, 1))):
        (two / name).symlink_to(Path(folder, name))
    (state,) = run_catalog(
        catalog,
        out=tmp_path / "cube.zarr",
        workflow=Workflow(cluster="none"),
        parameters={"location": str(two)},
    )
    cube = open_cube(state.store).load()
    assert (cube.frame_status == FrameStatus.DONE).all()
    assert float(np.isfinite(cube.z).mean()) > 0.95
    # the specimen is flat to a third of a millimetre, and lies where its calibration puts it
    assert abs(float(cube.z.median())) < 1e-3
    assert float(abs(cube.eps_piv).median()) < 0.1
    # its report finds the images where the parameter printed
    assert set(wf.open_run(state.store).frames) == {"left", "right"}


def test_two_cameras_run_from_the_catalog_that_is_shipped(tmp_path):
    scene = wf.Scene.load("two_cameras").with_(frames=6, rig={"crop": 0.2}, calibration={"tilted": 0})
    folder = wf.simulate(scene, tmp_path / "tank", workers=1).parent
    shutil.copy(folder / "truth" / "rig.yaml", folder)  # in place of a calibration
    (state,) = run_catalog(
        ROOT / "catalogs" / "two_cameras.yaml",
        out=tmp_path / "cube.zarr",
        workflow=Workflow(cluster="none"),
        parameters={"location": str(folder)},
    )
    cube = open_cube(state.store)
    truth = xr.open_zarr(folder / "truth" / "truth.zarr", consolidated=False)
    errors = errors_against(cube, truth).isel(x=slice(30, -30), y=slice(22, -22))
    assert float(np.sqrt((errors.z**2).mean())) < 0.1 * cube.attrs["pixel_size"]
