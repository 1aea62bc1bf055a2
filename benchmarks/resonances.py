"""Coherence of wave vectors on seas of an independent generator: false discoveries, and planted quartets.

`python -m benchmarks.resonances --seas 6 --first 52000`: Gaussian seas (isotropic to s = 50, bimodal, on a
current), each alone, and with four trains of free waves on resonance at wave vectors between the cells, whose
fourth has a share of its power from the product of the other three.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "waves"))

from independent_seas import GRAVITY, REFEREE_SEAS, LatticeSea

from benchmarks.options import parser_of
from wavefield.waves import resonances

Array = NDArray[Any]

NY, NX = 28, 34
BAND = 0.7  # rad/s, of the trains
APART, FROM_ZERO = 4.5, 2.6  # cells


def _frequency(k: Array, sea: LatticeSea) -> Array:
    length = np.hypot(k[..., 0], k[..., 1])
    return np.asarray(np.sqrt(GRAVITY * length * np.tanh(length * sea.depth)))


def _cell(sea: LatticeSea) -> Array:
    return np.asarray(2 * np.pi / (np.array([NX, NY]) * sea.dx))


def resonant_quartet(rng: np.random.Generator, sea: LatticeSea) -> Array:
    """Wave vectors (kx, ky) on resonance whose pairs the windows resolve, (4, 2), rad/m."""
    low, high = 2 * np.pi * (sea.lowest + 0.1), 2 * np.pi * (sea.highest - 0.1)
    cell = _cell(sea)
    while True:
        angle = rng.uniform(-np.pi, np.pi, 3)
        way = np.column_stack([np.cos(angle), np.sin(angle)])
        k1, k2 = (rng.uniform(low, high, 2) ** 2 / GRAVITY)[:, None] * way[:2]
        k3 = np.linspace(2, 60, 4000)[:, None] * way[2]
        k4 = k1 + k2 - k3
        off = _frequency(k1, sea) + _frequency(k2, sea) - _frequency(k3, sea) - _frequency(k4, sea)
        for i in np.flatnonzero(np.diff(np.sign(off))):
            k = np.array([k1, k2, k3[i], k4[i]])
            inside = (_frequency(k, sea) > low) & (_frequency(k, sea) < high)
            apart = np.abs((k[:2, None] - k[None, 2:]) / cell).max(axis=-1)
            if inside.all() and (apart > APART).all() and (np.hypot(*k.T) > FROM_ZERO * cell.max()).all():
                return k


def _train(rng: np.random.Generator, steps: int, dt: float) -> Array:
    omega = 2 * np.pi * np.fft.fftfreq(steps, dt)
    a = np.fft.ifft(np.exp(-((omega / BAND) ** 2) / 2) * (rng.standard_normal((steps, 2)) @ [1, 1j]))
    return np.asarray(a / np.sqrt((np.abs(a) ** 2).mean()))


def plant(
    w: xr.DataArray, sea: LatticeSea, k: Array, amplitude: float, share: float, seed: int
) -> xr.DataArray:
    """Add four wave trains; a share of the fourth's power goes with the product of the others."""
    rng = np.random.default_rng(seed)
    trains = [_train(rng, w.sizes["time"], sea.dt) for _ in range(4)]
    product = trains[0] * trains[1] * trains[2].conj()
    product /= np.sqrt((np.abs(product) ** 2).mean())
    trains[3] = np.sqrt(share) * product + np.sqrt(1 - share) * trains[3]
    t, y, x = (w[name].values for name in ("time", "y", "x"))
    values = w.values.copy()
    for (kx, ky), omega, train in zip(k, _frequency(k, sea) + k @ np.array(sea.current), trains):
        turned = (amplitude * train * np.exp(-1j * omega * t)).astype("c8")
        values += (turned[:, None, None] * np.exp(1j * (ky * y[:, None] + kx * x)).astype("c8")).real
    return w.copy(data=values)


def rank_of(found: xr.Dataset, k: Array, cell: Array) -> int | None:
    """Place of a quartet among the significant ones."""
    orders = [(*p, *q) for p in ((0, 1), (1, 0)) for q in ((2, 3), (3, 2))]
    orders += [(c, d, a, b) for a, b, c, d in orders]
    for i in np.flatnonzero(found.quartet_significant.values):
        at = np.stack([found.quartet_kx[i], found.quartet_ky[i]], axis=-1)
        if any((np.abs(at[list(order)] - k) < 1.5 * cell).all() for order in orders):
            return int(i)
    return None


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seas", type=int, default=6)
    parser.add_argument("--first", type=int, default=52000, help="seed of the first sea")
    parser.add_argument("--steps", type=int, default=2400)
    parser.add_argument("--amplitude", type=float, default=1.0, help="of the trains over the rms of w")
    parser.add_argument("--share", type=float, default=0.5)
    parser.add_argument("--noise", type=float, default=5e-5, help="of displacements, m")
    given = parser.parse_args()
    print(
        "| seed | sea | false quartets, triads | found, of so many | mismatch, rad/s | power |\n"
        + "|---" * 6
        + "|"
    )
    names = list(REFEREE_SEAS)[:6]
    for seed in range(given.first, given.first + given.seas):
        name = names[seed % len(names)]
        sea = replace(REFEREE_SEAS[name], shape=(given.steps, NY, NX), side=150, noise=given.noise)
        w = sea.cube(seed, names=("w",))["w"]
        k = resonant_quartet(np.random.default_rng(seed), sea)
        planted = plant(w, sea, k, given.amplitude * float(w.std()), given.share, seed)
        alone, found = (resonances(f, sea.depth, current=sea.current) for f in (w, planted))
        false = [int(alone[f"{kind}_significant"].sum()) for kind in ("quartet", "triad")]
        rank = rank_of(found, k, _cell(sea))
        of = int(found.quartet_significant.sum())
        power = float(found.power.sel(share=given.share, method="nearest"))
        mismatch = ""
        if rank is not None:
            mismatch = f"{found.quartet_mismatch[rank]:.2f} +- {found.quartet_mismatch_std[rank]:.2f}"
        cells = (seed, name, false, f"{'no' if rank is None else rank + 1}, {of}", mismatch, f"{power:.2f}")
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
