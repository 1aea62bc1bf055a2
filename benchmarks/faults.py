"""Faulty experiments that `wavefield check` calls sound, and sound ones that it does not; small tanks.

    python -m benchmarks.faults [--only NAME ...] [--sound] [--seeds N] [--first SEED] [--save]

Every fault of images, numbers, units or disk is put into a small simulated experiment of its own. It is found
if `check` refuses it or gives a remark of weight (exit status 1 or 3). ``--sound``: experiments without a
fault, of other seas, files and numbers; any remark of weight is a false alarm.
"""

import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import cv2
import numpy as np
import tifffile
import yaml
from numpy.typing import NDArray

from benchmarks.results import parser_of, print_table, save_result
from wavefield.errors import WavefieldError
from wavefield.images import read_image, write_image
from wavefield.pipeline import check
from wavefield.tank import Scene, Tank

FRAMES = 13
FIRST = 301  # seed; none of them was tuned on
WIDTH = 150  # characters of the words that are printed
SMALL: dict[str, Any] = {"rig": {"crop": 0.25}, "sea": {"shortest": 0.15}}
GRID: dict[str, Any] = {"x": [-0.15, 0.15], "y": [-0.1, 0.1], "step": 0.01}

Spoil = Callable[[Path], None]
Function = Callable[[NDArray[Any]], NDArray[Any]]


def write_experiment(folder: Path, seed: int = FIRST, frames: int = FRAMES, **scene: Any) -> Path:
    """Images of a small tank, its rig and its experiment file; returns the file."""
    tank = Tank(Scene.load("demo").with_(seed=seed, **SMALL).with_(**scene))
    folder.mkdir(parents=True)
    tank.rig.save(folder / "rig.yaml")
    for number in range(frames):
        for name, image in tank.render(number).items():
            write_image(folder / name / f"img_{number:05d}.tif", image)
    note = {
        "name": "small-tank",
        "frame_rate": tank.scene.frame_rate,
        "cameras": {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in tank.rig},
        "rig": "rig.yaml",
        "grid": GRID,
        "water": {"depth": 0.7},
    }
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump(note, sort_keys=False))
    return path


def outcome(path: Path) -> tuple[int, str]:
    """Exit status of `check`, and the words that it gives."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = check(path)
        except WavefieldError as error:
            return 1, str(error)
    words = [*found.problems, *(str(r) for r in (found.verdict.remarks if found.verdict else ()))]
    weighty = [str(r) for r in (found.verdict.remarks if found.verdict else ()) if r.weight != "note"]
    return found.exit_status, "; ".join([*found.problems, *weighty] or words)


# -- faults --------------------------------------------------------------------------------------------------


def files_of(folder: Path, camera: str) -> list[Path]:
    return sorted((folder / camera).iterdir())


def images(camera: str, function: Function, which: slice = slice(None)) -> Spoil:
    """Some images of a camera are changed."""

    def spoil(folder: Path) -> None:
        for file in files_of(folder, camera)[which]:
            write_image(file, function(read_image(file)))

    return spoil


def all_images(function: Function) -> Spoil:
    """All images of all cameras are changed."""

    def spoil(folder: Path) -> None:
        for camera in ("cam1", "cam2", "cam3"):
            images(camera, function)(folder)

    return spoil


def data(camera: str, function: Callable[[bytes], bytes], which: slice = slice(None)) -> Spoil:
    """The bytes of some files are changed."""

    def spoil(folder: Path) -> None:
        for file in files_of(folder, camera)[which]:
            file.write_bytes(function(file.read_bytes()))

    return spoil


def removed(camera: str, which: slice) -> Spoil:
    def spoil(folder: Path) -> None:
        for file in files_of(folder, camera)[which]:
            file.unlink()

    return spoil


def numbered(camera: str, number: Callable[[int], int]) -> Spoil:
    """The files of a camera have other numbers."""

    def spoil(folder: Path) -> None:
        there = files_of(folder, camera)
        for k, file in enumerate(there):
            file.rename(file.with_name(f"new_{number(k):05d}.tif"))
        for file in files_of(folder, camera):
            file.rename(file.with_name(file.name.replace("new_", "img_")))

    return spoil


def frozen(camera: str, every: int) -> Spoil:
    """Images are those of the frame before."""

    def spoil(folder: Path) -> None:
        there = files_of(folder, camera)
        for k in range(1, len(there)):
            if k % every:
                shutil.copy(there[k - 1], there[k])

    return spoil


def by_tens(folder: Path) -> None:
    for camera in ("cam1", "cam2", "cam3"):
        numbered(camera, lambda k: 10 * k)(folder)


def twice(folder: Path) -> None:
    shutil.copy(folder / "cam2" / "img_00004.tif", folder / "cam2" / "img_4.tif")


def swapped(folder: Path) -> None:
    (folder / "cam1").rename(folder / "other")
    (folder / "cam2").rename(folder / "cam1")
    (folder / "other").rename(folder / "cam2")


def copied(folder: Path) -> None:
    shutil.rmtree(folder / "cam2")
    shutil.copytree(folder / "cam1", folder / "cam2")


def note(**entries: Any) -> Spoil:
    """Entries of the experiment file are others."""

    def spoil(folder: Path) -> None:
        path = folder / "experiment.yaml"
        path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **entries}, sort_keys=False))

    return spoil


def text(old: str, new: str) -> Spoil:
    """The text of the experiment file is another."""

    def spoil(folder: Path) -> None:
        path = folder / "experiment.yaml"
        before = path.read_text()
        assert old in before
        path.write_text(before.replace(old, new))

    return spoil


def grid(along: float, step: float) -> Spoil:
    """Lengths of the grid in another unit."""
    sides = {side: [along * end for end in GRID[side]] for side in ("x", "y")}
    return note(grid={**sides, "step": step * GRID["step"]})


def rig(factor: float) -> Spoil:
    """Lengths of the rig in another unit."""

    def spoil(folder: Path) -> None:
        path = folder / "rig.yaml"
        cameras = yaml.safe_load(path.read_text())
        for camera in cameras["cameras"].values():
            camera["translation"] = [factor * length for length in camera["translation"]]
        path.write_text(yaml.safe_dump(cameras))

    return spoil


def covered(folder: Path) -> None:
    height, width = read_image(folder / "cam3" / "img_00000.tif").shape
    polygon = [[-1, -1], [0.97 * width, -1], [0.97 * width, height], [-1, height]]
    note(mask={"cam3": {"polygon": polygon}})(folder)


def full_disk(folder: Path) -> None:
    """Marked by a file: `free_bytes` gives the room that it names."""
    (folder / "free").write_text("100")


def free_bytes(path: Path) -> Any:
    """As `shutil.disk_usage`, with the room that a fault left."""
    mark = Path(path) / "free"
    return SimpleNamespace(free=int(mark.read_text()) if mark.exists() else 10**12)


HALF, LATTER = slice(0, None, 2), slice(7, None)

FAULTS: dict[str, Spoil] = {
    # images
    "a camera black": images("cam2", np.zeros_like),
    "half of a camera of another type": images("cam1", lambda image: image.astype(np.uint16), LATTER),
    "half of a camera of another size": images("cam1", lambda image: image[:-16].copy(), HALF),
    "the first frame of another size": images("cam1", lambda image: image[:-16].copy(), slice(0, 1)),
    "a camera frozen": frozen("cam3", 100),
    "half of the files half written": data("cam1", lambda whole: whole[: len(whole) // 2], HALF),
    "the last files half written": data("cam1", lambda whole: whole[: len(whole) // 2], slice(-3, None)),
    "a camera mirrored": images("cam1", lambda image: image[:, ::-1].copy()),
    "a camera negative": images("cam1", lambda image: 255 - image),
    "a camera out of focus": images("cam1", lambda image: cv2.GaussianBlur(image, (0, 0), 3.0)),
    "a camera overexposed": images("cam1", lambda image: np.clip(image * 30.0, 0, 255).astype(np.uint8)),
    "a camera of noise": images(
        "cam2", lambda image: np.random.default_rng(image.sum()).integers(0, 255, image.shape, np.uint8)
    ),
    "two cameras exchanged": swapped,
    "a camera that is a copy of another": copied,
    "nearly all of a camera covered by its mask": covered,
    # numbers
    "20 of 24 frames missing": removed("cam2", slice(3, None)),
    "every third frame missing": removed("cam2", slice(0, None, 3)),
    "numbers that leap": numbered("cam1", lambda k: k + 1000 * (k > 6)),
    "all numbers by tens": by_tens,
    "two files of one number": twice,
    "a camera one frame late": numbered("cam1", lambda k: k + 1),
    "a camera in reverse": numbered("cam2", lambda k: FRAMES - 1 - k),
    "frames beyond the record": note(frames={"first": 0, "last": 40}),
    # units
    "grid in centimetres": grid(100, 100),
    "grid in centimetres, its step in metres": grid(100, 1),
    "grid in inches": grid(39.4, 39.4),
    "grid of four times the field": grid(4, 1),
    "rig in millimetres": rig(1000.0),
    "z_range in millimetres": note(settings={"z_range": [-80.0, 80.0]}),
    "bead_height in millimetres": note(settings={"bead_height": 0.4}),
    "level of the water in millimetres": note(water={"depth": 0.7, "level": 20.0}),
    "density in g cm-3": note(water={"depth": 0.7, "density": 1.0}),
    "surface tension in mN m-1": note(water={"depth": 0.7, "surface_tension": 73.0}),
    "frame rate of yes": text("frame_rate: 20.0", "frame_rate: yes"),
    # disk
    "no room on the disk": full_disk,
    "the folder of a camera is gone": lambda folder: shutil.rmtree(folder / "cam3"),
    "the rig is gone": lambda folder: (folder / "rig.yaml").unlink(),
}


# -- sound experiments ---------------------------------------------------------------------------------------


def as_png(folder: Path) -> None:
    for file in folder.rglob("*.tif"):
        write_image(file.with_suffix(".png"), read_image(file))
        file.unlink()
    text(".tif", ".png")(folder)


def as_pages(folder: Path) -> None:
    for name in ("cam1", "cam2", "cam3"):
        pages = np.stack([read_image(file) for file in files_of(folder, name)])
        tifffile.imwrite(folder / f"{name}.tif", pages, photometric="minisblack")
        shutil.rmtree(folder / name)
        text(f"{name}/img_{{frame:05d}}.tif", f"{name}.tif")(folder)


def one_lost(folder: Path) -> None:
    (folder / "cam2" / "img_00008.tif").unlink()
    files_of(folder, "cam1")[3].write_bytes(b"")


def later_numbers(folder: Path) -> None:
    for camera in ("cam1", "cam2", "cam3"):
        numbered(camera, lambda k: k + 70123)(folder)


def same(folder: Path) -> None:
    """As it was written."""


SOUND: tuple[tuple[str, dict[str, Any], Spoil], ...] = (
    ("a sea", {}, same),
    ("16 bits", {}, all_images(lambda image: 256 * image.astype(np.uint16))),
    ("12 bits in 16", {}, all_images(lambda image: 16 * image.astype(np.uint16))),
    ("PNG files", {}, as_png),
    ("TIFF files of many pages", {}, as_pages),
    ("numbers from 70123", {}, later_numbers),
    ("a frame lost here and there", {}, one_lost),
    ("a grid that is chosen", {}, note(grid="auto")),
    ("a grid wider than what is seen", {}, grid(1.1, 1)),
    ("no depth", {}, note(water={})),
    ("still water", {"sea": {"kind": "still"}}, same),
    ("low waves", {"sea": {"rms": 0.002}}, same),
    ("dark images", {"light": {"gain": {"cam1": 0.5, "cam2": 0.5, "cam3": 0.5}}}, same),
    ("unlike light", {"light": {"gain": {"cam1": 0.6, "cam2": 1.4}}}, same),
    ("flicker", {"light": {"flicker": 0.2}}, same),
    ("short record", {"frames": 8}, same),
    ("float images", {}, all_images(lambda image: image.astype(np.float32) / 255)),
    ("range of frames stated", {}, note(frames={"first": 2, "last": 11})),
    ("range of elevations stated", {}, note(settings={"z_range": [-0.08, 0.08]})),
)


def faults(names: Sequence[str], seed: int, folder: Path) -> list[list[str]]:
    """Rows of the faults: exit status and first words of `check`."""
    whole = write_experiment(folder / "whole", seed).parent
    rows = []
    for name in names:
        spoiled = folder / "faulty"
        shutil.copytree(whole, spoiled)
        FAULTS[name](spoiled)
        rows.append([name, *cells(spoiled)])
        shutil.rmtree(spoiled)
    return rows


def sound(count: int, first: int, folder: Path) -> list[list[str]]:
    """Rows of experiments without a fault."""
    rows = []
    for k in range(count):
        name, scene, change = SOUND[k % len(SOUND)]
        path = write_experiment(folder / "sound", first + k, **scene)
        change(path.parent)
        rows.append([f"{name} (seed {first + k})", *cells(path.parent)])
        shutil.rmtree(path.parent)
    return rows


def cells(folder: Path) -> list[str]:
    """Exit status of `check` and its first words."""
    status, words = outcome(folder / "experiment.yaml")
    return [str(status), words.replace(f"{folder}/", "").replace("|", "/")[:WIDTH]]


def main(words: Sequence[str]) -> int:
    """Print a table; exit status 1 where a fault is called sound, or an experiment without one is not."""
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", choices=FAULTS, default=list(FAULTS), metavar="NAME")
    parser.add_argument("--sound", action="store_true", help="experiments without a fault")
    parser.add_argument("--seeds", type=int, default=len(SOUND), help="number of sound experiments")
    parser.add_argument("--first", type=int, default=FIRST, help="seed of the first experiment")
    options = parser.parse_args(words)
    with (
        mock.patch("wavefield.pipeline.checking.shutil.disk_usage", free_bytes),
        tempfile.TemporaryDirectory() as place,
    ):
        if options.sound:
            rows = sound(options.seeds, options.first, Path(place))
        else:
            rows = faults(options.only, options.first, Path(place))
    columns = ("experiment", "exit status", "first words")
    wrong = sum((row[1] == "0") != options.sound for row in rows)
    print_table(columns, rows)
    print(f"\n{'false alarms' if options.sound else 'faults called sound'}: {wrong} of {len(rows)}")
    if options.save:
        save_result("sound" if options.sound else "faults", columns, rows)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
