"""Current and surface tension fitted to the ridge, on exact seas: `python -m benchmarks.currents`.

Seas of free waves ~ f^-5 between 1 and 6 Hz, cos^(2s) (theta / 2) wide, in a periodic basin of 7.7 m seen
at through 1.5 x 2 m, 20 frames a second. Swept are s, the current (at a direction that is drawn) and the
depth. Of each fit: the error of the current, mm/s, the same over its stated error, surface tension over the
true one, and what was refused.
"""

import itertools
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from benchmarks.options import parser_of
from wavefield.errors import CubeError
from wavefield.water import GAMMA, dispersion, group_velocity
from wavefield.waves import fit_dispersion, spectrum

BASIN, STEP, NY, NX, DT, SEGMENT = 384, 0.02, 75, 100, 0.05, 256
LOWEST, HIGHEST = 1.0, 6.0  # Hz, without the current

Array = NDArray[Any]


def sea(s: float, current: Array, depth: float, heading: float, steps: int, seed: int) -> xr.DataArray:
    """w of free waves on a current, m/s, (time, y, x)."""
    rng = np.random.default_rng(seed)
    line = 2 * np.pi * np.fft.fftfreq(BASIN, STEP)
    kx, ky = line[None, :], line[:, None]
    k = np.maximum(np.hypot(kx, ky), 1e-9)
    sigma = dispersion(k, depth)
    f = sigma / (2 * np.pi)
    density = np.where((f > LOWEST) & (f < HIGHEST), f ** (-5.0 + 2), 0.0) * group_velocity(k, depth) / k
    density *= np.cos((np.arctan2(ky, kx) - heading) / 2) ** (2 * s)
    lines = np.sqrt(density) * (rng.standard_normal(k.shape) + 1j * rng.standard_normal(k.shape))
    lines = (lines / np.sqrt((np.abs(lines) ** 2).sum() / 2) * 0.1).astype("c8")
    turn = np.exp(-1j * (sigma + kx * current[0] + ky * current[1]) * DT).astype("c8")
    rows = np.flatnonzero((f < HIGHEST).any(axis=1))
    values, wide = np.empty((steps, NY, NX), "f4"), np.zeros((BASIN, NX), "c8")
    for frame in values:
        wide[rows] = fft.ifft(lines[rows], axis=1)[:, :NX]
        frame[:] = fft.ifft(wide, axis=0)[:NY].real * BASIN**2
        lines *= turn
    axes = {"time": np.arange(steps) * DT, "y": np.arange(NY) * STEP, "x": np.arange(NX) * STEP}
    return xr.DataArray(values, axes, ("time", "y", "x"), name="w", attrs={"units": "m s-1"})


def one(s: float, speed: float, depth: float, steps: int, seed: int) -> tuple[xr.Dataset | str, Array]:
    """A fit, or why it was refused, and the true current."""
    rng = np.random.default_rng(seed)
    heading, towards = 2 * np.pi * rng.random(2)
    current = speed * np.array([np.cos(towards), np.sin(towards)])
    found = spectrum(sea(s, current, depth, heading, steps, seed + 1), segment=SEGMENT)
    try:
        return fit_dispersion(found["E"], depth), current
    except CubeError as error:
        return str(error), current


def row(
    s: float, speed: float, depth: float, steps: int, seed: int
) -> tuple[float, float, float, float] | None:
    """Print a line of the table; error of U, of it over the stated, tension over the true and its error."""
    fit, current = one(s, speed, depth, steps, seed)
    start = f"| {s:g} | {speed:.2f} | {depth:g} |"
    if isinstance(fit, str):
        print(f"{start} refused: {fit} |", flush=True)
        return None
    error = np.array([float(fit["current_x"]), float(fit["current_y"])]) - current
    stated = np.array([float(fit["current_x_std"]), float(fit["current_y_std"])])
    gamma, spread = float(fit["gamma"]) / GAMMA, float(fit["gamma_std"]) / GAMMA
    size, relative = float(np.hypot(*error)), float(np.sqrt(np.mean((error / stated) ** 2)))
    print(f"{start} {1e3 * size:.2f} | {relative:.1f} | {gamma:.3f} +- {spread:.3f} |", flush=True)
    return size, relative, gamma, spread


def main() -> None:
    """Print the table and its summary."""
    parser = parser_of(__doc__)
    parser.add_argument("--steps", type=int, default=1536)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--spreads", type=float, nargs="+", default=[5, 10, 50])
    parser.add_argument("--speeds", type=float, nargs="+", default=[0, 0.1, 0.25, 0.5])
    parser.add_argument("--depths", type=float, nargs="+", default=[0.06, 0.2, 0.7, np.inf])
    given = parser.parse_args()
    print("| s | U, m/s | h, m | error of U, mm/s | over stated | tension over true |\n|" + "---|" * 6)
    cases = itertools.product(given.spreads, given.speeds, given.depths)
    found = [row(*case, given.steps, given.seed + 10 * i) for i, case in enumerate(cases)]
    fits = np.array([line for line in found if line is not None])
    size, relative, gamma, known = fits.T
    off = np.abs(gamma[known < 0.05] - 1)
    size = 1e3 * size
    print(
        f"{len(fits)} fits, {len(found) - len(fits)} refused; error of U: rms {np.sqrt(np.mean(size**2)):.2f}"
        f" mm/s, largest {size.max():.2f}, within 2 mm/s {np.mean(size < 2):.0%};"
        f" over stated, rms {np.sqrt(np.mean(relative**2)):.2f};"
        f" tension known to 5 % {off.size} times, largest error {off.max(initial=0):.0%},"
        f" within 5 % {np.mean(off < 0.05) if off.size else np.nan:.0%}"
    )


if __name__ == "__main__":
    main()
