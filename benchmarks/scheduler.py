"""What a long record and many workers cost: `python -m benchmarks.scheduler [WORKERS CHUNKS [WATCHED]]`.

The scheduler is a process of its own; stand-in workers (all in another process, so that a machine can hold
200) do stand-in work that sleeps; all else is as in a run: the same map, the same messages, over TCP of the
loopback. Of a long record only the first chunks need be watched. Then the store of a long record is opened,
asked and verified.
"""

import asyncio
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import dask
import numpy as np
import psutil
from distributed import Client, Worker

from wavefield.execution.cluster import _map_on
from wavefield.execution.process import SETTINGS

_ROW = 10_000  # chunks: a row of the table each


def nap(chunk: int) -> int:
    """Stand-in for measuring a chunk."""
    time.sleep(0.02)
    return chunk


def count_tasks(dask_scheduler) -> int:
    """Tasks that the scheduler holds."""
    return len(dask_scheduler.tasks)


async def live(address: str, number: int) -> None:
    """Be that many workers, for as long as there is a scheduler."""
    workers = [
        Worker(address, nthreads=1, host="127.0.0.1", dashboard_address="127.0.0.1:0") for _ in range(number)
    ]
    await asyncio.gather(*workers)
    await asyncio.gather(*(worker.finished() for worker in workers))


def schedule(number: int, chunks: int, watched: int) -> None:
    """Print what that many chunks cost."""
    quiet = {"stderr": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    with tempfile.TemporaryDirectory() as folder, dask.config.set(SETTINGS):
        file = Path(folder) / "scheduler.json"
        command = [
            sys.executable,
            "-m",
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
        ]
        scheduler = subprocess.Popen([*command, "--no-dashboard", "--scheduler-file", str(file)], **quiet)
        workers = None
        try:
            with Client(scheduler_file=str(file), set_as_default=False) as client:
                command = [sys.executable, "-m", "benchmarks.scheduler", "live", client.scheduler.address]
                workers = subprocess.Popen([*command, str(number)], **quiet)
                client.wait_for_workers(number)
                measure(client, psutil.Process(scheduler.pid), number, chunks, watched)
        finally:
            for process in (workers, scheduler):
                if process:
                    process.kill()
                    process.wait()


def measure(client: Client, scheduler: psutil.Process, number: int, chunks: int, watched: int) -> None:
    """Map that many chunks, and print what the scheduler took for it."""
    start, cpu, own = time.perf_counter(), sum(scheduler.cpu_times()[:2]), time.process_time()
    memory, held, done = scheduler.memory_info().rss, 0, 0
    print(
        "| workers | chunks | watched | wall s | scheduler, CPU ms per chunk | client, CPU ms per chunk "
        "| memory of the scheduler, MB | grown by | most tasks held |\n|---|---|---|---|---|---|---|---|---|",
        flush=True,
    )
    with closing(_map_on(client, lambda client: None, number, nap, range(chunks))) as results:
        for chunk, result in results:
            done += 1
            assert chunk == result
            if done % 500 == 250:
                held = max(held, client.run_on_scheduler(count_tasks))
            if done == watched or done % _ROW == 0:
                now = scheduler.memory_info().rss
                print(
                    f"| {number} | {chunks} | {done} | {time.perf_counter() - start:.0f} "
                    f"| {1e3 * (sum(scheduler.cpu_times()[:2]) - cpu) / done:.2f} "
                    f"| {1e3 * (time.process_time() - own) / done:.2f} "
                    f"| {now / 1e6:.0f} | {(now - memory) / 1e6:.0f} | {held} |",
                    flush=True,
                )
            if done == watched:
                break
    assert done == watched
    print()


def ledger(steps: int) -> None:
    """Print what opening, asking and verifying the store of a long record costs."""
    import zarr

    from wavefield.pipeline import open_cube, status
    from wavefield.store.checked import chunk_path, stored_bytes
    from wavefield.store.layout import StoreLayout, create_store
    from wavefield.store.metadata import WATCHED
    from wavefield.store.recipe import Recipe
    from wavefield.store.verify import suspicious

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cube.zarr"
        x, y = np.linspace(-1, 1, 201), np.linspace(-0.75, 0.75, 151)
        layout = StoreLayout(steps, 100, ("cam1", "cam2", "cam3"), 0)
        recipe = Recipe("stand-in", {}, (0, steps), 20.0, {}, {}, {})
        create_store(path, recipe, x, y, layout, {})
        group = zarr.open_group(path, mode="r+")
        group["frame_status"][:] = 1
        group["frame_fault"][:] = 1
        print(f"| store of {steps} steps | files |\n|---|---|\n| its ledger | {count(path)} |")
        for block in range(len(layout.chunks())):  # files of one byte, and a note of their size
            for name in WATCHED:
                file = chunk_path(path, name, block)
                if not file.exists():
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_bytes(b"0")
            group["stored_bytes"][block] = [stored_bytes(path, name, block) for name in WATCHED]
        print(f"| all | {count(path)} |\n")
        print("| | s | CPU s |\n|---|---|---|")
        asked = ("open", open_cube), ("status", status), ("verify sizes, not data", suspicious)
        for name, function in asked:
            function(path)  # imports
            start, cpu = time.perf_counter(), time.process_time()
            function(path)
            wall, cpu = time.perf_counter() - start, time.process_time() - cpu
            print(f"| {name} | {wall:.2f} | {cpu:.2f} |", flush=True)
        for words in (["status"], ["verify", "--quick"]):
            start, cpu = time.perf_counter(), sum(os.times()[2:4])
            command = [sys.executable, "-m", "wavefield.commands.cli", "-q", *words, str(path)]
            subprocess.run(command, stdout=subprocess.DEVNULL)
            wall, cpu = time.perf_counter() - start, sum(os.times()[2:4]) - cpu
            print(f"| the command `wavefield {' '.join(words)}` | {wall:.2f} | {cpu:.2f} |", flush=True)


def count(folder: Path) -> int:
    """Files below a folder."""
    return sum(1 for file in folder.rglob("*") if file.is_file())


def message() -> None:
    """Print how large a task is that a worker is sent: rig, grid and settings, and a block's frames."""
    from wavefield.images import write_image
    from wavefield.measurement import GridGeometry
    from wavefield.pipeline.chunk import make_chunk
    from wavefield.pipeline.chunk_worker import Work
    from wavefield.series import Experiment
    from wavefield.tank import Scene, Tank

    tank = Tank(Scene.load("full"))
    work = Work(Path("cube.zarr"), GridGeometry(tank.rig, tank.scene.grid), None, tank.scene.frame_rate)
    with tempfile.TemporaryDirectory() as folder:
        for name in tank.rig:
            first = Path(folder) / name / "img_000000.tif"
            write_image(first, np.zeros((8, 8), np.uint8))
            for frame in range(1, 103):
                os.link(first, first.with_name(f"img_{frame:06d}.tif"))
        path = Path(folder) / "experiment.yaml"
        cameras = "".join(f'  {name}: "{name}/img_{{frame:06d}}.tif"\n' for name in tank.rig)
        path.write_text(f"name: long\nframe_rate: 20\ncameras:\n{cameras}")
        block = make_chunk(Experiment.load(path).open_frames(), 0, 100)
        sizes = [len(pickle.dumps(one)) for one in (work, block)]
    print(f"bytes sent to a worker: {sizes[0]} once a task, {sizes[1]} for each block of 100 steps\n")


def main() -> None:
    """Measure both."""
    if sys.argv[1:2] == ["live"]:
        asyncio.run(live(sys.argv[2], int(sys.argv[3])))
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that no process is left behind
    words = [int(word) for word in sys.argv[1:]] or [200, 100_000, 5_000]
    number, chunks = words[:2]
    schedule(number, chunks, words[2] if len(words) > 2 else chunks)
    message()
    ledger(120_000)


if __name__ == "__main__":
    main()
