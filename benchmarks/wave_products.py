"""Time and memory of an analysis and each of its products: `python -m benchmarks.wave_products [CUBE]`.

Of a cube, or of a sea of the tank with noise, 150 x 200 nodes, ``--steps N`` at 20 Hz. CPU time of a process,
and the largest memory in use at once beyond what was in use before; the pass is what no product accounts for.
"""

import sys
import time
import tracemalloc
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr

import wavefield as wf
from benchmarks.options import parser_of
from wavefield.tank import Scene
from wavefield.waves import analysis, analyze, products

MB = 1e6


def sea(steps: int) -> xr.Dataset:
    """z, z_t, u, v, w of a random sea with the noise of a measurement."""
    scene = Scene.load("full")
    exact, grid = scene.build_sea(), scene.grid
    names, noise = ("z", "z_t", "u", "v", "w"), np.random.default_rng(1)
    fields = {name: np.empty((steps, *grid.shape), np.float32) for name in names}
    for k in range(steps):
        values = exact.on_grid(grid.x_nodes, grid.y_nodes, k / scene.frame_rate, names)
        for name in names:
            size = 5e-5 if name == "z" else 1e-3
            fields[name][k] = values[name] + size * noise.standard_normal(grid.shape, np.float32)
    axes = {"time": np.arange(steps) / scene.frame_rate, "y": grid.y_nodes, "x": grid.x_nodes}
    labelled = {name: xr.DataArray(field, axes, ("time", "y", "x")) for name, field in fields.items()}
    return wf.cube(**labelled, velocity="instantaneous")


class Costs:
    """CPU seconds and megabytes of what is called."""

    def __init__(self) -> None:
        self.rows: dict[str, tuple[float, float]] = {}
        self._names = {product.compute: product.name for product in products.registered()}

    def of(self, name: str, call: Callable[[], Any]) -> Any:
        """Call, and keep what it cost."""
        tracemalloc.reset_peak()
        before, began = tracemalloc.get_traced_memory()[0], time.process_time()
        out = call()
        peak = tracemalloc.get_traced_memory()[1] - before
        self.rows[name] = time.process_time() - began, peak / MB
        return out

    def computed(self, inner: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """In place of the function that computes a product."""
        return lambda job: self.of(self._names[job[0]], lambda: inner(job))


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("cube", nargs="?", help="a cube's store")
    parser.add_argument("--steps", type=int, default=1200)
    options = parser.parse_args(words)
    cube = options.cube or sea(options.steps)
    costs = Costs()
    products._computed = costs.computed(products._computed)
    inner = analysis.one_pass
    analysis.one_pass = lambda *a, **k: costs.of("(pass over the cube)", lambda: inner(*a, **k))
    tracemalloc.start()
    began = time.process_time()
    analyze(cube)
    total = time.process_time() - began
    print(f"{'product':28s} {'CPU s':>8s} {'MB':>8s}")
    for name, (seconds, size) in sorted(costs.rows.items(), key=lambda row: -row[1][0]):
        print(f"{name:28s} {seconds:8.2f} {size:8.0f}")
    rest = total - sum(seconds for seconds, _ in costs.rows.values())
    print(f"{'(rest)':28s} {rest:8.2f}\n{'all':28s} {total:8.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
