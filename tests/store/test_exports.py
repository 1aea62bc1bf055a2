"""Cubes for other programs: what they hold is what the cube holds."""

import struct
import xml.etree.ElementTree as ET
import zlib

import h5py
import numpy as np
import pytest
from scipy.io import netcdf_file

import wavefield as wf
from wavefield.commands.cli import main
from wavefield.errors import StoreError
from wavefield.store.export_matlab import write_matlab
from wavefield.store.vtkhdf import write_vtkhdf


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
    write_matlab(part, (part.isel(time=k) for k in range(2)), tmp_path / "cube.mat")
    with h5py.File(tmp_path / "cube.mat") as file:
        np.testing.assert_array_equal(file["camera_shift"][:].T, shift)


def points_and_fields(path):
    """All arrays of a .vts, read by its own header."""
    data = path.read_bytes()
    start = data.index(b"_", data.index(b"<AppendedData")) + 1
    root = ET.fromstring(data[: start - 1] + b"</AppendedData></VTKFile>")
    kinds = {"Float32": "<f4", "UInt8": "u1", "UInt16": "u2"}
    out = {}
    for array in root.iter("DataArray"):
        at = start + int(array.get("offset"))
        blocks, size, _, packed = struct.unpack_from("<4Q", data, at)
        raw = zlib.decompress(data[at + 32 : at + 32 + packed])
        assert (blocks, len(raw)) == (1, size)
        parts = int(array.get("NumberOfComponents"))
        out[array.get("Name")] = np.frombuffer(raw, kinds[array.get("type")]).reshape(-1, parts)
    return root.find("StructuredGrid").get("WholeExtent"), out


def test_paraview_gets_the_surface_of_every_step_at_its_time(reference, cube, tmp_path):
    assert main(["-q", "export", str(reference), str(tmp_path / "cube.pvd"), "--steps", "2:8:3"]) == 0
    series = list(ET.parse(tmp_path / "cube.pvd").iter("DataSet"))
    assert [float(s.get("timestep")) for s in series] == pytest.approx(cube.time.values[2:8:3])
    extent, arrays = points_and_fields(tmp_path / series[1].get("file"))
    one = cube.isel(time=5)
    assert extent == f"0 {one.sizes['x'] - 1} 0 {one.sizes['y'] - 1} 0 0"
    z = one.z.values.ravel()
    hidden = arrays["vtkGhostType"][:, 0] == 2
    np.testing.assert_array_equal(hidden, ~np.isfinite(z))
    np.testing.assert_array_equal(arrays["Points"][~hidden, 2], z[~hidden])
    x, y = np.meshgrid(one.x, one.y)
    np.testing.assert_allclose(arrays["Points"][:, :2], np.stack([x.ravel(), y.ravel()], -1), rtol=1e-6)
    np.testing.assert_array_equal(arrays["velocity"][:, 2], one.w.values.ravel())
    np.testing.assert_array_equal(arrays["quality"][:, 0], one.quality.values.ravel())


@pytest.fixture(scope="module")
def holed(cube):
    """Six steps, some with nodes of unknown elevation, one without any known."""
    out = cube.isel(time=slice(0, 6)).copy(deep=True)
    out.z[1:3, 4, 5] = np.nan
    out.z[3] = np.nan
    out.z[5, 0, 0] = np.nan
    return out


def write_holed(holed, path):
    write_vtkhdf(holed, (holed.isel(time=k) for k in range(6)), path)


def cells_and_height(file, step):
    """Corners of the cells of a step, and its points, as VTKHDF has it."""
    root, steps = file["VTKHDF"], file["VTKHDF/Steps"]
    part = steps["PartOffsets"][step]
    count, first = root["NumberOfCells"][part], steps["ConnectivityIdOffsets"][step, 0]
    assert (root["Types"][:][steps["CellOffsets"][step, 0] :][:count] == 9).all()
    offsets = root["Offsets"][:][steps["CellOffsets"][step, 0] + part :][: count + 1]
    np.testing.assert_array_equal(offsets, 4 * np.arange(count + 1))
    corners = root["Connectivity"][first : first + 4 * count].reshape(-1, 4)
    start = steps["PointOffsets"][step]
    return corners, root["Points"][start : start + root["NumberOfPoints"][part]]


def test_vtkhdf_holds_the_surface_of_every_step_and_its_cells_where_they_change(holed, tmp_path):
    write_holed(holed, tmp_path / "cube.vtkhdf")
    with h5py.File(tmp_path / "cube.vtkhdf") as file:
        assert file["VTKHDF/Steps/PartOffsets"][:].tolist() == [0, 1, 1, 2, 3, 4]
        np.testing.assert_array_equal(file["VTKHDF/Steps/Values"], holed.time)
        for step in range(6):
            one = holed.isel(time=step)
            corners, points = cells_and_height(file, step)
            known = np.isfinite(one.z.values)
            whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, 1:] & known[1:, :-1]
            assert len(corners) == whole.sum()
            np.testing.assert_allclose(
                points[corners, 0].mean(axis=1).sum(), whole_middles(one, whole), atol=1e-5
            )
            at = file["VTKHDF/Steps/PointDataOffsets/velocity"][step]
            velocity = file["VTKHDF/PointData/velocity"][at : at + known.size]
            np.testing.assert_array_equal(velocity[:, 2], one.w.values.ravel())


def whole_middles(one, whole):
    x = (one.x.values[1:] + one.x.values[:-1]) / 2
    return np.broadcast_to(x, whole.shape)[whole].sum()


def test_paraview_s_own_reader_reads_vtkhdf(reference, cube, holed, tmp_path):
    reading = pytest.importorskip("vtkmodules.vtkIOHDF", reason="needs VTK, whose reader ParaView uses")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    assert main(["-q", "export", str(reference), str(tmp_path / "cube.vtkhdf"), "--steps", "2:8:3"]) == 0
    write_holed(holed, tmp_path / "holed.vtkhdf")
    for name, steps in (("cube", cube.isel(time=slice(2, 8, 3))), ("holed", holed)):
        reader = reading.vtkHDFReader()
        reader.SetFileName(str(tmp_path / f"{name}.vtkhdf"))
        reader.UpdateInformation()
        for k in range(steps.sizes["time"]):
            one = steps.isel(time=k)
            reader.UpdateTimeStep(float(one.time))
            grid = reader.GetOutputDataObject(0)
            known = np.isfinite(one.z.values)
            whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, 1:] & known[1:, :-1]
            assert grid.GetNumberOfCells() == whole.sum()
            points = vtk_to_numpy(grid.GetPoints().GetData())
            np.testing.assert_array_equal(points[known.ravel(), 2], one.z.values[known])
            for field in ("z", "z_std", "quality"):
                found = vtk_to_numpy(grid.GetPointData().GetArray(field))
                np.testing.assert_array_equal(found, one[field].values.ravel())


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


def test_pivpy_gets_y_x_t_with_flags(cube):
    out = wf.to_pivpy(cube)
    assert out.u.dims == ("y", "x", "t")
    assert out.attrs["delta_t"] == pytest.approx(float(cube.time[1] - cube.time[0]))
    np.testing.assert_array_equal(out.chc.values == 1, (cube.quality.values & 1).transpose(1, 2, 0) == 1)
    np.testing.assert_array_equal(out.w.values, cube.w.values.transpose(1, 2, 0))


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
    (tmp_path / "cube_steps").mkdir()
    (tmp_path / "cube_steps" / "thesis.tex").write_text("years of work")
    with pytest.raises(StoreError, match="holds other files"):
        wf.export(reference, tmp_path / "cube.pvd")
    assert (tmp_path / "cube_steps" / "thesis.tex").read_text() == "years of work"
    with pytest.raises(StoreError, match="no such steps: it holds 16"):
        wf.export(reference, tmp_path / "cube.mat", slice(90, 99))
    assert main(["-q", "export", str(reference), str(tmp_path / "a.mat"), "--steps", "every"]) == 2
    assert "FIRST:STOP" in capsys.readouterr().err
