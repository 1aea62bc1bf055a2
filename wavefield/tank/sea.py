"""A water surface known exactly: elevation and horizontal surface velocity as sums of waves.

The elevation z(x, y, t) and the horizontal velocity of the surface water u, v(x, y, t) are prescribed by
potential theory to first or second order; the vertical velocity is then *defined* by the kinematic condition

    w = z_t + u z_x + v z_y

so that water which moves with (u, v) and sits at z stays on the surface exactly, however steep the sea.
Every field is Re sum_j C_j(t) exp(i k_j . x): its derivatives are exact too.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.compiled import compiled
from wavefield.tank.bound_harmonics import BoundWaves, bound_waves
from wavefield.water import GAMMA, dispersion

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FIELDS = ("z", "z_x", "z_y", "z_t", "u", "v", "w")
_PRIMARY = ("z", "z_t", "u", "v")


@dataclass(frozen=True)
class Sea:
    """Free waves, with the waves bound to them, over water of constant depth with a uniform current.

    Parameters
    ----------
    kx, ky : array_like, (n,)
        Wave vectors, rad/m; they point where the waves go (relative to the water).
    amplitude : array_like of complex, (n,)
        z = Re sum a exp(i (k . x - omega t)), metres.
    depth : float, default infinity
        Depth, metres.
    surface_tension : float, default that of clean water
        Surface tension over density, m3 s-2.
    current : tuple of float, default (0, 0)
        Velocity of the water as a whole, m/s.
    bound : int, default 0
        How many free waves, the steepest, get second-order waves bound to them; 0 for a linear sea.

    Examples
    --------
    >>> sea = Sea([7.0], [0.0], [0.03])
    >>> at = sea.at(0.1, 0.2, 0.3)
    >>> bool(abs(at["w"] - (at["z_t"] + at["u"] * at["z_x"] + at["v"] * at["z_y"])) < 1e-15)
    True
    """

    kx: Array
    ky: Array
    amplitude: Complex
    depth: float = np.inf
    surface_tension: float = GAMMA
    current: tuple[float, float] = (0.0, 0.0)
    bound: int = 0
    _layout: "_WaveLayout" = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kx", np.atleast_1d(np.asarray(self.kx, float)))
        object.__setattr__(self, "ky", np.atleast_1d(np.asarray(self.ky, float)))
        object.__setattr__(self, "amplitude", np.atleast_1d(np.asarray(self.amplitude, complex)))
        kx, ky = self.kx, self.ky
        if self._bound is not None:
            kx, ky = np.concatenate([kx, self._bound.kx]), np.concatenate([ky, self._bound.ky])
        object.__setattr__(self, "_layout", _WaveLayout(kx, ky))

    @cached_property
    def k(self) -> Array:
        """Wave numbers of the free waves, (n,), rad/m."""
        return np.hypot(self.kx, self.ky)

    @cached_property
    def sigma(self) -> Array:
        """Angular frequencies of the free waves as seen by the water, (n,), rad/s."""
        out: Array = dispersion(self.k, self.depth, self.surface_tension)
        return out

    @cached_property
    def omega(self) -> Array:
        """Angular frequencies of the free waves as seen by the cameras, (n,), rad/s."""
        return self.sigma + self.kx * self.current[0] + self.ky * self.current[1]

    @property
    def axes(self) -> tuple[Array, Array]:
        """Wave numbers along x (nkx,) and along y (nky,) that occur in the sea, rad/m."""
        return self._layout.kx, self._layout.ky

    @property
    def shortest(self) -> float:
        """Shortest wavelength along an axis, bound waves included, metres."""
        top = max(self._layout.kx.max(initial=0.0), np.abs(self._layout.ky).max(initial=0.0))
        return 2 * np.pi / top if top > 0 else np.inf

    @property
    def reach(self) -> float:
        """Bound on the elevation that is hardly ever passed (4.5 standard deviations), metres."""
        power = 0.5 * float(np.sum(np.abs(self.amplitude) ** 2))
        out: float = min(float(np.sum(np.abs(self.amplitude))) * 1.1, 4.5 * np.sqrt(power))
        return out

    @cached_property
    def _bound(self) -> BoundWaves | None:
        if not self.bound:
            return None
        return bound_waves(
            self.kx, self.ky, self.amplitude, self.sigma, self.depth, self.surface_tension, self.bound
        )

    # -- coefficients at one instant ------------------------------------------------------------------

    def _coefficients(self, time: float) -> dict[str, Complex]:
        """Matrices (nky, nkx) of z, z_t, u, v on the layout's axes."""
        turned = self.amplitude * np.exp(-1j * self.omega * time)
        slip = self.sigma / (self.k * np.tanh(self.k * self.depth))  # velocity over elevation
        parts = {
            "z": turned,
            "z_t": -1j * self.omega * turned,
            "u": self.kx * slip * turned,
            "v": self.ky * slip * turned,
        }
        if self._bound is not None:
            more = self._bound.at(time, self.current)
            parts = {name: np.concatenate([parts[name], more[name]]) for name in _PRIMARY}
        return {name: self._layout.place(values) for name, values in parts.items()}

    def _matrices(self, time: float, names: Iterable[str]) -> list[Complex]:
        primary = self._coefficients(time)
        grad = {
            "z_x": lambda: 1j * self._layout.kx * primary["z"],
            "z_y": lambda: 1j * self._layout.ky[:, None] * primary["z"],
        }
        return [primary[name] if name in primary else grad[name]() for name in names]

    # -- fields ---------------------------------------------------------------------------------------

    def on_grid(self, x: Array, y: Array, time: float, names: Sequence[str] = FIELDS) -> dict[str, Array]:
        """Exact fields at the nodes of a regular grid.

        Parameters
        ----------
        x, y : ndarray, (nx,) and (ny,)
            Axes of the grid, metres.
        time : float
            Seconds.
        names : sequence of str
            Any of z, z_x, z_y, z_t, u, v, w.

        Returns
        -------
        dict of str to ndarray, (ny, nx)
            Metres, pure numbers (slopes) and m/s.
        """
        ex, ey = np.exp(1j * np.outer(self._layout.kx, x)), np.exp(1j * np.outer(y, self._layout.ky))
        return self._finish(self.sums(ex, ey, time, _needed(names)), names)

    def sums(self, ex: Complex, ey: Complex, time: float, names: Sequence[str]) -> dict[str, Array]:
        """Sums over waves without the current, for given values of the waves along the axes.

        Parameters
        ----------
        ex, ey : ndarray of complex, (nkx, nx) and (ny, nky)
            exp(i k . x) along each axis, times any weight of the wave numbers `axes`.
        time : float
            Seconds.
        names : sequence of str
            Any of z, z_x, z_y, z_t, u, v.

        Returns
        -------
        dict of str to ndarray, (ny, nx)
        """
        along_x = np.concatenate([ex.real, -ex.imag])
        along_y = np.concatenate([ey.real, ey.imag], axis=1)
        out = {}
        for name, matrix in zip(names, self._matrices(time, names), strict=True):
            # complex products written as real ones: [Re, Im] of ey @ matrix, then the real part of that @ ex
            both = np.block([[matrix.real, matrix.imag], [-matrix.imag, matrix.real]])
            out[name] = _product(_product(along_y, both), along_x)
        return out

    def at(self, x: ArrayLike, y: ArrayLike, time: float, names: Sequence[str] = FIELDS) -> dict[str, Array]:
        """Exact fields at scattered points.

        Parameters
        ----------
        x, y : array_like, broadcastable to shape S
            Positions, metres.
        time : float
            Seconds.
        names : sequence of str
            Any of z, z_x, z_y, z_t, u, v, w.

        Returns
        -------
        dict of str to ndarray, S
            Metres, pure numbers (slopes) and m/s.
        """
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        shape, x, y = x.shape, x.ravel(), y.ravel()
        requested = _needed(names)
        matrices = self._matrices(time, requested)
        out = {name: np.empty(x.size) for name in requested}
        for start in range(0, x.size, 2048):
            part = slice(start, start + 2048)
            ex = np.exp(1j * np.outer(x[part], self._layout.kx))
            ey = np.exp(1j * np.outer(y[part], self._layout.ky))
            for name, matrix in zip(requested, matrices, strict=True):
                out[name][part] = np.einsum("pk,pk->p", ey @ matrix, ex).real
        return {name: values.reshape(shape) for name, values in self._finish(out, names).items()}

    def _finish(self, out: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
        for name, speed in zip(("u", "v"), self.current, strict=True):
            if name in out and speed:
                out[name] = out[name] + speed
        if "w" in names:
            out["w"] = out["z_t"] + out["u"] * out["z_x"] + out["v"] * out["z_y"]
        return {name: out[name] for name in names}


def _needed(names: Sequence[str]) -> tuple[str, ...]:
    unknown = set(names) - set(FIELDS)
    if unknown:
        raise ValueError(f"the sea has no field {sorted(unknown)[0]!r}; it has {', '.join(FIELDS)}")
    return FIELDS[:-1] if "w" in names else tuple(names)


@compiled(fastmath=True)
def _product(a: Array, b: Array) -> Array:
    """Matrix product on one thread: BLAS would start threads of its own inside each of ours."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            factor = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]
    return out


class _WaveLayout:
    """Where each wave stands in a matrix (ky, kx) with kx >= 0: sums over waves become matrix products."""

    def __init__(self, kx: Array, ky: Array) -> None:
        self._mirror = kx < 0  # Re(C e^{ikx}) = Re(C* e^{-ikx})
        kx, ky = np.where(self._mirror, -kx, kx), np.where(self._mirror, -ky, ky)
        # equal wave numbers must meet in one row whatever the rounding of their making
        quantum = 1e-9 * max(float(np.max(np.abs(np.concatenate([kx, ky])), initial=0.0)), 1.0)
        rows, self._row = np.unique(np.round(ky / quantum), return_inverse=True)
        columns, self._column = np.unique(np.round(kx / quantum), return_inverse=True)
        self.ky, self.kx = rows * quantum, columns * quantum
        self._flat = self._row * self.kx.size + self._column

    def place(self, values: Complex) -> Complex:
        """Matrix (nky, nkx) of the coefficients of the waves, (n,)."""
        values = np.where(self._mirror, values.conj(), values)
        size = self.ky.size * self.kx.size
        real = np.bincount(self._flat, values.real, size)
        imag = np.bincount(self._flat, values.imag, size)
        return (real + 1j * imag).reshape(self.ky.size, self.kx.size)
