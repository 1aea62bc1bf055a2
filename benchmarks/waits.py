"""How long a user waits: `python -m benchmarks.waits [--only PART ...] [--steps 400] [--folder DIR]`.

Wall times of whole commands, from the shell to their end, full-size cameras unless stated otherwise; run it
on a quiet machine. Experiments are simulated below a temporary folder (6 MB a step; --folder keeps them). The
commands run once before, on a small tank, so that nothing is compiled meanwhile.
"""

import argparse
import contextlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import cv2
import psutil

from benchmarks.command_runs import finish, print_row, same, small_scene, start, workers_of, write_tank
from benchmarks.options import parser_of
from wavefield.execution.run_log import log_path
from wavefield.images import read_image
from wavefield.tank import Scene, simulate

IMPORTS = "import xarray, dask.distributed, numba, cv2"
# lines of the log of a run when a part of it begins
MARKS = {"learning": r"learning beads", "chunks": r"chunks to measure", "verdict": r"INFO done"}


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


def run(experiment: Path, out: Path, workers: int) -> tuple[float, dict[str, float], float]:
    """A run through the command line: its wall time, when its parts began, and a worker's most memory, GB."""
    shutil.rmtree(out, ignore_errors=True)
    log_path(out).unlink(missing_ok=True)
    began = time.time()
    process = start(experiment, out, cluster="local", workers=workers)
    most = 0.0
    while process.poll() is None:
        with contextlib.suppress(psutil.Error):
            most = max([most, *(worker.memory_info().rss for worker in workers_of(process))])
        time.sleep(0.05)
    took = time.time() - began
    finish(process, (0, 3))  # 3: remarks, as on frames that run forwards and backwards in turn
    log = log_path(out).read_text()
    parts = {}
    for name, mark in MARKS.items():
        found = re.search(rf"^(\S+ \S+),(\d+) .*{mark}", log, re.MULTILINE)
        assert found, (name, log)
        parts[name] = datetime.fromisoformat(found[1]).timestamp() + int(found[2]) / 1e3 - began
    return took, parts, most / 1e9


def two_dis(experiment: Path) -> float:
    """CPU time of two runs of OpenCV's DIS optical flow (MEDIUM), s."""
    first, second = (read_image(experiment.parent / "cam1" / f"img_{k:05d}.tif") for k in (0, 1))
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow.calc(first, second, None)
    times = []
    for _ in range(5):
        began = time.process_time()
        flow.calc(first, second, None)
        flow.calc(second, first, None)
        times.append(time.process_time() - began)
    return min(times)


def beginning(folder: Path, options: argparse.Namespace) -> None:
    """Until help is there, and until the first frame of a run is measured."""
    least = seconds([sys.executable, "-c", "import click"], 7)
    helped = seconds(wavefield("--help"), 7)
    print_row("wavefield --help over importing click", "3", f"{helped / least:.1f}  ({helped:.2f} s)")
    experiment = write_tank(folder / "first", small_scene(), 4)
    imported = seconds([sys.executable, "-c", IMPORTS], 5)
    parts = [run(experiment, folder / "start.zarr", 2)[1] for _ in range(5)]
    first, chunks = (min(part[name] for part in parts) for name in ("learning", "chunks"))
    detail = f"({first:.2f} s, {imported:.2f} s; small images)"
    print_row(
        "from the command to the first frame measured, over imports", "2", f"{first / imported:.2f}  {detail}"
    )
    print_row(
        "    to the first chunk, beads and spectra learned", "", f"{chunks / imported:.2f}  ({chunks:.2f} s)"
    )


def record(folder: Path, options: argparse.Namespace) -> None:
    """A run with two workers and with one."""
    steps = options.steps
    experiment = write_tank(folder / f"full-{steps}", Scene.load("full"), steps)
    dis = two_dis(experiment)
    took = {}
    for workers in options.workers:
        wall, parts, memory = run(experiment, folder / f"run{workers}.zarr", workers)
        took[workers] = wall
        over = f"{workers * wall / steps / dis:.2f}  ({wall:.1f} s; {1e3 * dis:.0f} ms; {steps} steps)"
        print_row(f"run, {workers} workers: wall x {workers} / steps over two DIS", "0.80", over)
        ends = [0.0, *parts.values(), wall]
        names = ("preparing", "learning", "chunks", "verdict")
        shown = ", ".join(f"{name} {b - a:.1f}" for name, a, b in zip(names, ends, ends[1:]))
        print_row("    of it, s", "", shown)
        print_row("    most memory of a worker", "0.5 GB", f"{memory:.2f} GB" if workers > 1 else "")
    if len(took) > 1:
        print_row("2 workers over 1", "0.53", f"{took[2] / took[1]:.3f}")
        equal = same(folder / "run1.zarr", folder / "run2.zarr")
        print_row("    the two cubes are the same to the bit", "yes", "yes" if equal else "no")


def calibration(folder: Path, options: argparse.Namespace) -> None:
    """Calibrating from 21 full-size images."""
    place = folder / "targets"
    if not place.exists():
        simulate(Scene.load("full").with_(frames=2), place)
    images = len(list((place / "calib").rglob("*.tif")))
    wall = seconds(wavefield("-q", "calibrate", place / "experiment.yaml"))
    print_row(f"calibrate, {images} full-size images", "15 s", f"{wall:.1f} s")


def checking(folder: Path, options: argparse.Namespace) -> None:
    """Checking the demo, and a record of full-size cameras."""
    place = folder / "demo"
    if not place.exists():
        simulate(Scene.load("demo"), place)
    given = ["--rig", place / "truth" / "rig.yaml"]
    wall = min(seconds(wavefield("-q", "check", place / "experiment.yaml", *given)) for _ in range(3))
    print_row("check, the demo's images", "6 s", f"{wall:.1f} s")
    full = folder / f"full-{options.steps}"
    if full.exists():
        print_row(
            "check, full size", "", f"{seconds(wavefield('-q', 'check', full / 'experiment.yaml')):.1f} s"
        )


PARTS = {"start": beginning, "run": record, "calibrate": calibration, "check": checking}


def main(words: Sequence[str]) -> int:
    """Measure the parts that are asked for."""
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--workers", type=int, nargs="+", default=[2, 1])
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args(words)
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        small = write_tank(folder / "first", small_scene(), 4)
        run(small, folder / "compiled.zarr", 2)
        seconds(wavefield("-q", "check", small))
        for name in options.only:
            PARTS[name](folder, options)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
