"""Targets to print: to scale on the page, and found by the program in their own picture."""

import io
import re
import zlib

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from wavefield.calibration.find import find_target
from wavefield.calibration.target import Target
from wavefield.commands.cli import main
from wavefield.figures.target_page import MM_PER_INCH, page_size, target_page, target_shapes

PIXELS_PER_MM = 4.0
POINTS_PER_MM = 72 / MM_PER_INCH
TARGETS = {
    "chessboard": Target("chessboard", mesh=0.025, shape=(9, 6)),
    "charuco": Target("charuco", mesh=0.025, shape=(10, 7), marker=0.0175),
    "dots": Target("dots", mesh=0.02, shape=(11, 8), diameter=0.009),
    "rings": Target("dots", mesh=0.02, shape=(11, 8), diameter=0.009, origin_mark="ring"),
}


def picture_of(figure):
    """The page as a grey image, PIXELS_PER_MM."""
    figure.set_dpi(PIXELS_PER_MM * MM_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., 0]


@pytest.mark.parametrize("kind", TARGETS)
def test_a_printed_target_is_found_in_the_picture_of_its_page_to_scale(kind):
    target = TARGETS[kind]
    found = find_target(picture_of(target_page(target)), target)
    nx, ny = target.shape if kind != "charuco" else (target.shape[0] - 1, target.shape[1] - 1)
    assert len(found) == nx * ny - (3 if kind == "rings" else 0)
    # nodes are a mesh apart, x to the right and y upwards: the lower left one is the first
    pixel = found.pixel * [1, -1]
    design = np.c_[found.node, np.ones(len(found))]
    fit, *_ = np.linalg.lstsq(design, pixel, rcond=None)
    mesh = 1e3 * target.mesh * PIXELS_PER_MM
    assert fit[:2] == pytest.approx(np.eye(2) * mesh, abs=0.003 * mesh / max(nx, ny))
    assert np.abs(design @ fit - pixel).max() < 0.1


def _extent_mm(pdf):
    """Width and height of the page, and of all rectangles that are drawn, mm."""
    box = [float(word) for word in re.search(rb"/MediaBox \[([^\]]*)\]", pdf)[1].split()]
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.S)
    page = next(text for text in map(_inflated, streams) if b"BT" in text).decode("latin-1")
    corners = np.array(re.findall(r"^([\d.]+) ([\d.]+) [ml]$", page, re.M), float)
    inside = ((corners > 1) & (corners < np.array(box[2:]) - 1)).all(axis=1)
    return np.array(box[2:]) / POINTS_PER_MM, corners[inside] / POINTS_PER_MM


def _inflated(data):
    try:
        return zlib.decompress(data)
    except zlib.error:
        return b""


@pytest.mark.parametrize(("mesh", "paper"), [(0.025, (297, 210)), (0.01, (210, 297)), (0.03, (420, 297))])
def test_lengths_in_the_pdf_are_exact(mesh, paper):
    target = Target("chessboard", mesh=mesh, shape=(9, 6))
    file = io.BytesIO()
    target_page(target).savefig(file, format="pdf")
    page, corners = _extent_mm(file.getvalue())
    assert page == pytest.approx(paper, abs=1e-3)
    board = corners[corners[:, 1] > 20]  # above the caption
    assert np.ptp(board, axis=0) == pytest.approx([10e3 * mesh, 7e3 * mesh], abs=1e-3)
    line = corners[corners[:, 1] < 11]
    assert np.ptp(line[:, 0]) == pytest.approx(100, abs=1e-3)


def test_a_target_is_written_as_pdf_with_its_entry_and_never_over_other_files(tmp_path, capsys):
    file = tmp_path / "board.pdf"
    assert main(["target", "charuco", str(file), "--mesh", "0.03"]) == 0
    assert "target: {kind: charuco, mesh: 0.03, shape: [10, 7], marker: 0.021" in capsys.readouterr().out
    assert file.read_bytes().startswith(b"%PDF-")
    assert main(["-q", "target", "dots", str(file)]) == 0  # one of ours is replaced
    file.write_bytes(b"%PDF-1.4 a thesis")
    assert main(["target", "dots", str(file)]) == 1
    assert "is not a target to print" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["charuco", "--shape", "40x30"], "choose a larger dictionary"),
        (["chessboard", "--mesh", "0.3"], "does not fit A0"),
        (["dots", "--diameter", "0.03"], "larger than its mesh"),
        (["chessboard", "--mesh", "25"], "mesh: give metres, above 0.00005 and below 2"),
    ],
)
def test_a_target_that_cannot_be_printed_is_refused_with_the_remedy(words, reason, tmp_path, capsys):
    assert main(["target", words[0], str(tmp_path / "a.pdf"), *words[1:]]) == 1
    assert reason in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_page_as_large_as_the_board_holds_any():
    shapes = target_shapes(Target("chessboard", mesh=0.3, shape=(9, 6)))
    width, height = page_size(shapes, "fit")
    assert width > 3000
    assert height > 2100
