"""Analysis on workers beside one process: `python -m benchmarks.analysis CUBE [WORKERS]`.

CUBE is made as by `benchmarks.waves` where it is not there: 12,000 x 150 x 200, ten minutes. Every
analysis is a process of its own with one thread, from the start of the interpreter to the store of waves.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import xarray as xr

from benchmarks.waves import write_cube

_STEPS = 12000
_PROGRAM = """
import sys
import wavefield as wf
if __name__ == "__main__":
    cube, out, workers = sys.argv[1], sys.argv[2], int(sys.argv[3])
    cluster = "local" if workers > 1 else "none"
    wf.analyze_on_workers(cube, out, wf.Workflow(cluster=cluster, workers=workers))
"""


def timed(cube: Path, out: Path, workers: int) -> tuple[float, float]:
    """Wall and CPU time of an analysis, s."""
    program = out.with_suffix(".py")
    program.write_text(_PROGRAM)
    start, cpu = time.perf_counter(), sum(os.times()[2:4])
    subprocess.run([sys.executable, program, cube, out, str(workers)], check=True)
    return time.perf_counter() - start, sum(os.times()[2:4]) - cpu


def same(one: Path, other: Path) -> bool:
    """Whether two stores of waves hold the same bits."""
    a, b = (xr.open_datatree(path, engine="zarr") for path in (one, other))
    return all(
        np.asarray(a[group][name]).tobytes() == np.asarray(b[group][name]).tobytes()
        for group in a.groups
        for name in a[group].data_vars
    )


def main() -> None:
    """Print the times, their ratio, and whether the waves are the same."""
    cube, workers = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 2
    if not cube.exists():
        write_cube(cube, _STEPS)
    with tempfile.TemporaryDirectory() as folder:
        one, many = Path(folder) / "one.zarr", Path(folder) / "many.zarr"
        alone, cpu_alone = timed(cube, one, 1)
        print(f"one process: {alone:.1f} s, {cpu_alone:.1f} s of CPU", flush=True)
        shared, cpu_shared = timed(cube, many, workers)
        print(f"{workers} workers: {shared:.1f} s, {cpu_shared:.1f} s of CPU; ratio {shared / alone:.2f}")
        print("the same to the bit" if same(one, many) else "NOT the same")


if __name__ == "__main__":
    main()
