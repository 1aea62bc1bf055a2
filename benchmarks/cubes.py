"""What series and cubes reach: opening, speed over a plain loop, memory, kills, reading.

    python -m benchmarks.cubes [--only PART ...] [--steps 200] [--kills 10] [--folder DIR]

Simulated experiments are written below a temporary folder (about 2 GB; --folder keeps them).
Times are of whole processes, from the command line to the end, so that starting workers is part of them; run
it on a quiet machine. CPU times, of a run and its workers together, say more on a busy one.
"""

import argparse
import ctypes
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import numpy as np
import psutil
import xarray as xr

from wavefield.images import read_image, write_image
from wavefield.pipeline import open_cube, reconstruct, status
from wavefield.series import frames, listing
from wavefield.store.verify import verify
from wavefield.tank import Scene, Tank, paper_rig
from wavefield.variables import CUBE_FIELDS

cv2.setNumThreads(1)

# frames read once each, one at a time, all steps in one call: nothing that could be saved
PLAIN_LOOP = """
import sys
import cv2
cv2.setNumThreads(1)
from wavefield.measurement import GridGeometry, Settings, measure
from wavefield.series import Experiment
note = Experiment.load(sys.argv[1])
rig = note.load_rig()
geometry = GridGeometry(rig, note.choose_grid(rig), Settings())
series = note.open_frames()
class Frames:
    def __init__(self, one): self.one = one
    def __len__(self): return len(self.one) + 4
    def __getitem__(self, i):
        inside = 1 < i < len(self.one) + 2
        return cv2.imread(self.one.entries[i - 2].path, cv2.IMREAD_UNCHANGED) if inside else None
measure({name: Frames(one) for name, one in series.items()}, geometry, note.frame_rate)
"""


def say(test: str, asked: str, reached: str) -> None:
    print(f"{test:66s} {asked:>14s}   {reached}", flush=True)


# -- experiments ------------------------------------------------------------------------------------------


def write_tank(folder: Path, scene: Scene, steps: int, drawn: int = 12) -> Path:
    """An experiment of any length from a few drawn frames, shown forwards and backwards in turn."""
    path = folder / "experiment.yaml"
    if path.exists():
        return path
    tank = Tank(scene)
    folder.mkdir(parents=True, exist_ok=True)
    tank.rig.save(folder / "rig.yaml")
    turn = [*range(drawn), *range(drawn - 2, 0, -1)]
    for number in range(min(drawn, steps + 1)):
        for camera, image in tank.render(number).items():
            write_image(folder / camera / f"img_{number:05d}.tif", image)
    for camera in tank.rig:
        for number in range(drawn, steps + 1):
            source = folder / camera / f"img_{turn[number % len(turn)]:05d}.tif"
            shutil.copyfile(source, folder / camera / f"img_{number:05d}.tif")
    cameras = "".join(f'  {name}: {{images: "{name}/img_{{frame:05d}}.tif"}}\n' for name in tank.rig)
    grid = scene.grid
    path.write_text(
        f"name: {folder.name}\nframe_rate: {scene.frame_rate}\ncameras:\n{cameras}rig: rig.yaml\n"
        f"grid: {{x: {list(grid.x)}, y: {list(grid.y)}, step: {grid.step}}}\n"
    )
    return path


def small_scene() -> Scene:
    return Scene.load("demo").with_(
        rig={"crop": 0.12},
        sea={"shortest": 0.15},
        grid={"x": [-0.04, 0.04], "y": [-0.06, 0.06], "step": 0.01},
    )


# -- runs as processes --------------------------------------------------------------------------------------


def start(experiment: Path, out: Path, **settings: object) -> subprocess.Popen:
    """A run through the command line."""
    workflow = out.with_suffix(".yaml")
    workflow.write_text("".join(f"{name}: {value}\n" for name, value in settings.items()))
    command = [
        "-m",
        "wavefield.commands.cli",
        "run",
        str(experiment),
        "-o",
        str(out),
        "--workflow",
        str(workflow),
    ]
    return subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def finish(process: subprocess.Popen, expected: tuple[int, ...] = (0,)) -> str:
    text, _ = process.communicate()
    if process.returncode not in expected:
        raise RuntimeError(f"a run ended with {process.returncode}: {text}")
    return text


def workers_of(process: subprocess.Popen) -> list[psutil.Process]:
    """Workers of a run; forked ones are children of the process that forks them."""
    children = psutil.Process(process.pid).children(recursive=True)
    return [c for c in children if c.ppid() != process.pid or "spawn_main" in " ".join(c.cmdline())]


def steps_done(out: Path) -> int:
    if not out.exists():
        return 0
    now = status(out)
    return now.steps - now.left


def same(one: Path, other: Path) -> bool:
    a, b = open_cube(one).load(), open_cube(other).load()
    return all(a[n].values.tobytes() == b[n].values.tobytes() for n in (*CUBE_FIELDS, "frame_status"))


@contextmanager
def scheduler_and_workers(folder: Path, count: int = 2) -> Iterator[tuple[str, subprocess.Popen]]:
    """A scheduler and workers as processes of their own, over TCP."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    module = [sys.executable, "-m"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    scheduler = [*module, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port)]
    worker = [
        *module,
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-nanny",
        "--no-dashboard",
    ]
    processes = [subprocess.Popen([*scheduler, "--no-dashboard"], **quiet)]  # type: ignore[call-overload]
    processes += [subprocess.Popen(worker, **quiet) for _ in range(count)]  # type: ignore[call-overload]
    try:
        yield address, processes[0]
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


# -- parts --------------------------------------------------------------------------------------------------


def opening(folder: Path, options: argparse.Namespace) -> None:
    """Three cameras of 12,000 files each."""
    count = 12_000
    place = folder / "many"
    for camera in ("cam1", "cam2", "cam3"):
        first = place / camera / "img_00000.tif"
        if not first.exists():
            write_image(first, np.random.default_rng(0).integers(0, 255, (24, 32), dtype=np.uint8))
            raw = first.read_bytes()
            for number in range(1, count):
                (place / camera / f"img_{number:05d}.tif").write_bytes(raw)
    path = place / "experiment.yaml"
    path.write_text(
        "name: many\nframe_rate: 20\ncameras:\n"
        + "".join(f'  cam{k}: {{images: "cam{k}/img_{{frame:05d}}.tif"}}\n' for k in (1, 2, 3))
    )
    reads: list[str] = []
    real = listing.read_entry

    def counting(entry):
        reads.append(entry.path)
        return real(entry)

    frames.read_entry = listing.read_entry = counting
    listed, opened = [], []
    for _ in range(5):
        since = time.perf_counter()
        for camera in ("cam1", "cam2", "cam3"):
            os.listdir(place / camera)
        listed.append(time.perf_counter() - since)
        since = time.perf_counter()
        xr.open_datatree(path, engine="wavefield")
        opened.append(time.perf_counter() - since)
    frames.read_entry = listing.read_entry = real
    say("opening 3 cameras x 12,000 files, the first time", "2 s", f"{opened[0]:.2f} s")
    say(
        "    again, over listing the folders",
        "20 x",
        f"{min(opened) / min(listed):.1f} x ({min(opened):.2f} s)",
    )
    say("    frames read per camera", "1", f"{len(reads) / len(opened) / 3:.0f}")
    rig = paper_rig(crop=0.12)
    arrays = {
        name: xr.DataArray(
            np.broadcast_to(np.zeros((), np.uint8), (count + 1, *rig[name].size[::-1])),
            dims=("time", "row", "column"),
            coords={"time": np.arange(count + 1) / 20.0},
        )
        for name in rig
    }
    computed: list[int] = []

    def watch(dsk, keys, **keywords):
        computed.append(1)
        raise AssertionError

    import dask

    with dask.config.set(scheduler=watch):
        cube = reconstruct(arrays, rig, small_scene().grid)
        repr(cube)
    say("    Dask tasks per step of reconstruct", "0.2", f"{len(cube.__dask_graph__()) / count:.3f}")
    say("    computes before the user asks", "0", str(len(computed)))


def speed(folder: Path, options: argparse.Namespace) -> None:
    """A run over a plain loop, half-size cameras."""
    steps = options.steps
    experiment = write_tank(folder / f"half-{steps}", Scene.load("half"), steps)
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
    }

    def plain() -> None:
        subprocess.run([sys.executable, "-c", PLAIN_LOOP, str(experiment)], check=True, env=environment)

    def by_run(workers: int) -> Callable[[], None]:
        def go() -> None:
            out = folder / f"speed{workers}.zarr"
            shutil.rmtree(out, ignore_errors=True)
            finish(start(experiment, out, cluster="local", workers=workers, dashboard="null"))

        return go

    # what is compiled is kept for later processes: not part of any of the times
    shutil.rmtree(folder / "first.zarr", ignore_errors=True)
    finish(start(write_tank(folder / "first", small_scene(), 4), folder / "first.zarr", cluster="none"))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    times: dict[str, list[float]] = {"plain": [], "one": [], "two": []}
    spent: dict[str, list[float]] = {name: [] for name in times}
    work = {"plain": plain, "one": by_run(1), "two": by_run(2)}
    for _ in range(options.repeat):
        for name, job in work.items():
            since, before = time.perf_counter(), _spent_by_children()
            job()
            times[name].append(time.perf_counter() - since)
            spent[name].append(_spent_by_children() - before)
    best = {name: min(seconds) for name, seconds in times.items()}
    cpu = {name: min(seconds) for name, seconds in spent.items()}
    detail = f"({best['plain']:.1f} s for {steps} steps in the loop)"
    say(
        "2 worker processes over the plain loop, half size",
        "0.58",
        f"{best['two'] / best['plain']:.3f}  {detail}",
    )
    say("1 worker over the plain loop", "1.06", f"{best['one'] / best['plain']:.3f}")
    shares = f"{cpu['two'] / cpu['plain']:.3f}, {cpu['one'] / cpu['plain']:.3f}"
    say("    CPU time of 2 workers and of 1 over the loop's", "", f"{shares}  ({cpu['plain']:.1f} s)")
    say(
        "    the two cubes are the same to the bit",
        "yes",
        _yes(same(folder / "speed1.zarr", folder / "speed2.zarr")),
    )


_PR_SET_CHILD_SUBREAPER = 36  # of linux/prctl.h


def _spent_by_children() -> float:
    """CPU time of all processes that have ended, theirs included, s.

    Waits for all of them: a run does not wait for the process that its workers are forked from, which comes
    to us when the run has ended.
    """
    with suppress(ChildProcessError):
        while True:
            os.wait()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def memory(folder: Path, options: argparse.Namespace) -> None:
    """Peak memory of workers, full-size cameras."""
    steps = options.steps
    experiment = write_tank(folder / f"full-{steps}", Scene.load("full"), steps)
    block = max(1, min(16, steps // 6))  # several for each worker, in each half of the run
    out = folder / "memory.zarr"
    shutil.rmtree(out, ignore_errors=True)
    process = start(experiment, out, cluster="local", workers=2, dashboard="null", steps_per_block=block)
    seen: list[tuple[int, int]] = []
    while process.poll() is None:
        try:
            done = steps_done(out)
            seen += [(done, worker.memory_info().rss) for worker in workers_of(process)]
        except psutil.Error:
            pass
        time.sleep(0.1)
    finish(process)
    peak = max(rss for _, rss in seen)
    early = max(rss for done, rss in seen if done <= steps // 2)
    late = max(rss for done, rss in seen if done > steps // 2)
    say("peak memory of a worker, full-size cameras", "1.5 GB", f"{peak / 1e9:.2f} GB")
    say("    second half of the run over the first", "not growing", f"{late / early:.3f} ({steps} steps)")


def kills(folder: Path, options: argparse.Namespace) -> None:
    """SIGKILL at random moments, then resume."""
    experiment = write_tank(folder / "small", small_scene(), 96, drawn=24)
    reference, out = folder / "reference.zarr", folder / "killed.zarr"
    for path in (reference, out):
        shutil.rmtree(path, ignore_errors=True)
    finish(start(experiment, reference, cluster="none"))
    chance = random.Random(options.seed)
    local = {"cluster": "local", "workers": 2, "steps_per_block": 2, "dashboard": "null"}
    victims = ["worker", "scheduler", "run"]
    log = []
    for number in range(options.kills):
        victim = victims[number % 3]
        before = steps_done(out)
        if before == 96:  # everything is done: begin anew
            assert same(out, reference)
            shutil.rmtree(out)
            before = 0
        if victim == "scheduler":
            with scheduler_and_workers(folder) as (address, scheduler):
                process = start(experiment, out, cluster="address", address=address, steps_per_block=2)
                _wait_for_more(out, before, process, chance)
                scheduler.send_signal(signal.SIGKILL)
                finish(process, (0, 1))
        else:
            process = start(experiment, out, **local)
            _wait_for_more(out, before, process, chance)
            family = workers_of(process)
            if victim == "worker":
                chance.choice(family).kill() if family else None
                time.sleep(chance.uniform(0.0, 1.0))
            family = [*family, psutil.Process(process.pid)]
            for member in family:
                if member.is_running():
                    member.kill()
            process.communicate()
        log.append(f"{victim} {before}-{steps_done(out)}")
    finish(start(experiment, out, **local))
    say(
        f"{options.kills} SIGKILLs of workers, schedulers and runs, then resumed",
        "bit-identical",
        _yes(same(out, reference)),
    )
    say("    `wavefield verify` of it", "sound", _yes(verify(out).sound))
    print("    steps done at start and end of each: " + ", ".join(log))
    partial = list(out.rglob("*.partial"))
    say("    half-written files left behind", "0", str(len(partial)))


def _wait_for_more(out: Path, before: int, process: subprocess.Popen, chance: random.Random) -> None:
    while steps_done(out) <= before and process.poll() is None:
        time.sleep(0.02)
    time.sleep(chance.uniform(0.0, 0.5))


def identity(folder: Path, options: argparse.Namespace) -> None:
    """The same cube whatever the blocks and workers."""
    experiment = write_tank(folder / "small", small_scene(), 96, drawn=24)
    made = []
    for block, workers in ((1, 1), (7, 1), (32, 1), (1, 2), (7, 2), (32, 2)):
        out = folder / f"identity-{block}-{workers}.zarr"
        shutil.rmtree(out, ignore_errors=True)
        finish(
            start(experiment, out, cluster="local", workers=workers, steps_per_block=block, dashboard="null")
        )
        made.append(out)
    equal = all(same(made[0], other) for other in made[1:])
    say("chunk sizes 1, 7, 32 and workers 1, 2", "bit-identical", _yes(equal))
    out = folder / "tcp.zarr"
    shutil.rmtree(out, ignore_errors=True)
    with scheduler_and_workers(folder) as (address, _):
        finish(start(experiment, out, cluster="address", address=address))
    say("scheduler and workers as processes over TCP", "bit-identical", _yes(same(out, made[0])))


def reading(folder: Path, options: argparse.Namespace) -> None:
    """Reading files against cv2.imread in a loop."""
    rng = np.random.default_rng(1)
    smooth = cv2.GaussianBlur(rng.integers(0, 256, (1024, 1024), dtype=np.uint8), (0, 0), 2.0)
    place = folder / "reading"
    place.mkdir(exist_ok=True)
    for ending in ("tif", "png"):
        for bits, image in ((8, smooth), (16, smooth.astype(np.uint16) * 16)):
            paths = [str(place / f"{bits}_{k}.{ending}") for k in range(10)]
            for path in paths:
                write_image(path, image)

            def ours(paths: list[str] = paths) -> None:
                for path in paths:
                    read_image(path)

            def theirs(paths: list[str] = paths) -> None:
                for path in paths:
                    cv2.imread(path, cv2.IMREAD_UNCHANGED)

            spent: dict[str, list[float]] = {"ours": [], "theirs": []}
            for _ in range(9):
                for name, job in (("ours", ours), ("theirs", theirs)):
                    since = time.process_time()
                    job()
                    spent[name].append(time.process_time() - since)
            ratio = min(spent["ours"]) / min(spent["theirs"])
            each = 100 * min(spent["ours"])
            say(
                f"reading {ending}, {bits} bit, over cv2.imread",
                "1.1",
                f"{ratio:.3f} ({each:.2f} ms per image)",
            )


def _yes(condition: bool) -> str:
    return "yes" if condition else "NO"


PARTS = {part.__name__: part for part in (opening, reading, identity, kills, speed, memory)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--steps", type=int, default=200, help="steps of the speed and memory runs")
    parser.add_argument("--repeat", type=int, default=2, help="times each timed run is done; the best counts")
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0, help="of the moments of the kills")
    parser.add_argument("--folder", type=Path, help="where to put the experiments, to keep them")
    options = parser.parse_args()
    temporary = None if options.folder else tempfile.TemporaryDirectory(prefix="wavefield-cubes-")
    folder = options.folder or Path(temporary.name)
    folder.mkdir(parents=True, exist_ok=True)
    print(f"{'test':66s} {'asked':>14s}   reached")
    try:
        for part in options.only:
            PARTS[part](folder, options)
    finally:
        if temporary:
            temporary.cleanup()


if __name__ == "__main__":
    main()
