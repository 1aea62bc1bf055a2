"""Series that are worked out at a node; cubes of which a part is missing."""

import shutil

import numpy as np
import pytest
from explorer_cases import create_cube, make_cube, write_cube_block

from wavefield.errors import StoreError
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.place import Place
from wavefield.explorer.save import as_csv, node_series, step_fields
from wavefield.explorer.server import make_server
from wavefield.explorer.whole_record import derived_series
from wavefield.figures.display import DERIVED
from wavefield.pipeline import open_cube
from wavefield.waves import kinematics


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    path = tmp_path_factory.mktemp("derived") / "cube.zarr"
    make_cube(path)
    return path


@pytest.mark.parametrize("node", [(8, 9), (0, 19), (2, 4)])
def test_a_derived_series_is_that_of_the_analysis(cube, node):
    expected = kinematics(open_cube(cube).load())
    reported = []
    found = derived_series(CubeRecord(cube), *node, reported.append)
    assert set(found) == set(DERIVED)
    for name, series in found.items():
        np.testing.assert_allclose(series, expected[name].values[:, *node], rtol=1e-4, atol=1e-6)
    assert reported[-1] == 1.0


def test_saved_series_and_steps_hold_what_is_derived(cube):
    record = CubeRecord(cube)
    record.preview.load()
    expected = kinematics(open_cube(cube).load())
    place = Place(node=(float(record.x[9]), float(record.y[8])), step=41)
    series, step = node_series(record, place), step_fields(record, place)
    there = {"x": float(series.x), "y": float(series.y)}
    for name in DERIVED:
        at_node = expected[name].sel(there, method="nearest").values
        np.testing.assert_allclose(series[name].values, at_node, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(step[name].values, expected[name].values[41], rtol=1e-4, atol=1e-6)
    head = as_csv(series).split(b"\n", 1)[0].decode()
    assert "vorticity (s-1)" in head
    assert "residual (m s-1)" in head


def test_a_derived_map_is_that_of_the_analysis(cube):
    expected = kinematics(open_cube(cube).load())
    record = CubeRecord(cube)
    for name in DERIVED:
        np.testing.assert_allclose(record.field(name, 41), expected[name].values[41], rtol=1e-4, atol=1e-6)


def test_steps_to_come_are_empty(tmp_path):
    path = tmp_path / "cube.zarr"
    create_cube(path)
    write_cube_block(path, 40)
    series = derived_series(CubeRecord(path), 8, 9)["vorticity"]
    assert np.isfinite(series[40:80]).all()
    assert np.isnan(series[:40]).all()
    assert np.isnan(series[80:]).all()


def test_half_a_cube_is_a_sentence_that_names_what_is_missing(cube, tmp_path):
    half = tmp_path / "cube.zarr"
    shutil.copytree(cube, half)
    shutil.rmtree(half / "u" / "c" / "1")
    record = CubeRecord(half)
    assert np.isfinite(record.field("u", 3)).any()
    with pytest.raises(
        StoreError, match=r"u of steps 40 to 79 is not in cube\.zarr.*copy the complete cube again"
    ):
        record.field("u", 50)


def test_a_cube_without_a_velocity_shows_what_it_has(cube, tmp_path):
    part = tmp_path / "cube.zarr"
    shutil.copytree(cube, part)
    shutil.rmtree(part / "v")
    (part / "checksum" / "metadata.zip").unlink()  # as of a cube from before
    record = CubeRecord(part)
    assert "u" in record.names
    assert not {"v", "vorticity", "residual"} & set(record.names)
    assert derived_series(record, 8, 9) == {}


def test_a_port_that_is_taken_is_a_sentence():
    first = make_server(lambda document: None, 0)
    try:
        from wavefield.errors import WavefieldError

        with pytest.raises(WavefieldError, match=rf"port {first.port} is taken; choose another with --port"):
            make_server(lambda document: None, first.port)
    finally:
        first.stop()
