"""How often the 95 % intervals of the spectra hold: `python -m benchmarks.coverage`.

Gaussian seas of free waves with linear kinematics, cos^(2s) (theta / 2) wide, seen through a part of their
periodic basin. The truth of each estimate is the mean of the other draws' estimates, whose own error is taken
into the count by as much narrower a deviation. Printed are the fractions of cells, weighted alike, whose
interval holds it: E(k, omega) of w and of u . grad z, D(theta), E(omega) and E(k) of w; and how often two
independent seas exceed the 5 % level of coherence.
"""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from benchmarks.options import parser_of
from wavefield.water import dispersion
from wavefield.waves import cross_spectra, directions, spectrum
from wavefield.waves.cross import significance_level
from wavefield.waves.welch import interval

NODES, STEP, NY, NX, DT, DEPTH = 72, 0.04, 38, 50, 0.05, 0.7
LOWEST, HIGHEST, WIDTH = 1.4, 3.4, 0.4  # Hz, Hz, rad/s: waves are drawn anew before they come round again
_ROWS = ("w", "nl", "D", "omega", "k")

Array = NDArray[Any]


def sea(s: float, steps: int, seed: int) -> xr.Dataset:
    """z, z_t, u, v, w of a Gaussian sea, (time, y, x); standard deviation 8 mm in the mean of draws."""
    rng = np.random.default_rng(seed)
    line = 2 * np.pi * np.fft.fftfreq(NODES, STEP)
    kx, ky = line[None, :], line[:, None]
    k = np.maximum(np.hypot(kx, ky), 1e-9)
    free = dispersion(k, DEPTH)
    omega = 2 * np.pi * np.fft.fftfreq(steps, DT)[:, None, None]
    size = np.exp(-(((-omega - free) / WIDTH) ** 2) / 4) / np.maximum(free, 1) ** 2.5
    size *= (free > 2 * np.pi * LOWEST) & (free < 2 * np.pi * HIGHEST)
    size *= np.abs(np.cos(np.arctan2(ky, kx) / 2)) ** s
    lines = size * (
        rng.standard_normal(size.shape, dtype="f4") + 1j * rng.standard_normal(size.shape, dtype="f4")
    )
    # the variance of the law, not of the draw: that would take from rings the scatter they have in common
    lines = (0.008 * lines / np.sqrt((size**2).sum())).astype("c8") * lines.size
    slip = free / k / np.tanh(k * DEPTH)
    gains = {"z": 1.0, "z_t": 1j * omega, "u": kx * slip, "v": ky * slip, "w": 1j * omega}
    axes = {"time": np.arange(steps) * DT, "y": np.arange(NY) * STEP, "x": np.arange(NX) * STEP}
    out = {}
    for name, gain in gains.items():
        values = fft.ifftn((lines * gain).astype("c8")).real[:, :NY, :NX].astype("f4")
        out[name] = (("time", "y", "x"), values, {"units": "m" if name == "z" else "m s-1"})
    return xr.Dataset(out, axes, {"water_depth": DEPTH, "frame_rate": 1 / DT})


def held(values: Array, low: Array, high: Array, there: Array) -> float:
    """Fraction of the estimates, (draws, ...), whose interval holds the mean of the other draws."""
    n = len(values)
    others = (values.sum(axis=0) - values) / (n - 1)
    # the others' mean errs too: the deviation is wider by sqrt(1 + 1 / (n - 1))
    nearer = values * np.exp(np.log(others / values) / np.sqrt(n / (n - 1)))
    inside = (nearer >= low * values) & (nearer <= high * values)
    return float(inside[there].mean())


def row(s: float, steps: int, segment: int, draws: int, seed: int) -> None:
    """Print a line of the table."""
    found: dict[str, list[Array]] = {f"{part}{name}": [] for name in _ROWS for part in ("", "dof_")}
    levels = []
    before: xr.Dataset | None = None
    for draw in range(draws):
        cube = sea(s, steps, seed + draw)
        ring = cross_spectra(cube, ("w", "nl"), segment=segment)
        for name in ("w", "nl"):
            found[name].append(ring[f"E_{name}"].values)
            found[f"dof_{name}"].append(ring[f"dof_{name}"].values)
        for name, over in (("omega", "k"), ("k", "omega")):
            found[name].append(ring["E_w"].sum(over).values)
            found[f"dof_{name}"].append(ring[f"dof_{name}_w"].values)
        S = spectrum(cube["w"], segment=segment)
        D = directions(
            S["E"], [1.8, 2.2, 2.6, 3.0], DEPTH, current=(0.0, 0.0), dof=S.attrs["degrees_of_freedom"]
        )
        found["D"].append(D["D"].values)
        found["dof_D"].append(D["dof"].values)
        if before is not None:
            pair = xr.Dataset({"z_t": before["w"], "w": cube["w"]})
            cross = cross_spectra(pair, ("z_t", "w"), (("z_t", "w"),), segment=segment)
            gamma2 = np.abs(cross["S_z_t_w"]) ** 2 / (cross["E_z_t"] * cross["E_w"])
            over = gamma2 > significance_level((cross["dof_z_t"] * cross["dof_w"]) ** 0.5 / 2)
            waves = cross["valid"] & (cross["E_w"] > 1e-3 * cross["E_w"].max("k"))
            waves &= (cross["frequency"] > LOWEST) & (cross["frequency"] < HIGHEST)
            levels.append(float(over.where(waves).mean()))
            before = None
        else:
            before = cube
    arrays = {name: np.array(values) for name, values in found.items()}
    fractions = []
    for name in _ROWS:
        mean = arrays[name].mean(axis=0)
        if name == "D":
            there = mean > 0.02 * mean.max(axis=-1, keepdims=True)
        elif name in ("omega", "k"):
            there = mean > 1e-3 * mean.max()
        else:
            there = ring["valid"].values & (mean > 1e-3 * mean.max())
        low, high = interval(arrays[f"dof_{name}"])
        everywhere = np.broadcast_to(there, arrays[name].shape)
        fractions.append(held(arrays[name], low, high, everywhere))
    null = f"{np.mean(levels):.3f} +- {np.std(levels, ddof=1) / np.sqrt(len(levels)):.3f}"
    cells = " | ".join(f"{f:.3f}" for f in fractions)
    print(f"| {s:g} | {segment} | {cells} | {null} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--steps", type=int, default=1280)
    parser.add_argument("--segments", type=int, nargs="+", default=[64, 256])
    parser.add_argument("--spreads", type=float, nargs="+", default=[0, 10, 30])
    parser.add_argument("--seed", type=int, default=4000)
    given = parser.parse_args()
    print("| s | segment | E(k, omega) of w | of u.grad z | D(theta) | E(omega) | E(k) | null of coherence |")
    print("|" + "---|" * 8)
    for s in given.spreads:
        for segment in given.segments:
            row(s, given.steps, segment, given.draws, given.seed)


if __name__ == "__main__":
    main()
