import numpy as np
import pytest

from wavefield.pipeline.assess import compare_cameras
from wavefield.pipeline.prepare import prepare
from wavefield.tank import Scene, simulate


@pytest.mark.parametrize(
    ("thickness", "found"), [(0.0005, []), (0.004, [("light sheet", "remark")])], ids=["thin", "deep"]
)
def test_a_sound_light_sheet_is_not_called_untrustworthy_for_its_depth(thickness, found, tmp_path):
    surface = {"kind": "sheet", "thickness": thickness}
    scene = Scene.load("sheet").with_(frames=2, seed=11, surface=surface, calibration={"tilted": 0})
    experiment = simulate(scene, tmp_path, workers=1)
    remarks = compare_cameras(prepare(experiment, scene.build_rig()), np.zeros(0, np.uint16)).remarks
    assert [(one.kind, one.weight) for one in remarks] == found
