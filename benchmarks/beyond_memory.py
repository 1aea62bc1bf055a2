"""E(k, omega) of a cube larger than memory: `python -m benchmarks.beyond_memory CUBE [--memory 0.5]`.

On workers of a Dask cluster that are ended when they exceed so many GB. Printed: the size of the variable in
memory, what the workers read of the disk over what is stored of it (1: one pass), how many tasks of the graph
move data from chunk to chunk (rechunk), the most memory of a worker, and whether E is that of one process.
CUBE is made as by `benchmarks.waves` where it is not there: 12,000 x 150 x 200, 1.4 GB a variable.
"""

import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import dask
import numpy as np
import psutil
import xarray as xr
from dask.distributed import Client, LocalCluster

import wavefield.waves as wv
from benchmarks.options import parser_of
from benchmarks.waves import row, title, write_cube

_SEGMENT = 512


def _read(dask_worker: Any) -> tuple[int, int]:
    """Id of a worker's process, and the bytes that it has read."""
    own = psutil.Process()
    return own.pid, own.io_counters().read_chars


class _Watch:
    """The most memory of some processes, B."""

    def __init__(self, pids: Sequence[int]) -> None:
        self.most, self._on = 0, True
        self._processes = [psutil.Process(pid) for pid in pids]
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        while self._on:
            self.most = max([self.most, *(one.memory_info().rss for one in self._processes)])
            time.sleep(0.05)

    def stop(self) -> int:
        self._on = False
        self._thread.join()
        return self.most


def main(words: Sequence[str]) -> int:
    """Measure and print."""
    parser = parser_of(__doc__)
    parser.add_argument("cube", type=Path)
    parser.add_argument("--memory", type=float, default=0.5, help="GB of each worker")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--steps", type=int, default=12_000, help="of the cube that are read")
    options = parser.parse_args(words)
    if not options.cube.exists():
        write_cube(options.cube, options.steps)
    whole = xr.open_zarr(options.cube, consolidated=False).w
    w = whole[: options.steps]
    stored = sum(file.stat().st_size for file in (options.cube / "w").rglob("*") if file.is_file())
    stored = stored * w.nbytes / whole.nbytes
    lazy = wv.komega(w, segment=_SEGMENT).E
    moving = [key for key in map(str, dict(lazy.__dask_graph__())) if "rechunk" in key]
    limit = f"{options.memory}GB"
    with (
        LocalCluster(options.workers, threads_per_worker=1, memory_limit=limit, dashboard_address=None) as at,
        Client(at) as client,
    ):
        before = client.run(_read)
        watch = _Watch([pid for pid, _ in before.values()])
        since = time.perf_counter()
        found = lazy.compute()
        took = time.perf_counter() - since
        most = watch.stop()
        after = client.run(_read)
    read = sum(after[name][1] - before[name][1] for name in before if name in after)
    title(f"E(k, omega) of {' x '.join(map(str, w.shape))}, {options.workers} workers of {limit}")
    row("the variable in memory", "", f"{w.nbytes / 1e9:.2f} GB")
    row("most memory of a worker", limit, f"{most / 1e9:.2f} GB")
    row("workers that live to the end", str(len(before)), str(len(set(before) & set(after))))
    row("read over stored", "1", f"{read / stored:.2f}")
    row("tasks that move data from chunk to chunk", "0", str(len(moving)))
    row("wall time", "", f"{took:.1f} s")
    with dask.config.set(scheduler="synchronous"):
        alone = wv.komega(w, segment=_SEGMENT).E.compute()
    row("the same to the bit as of one process", "yes", "yes" if np.array_equal(found, alone) else "no")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
