import shutil
import sys

import numpy as np
import pytest
from cube_cases import FOURS

import wavefield as wf
from wavefield.store import results
from wavefield.store.results import PAIR_GROUP


def stored(store):
    return wf.open_run(store).pair_statistics


def files(store):
    found = [path for path in (store / PAIR_GROUP).rglob("*") if path.is_file()]
    return {str(path.relative_to(store)): path.read_bytes() for path in found}


def test_errors_of_every_pair_are_stored_at_the_end_of_a_run(measured):
    found = stored(measured / "cube.zarr")
    pairs = {"cam3-cam1", "cam3-cam2", "cam1-cam2"}
    for quantity in ("eps_y", "sigma_z"):
        assert set(found.cameras.values[found.quantity == quantity]) == pairs
    assert set(found.quantity.values) >= {"z", "z_recombined", "eps_piv", "dx", "dy", "dz"}
    np.testing.assert_array_equal(found.units == "pixel", found.quantity == "eps_piv")
    measured_rms = found.rms.values / np.where(found.units == "pixel", 1, found.attrs["pixel_size"])
    assert (measured_rms > 0).all()
    assert (measured_rms < 0.2).all()  # px
    share = (found.density.sum("bin") * 0.1)[found.quantity != "sigma_z"]
    np.testing.assert_allclose(share, 1, atol=0.05)


def test_a_run_killed_while_it_writes_them_writes_them_again(measured, tmp_path, monkeypatch):
    shutil.copytree(measured, tmp_path, dirs_exist_ok=True)
    store = tmp_path / "cube.zarr"
    shutil.rmtree(store / PAIR_GROUP)
    with monkeypatch.context() as patch:
        patch.setattr(results, "write_mark", lambda *_: sys.exit("killed"))
        with pytest.raises(SystemExit):
            wf.run(tmp_path / "experiment.yaml", workflow=FOURS)
    assert stored(store) is None
    wf.run(tmp_path / "experiment.yaml", workflow=FOURS)
    assert files(store) == files(measured / "cube.zarr")


def test_cubes_without_them_open(measured, tmp_path):
    shutil.copytree(measured / "cube.zarr", tmp_path / "cube.zarr")
    shutil.rmtree(tmp_path / "cube.zarr" / PAIR_GROUP)
    found = wf.open_run(tmp_path / "cube.zarr")
    assert found.pair_statistics is None
    assert "earlier version" in found.reason("pair_statistics")
