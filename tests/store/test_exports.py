"""Exports for other programs contain the values of the cube."""

import numpy as np
import pytest
import xarray as xr
from cube_cases import different
from scipy.io import loadmat, netcdf_file

import wavefield as wf
from wavefield.commands.cli import main
from wavefield.errors import StoreError


@pytest.fixture(scope="module")
def cube(reference):
    return wf.open_cube(reference).load()


def test_matlab_reads_fields_as_y_x_time(reference, cube, tmp_path):
    wf.export(reference, tmp_path / "cube.mat")
    found = loadmat(tmp_path / "cube.mat", simplify_cells=True)
    for name in ("z", "u", "v", "w", "z_std", "quality"):
        np.testing.assert_array_equal(found[name], cube[name].transpose("y", "x", "time"))
    assert (found["z"].dtype, found["quality"].dtype) == (np.float32, np.uint16)
    assert loadmat(tmp_path / "cube.mat")["time"].shape == (cube.sizes["time"], 1)
    np.testing.assert_array_equal(found["frame_fault"], cube.frame_fault)
    assert found["units"]["w"] == "m s-1"
    assert '"grid"' in found["recipe"]


def test_a_variable_that_matlab_cannot_hold_is_refused_with_a_remedy(reference, tmp_path, monkeypatch):
    monkeypatch.setattr("wavefield.store.export._MATLAB_BYTES", 1000)
    with pytest.raises(StoreError, match=r"does not fit into a MAT-file.*ncread"):
        wf.export(reference, tmp_path / "cube.mat")
    assert not list(tmp_path.iterdir())


def test_uvmat_gets_a_file_per_step_with_roles(reference, cube, tmp_path):
    wf.export(reference, tmp_path / "run.uvmat", slice(0, 3))
    names = sorted(p.name for p in (tmp_path / "run.uvmat").iterdir())
    assert names == ["run_1.nc", "run_2.nc", "run_3.nc"]
    with netcdf_file(str(tmp_path / "run.uvmat" / "run_2.nc"), mmap=False) as file:
        one = cube.isel(time=1)
        assert (file.Conventions, file.CoordUnit) == (b"uvmat", b"m")
        assert file.Time == pytest.approx(float(one.time))
        roles = {name: variable.Role.decode() for name, variable in file.variables.items()}
        assert (roles["U"], roles["V"]) == ("vector_x", "vector_y")
        assert roles["coord_y"] == "coord_y"
        np.testing.assert_array_equal(file.variables["W"][:], one.w.values)
        np.testing.assert_array_equal(file.variables["FF"][:] == 0, (one.quality.values & 1) == 1)


def test_netcdf_holds_the_same_and_passes_as_cf(reference, cube, tmp_path):
    """Variables have units, known axes and flags of their own type; no reference leads out of the file."""
    import cf_xarray  # noqa: F401

    path = tmp_path / "new" / "cube.nc"
    wf.export(reference, path)
    assert [p.name for p in path.parent.iterdir()] == ["cube.nc"]
    with xr.open_dataset(path, engine="h5netcdf") as plain:
        assert different(plain, cube) == []
        assert plain.attrs["Conventions"] == "CF-1.11"
        assert plain.attrs["recipe"] == cube.attrs["recipe"]
        assert plain.z.attrs["standard_name"] == "water_surface_height_above_reference_datum"
        assert plain.quality.attrs["flag_masks"].dtype == np.uint16
        assert plain.quality.attrs["flag_meanings"].split()[0] == "measured"
        assert {k: v for k, v in plain.cf.axes.items() if k in "TXY"} == {
            "T": ["time"],
            "X": ["x"],
            "Y": ["y"],
        }
        for name, variable in plain.variables.items():
            label = variable.dtype.kind in "OUT"  # a name has no units
            needed = {"long_name"} if label else {"units", "long_name"}
            assert needed <= set(variable.attrs) | set(variable.encoding), name
            for other in variable.attrs.get("ancillary_variables", "").split():
                assert other in plain
    assert not plain.variables.keys() - cube.variables.keys()


def test_steps_that_are_not_there_are_refused(reference, tmp_path, capsys):
    with pytest.raises(StoreError, match="no steps in the given range: it has 16 steps"):
        wf.export(reference, tmp_path / "cube.mat", slice(90, 99))
    assert main(["-q", "export", str(reference), str(tmp_path / "a.mat"), "--steps", "every"]) == 2
    assert "FIRST:STOP" in capsys.readouterr().err
