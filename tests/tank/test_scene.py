"""Scenes are read from YAML, and a wrong scene is refused with one sentence."""

import numpy as np
import pytest
import yaml

from wavefield.errors import ExperimentError
from wavefield.tank import Scene
from wavefield.tank.rigs import pixel_footprint


@pytest.mark.parametrize("name", sorted(Scene.presets()))
def test_presets_have_resolution_seeding_and_a_grid_in_view(name):
    scene = Scene.load(name)
    assert scene.name == name
    rig, (x, y) = scene.build_rig(), np.meshgrid(scene.grid.x_nodes, scene.grid.y_nodes)
    visible = np.logical_and.reduce([rig[camera].sees(x, y, 0.0) for camera in rig])
    assert visible.mean() > 0.97
    largest = 1e3 * max(max(pixel_footprint(rig[camera])) for camera in rig)  # mm
    low, high = {"sheet": (0.2, 0.3), "sea": (50, 150)}.get(scene.surface.kind, (1.0, 5))
    assert low < largest < high
    if scene.surface.kind == "beads":
        assert 15 <= scene.surface.density * 0.04**2 <= 20  # per 4 x 4 cm, the paper's finest block


def test_scene_survives_being_written_and_read(tmp_path):
    for name in ("demo", "texture", "steep"):
        scene = Scene.load(name).with_(sea={"depth": float("inf")})
        (tmp_path / "scene.yaml").write_text(scene.to_yaml())
        assert Scene.load(tmp_path / "scene.yaml") == scene


@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_paper_s_tank_is_seen_by_two_to_four_cameras(count):
    scene = Scene.load("demo").with_(rig={"cameras": count})
    assert list(scene.build_rig()) == ["cam1", "cam2", "cam3", "cam4"][:count]
    with pytest.raises(ExperimentError, match=f"names 'cam{count + 1}', which is no camera"):
        scene.with_(faults={f"cam{count + 1}": {"late": 1}})


def test_rig_file_is_found_beside_the_scene(tmp_path):
    demo = Scene.load("demo")
    demo.build_rig().save(tmp_path / "mine.yaml")
    data = yaml.safe_load(demo.to_yaml()) | {"rig": {"file": "mine.yaml"}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(data))
    assert dict(Scene.load(tmp_path / "scene.yaml").build_rig().cameras) == dict(demo.build_rig().cameras)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sea": {"kind": "random", "rms": -1, "spectrum": {"kind": "power", "peak": 1}}}, "sea.rms"),
        ({"sea": {"kind": "tsunami"}}, "tsunami"),
        ({"sea": {"rms": 0.01}}, "kind"),
        ({"sea": {"kind": "single", "amplitude": 0.01}}, "sea.wavelength is missing"),
        ({"frames": 0}, "frames"),
        ({"framerate": 20}, "framerate is not a known key; did you mean 'frame_rate'"),
        ({"light": {"bits": 12}}, "light.bits"),
        ({"light": {"gain": {"cam9": 2.0}}}, "cam9"),
        ({"faults": {"cam8": {"late": 1}}}, "faults names 'cam8'"),
        ({"faults": {"cam1": {"shows": "cam7"}}}, "cam7"),
        ({"surface": {"hole_diameter": [0.2, 0.1]}}, "surface.hole_diameter"),
        ({"grid": {"x": [1, -1], "y": [0, 1], "step": 0.1}}, "grid"),
        ({"surface": {"density": 0}}, "surface.density"),
        ({"surface": {"kind": "oil"}}, "oil"),
        ({"surface": {"kind": "sheet"}, "sea": {"kind": "still", "current": [0.1, 0]}}, "a flow of its own"),
        ({"surface": {"kind": "sheet"}, "faults": {"cam1": {"delay": 0.001}}}, "a delay is not simulated"),
        ({"surface": {"kind": "sheet"}, "timing": {"jitter": 0.001}}, "jitter is not simulated"),
        ({"surface": {"kind": "sheet", "thickness": 0}}, "surface.thickness"),
        ({"rig": {"angle": 90}}, ": rig.angle "),
        ({"calibration": {"target": {"kind": "strings", "mesh": "wide"}}}, "calibration.target.mesh"),
        ({"rig": {"scale": 9}}, ": rig.scale "),
        ({"rig": {"file": 3}}, ": rig.file "),
    ],
)
def test_wrong_settings_are_named(tmp_path, changes, words):
    data = {"sea": {"kind": "still"}} | changes
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(ExperimentError) as caught:
        Scene.load(path)
    message = str(caught.value)
    assert str(path) in message
    assert words in message
    assert "\n" not in message
    assert len(message) < 300


def test_grid_is_what_all_cameras_see_unless_it_is_given():
    scene = Scene.from_dict({"sea": {"kind": "still"}, "rig": {"crop": 0.3}})
    x, y = scene.grid.x_nodes, scene.grid.y_nodes
    assert x[-1] - x[0] > 0.4
    for camera in scene.build_rig().cameras.values():
        for corner_x, corner_y in ((x[0], y[0]), (x[-1], y[-1]), (x[0], y[-1]), (x[-1], y[0])):
            assert camera.sees(corner_x, corner_y, 0.0, 10.0)
