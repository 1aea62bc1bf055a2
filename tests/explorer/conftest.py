"""A cube with rig, images, probes and waves, its page, and a browser; made once."""

import os
from pathlib import Path

import numpy as np
import pytest
from browser import FLAGS, Browser, chromium
from explorer_cases import make_cube

GRID = {"steps": 160, "ny": 16, "nx": 20, "block": 40}


@pytest.fixture(scope="session")
def tank_rig():
    from wavefield.tank import Scene, Tank

    return Tank(Scene.load("demo").with_(rig={"crop": 0.12})).rig


@pytest.fixture(scope="session")
def whole(tmp_path_factory, tank_rig):
    """A cube with rig, images, probes and waves; returns its path and its fields."""
    from wavefield import analyze
    from wavefield.images import write_image

    folder = tmp_path_factory.mktemp("whole")
    tank_rig.save(folder / "rig.yaml")
    rng = np.random.default_rng(11)
    for name in tank_rig:
        width, height = tank_rig[name].size
        for frame in range(6):
            image = rng.integers(20, 200, (height, width)).astype(np.uint8)
            write_image(folder / name / f"img_{frame:05d}.tif", image)
    time = np.arange(0, 8.2, 0.02)
    probe = 0.01 * np.sin(2 * np.pi * 1.1 * time)
    rows = "\n".join(f"{t:.3f},{z:.6f}" for t, z in zip(time, probe))
    (folder / "probes.csv").write_text(f"time,p1\n{rows}\n")
    cameras = "\n".join(f'  {name}: "{name}/img_{{frame:05d}}.tif"' for name in tank_rig)
    (folder / "experiment.yaml").write_text(
        f"name: whole\nframe_rate: 20\nframes: {{first: 0, last: {GRID['steps']}}}\ncameras:\n{cameras}\n"
        "rig: rig.yaml\nprobes: {file: probes.csv, places: {p1: [0.1, 0.1]}}\n"
    )
    path = folder / "cube.zarr"
    rig = {name: tank_rig[name].to_dict() for name in tank_rig}
    fields = make_cube(path, rig=rig, experiment_file=str(folder / "experiment.yaml"), **GRID)
    analyze(path, folder / "waves.zarr")
    return path, fields


@pytest.fixture(scope="session")
def served(whole):
    """The page of that cube, served as in a notebook."""
    from wavefield.explorer.server import look

    page = look(whole[0])
    yield page
    page.stop()


@pytest.fixture(scope="session")
def chrome():
    """A headless Chromium; skips if there is none or WAVEFIELD_BROWSER is not set."""
    if not os.environ.get("WAVEFIELD_BROWSER"):
        pytest.skip("drives a browser for minutes: asked for with WAVEFIELD_BROWSER=1, as .ci/run does")
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
    path = os.environ.get("WAVEFIELD_CHROMIUM") or chromium()
    if path is None or not Path(path).exists():
        pytest.skip("needs Chromium: apt-get install chromium")
    with sync_api.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=FLAGS.split())
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def page(chrome, served):
    """The page of the cube in a window of 1400 x 900; fails if the page logs an error."""
    window = chrome.new_page(viewport={"width": 1400, "height": 900})
    driver = Browser(window)
    driver.open(served.url)
    yield driver
    window.close()
    assert driver.errors == []
    assert driver.outside == []
