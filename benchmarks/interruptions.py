"""Interrupted runs give the same cube: `python -m benchmarks.interruptions [--moments 100] [--seed 0]`.

A run of a small tank whose first chunk is stored is continued, and at a random moment of it two faults are
inflicted, one shortly after the other: the run or one of its workers killed or suspended, the run asked to
stop, the disk full for a while. Then the same command is given until it ends well, and every array of its
cube is compared with that of an uninterrupted run. Full disks need the right to mount a small file system.
"""

import argparse
import contextlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import zarr

from benchmarks.command_runs import print_row, small_scene, start, workers_of, write_tank
from benchmarks.options import parser_of
from wavefield.pipeline import status

PATIENCE_S = 600.0
MAX_TRIES = 5  # of the same command after the faults
STEPS = 12
DISK = "6m"


def kill_run(process: subprocess.Popen, disk: Path, draw: random.Random) -> None:
    process.kill()


def kill_worker(process: subprocess.Popen, disk: Path, draw: random.Random) -> None:
    _signal_worker(process, signal.SIGKILL, draw)


def suspend_worker(process: subprocess.Popen, disk: Path, draw: random.Random) -> None:
    """For good: it is continued only when its run is gone, which cannot end it if it was killed itself."""
    for worker in _signal_worker(process, signal.SIGSTOP, draw):
        threading.Thread(target=_continue_after, args=(process, worker), daemon=True).start()


def _continue_after(process: subprocess.Popen, worker: psutil.Process) -> None:
    while process.poll() is None:
        time.sleep(0.1)
    with contextlib.suppress(psutil.Error):
        worker.resume()


def suspend_run(process: subprocess.Popen, disk: Path, draw: random.Random) -> None:
    """For up to two seconds: nothing but a user or the system can continue it."""
    process.send_signal(signal.SIGSTOP)
    time.sleep(draw.uniform(0, 2))
    process.send_signal(signal.SIGCONT)


def interrupt(process: subprocess.Popen, disk: Path, draw: random.Random) -> None:
    process.send_signal(signal.SIGINT)


def terminate(process: subprocess.Popen, disk: Path, draw: random.Random) -> None:
    process.send_signal(signal.SIGTERM)


def fill_disk(process: subprocess.Popen, disk: Path, draw: random.Random) -> None:
    """Leave no byte free, for up to two seconds or until the run ends."""
    with (disk / "filler").open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while True:
            stream.write(bytes(512))


def _signal_worker(process: subprocess.Popen, number: int, draw: random.Random) -> list[psutil.Process]:
    with contextlib.suppress(psutil.Error):
        workers = workers_of(process)
        chosen = [draw.choice(workers)] if workers else []
        for worker in chosen:
            worker.send_signal(number)
        return chosen
    return []


FAULTS = {
    "run killed": kill_run,
    "worker killed": kill_worker,
    "worker suspended": suspend_worker,
    "run suspended": suspend_run,
    "Ctrl-C": interrupt,
    "SIGTERM": terminate,
    "disk full": fill_disk,
}


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """A small file system in a folder, where that is allowed."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(folder)]
    mounted = (
        shutil.which("mount") is not None and subprocess.run(command, capture_output=True).returncode == 0
    )
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


def continued(experiment: Path, cube: Path) -> subprocess.Popen:
    return start(experiment, cube, cluster="local", workers=2, steps_per_block=1)


def different(one: Path, other: Path) -> list[str]:
    """Arrays of two stores that differ in any bit."""
    a, b = (
        {
            name: part[...]
            for name, part in zarr.open_group(path, mode="r").members(None)
            if hasattr(part, "shape")
        }
        for path in (one, other)
    )
    return [
        n for n in sorted(a.keys() | b.keys()) if n not in a or n not in b or a[n].tobytes() != b[n].tobytes()
    ]


def disturbed(
    experiment: Path, begun: Path, whole: Path, seconds: float, draw: random.Random, folder: Path
) -> tuple[list[str], list[str]]:
    """One moment: its faults, and what is wrong afterwards."""
    with small_disk(folder) as mounted:
        cube = folder / "cube.zarr"
        shutil.copytree(begun, cube)
        names = draw.sample([name for name in FAULTS if mounted or name != "disk full"], 2)
        process = continued(experiment, cube)
        time.sleep(draw.uniform(0, seconds))
        for name in names:
            if process.poll() is None:
                FAULTS[name](process, folder, draw)
                time.sleep(draw.uniform(0, 0.3))
        since = time.monotonic()
        if "disk full" in names:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(draw.uniform(0, 2))
            (folder / "filler").unlink(missing_ok=True)
        wrong = []
        for _ in range(MAX_TRIES):
            try:
                text, _ = process.communicate(timeout=PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                return names, [f"hangs {time.monotonic() - since:.0f} s after the faults"]
            if "Traceback" in text or "did not foresee" in text:
                wrong.append(f"unforeseen: {text.strip().splitlines()[-1]}")
            if process.returncode in (0, 3) and status(cube).complete:
                break
            process = continued(experiment, cube)
        else:
            process.kill()
            return names, [*wrong, f"not complete after {MAX_TRIES} tries: {text.strip()[-300:]}"]
        return names, wrong + [f"{name} differs" for name in different(cube, whole)]


def main(words: Sequence[str]) -> int:
    """Interrupt a run at random moments, and count the cubes that are the same to the bit."""
    parser = parser_of(__doc__)
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--parallel", type=int, default=2, help="runs that are disturbed side by side")
    options: argparse.Namespace = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        experiment = write_tank(folder / "tank", small_scene(), STEPS)
        begun, whole = folder / "begun" / "cube.zarr", folder / "whole" / "cube.zarr"
        for path in (begun, whole):
            path.parent.mkdir()
        process = continued(experiment, begun)
        while not begun.exists() or status(begun).left == STEPS:
            if process.poll() is not None:
                raise RuntimeError(process.communicate()[0])
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        process.communicate()
        shutil.copytree(begun, whole)
        since = time.monotonic()
        continued(experiment, whole).communicate()
        seconds = time.monotonic() - since
        faults, same, failures = Counter[str](), 0, 0

        def inflicted(moment: int) -> tuple[list[str], list[str]]:
            draw = random.Random(f"{options.seed} {moment}")
            return disturbed(experiment, begun, whole, seconds, draw, folder / f"moment{moment}")

        with ThreadPoolExecutor(options.parallel) as pool:
            for moment, (names, wrong) in enumerate(pool.map(inflicted, range(options.moments))):
                faults.update(names)
                same += not any("differs" in one or "tries" in one or "hangs" in one for one in wrong)
                failures += bool(wrong)
                print(
                    f"moment {moment} ({' and '.join(names)}): {'; '.join(wrong) or 'the same'}", flush=True
                )
        print_row("moments, two faults each; the same cube to the bit", "all", f"{same} of {options.moments}")
        print_row("    with an error that was not foreseen, a hang or a difference", "0", str(failures))
        for name in FAULTS:
            print_row(f"    {name}", "", f"{faults[name]} times")
        print_row("an uninterrupted continuation", "", f"{seconds:.1f} s")
    return 0 if not failures else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
