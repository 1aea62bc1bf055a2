"""Shared by all tests: one thread per library, and where the real data lie."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# a suite that was started in the background ignores Ctrl-C, and all that it starts would, too
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

gc.disable()  # until all is imported and collected: see below

import cv2
import numpy as np
import pytest
from cube_fixtures import cube, knocked, learned_once, measured, own_tank, reference, tank
from hypothesis import settings

# made once, for every room
__all__ = ["cube", "knocked", "learned_once", "measured", "own_tank", "reference", "tank"]

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


# a PNG file of one white pixel
BLANK = cv2.imencode(".png", np.full((1, 1), 255, np.uint8))[1].tobytes()


@pytest.fixture(scope="session", autouse=True)
def nothing_waits_for_the_disk() -> Iterator[None]:
    """Files of tests need not outlive a power cut: waiting for the disk is a tenth of a run here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda number: None)
        yield


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves pictures blank, for tests of what stands beside them: drawing is most of the time of a page."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, file, **how: file.write(BLANK))


@contextmanager
def _without_pixels() -> Iterator[None]:
    from matplotlib.figure import Figure

    def draw(figure: Figure, file: BinaryIO, **how: Any) -> None:
        figure.set_layout_engine("none")
        figure.draw_without_rendering()
        file.write(BLANK)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", draw)
        yield


@pytest.fixture(scope="session")
def without_pixels() -> Callable[[], AbstractContextManager[None]]:
    """Within it pictures are drawn but for their pixels, and not arranged: that takes half the time."""
    return _without_pixels


# What takes longest comes first, so that no worker is left alone with it at the end. On a new machine the
# very first compiles the loops that measure, for a minute and more: the other tests waves meanwhile.
LONG = [
    *("run", "end_to_end", "faults", "spectra", "verify", "analyze", "public_calls"),
    *("fusion", "record", "labels", "measure", "solve_rig", "light_sheet", "verdict", "dispersion"),
    *("knocked_camera", "follow", "current_fit", "smooth", "targets_printed", "page", "coherence"),
    *("relative_frame", "solve_rest", "targets_two_level", "camera_faults", "referee", "masked"),
    "run_options",
]


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
        place = {f"test_{name}": number for number, name in enumerate(LONG)}
        items.sort(key=lambda item: place.get(item.path.stem, len(LONG)))
