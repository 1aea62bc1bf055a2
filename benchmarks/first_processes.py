"""Processes that start at once on a fresh copy: `python -m benchmarks.first_processes [--repeats 20]`.

Each repeat copies the package without its compiled code and starts several processes on the copy at once,
which compile what they need and keep it: commands, and scripts that import the rooms with compiled loops in
random order and use one. Later three more processes run there. None may crash, all cubes must be the same
to the bit, and each kept file must hold the kernel and the wrapper of one loop, as one process compiled them.
"""

import argparse
import os
import pickle
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import wavefield
from benchmarks.command_runs import print_row, same, small_scene, write_tank
from benchmarks.options import parser_of
from wavefield.compiled import _DIGEST_BYTES

STEPS = 4
LATER = 3  # processes of the same copy, one after the other, when the first have ended
KINDS = ("run", "run on workers", "check", "simulate", "imports")
ROOMS = (
    "rig.stereo",
    "matching",
    "measurement.measure",
    "measurement.regrid",
    "measurement.paths",
    "calibration.subpixel",
    "tank.sensor",
    "series.formats.packed",
)
SCRIPT = """
import sys
from importlib import import_module
for name in sys.argv[2:]:
    import_module("wavefield." + name)
import numpy as np
from wavefield.rig import Rig
from wavefield.rig.stereo import jacobians, solve_displacement
cameras = list(Rig.load(sys.argv[1]).cameras.values())[:2]
x, y, z = np.random.default_rng(0).uniform(-0.03, 0.03, (3, 50))
print(solve_displacement(jacobians(cameras, x, y, z), np.stack([x, y, z, x], -1))[0].tobytes().hex())
"""


def words_of(kind: str, experiment: Path, out: Path, draw: random.Random) -> list[str]:
    """The command line of one process."""
    command = [sys.executable, "-m", "wavefield.commands.cli", "-q"]
    if kind == "imports":
        rooms = draw.sample(ROOMS, len(ROOMS))
        return [sys.executable, "-c", SCRIPT, str(experiment.with_name("rig.yaml")), *rooms]
    if kind == "check":
        return [*command, "check", str(experiment)]
    if kind == "simulate":
        return [*command, "simulate", "demo", str(out.with_suffix(""))]
    workflow = out.with_suffix(".yaml")
    workers = {"run": "cluster: none", "run on workers": "{cluster: local, workers: 2, steps_per_block: 2}"}[
        kind
    ]
    workflow.write_text(workers)
    return [*command, "run", str(experiment), "-o", str(out), "--workflow", str(workflow)]


def mixed(files: Sequence[Path]) -> list[str]:
    """Kept files whose kernel and wrapper are not those of one process, by the numbers in their names."""
    out = []
    for path in files:
        _, data = pickle.loads(path.read_bytes()[_DIGEST_BYTES:])
        code, described = data[0][2][0], data[1]
        loop, number = re.findall(r"_ZN(\w*?)B\d+v(\d+)B", described.llvm_func_name)[0]
        numbers = set(re.findall(rb"%bB\d+v(\d+)B" % loop.encode(), code))
        if described.llvm_cpython_wrapper_name.encode() not in code or numbers != {number.encode()}:
            out.append(path.name)
    return out


def repeat(
    experiment: Path, whole: Path | None, processes: int, folder: Path, draw: random.Random
) -> tuple[list[str], int, Path]:
    """Processes at once on a fresh copy, then some more; what went wrong, files kept, and a cube."""
    copy = folder / "copy"
    shutil.copytree(
        Path(wavefield.__file__).parent, copy / "wavefield", ignore=shutil.ignore_patterns("__pycache__")
    )
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    environment.pop("NUMBA_CACHE_DIR", None)
    kinds = [*KINDS, *draw.choices(KINDS, k=max(processes - len(KINDS), 0))][:processes]
    draw.shuffle(kinds)
    later = ["run", "imports", *draw.choices(KINDS, k=LATER - 2)]
    wrong: list[str] = []
    cubes: list[Path] = [] if whole is None else [whole]
    displacements = set()

    def end(kind: str, out: Path, process: subprocess.Popen) -> None:
        text, _ = process.communicate()
        log = out.with_suffix(".log")
        logged = log.read_text() if log.exists() else ""
        if process.returncode not in (0, 3) or "crash" in text + logged or "Traceback" in text:
            wrong.append(f"{kind} ended with {process.returncode}: {text.strip()[-300:]}")
        elif kind.startswith("run"):
            cubes.append(out)
            if not same(cubes[0], out):
                wrong.append(f"{kind} gave another cube")
        elif kind == "imports":
            displacements.add(text)

    def begun(kind: str, name: str) -> tuple[str, Path, subprocess.Popen]:
        out = folder / f"{name}.zarr"
        words = words_of(kind, experiment, out, draw)
        stream = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return kind, out, subprocess.Popen(words, env=environment, cwd=folder, **stream)

    for each in [begun(kind, f"first{k}") for k, kind in enumerate(kinds)]:
        end(*each)
    for k, kind in enumerate(later):
        end(*begun(kind, f"later{k}"))
    if len(displacements) > 1:
        wrong.append("displacements differ")
    kept = sorted(copy.rglob("*.nbc"))
    return (
        wrong + [f"{name}: kernel and wrapper of two processes" for name in mixed(kept)],
        len(kept),
        cubes[0],
    )


def main(words: Sequence[str]) -> int:
    """Repeat first starts on fresh copies, and count crashes."""
    parser = parser_of(__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--processes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    options: argparse.Namespace = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        experiment = write_tank(place / "tank", small_scene(), STEPS)
        whole, good, files = None, 0, 0
        for number in range(options.repeats):
            since = time.monotonic()
            draw = random.Random(f"{options.seed} {number}")
            folder = place / f"repeat{number}"
            folder.mkdir()
            wrong, kept, cube = repeat(experiment, whole, options.processes, folder, draw)
            if whole is None:
                whole = Path(shutil.copytree(cube, place / "whole.zarr"))
            shutil.rmtree(folder)
            good, files = good + (not wrong), files + kept
            print(f"repeat {number}: {time.monotonic() - since:.0f} s  {'; '.join(wrong)}", flush=True)
        title = f"repeats of {options.processes} first processes and {LATER} later without a crash"
        print_row(title, "all", f"{good} of {options.repeats}")
        print_row("files of compiled code, each of one process", "", f"{files}")
    return 0 if good == options.repeats else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
