"""Shared by all tests: one thread per library, and where the real data lie."""

import gc
import os
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

gc.disable()  # until all is imported and collected: see below

import cv2
import pytest
from hypothesis import settings

cv2.setNumThreads(1)
settings.register_profile("wavefield", deadline=None, derandomize=True, max_examples=25)
settings.load_profile("wavefield")

SHARED = Path(os.environ.get("WAVEFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared"))


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with the real images and the peers' cases; skips the test where it is absent."""
    if not (SHARED / "data").is_dir():
        pytest.skip("needs the real images (set WAVEFIELD_SHARED to their folder)")
    return SHARED


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves pictures blank, for tests of what stands beside them: drawing is most of the time of a page."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, file, **how: file.write(b"\x89PNG"))


@pytest.fixture
def unarranged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws pictures, but leaves their parts where they lie: arranging them takes longer than drawing."""
    from matplotlib.figure import Figure

    def draw(figure: Figure, *to: object, **how: Any) -> None:
        figure.set_layout_engine("none")
        save(figure, *to, **how)

    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", draw)


# What takes longest comes first, so that no worker is left alone with it at the end. On a new machine the
# very first compiles the loops that measure, for a minute and a half: the other looks at waves meanwhile.
LONG = (
    "test_end_to_end",
    "test_analyze",
    "test_fusion",
    "test_figures",
    "test_report",
    "test_spectra",
    "test_dispersion",
    "test_referee",
    "test_cubes_run",
    "test_cubes_cluster",
    "test_cubes_analysis",
    "test_cubes_front",
    "test_cubes_verdict",
    "test_kernels",
    "test_light_sheet",
    "test_targets_printed",
    "test_solve_rest",
    "test_solve_rig",
    "test_two_cameras_at_sea",
)


def pytest_configure(config: pytest.Config) -> None:
    """With several workers (`-n 2`), leave each file to one, so that what its tests share is made once."""
    if getattr(config.option, "dist", "no") == "load":
        config.option.dist = "loadfile"
        config.option.loadscopereorder = False


def pytest_collection_finish() -> None:
    """Look for garbage in what tests leave, not in the libraries too: that is a tenth of the suite's time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that asks for the real images, so that `-m real_data` leaves none out."""
    for item in items:
        if "shared" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.real_data)


@pytest.hookimpl(specname="pytest_collection_modifyitems", trylast=True)  # after the order was shuffled
def pytest_collection_modifyitems_longest_first(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Hand the longest files to the workers first."""
    if hasattr(config, "workerinput"):
        place = {name: number for number, name in enumerate(LONG)}
        items.sort(key=lambda item: place.get(item.path.stem, len(LONG)))
