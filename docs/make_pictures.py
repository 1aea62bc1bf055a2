"""Draw the pictures of README and how-to pages: `python docs/make_pictures.py wavefield-demo trial platform`.

The folders come from `wavefield demo`, `wavefield simulate sheet trial`, `wavefield simulate sea platform`.
Two pictures are photographs of pages; they need the extra `browser` and Chromium.
"""

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from playwright.sync_api import sync_playwright

import wavefield as wf
from wavefield import figures
from wavefield.images import read_image
from wavefield.reports import errors_against
from wavefield.tank import Tank

DOCS = Path(__file__).parent
PICTURES = DOCS / "pictures"
REPORT, PAGE = (1260, 770), (1260, 800)  # px: verdict, first map and key numbers of a report; a page


def save(figure: Figure, name: str) -> None:
    """Write a figure as a small JPEG."""
    figure.savefig(PICTURES / f"{name}.jpg", dpi=90, pil_kwargs={"quality": 80})


def images(name: str, titles: Sequence[str], frames: Sequence[np.ndarray], **limits: Any) -> Figure:
    """Draw grey images next to each other and write them."""
    figure = Figure(figsize=(9, 3.3), layout="constrained")
    for axes, title, frame in zip(figure.subplots(1, len(frames)), titles, frames):
        axes.imshow(frame, cmap="gray", **limits)
        axes.set_title(title, fontsize=10)
        axes.set(xticks=[], yticks=[])
    save(figure, name)
    return figure


def from_experiments(demo: Path, sheet: Path, sea: Path) -> None:
    """Draw images, rig, errors and smoothed values of simulated experiments."""
    cameras = ["cam1", "cam2", "cam3"]
    images("target", cameras, [read_image(demo / "calib" / name / "tilt_1.tif") for name in cameras])
    images(
        "sheet", ["left", "right"], [read_image(path) for path in sorted(sheet.glob("cam*/img_00000.tif"))]
    )
    images("sea", ["left", "right"], [read_image(sea / name / "img_00000.tif") for name in ("left", "right")])
    densities = {4: "4 beads per 4 x 4 cm: too few", 16: "16: right", 64: "64: too many"}
    tanks = [Tank(wf.Scene.load("demo").with_(surface={"density": n / 0.04**2})) for n in densities]
    frames = [tank.render(0, ["cam1"])["cam1"] for tank in tanks]
    middle = tuple(slice(n // 2 - 45, n // 2 + 45) for n in frames[0].shape)  # px: 17 cm
    images("beads", list(densities.values()), [frame[middle] for frame in frames], vmin=0, vmax=255)
    scene = wf.Scene.load("two_cameras")
    save(figures.rig_views(scene.build_rig(), scene.grid), "rig")
    run = wf.open_run(demo / "cube.zarr")
    save(figures.uncertainty_maps(run.cube), "uncertainty")
    assert run.truth is not None  # the demo has one
    errors = [errors_against(cube, run.truth).w[20].values for cube in (run.cube, wf.smooth(run.cube))]
    limit = 3 * float(np.std(errors[0]))
    images("smooth", ["error of w, measured", "smoothed"], errors, vmin=-limit, vmax=limit)


def photographs(demo: Path) -> None:
    """Photograph the head of the report, and the page of a cube."""
    served = wf.look(demo / "cube.zarr")
    pages = (
        (DOCS / "report.jpg", (demo / "report.html").absolute().as_uri(), REPORT),
        (PICTURES / "look.jpg", served.url, PAGE),
    )
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for path, address, (width, height) in pages:
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(address)
            page.wait_for_timeout(4000)  # scripts draw the maps
            page.screenshot(path=path, type="jpeg", quality=80)
        browser.close()
    served.stop()


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    from_experiments(*map(Path, sys.argv[1:4]))
    photographs(Path(sys.argv[1]))
