import json

import numpy as np
import pytest
from cube_cases import HERE

from wavefield.pipeline import open_cube, run
from wavefield.variables import Quality

MASK = "mask: {water: {polygon: [[-0.015, -0.015], [0.015, -0.015], [0.0, 0.015]]}}\n"
MASKED = int(Quality.MASKED)


@pytest.fixture
def masked(own_tank):
    own_tank.write_text(own_tank.read_text() + MASK + "frames: {first: 0, last: 4}\n")
    return own_tank


def test_masked_nodes_stay_empty_in_the_cube_and_the_recipe_holds_what_was_masked(masked, tmp_path):
    out = tmp_path / "cube.zarr"
    status = run(masked, out=out, workflow=HERE)
    assert status.complete
    cube = open_cube(out)
    hidden = (cube.quality.values & MASKED) != 0
    assert 0 < hidden[0].sum() < 0.5 * hidden[0].size
    for name in ("z", "z_t", "u", "v", "w"):
        np.testing.assert_array_equal(np.isnan(cube[name].values), hidden, err_msg=name)
    assert json.loads(cube.attrs["recipe"])["mask"]["water"][0]["polygon"][2] == [0.0, 0.015]
    assert "masked" in cube.quality.attrs["flag_meanings"]
