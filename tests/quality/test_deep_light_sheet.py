import numpy as np
import pytest
import yaml

from wavefield.images import write_image
from wavefield.pipeline.assess import compare_cameras
from wavefield.pipeline.prepare import prepare
from wavefield.tank import Scene
from wavefield.tank.tank import Tank


@pytest.mark.parametrize(
    ("thickness", "found"), [(0.0005, []), (0.004, [("light sheet", "remark")])], ids=["thin", "deep"]
)
def test_a_sound_light_sheet_is_not_called_untrustworthy_for_its_depth(thickness, found, tmp_path):
    tank = Tank(
        Scene.load("sheet").with_(
            frames=2,
            seed=11,
            surface={"kind": "sheet", "thickness": thickness},
        )
    )
    tank.rig.save(tmp_path / "rig.yaml")
    for number in range(2):
        for name, image in tank.render(number).items():
            write_image(tmp_path / name / f"img_{number:05d}.tif", image)
    experiment = {
        "name": "sheet",
        "frame_rate": 20.0,
        "rig": "rig.yaml",
        "cameras": {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in tank.rig},
        "settings": {"preset": "sheet", "sheet_thickness": thickness},
    }
    (tmp_path / "experiment.yaml").write_text(yaml.safe_dump(experiment))
    remarks = compare_cameras(prepare(tmp_path / "experiment.yaml"), np.zeros(0, np.uint16)).remarks
    assert [(one.kind, one.weight) for one in remarks] == found
