"""Cubes for other programs: what they hold is what the cube holds."""

import h5py
import numpy as np
import pytest
from scipy.io import netcdf_file

import wavefield as wf
from wavefield.commands.cli import main
from wavefield.errors import StoreError
from wavefield.store.export_matlab import write_matlab


@pytest.fixture(scope="module")
def cube(reference):
    return wf.open_cube(reference).load()


def test_matlab_reads_fields_as_y_x_time(reference, cube, tmp_path):
    wf.export(reference, tmp_path / "cube.mat")
    head = (tmp_path / "cube.mat").read_bytes()[:128]
    assert head.startswith(b"MATLAB 7.3 MAT-file")
    assert head[124:] == b"\x00\x02IM"
    with h5py.File(tmp_path / "cube.mat") as file:
        for name in ("z", "u", "v", "w", "z_std", "quality"):
            as_matlab_has_it = file[name][:].T  # it reads dimensions in reverse
            np.testing.assert_array_equal(as_matlab_has_it, cube[name].transpose("y", "x", "time"))
        assert file["z"].attrs["MATLAB_class"] == b"single"
        assert file["quality"].attrs["MATLAB_class"] == b"uint16"
        assert file["time"][:].T.shape == (cube.sizes["time"], 1)
        assert file["units"].attrs["MATLAB_class"] == b"struct"
        assert file["units/w"][:].astype("<u2").tobytes().decode("utf-16-le") == "m s-1"
        assert '"grid"' in file["recipe"][:].astype("<u2").tobytes().decode("utf-16-le")


def test_what_is_no_field_is_written_to_matlab_with_its_values(cube, tmp_path):
    part = cube.isel(time=slice(2))
    shift = np.random.default_rng(1).random((3, cube.sizes["frame"], 3), np.float32)
    part["camera_shift"] = (("camera", "frame", "part"), shift)  # as a corrected vibration leaves it
    with (tmp_path / "cube.mat").open("w+b") as file:
        write_matlab(part, (part.isel(time=k) for k in range(2)), file)
    with h5py.File(tmp_path / "cube.mat") as file:
        np.testing.assert_array_equal(file["camera_shift"][:].T, shift)


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


def test_netcdf_passes_as_cf(reference, cube, tmp_path):
    """Every variable has units, known axes and flags of its own type, and refers to what is there."""
    import cf_xarray  # noqa: F401
    import xarray as xr

    wf.export(reference, tmp_path / "cube.nc")
    with xr.open_dataset(tmp_path / "cube.nc", engine="h5netcdf") as plain:
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


def test_what_is_in_the_way_is_not_replaced(reference, tmp_path, capsys):
    (tmp_path / "run.uvmat").mkdir()
    (tmp_path / "run.uvmat" / "thesis.tex").write_text("years of work")
    with pytest.raises(StoreError, match="was not written by wavefield"):
        wf.export(reference, tmp_path / "run.uvmat")
    assert (tmp_path / "run.uvmat" / "thesis.tex").read_text() == "years of work"
    with pytest.raises(StoreError, match="no such steps: it holds 16"):
        wf.export(reference, tmp_path / "cube.mat", slice(90, 99))
    assert main(["-q", "export", str(reference), str(tmp_path / "a.mat"), "--steps", "every"]) == 2
    assert "FIRST:STOP" in capsys.readouterr().err
