"""Coherence of wave vectors: false discoveries on random seas, and planted quartets that are found.

`python -m benchmarks.resonances --seas 40 --planted 4`: Gaussian seas of 3,072 steps, and of 12,000 with a
quartet of wave vectors whose fourth wave goes in part with the other three.
"""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from benchmarks.options import parser_of
from wavefield.water import dispersion
from wavefield.waves import resonances

NODES, NY, NX, STEP, DT, DEPTH = 40, 24, 32, 0.06, 0.05, 0.7
CELLS = np.array([(2, 2), (-2, -2), (2, -2), (-2, 2)])  # of every second cell: a wave vector and its images

Array = NDArray[Any]


def gaussian_sea(steps: int, seed: int) -> xr.DataArray:
    """Waves of 1.2 to 3 Hz with random phases, (time, y, x), a piece of a periodic box."""
    rng = np.random.default_rng(seed)
    k = 2 * np.pi * np.fft.fftfreq(NODES, STEP)
    free = dispersion(np.hypot(k[:, None], k), DEPTH)
    omega = 2 * np.pi * np.fft.fftfreq(steps, DT)[:, None, None]
    size = np.exp(-(((omega + free) / 0.6) ** 2) / 4) / np.maximum(free, 1) ** 2.5
    size *= (free > 2 * np.pi * 1.2) & (free < 2 * np.pi * 3.0)
    lines = size.astype("c8") * rng.standard_normal(size.shape, dtype="f4")
    lines += 1j * size * rng.standard_normal(size.shape, dtype="f4")
    w = np.fft.ifftn(lines).real[:, :NY, :NX]
    axes = {"time": np.arange(steps) * DT, "y": np.arange(NY) * STEP, "x": np.arange(NX) * STEP}
    return xr.DataArray(0.1 * w / w.std(), axes, ("time", "y", "x"), name="w", attrs={"units": "m s-1"})


def _train(rng: np.random.Generator, steps: int) -> Array:
    omega = 2 * np.pi * np.fft.fftfreq(steps, DT)
    a = np.fft.ifft(np.exp(-(omega**2) / 2) * (rng.standard_normal((steps, 2)) @ [1, 1j]))
    return np.asarray(a / np.sqrt((np.abs(a) ** 2).mean()))


def plant(w: xr.DataArray, amplitude: float, part: float, seed: int) -> xr.DataArray:
    """Add four wave trains; `part` of the fourth's energy goes with the product of the others."""
    rng = np.random.default_rng(seed)
    trains = [_train(rng, w.sizes["time"]) for _ in range(4)]
    product = trains[0] * trains[1] * trains[2].conj()
    product /= np.sqrt((np.abs(product) ** 2).mean())
    trains[3] = np.sqrt(part) * product + np.sqrt(1 - part) * trains[3]
    t, y, x = (w[name].values for name in ("time", "y", "x"))
    values = w.values.copy()
    for (row, column), train in zip(CELLS, trains):
        ky, kx = 4 * np.pi * row / (NY * STEP), 4 * np.pi * column / (NX * STEP)
        turned = train * np.exp(-1j * float(dispersion(np.hypot(ky, kx), DEPTH)) * t)
        values += amplitude * (turned[:, None, None] * np.exp(1j * (ky * y[:, None] + kx * x))).real
    return w.copy(data=values)


def _planted(found: xr.Dataset) -> tuple[float, bool]:
    planted_cells = {tuple(cell) for cell in CELLS.tolist()}
    for i in range(found.sizes["quartet"]):
        rows = (found.quartet_ky[i] * NY * STEP / (4 * np.pi)).round().astype(int).values
        columns = (found.quartet_kx[i] * NX * STEP / (4 * np.pi)).round().astype(int).values
        if set(zip(rows.tolist(), columns.tolist())) == planted_cells:
            return float(found.quartet_coherence[i]), bool(found.quartet_significant[i])
    return float("nan"), False


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seas", type=int, default=40)
    parser.add_argument("--planted", type=int, default=4)
    given = parser.parse_args()
    false = [0, 0]
    for seed in range(given.seas):
        found = resonances(gaussian_sea(3072, 100 + seed), DEPTH)
        false[0] += bool(found.quartet_significant.any())
        false[1] += bool(found.triad_significant.any())
    print(f"random seas with a false quartet: {false[0]} of {given.seas}; with a false triad: {false[1]}")
    print("| amplitude over rms of w, 12,000 steps | squared coherence | found |\n|---|---|---|")
    for seed in range(given.planted):
        sea = gaussian_sea(12_000, 500 + seed)
        for amplitude in (0.11, 0.13):
            value, there = _planted(resonances(plant(sea, 0.1 * amplitude, 0.5, 900 + seed), DEPTH))
            print(f"| {amplitude} | {value:.3f} | {'yes' if there else 'no'} |", flush=True)


if __name__ == "__main__":
    main()
