"""Velocity and pressure below the surface, by potential continuation of the measured vertical velocity."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft
from scipy.sparse.linalg import LinearOperator, gmres

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import DENSITY, GRAVITY, water_of
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.wave_record import check_axes

Array = NDArray[Any]

ORDERS = 10  # of the expansion about z = 0
MAX_STEEPNESS = 2.0  # k times the largest elevation: shorter waves are left out
SHORTEST_WAVES = 0.7  # of the Nyquist wavenumber: shorter ones are mostly noise
TAPER = 0.12  # of each side: fields are brought to zero over it
PADDING = 1.5  # of each side, so that the field does not meet its own image
TOLERANCE, ITERATIONS = 1e-3, 30


@dataclass(frozen=True)
class _Box:
    """A rectangle of nodes in a larger periodic one."""

    shape: tuple[int, int]
    steps: tuple[float, float]  # dy, dx, m
    depth: float
    highest: float  # largest wavenumber, rad/m

    @cached_property
    def size(self) -> tuple[int, int]:
        return tuple(fft.next_fast_len(round(PADDING * n)) for n in self.shape)

    @cached_property
    def waves(self) -> tuple[Array, Array, Array, Array]:
        """ky, kx, k and k h of the half plane; k is 1 where it is 0."""
        ky = 2 * np.pi * np.fft.fftfreq(self.size[0], self.steps[0])[:, None]
        kx = 2 * np.pi * np.fft.rfftfreq(self.size[1], self.steps[1])[None]
        k = np.hypot(ky, kx)
        return ky, kx, np.where(k > 0, k, 1.0), np.minimum(k * min(self.depth, 1e300), 300.0)

    @cached_property
    def kept(self) -> Array:
        ky, kx, *_ = self.waves
        k = np.hypot(ky, kx)
        return np.asarray((k > 0) & (k <= self.highest))

    @cached_property
    def window(self) -> Array:
        """Of the rectangle, one but for a cosine at the edges."""
        sides = []
        for n in self.shape:
            inside = np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / max(TAPER * n, 1.0)
            sides.append(0.5 - 0.5 * np.cos(np.pi * np.minimum(inside, 1.0)))
        return np.outer(*sides)

    def tapered(self, values: Array) -> Array:
        """Values (ny, nx) in the larger rectangle, zero outside."""
        out = np.zeros(self.size)
        out[: self.shape[0], : self.shape[1]] = values * self.window
        return out

    def back(self, transform: Array) -> Array:
        """Field (ny, nx) of a transform."""
        return np.asarray(fft.irfft2(transform, self.size)[: self.shape[0], : self.shape[1]])

    def on_surface(self, surface: Array, transform: Array, odd: Array) -> Array:
        """A harmonic function on the surface, from its transform at z = 0."""
        k = self.waves[2]
        out, power = np.zeros(self.size), np.ones(self.size)
        for n in range(ORDERS):
            factor = np.where(self.kept, k**n * (odd if n % 2 else 1.0), 0.0)
            out += power * fft.irfft2(factor * transform, self.size)
            power = power * surface / (n + 1)
        return out

    def at_rest(self, surface: Array, values: Array, odd: Array) -> tuple[Array, float]:
        """Transform of the harmonic function at z = 0 that has some values on the surface, and its misfit.
        d^n / dz^n at z = 0 is k^n, times `odd` for odd n.
        """

        def on_surface(flat: Array) -> Array:
            return self.on_surface(surface, fft.rfft2(flat.reshape(self.size)), odd).ravel()

        right = fft.irfft2(np.where(self.kept, fft.rfft2(values), 0.0), self.size).ravel()
        size = right.size
        operator = LinearOperator((size, size), matvec=on_surface, dtype=float)
        found, _ = gmres(operator, right, rtol=TOLERANCE, restart=ITERATIONS, maxiter=1)
        norm = float(np.linalg.norm(values))
        misfit = float(np.linalg.norm(on_surface(found) - values.ravel()) / norm) if norm > 0 else 0.0
        return np.asarray(np.where(self.kept, fft.rfft2(found.reshape(self.size)), 0.0)), misfit

    def ratio(self, level: float, kind: str) -> Array:
        """cosh or sinh of k (h + z) over its value at z = 0."""
        k, kh = self.waves[2:]
        below = np.exp(k * level)  # level <= 0
        mirror = np.where(kh > 0, np.exp(-2 * kh), 0.0) * (1.0 if kind == "cosh" else -1.0)
        return np.asarray(below * (1 + mirror * np.exp(-2 * k * level)) / (1 + mirror))


def _step(box: _Box, fields: dict[str, Array], levels: Array, gamma: float) -> dict[str, Array]:
    """u, v, w, p at the levels, (levels, ny, nx), of one step's fields at the surface."""
    ky, kx, k, kh = box.waves
    tanh = np.tanh(kh)
    surface = box.tapered(fields["z"])
    w_rest, misfit_w = box.at_rest(surface, box.tapered(fields["w"]), 1 / np.where(kh > 0, tanh, 1.0))
    speed = 0.5 * (fields["u"] ** 2 + fields["v"] ** 2 + fields["w"] ** 2)
    curvature = fft.irfft2(np.where(box.kept, -(k**2), 0.0) * fft.rfft2(surface), box.size)
    on_surface = -GRAVITY * surface - box.tapered(speed) + gamma * curvature
    rate_rest, misfit_p = box.at_rest(surface, on_surface, tanh)
    potential = w_rest / (k * np.where(kh > 0, tanh, 1.0))
    ny, nx = box.shape
    inner = slice(ny // 4, -(ny // 4)), slice(nx // 4, -(nx // 4))
    missed = [
        box.on_surface(surface, 1j * along * potential, tanh)[:ny, :nx][inner] - fields[name][inner]
        for name, along in (("u", kx), ("v", ky))
    ]
    power = sum((fields[name][inner] ** 2).mean() for name in ("u", "v"))
    horizontal = np.sqrt(sum((part**2).mean() for part in missed) / power) if power > 0 else np.nan
    out: dict[str, list[Array]] = {name: [] for name in ("u", "v", "w", "p")}
    for level in levels:
        of_potential = potential * box.ratio(level, "cosh")
        velocity = [
            box.back(1j * kx * of_potential),
            box.back(1j * ky * of_potential),
            box.back(w_rest * box.ratio(level, "sinh")),
        ]
        rate = box.back(rate_rest * box.ratio(level, "cosh"))
        pressure = -DENSITY * (rate + 0.5 * sum(part**2 for part in velocity))
        wet = level <= fields["z"]
        for name, values in zip(out, (*velocity, pressure)):
            out[name].append(np.where(wet, values, np.nan))
    return {name: np.array(values) for name, values in out.items()} | {
        "surface_misfit": np.array(max(misfit_w, misfit_p)),
        "horizontal_misfit": np.array(horizontal),
    }


@takes(a_cube)
def subsurface(cube: xr.Dataset, levels: Sequence[float], *, depth: float | None = None) -> xr.Dataset:
    """Velocity and pressure below the surface, by potential continuation.

    Parameters
    ----------
    cube : Dataset
        z, u, v, w over (time, y, x), m and m/s, without gaps; about half a second a step: select some
        steps, as ``cube.isel(time=slice(100, 110))``. Computed at once.
    levels : sequence of float
        Heights, m, 0 at the mean level and negative below it.
    depth : float, optional
        Depth of the water, m; that of the cube, or deep, if not given.

    Returns
    -------
    Dataset
        ``u``, ``v``, ``w`` (time, level, y, x), m/s, without the mean current; ``p``, Pa, what the pressure
        exceeds -rho g z by. NaN above the surface. ``holds`` (level, y, x): where the field reaches far
        enough for the level; ``deepest``, m, the lowest level at which any node does. ``surface_misfit``
        (time): part of the measured w, or of the surface's condition for p, that the result does not have on
        the surface. ``horizontal_misfit`` (time): rms difference from the measured u and v on the surface,
        which are not used, over their rms, in the middle of the field: vortices, noise, and the water beyond
        the edges. Attribute ``shortest``, m, the shortest waves that are continued.

    Raises
    ------
    CubeError
        If a field is missing or has gaps, a level is above 0 or below the bottom, or none is given.

    Notes
    -----
    The potential is sum A cosh k(z + h) exp(i k . x) with A such that its vertical derivative on the
    measured surface is w: expanded about z = 0 to tenth order in k z and solved by GMRES. phi_t is harmonic
    as well; on the surface it is -g z - |u|^2 / 2 + gamma laplacian z; p is -rho (phi_t + |u|^2 / 2 + g z).
    Waves with k max|z| above 2 or beyond 0.7 of the Nyquist wavenumber are left out; a level of depth d is
    determined by waves longer than about 2 d, and by a surface of about d around each point: ``holds`` is
    true at nodes that are d + 1 / k inside of the edge, which a cosine tapers, k being the rms slope over the
    rms elevation; there the rms error of the velocity of random exact potentials is at most 0.15 of the rms
    of w at the surface (`tests/waves/test_continuation_and_averages.py`), mostly of u and v of long waves.

    Examples
    --------
    A deep-water wave: at a depth of 1 / k, 1 / e of its velocity and pressure are left.

    >>> y, x = np.arange(60) * 0.025, np.arange(80) * 0.025
    >>> k, a, sigma = 12.0, 0.001, float(np.sqrt(9.81 * 12))
    >>> phase = k * x + 0 * y[:, None]
    >>> fields = {"z": a * np.cos(phase), "w": a * sigma * np.sin(phase), "u": a * sigma * np.cos(phase)}
    >>> fields["v"] = 0 * phase
    >>> at = ("time", "y", "x")
    >>> data = {n: (at, np.stack([f, f]), {"units": "m" if n == "z" else "m s-1"}) for n, f in fields.items()}
    >>> found = subsurface(xr.Dataset(data, {"time": [0, 0.05], "y": y, "x": x}), [-1 / k])
    >>> middle = found.isel(time=0, level=0, x=slice(30, 50), y=slice(25, 35))
    >>> round(float(middle.u.max() / (a * sigma)), 1), round(float(middle.p.max() / (9810 * a)), 1)
    (0.4, 0.4)
    """
    for name in ("z", "u", "v", "w"):
        if name not in cube:
            raise CubeError(f"the cube has no {name!r}: velocities below the surface need z, u, v and w")
    fields = validate(cube, "z", "u", "v", "w").load()
    _, dy, dx = check_axes(fields)
    depth, gamma = water_of(cube.attrs, depth)
    level = np.atleast_1d(np.asarray(levels, float))
    if not level.size or level.max() > 0 or level.min() < -depth:
        raise CubeError(f"levels are heights of 0 and less, down to the bottom at {-depth:g} m: got {levels}")
    arrays = {name: fields[name].values.astype(float) for name in ("z", "u", "v", "w")}
    gaps = [name for name, values in arrays.items() if not np.isfinite(values).all()]
    if gaps:
        raise CubeError(
            f"{', '.join(gaps)} of the cube {'has' if len(gaps) == 1 else 'have'} gaps: crop them, or fill"
            " them (`cube.interpolate_na`)"
        )
    for name in ("u", "v"):
        arrays[name] -= arrays[name].mean()
    highest = min(
        SHORTEST_WAVES * np.pi / max(dy, dx), MAX_STEEPNESS / max(float(np.abs(arrays["z"]).max()), 1e-9)
    )
    box = _Box(arrays["z"].shape[1:], (dy, dx), depth, highest)
    steps = [_step(box, {n: a[i] for n, a in arrays.items()}, level, gamma) for i in range(len(arrays["z"]))]
    dims = ("time", "level", "y", "x")
    out: dict[str, Any] = {n: (dims, np.stack([s[n] for s in steps])) for n in ("u", "v", "w", "p")}
    for name in ("surface_misfit", "horizontal_misfit"):
        out[name] = ("time", np.array([float(s[name]) for s in steps]))
    ny, nx = box.shape
    inside = [np.minimum(np.arange(n), np.arange(n)[::-1]) - TAPER * n for n in (ny, nx)]
    reach = np.minimum(inside[0][:, None] * dy, inside[1] * dx)
    slopes = np.gradient(arrays["z"], dy, dx, axis=(1, 2))
    slope = float(np.sqrt(sum((part**2).mean() for part in slopes)))
    margin = float(arrays["z"].std()) / slope if slope > 0 else 0.0
    holds = reach >= margin - level[:, None, None]
    out["holds"] = (("level", "y", "x"), holds)
    out["deepest"] = ((), -max(float(reach.max()) - margin, 0.0))
    coords = {"time": fields["time"], "level": level, "y": fields["y"], "x": fields["x"]}
    return annotate(xr.Dataset(out, coords), "subsurface").assign_attrs(shortest=2 * np.pi / highest)
