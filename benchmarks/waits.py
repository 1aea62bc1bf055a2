"""How long a user waits for whole commands, from the shell to their end.

    python -m benchmarks.waits [--only PART ...] [--steps 400] [--folder DIR] [--save]

Parts: start (help, and a run's first frame), run (two workers and one), calibrate, check, analyze. Wall times
on full-size cameras unless stated otherwise; run it on a quiet machine. Experiments are simulated below a
temporary folder (6 MB a step; --folder keeps them). The commands run once before, on a small tank, so that
nothing is compiled meanwhile.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

import cv2

from benchmarks.results import parser_of, print_table, save_result
from wavefield.execution.run_files import log_path
from wavefield.images import write_image
from wavefield.pipeline import open_cube
from wavefield.tank import Scene, Tank, simulate
from wavefield.variables import CUBE_FIELDS

IMPORTS = "import xarray, dask.distributed, numba, cv2"
DRAWN = 12  # frames that are rendered; longer records show them forwards and backwards in turn
FIRST_FRAME = re.compile(r"^(\S+ \S+),(\d+) .*learning bead", re.MULTILINE)  # in the log of a run

Row = tuple[str, str]


def write_tank(folder: Path, scene: Scene, steps: int) -> Path:
    """An experiment of any length from a few rendered frames."""
    path = folder / "experiment.yaml"
    if path.exists():
        return path
    tank = Tank(scene)
    folder.mkdir(parents=True, exist_ok=True)
    tank.rig.save(folder / "rig.yaml")
    turn = [*range(DRAWN), *range(DRAWN - 2, 0, -1)]
    for number in range(steps + 1):
        images = tank.render(number) if number < DRAWN else {}
        for camera in tank.rig:
            target = folder / camera / f"img_{number:05d}.tif"
            if images:
                write_image(target, images[camera])
            else:
                shutil.copyfile(folder / camera / f"img_{turn[number % len(turn)]:05d}.tif", target)
    cameras = "".join(f'  {name}: {{images: "{name}/img_{{frame:05d}}.tif"}}\n' for name in tank.rig)
    grid = scene.grid
    path.write_text(
        f"name: {folder.name}\nframe_rate: {scene.frame_rate}\ncameras:\n{cameras}rig: rig.yaml\n"
        f"grid: {{x: {list(grid.x)}, y: {list(grid.y)}, step: {grid.step}}}\n"
    )
    return path


def small_tank(folder: Path) -> Path:
    """Four steps of a small part of every sensor."""
    grid = {"x": [-0.04, 0.04], "y": [-0.06, 0.06], "step": 0.01}
    scene = Scene.load("demo").with_(rig={"crop": 0.12}, sea={"shortest": 0.15}, grid=grid)
    return write_tank(folder / "first", scene, 4)


def seconds(command: Sequence[object], repeats: int = 1) -> float:
    """Least wall time of a command."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
        times.append(time.perf_counter() - began)
        if done.returncode not in (0, 3):  # 3: remarks
            raise RuntimeError(done.stdout + done.stderr)
    return min(times)


def wavefield(*words: object) -> list[object]:
    """A command line of this program."""
    return [sys.executable, "-m", "wavefield.commands.cli", *words]


def run(experiment: Path, out: Path, workers: int) -> float:
    """Wall time of a run."""
    shutil.rmtree(out, ignore_errors=True)
    log_path(out).unlink(missing_ok=True)
    workflow = out.with_suffix(".yaml")
    workflow.write_text(f"cluster: local\nworkers: {workers}\n")
    return seconds(wavefield("run", experiment, "-o", out, "--workflow", workflow))


def starting(folder: Path, steps: int) -> Iterator[Row]:
    """Until help is there, and until a run reads its first frames."""
    least, helped = seconds([sys.executable, "-c", "import click"], 7), seconds(wavefield("--help"), 7)
    yield "help", f"{helped:.2f} s, {helped / least:.1f} times importing click"
    experiment, imported = small_tank(folder), seconds([sys.executable, "-c", IMPORTS], 5)
    first = []
    for _ in range(5):
        began = time.time()
        run(experiment, folder / "start.zarr", 2)
        found = FIRST_FRAME.search(log_path(folder / "start.zarr").read_text())
        assert found
        first.append(datetime.fromisoformat(found[1]).timestamp() + int(found[2]) / 1e3 - began)
    yield "a run's first frames, small", f"{min(first):.2f} s, {min(first) / imported:.1f} times the imports"


def running(folder: Path, steps: int) -> Iterator[Row]:
    """A run with two workers and with one."""
    experiment = write_tank(folder / f"full-{steps}", Scene.load("full"), steps)
    cubes = []
    for workers in (2, 1):
        out = folder / f"run{workers}.zarr"
        yield f"run, {steps} steps, workers: {workers}", f"{run(experiment, out, workers):.1f} s"
        cubes.append(open_cube(out).load())
    a, b = cubes
    same = all(a[n].values.tobytes() == b[n].values.tobytes() for n in (*CUBE_FIELDS, "frame_status"))
    yield "both cubes are the same to the bit", "yes" if same else "no"


def calibrating(folder: Path, steps: int) -> Iterator[Row]:
    """Calibrating from full-size images."""
    place = folder / "targets"
    if not place.exists():
        simulate(Scene.load("full").with_(frames=2), place)
    images = len(list((place / "calib").rglob("*.tif")))
    wall = seconds(wavefield("-q", "calibrate", place / "experiment.yaml"))
    yield f"calibrate, {images} images", f"{wall:.1f} s"


def checking(folder: Path, steps: int) -> Iterator[Row]:
    """Checking the demo."""
    place = folder / "demo"
    if not place.exists():
        simulate(Scene.load("demo"), place)
    command = wavefield("-q", "check", place / "experiment.yaml", "--rig", place / "truth" / "rig.yaml")
    yield "check, the demo", f"{seconds(command, 3):.1f} s"


def analysing(folder: Path, steps: int) -> Iterator[Row]:
    """The wave analysis of the cube of a run."""
    cube = folder / "run2.zarr"
    if not cube.exists():
        run(write_tank(folder / f"full-{steps}", Scene.load("full"), steps), cube, 2)
    wall = seconds(wavefield("-q", "analyze", cube, "-o", folder / "waves.zarr"))
    yield f"analyze, {steps} steps", f"{wall:.1f} s"


PARTS = {"start": starting, "run": running, "calibrate": calibrating, "check": checking, "analyze": analysing}


def main(words: Sequence[str]) -> int:
    """Measure the parts that are asked for."""
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args(words)
    cv2.setNumThreads(1)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        run(small_tank(folder), folder / "compiled.zarr", 2)
        for name in options.only:
            rows += PARTS[name](folder, options.steps)
    columns = ("command", "wall time")
    print_table(columns, rows)
    if options.save:
        save_result("waits", columns, rows, measures_images=False)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
