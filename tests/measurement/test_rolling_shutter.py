import numpy as np
import pytest

from wavefield.errors import ExperimentError
from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Settings
from wavefield.measurement.midtime import common_lateness, elevation_errors, lateness
from wavefield.series import Experiment
from wavefield.tank import Scene

ROWS = {"cam1": 3e-4, "cam2": -2e-4, "cam3": 5e-4}


@pytest.mark.parametrize("seed", range(2))
def test_what_differs_between_the_cameras_is_taken_off_the_elevation(seed):
    rig = Scene.load("demo").with_(rig={"crop": 0.4}).build_rig()
    geometry = GridGeometry(
        rig, Grid((-0.2, 0.2), (-0.15, 0.15), 0.05), Settings(row_delays=tuple(ROWS.items()))
    )
    z0, d = 0.01, np.random.default_rng(seed).normal(0, 6e-3, 3)
    z = np.full(geometry.x.shape, z0)
    late, mean = lateness(z, geometry), common_lateness(z, geometry)
    seen = {}
    for name, tau in late.items():  # where a camera shows what is at a node on the plane z = 0
        at = [v + (tau - mean) * step for v, step in zip((geometry.x, geometry.y, z), d)]
        Dx, Dy = rig[name].sight_line(*at)
        seen[name] = np.stack([at[0] - Dx * at[2], at[1] - Dy * at[2]])
    a = geometry.reference
    parallax = {n: np.stack(rig[n].sight_line(geometry.x, geometry.y, z)) for n in late}
    along = sum(-((parallax[b] - parallax[a]) * (seen[b] - seen[a])).sum(0) for _, b in geometry.pairs)
    found = along / sum(np.square(parallax[b] - parallax[a]).sum(0) for _, b in geometry.pairs)
    moved = np.broadcast_to(d[:, None, None], (3, *z.shape))
    error, place = elevation_errors(z, moved, geometry)
    assert np.abs(error).max() > 2e-6
    np.testing.assert_allclose(found - z0, error, atol=0.03 * np.abs(error).max() + 1e-8)
    label = seen[a] + parallax[a] * found
    np.testing.assert_allclose(label - [geometry.x, geometry.y], place, atol=0.03 * np.abs(place).max())


def test_the_row_time_of_a_camera_belongs_to_settings_and_recipe(tmp_path):
    from wavefield.execution.workflow import Workflow
    from wavefield.pipeline.prepare import make_settings

    path = tmp_path / "experiment.yaml"
    text = "name: a\nframe_rate: 25\nrig: rig.yaml\ncameras:\n  left: {images: a/*.tif, row_time: 1.0e-5}\n"
    text += "  right: b/*.tif\n"
    path.write_text(text)
    settings = make_settings(Experiment.load(path), Workflow())
    assert settings.row_delays == (("left", pytest.approx(2.5e-4)),)
    assert Settings.from_dict(settings.to_dict()) == settings
    assert "row_delays" not in Settings().to_dict(), "recipes of other cubes stay as they are"
    path.write_text(text.replace("1.0e-5", "fast"))
    with pytest.raises(ExperimentError, match="row_time"):
        Experiment.load(path)
