"""Target images in the page of a cube, with what is found in them."""

import numpy as np
import pytest
from bokeh.document import Document
from explorer_cases import make_cube

from wavefield.explorer.look_page import LookPage
from wavefield.explorer.place import Place
from wavefield.explorer.session import LookSession
from wavefield.images import write_image

SQUARE, SHAPE = 24, (7, 5)  # px; inner corners along a row, and rows
NOISE = np.random.default_rng(1)


def chessboard():
    """A board seen from straight above, with a white border."""
    rows, columns = np.mgrid[: (SHAPE[1] + 1) * SQUARE, : (SHAPE[0] + 1) * SQUARE] // SQUARE
    board = np.where((rows + columns) % 2, 220, 30).astype(np.uint8)
    return np.pad(board, 2 * SQUARE, constant_values=220)


@pytest.fixture
def page(tmp_path, tank_rig):
    """Of a cube whose experiment names a chessboard, and an image without one."""
    image = chessboard()
    for camera in ("cam1", "cam2"):
        for frame in range(3):
            write_image(tmp_path / camera / f"img_{frame}.tif", image)
        write_image(tmp_path / camera / "target_a.tif", image)
        write_image(tmp_path / camera / "target_b.tif", NOISE.integers(60, 120, image.shape).astype(np.uint8))
    cameras = "".join(f'  {name}: "{name}/img_{{frame:d}}.tif"\n' for name in ("cam1", "cam2"))
    (tmp_path / "experiment.yaml").write_text(
        f"name: lab\nframe_rate: 20\ncameras:\n{cameras}"
        "calibration:\n  target: {kind: chessboard, mesh: 0.05, shape: [7, 5]}\n"
        '  tilted: "{camera}/target_*.tif"\n'
    )
    rig = {name: tank_rig[name].to_dict() for name in ("cam1", "cam2")}
    make_cube(tmp_path / "cube.zarr", rig=rig, experiment_file=str(tmp_path / "experiment.yaml"))
    session = LookSession(tmp_path / "cube.zarr")
    out, document = LookPage(session, Place(tab="cameras")), Document()
    out.attach(document)
    return out


def test_the_nodes_that_are_found_are_drawn_over_the_image(page):
    cameras = page.panels.cameras()
    assert cameras.frame.options == ["first frame", "second frame", "target: target_a", "target: target_b"]
    cameras.frame.value = "target: target_a"
    cameras.show(page.place)
    corners = 3 * SQUARE - 0.5 + SQUARE * np.mgrid[: SHAPE[1], : SHAPE[0]][::-1].reshape(2, -1).T
    found = np.column_stack([cameras.sources["target"].data["X"], cameras.sources["target"].data["Y"]])
    for corner in corners:
        assert np.hypot(*(found - corner).T).min() < 0.1
    assert len(found) == len(corners)
    assert "35 nodes found in target_a.tif" in cameras.words.text
    assert cameras.figure.title.text == "cam1, target: target_a"


def test_an_image_without_a_target_is_shown_with_a_sentence(page):
    cameras = page.panels.cameras()
    cameras.frame.value = "target: target_b"
    cameras.show(page.place)
    assert len(cameras.sources["image"].data["image"]) == 1
    assert len(cameras.sources["target"].data["X"]) == 0
    assert "target_b" in cameras.words.text or "no " in cameras.words.text
    cameras.frame.value = "first frame"
    cameras.show(page.place)
    assert cameras.figure.title.text == "cam1, frame 0"
