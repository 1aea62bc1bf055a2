import re

import pytest
from cube_cases import HERE

from wavefield.errors import RigError
from wavefield.pipeline import open_cube, run


def with_grid(note, x, y):
    text = re.sub(r"(?m)^grid:.*\n", "", note.read_text())
    note.write_text(
        f"{text}grid: {{x: [{-x}, {x}], y: [{-y}, {y}], step: 0.003}}\nframes: {{first: 0, last: 5}}\n"
        "settings: {z_range: [-0.03, 0.03]}\nsurface: {pairs: [[cam1, cam2]]}\n"
        "velocity: {cameras: [cam1, cam2]}\n"
    )


def test_a_grid_narrower_than_a_patch_is_measured(own_tank, tmp_path):
    with_grid(own_tank, 0.01, 0.06)
    cube = open_cube(run(own_tank, out=tmp_path / "cube.zarr", workflow=HERE).store)
    assert cube.z.notnull().mean() > 0.9


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (0.06, 0.01, r"too small: .* matching needs [\d.]+ mm along each side; enlarge `grid`"),
        (0.004, 0.004, r"too small: .* matching needs"),
        (0.002, 0.06, "2 x 41 nodes, and slopes need 3 along each side: enlarge `grid`, or lower"),
    ],
)
def test_a_grid_that_cannot_be_measured_is_refused_with_its_size(own_tank, tmp_path, x, y, words):
    with_grid(own_tank, x, y)
    with pytest.raises(RigError, match=words):
        run(own_tank, out=tmp_path / "cube.zarr", workflow=HERE)
