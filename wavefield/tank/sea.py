"""A sea of free waves and second-order bound waves, in water of any depth, with surface tension.

The kinematic and dynamic conditions are expanded to second order at z = 0,

    phi2_z - z2_t                  = grad phi1 . grad z1 - z1 phi1_zz                       = F
    phi2_t + g z2 - gamma lap z2   = -|grad phi1|^2/2 - phi1_z^2/2 - z1 phi1_tz             = G

where phi is the velocity potential, z the elevation, g gravity, gamma the surface tension over density, and
1 and 2 the orders. In water of depth h each pair (m, n) of free waves, with wave vectors k and frequencies s,
forces a bound wave with wave vector K = k_m +- k_n and frequency S = s_m +- s_n. With z2, phi2, F and G now
the complex amplitudes of exp(i (K . x - S t)):

    z2 = (q G + i S F) / (q g' - S^2),   phi2 = (g' F - i S G) / (q g' - S^2),
    q = |K| tanh |K|h,   g' = g + gamma K^2.

To second order the velocity of the surface water is grad phi1 + z1 grad phi1_z + grad phi2 at z = 0. Beads
that follow it have the Stokes drift.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.compiled import compiled
from wavefield.water import GAMMA, GRAVITY, dispersion

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MIN_DETUNING = 0.1  # pairs with |q g' - S^2| below this fraction of q g' are resonant, beyond second order


@dataclass(frozen=True)
class BoundWaves:
    """Second-order waves that p pairs of free waves force; several pairs may share one of m wave vectors."""

    kx: Array  # (m,): Wave vectors, rad/m
    ky: Array
    z: Complex  # (p,): Elevation of each pair at time zero, metres
    u: Complex  # (p,): Velocity of each pair at time zero, m/s
    v: Complex
    frequency: Array  # (p,): Frequency of each pair relative to the water, rad/s
    target: NDArray[np.int64]  # (p,): Index of the wave vector of each pair

    def at(self, time: float, current: tuple[float, float]) -> dict[str, Complex]:
        """Return complex amplitudes (m,) of z (m), z_t, u and v (m/s), by these names, at a time, s.
        The `current`, m/s, carries the waves along; its own velocity is not added to u and v."""
        turn = np.exp(-1j * self.frequency * time)
        drift = self.kx * current[0] + self.ky * current[1]
        carried = np.exp(-1j * drift * time)

        def gather(values: Complex) -> Complex:
            real, imag = (np.bincount(self.target, part, self.kx.size) for part in (values.real, values.imag))
            return np.asarray((real + 1j * imag) * carried)

        z = gather(self.z * turn)
        return {
            "z": z,
            "z_t": gather(-1j * self.frequency * self.z * turn) - 1j * drift * z,
            "u": gather(self.u * turn),
            "v": gather(self.v * turn),
        }


def bound_waves(
    kx: Array, ky: Array, amplitude: Complex, sigma: Array, depth: float, surface_tension: float, number: int
) -> BoundWaves:
    """Return the second-order waves that the `number` steepest of n free waves force.
    The wave vectors kx and ky, rad/m, `amplitude`, m, and the frequency `sigma` relative to the water, rad/s,
    are (n,). `depth` is in m; `surface_tension` is over density, m3 s-2."""
    steep = np.argsort(-np.hypot(kx, ky) * np.abs(amplitude), kind="stable")[:number]
    kx, ky, a, s = kx[steep], ky[steep], amplitude[steep], sigma[steep]
    k = np.hypot(kx, ky)
    b = a * s / (k * np.tanh(k * depth))  # potential: phi1 = Re sum -i b exp(i theta)
    dot = np.multiply.outer(kx, kx) + np.multiply.outer(ky, ky)
    parts = []
    for sign in (+1, -1):
        # index i for the potential, j for the elevation; for differences the second factor is conjugate
        ai, bi = a[:, None], b[:, None]
        aj, bj = (a, b) if sign > 0 else (a.conj(), b.conj())
        ki2, si = (k * k)[:, None], s[:, None]
        f = 0.5j * bi * aj * (sign * dot + ki2)
        g = 0.5 * (-0.5 * dot * bi * bj + sign * 0.5 * si * s * ai * aj + si * si * ai * aj)
        sum_x, sum_y = kx[:, None] + sign * kx, ky[:, None] + sign * ky
        frequency = np.broadcast_to(si + sign * s, dot.shape)
        length = np.hypot(sum_x, sum_y)
        with np.errstate(invalid="ignore"):
            q = length * np.tanh(length * depth)
        stiffness = GRAVITY + surface_tension * length**2
        det = q * stiffness - frequency**2
        bound = (length > 1e-9) & (np.abs(det) > MIN_DETUNING * q * stiffness)
        det = np.where(bound, det, np.inf)
        z = (q * g + 1j * frequency * f) / det
        phi = (stiffness * f - 1j * frequency * g) / det
        lift = 0.5 * si * ai * aj  # z1 grad phi1_z
        u, v = kx[:, None] * lift + 1j * sum_x * phi, ky[:, None] * lift + 1j * sum_y * phi
        # K = 0, a wave with itself, adds nothing to the mean level but the mean drift
        used = bound | (length <= 1e-9)
        parts.append([part[used] for part in (sum_x, sum_y, z, u, v, frequency)])
    sum_x, sum_y, z, u, v, frequency = (np.concatenate(p) for p in zip(*parts, strict=True))
    quantum = 1e-9 * max(float(np.abs(k).max(initial=1.0)), 1.0)
    keys = np.stack([np.round(sum_x / quantum), np.round(sum_y / quantum)], axis=1)
    vectors, target = np.unique(keys, axis=0, return_inverse=True)
    return BoundWaves(
        vectors[:, 0] * quantum, vectors[:, 1] * quantum, z, u, v, frequency, target.reshape(-1)
    )


FIELDS = ("z", "z_x", "z_y", "z_t", "u", "v", "w")


@dataclass(frozen=True)
class Sea:
    """Free waves and the waves bound to them, in water of constant depth with a uniform current.

    Parameters
    ----------
    kx, ky : array_like, (n,)
        Wave vectors, rad/m; they point in the direction of propagation relative to the water.
    amplitude : array_like of complex, (n,)
        Complex amplitudes a, metres: z = Re sum a exp(i (k . x - omega t)), with omega at a fixed point.
    depth : float, default infinity
        Depth, metres.
    surface_tension : float, default that of clean water
        Surface tension over density, m3 s-2.
    current : tuple of float, default (0, 0)
        Uniform velocity of the water, m/s.
    bound : int, default 0
        Number of free waves, taken from the steepest, that force second-order bound waves; 0: linear sea.

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
        """Wavenumbers of the free waves, (n,), rad/m."""
        return np.hypot(self.kx, self.ky)

    @cached_property
    def sigma(self) -> Array:
        """Angular frequencies of the free waves relative to the water, (n,), rad/s."""
        return np.asarray(dispersion(self.k, self.depth, self.surface_tension))

    @cached_property
    def omega(self) -> Array:
        """Angular frequencies of the free waves at a fixed point, (n,), rad/s."""
        return self.sigma + self.kx * self.current[0] + self.ky * self.current[1]

    @property
    def axes(self) -> tuple[Array, Array]:
        """Different wavenumbers of all waves along x, (nkx,), and along y, (nky,), rad/m.
        A wave with kx < 0 is represented by its complex conjugate at -k."""
        return self._layout.kx, self._layout.ky

    @property
    def shortest(self) -> float:
        """Shortest wavelength along x or y, m: 2 pi over the largest |kx| or |ky|; infinite without waves."""
        top = max(self._layout.kx.max(initial=0.0), np.abs(self._layout.ky).max(initial=0.0))
        return 2 * np.pi / top if top > 0 else np.inf

    @property
    def reach(self) -> float:
        """Elevation that the sea hardly ever exceeds, m.
        This is 4.5 standard deviations or 1.1 times the sum of all amplitudes, whichever is smaller."""
        height = np.abs(self.amplitude)
        return float(min(np.sum(height) * 1.1, 4.5 * np.sqrt(0.5 * np.sum(height**2))))

    @cached_property
    def _bound(self) -> BoundWaves | None:
        if not self.bound:
            return None
        return bound_waves(
            self.kx, self.ky, self.amplitude, self.sigma, self.depth, self.surface_tension, self.bound
        )

    def _coefficients(self, time: float) -> dict[str, Complex]:
        """Return complex amplitudes (nky, nkx) of all waves at a time, s, by name of field (all but w)."""
        turned = self.amplitude * np.exp(-1j * self.omega * time)
        velocity_over_elevation = self.sigma / (self.k * np.tanh(self.k * self.depth))
        waves = {
            "z": turned,
            "z_t": -1j * self.omega * turned,
            "u": self.kx * velocity_over_elevation * turned,
            "v": self.ky * velocity_over_elevation * turned,
        }
        if self._bound is not None:
            bound = self._bound.at(time, self.current)
            waves = {name: np.concatenate([values, bound[name]]) for name, values in waves.items()}
        out = {name: self._layout.place(values) for name, values in waves.items()}
        out["z_x"] = 1j * self._layout.kx * out["z"]
        out["z_y"] = 1j * self._layout.ky[:, None] * out["z"]
        return out

    def on_grid(self, x: Array, y: Array, time: float, names: Sequence[str] = FIELDS) -> dict[str, Array]:
        """Return the exact fields `names`, (ny, nx), at a time, s, on axes x (nx,) and y (ny,), metres.
        The result is a dict by name. z is in m, z_t, u, v and w in m/s; z_x and z_y are slopes."""
        ex, ey = np.exp(1j * np.outer(self._layout.kx, x)), np.exp(1j * np.outer(y, self._layout.ky))
        return self._finish(self.sums(ex, ey, time, _needed(names)), names)

    def sums(self, ex: Complex, ey: Complex, time: float, names: Sequence[str]) -> dict[str, Array]:
        """Return the fields `names`, (ny, nx), at a time, s, as sums over all waves, without the current.
        `ex` (nkx, nx) is exp(i kx x) and `ey` (ny, nky) is exp(i ky y); each may contain a factor that
        depends on the wavenumber. The field w is not available."""
        along_x = np.concatenate([ex.real, -ex.imag])
        along_y = np.concatenate([ey.real, ey.imag], axis=1)
        coefficients = self._coefficients(time)
        out = {}
        for name in names:
            matrix = coefficients[name]
            # Re(ey @ matrix @ ex) by two real products, of stacked real and imaginary parts
            both = np.block([[matrix.real, matrix.imag], [-matrix.imag, matrix.real]])
            out[name] = _product(_product(along_y, both), along_x)
        return out

    def at(self, x: ArrayLike, y: ArrayLike, time: float, names: Sequence[str] = FIELDS) -> dict[str, Array]:
        """Return the exact fields `names` at a time, s, at points x, y, m, of any shape.
        The result is a dict by name. z is in m, z_t, u, v and w in m/s; z_x and z_y are slopes."""
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        shape, x, y = x.shape, x.ravel(), y.ravel()
        coefficients = self._coefficients(time)
        ex, ey = np.exp(1j * np.outer(x, self._layout.kx)), np.exp(1j * np.outer(y, self._layout.ky))
        out = {name: np.einsum("pk,pk->p", ey @ coefficients[name], ex).real for name in _needed(names)}
        return {name: values.reshape(shape) for name, values in self._finish(out, names).items()}

    def _finish(self, out: dict[str, Array], names: Sequence[str]) -> dict[str, Array]:
        """Add the current to `out`, compute w as z_t + u z_x + v z_y, and return the fields `names`."""
        for name, speed in zip(("u", "v"), self.current, strict=True):
            if name in out and speed:
                out[name] = out[name] + speed
        if "w" in names:
            out["w"] = out["z_t"] + out["u"] * out["z_x"] + out["v"] * out["z_y"]
        return {name: out[name] for name in names}


def _needed(names: Sequence[str]) -> tuple[str, ...]:
    """Return the fields that must be summed over waves to find the fields `names`; w needs all others.
    Raises a ValueError for an unknown name."""
    unknown = set(names) - set(FIELDS)
    if unknown:
        raise ValueError(f"the sea has no field {sorted(unknown)[0]!r}; it has {', '.join(FIELDS)}")
    return FIELDS[:-1] if "w" in names else tuple(names)


@compiled(fastmath=True)
def _product(a: Array, b: Array) -> Array:
    """Return the matrix product a @ b, computed on one thread."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            factor = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]
    return out


class _WaveLayout:
    """Arranges n waves (kx, ky) in a matrix over ky and kx >= 0, to sum over waves by matrix products."""

    def __init__(self, kx: Array, ky: Array) -> None:
        self._mirror = kx < 0  # Re(C e^{ikx}) = Re(C* e^{-ikx})
        kx, ky = np.where(self._mirror, -kx, kx), np.where(self._mirror, -ky, ky)
        # equal wavenumbers share one row, whatever their rounding errors
        quantum = 1e-9 * max(float(np.max(np.abs(np.concatenate([kx, ky])), initial=0.0)), 1.0)
        rows, self._row = np.unique(np.round(ky / quantum), return_inverse=True)
        columns, self._column = np.unique(np.round(kx / quantum), return_inverse=True)
        self.ky, self.kx = rows * quantum, columns * quantum
        self._flat = self._row * self.kx.size + self._column

    def place(self, values: Complex) -> Complex:
        """Return the amplitudes (n,) of the waves as a matrix (nky, nkx); equal wave vectors are added up."""
        values = np.where(self._mirror, values.conj(), values)
        size = self.ky.size * self.kx.size
        real = np.bincount(self._flat, values.real, size)
        imag = np.bincount(self._flat, values.imag, size)
        return (real + 1j * imag).reshape(self.ky.size, self.kx.size)


KERNEL_WIDTH = 8  # lattice points under the interpolation kernel along each axis
# beta of the kernel exp(beta (sqrt(1 - s^2) - 1)), best for a lattice twice as fine as the waves need
# (Barnett, Magland and af Klinteberg 2019)
KERNEL_BETA = 2.30 * KERNEL_WIDTH
REMEMBERED_FRAMES = 8  # states kept in memory, because images of several frames are drawn at once


def _kernel(r: Array) -> Array:
    """Return the interpolation kernel of `Basin` at distances r, in steps of the lattice, any shape."""
    s = 2.0 * r / KERNEL_WIDTH
    return np.exp(KERNEL_BETA * (np.sqrt(np.maximum(1.0 - s * s, 0.0)) - 1.0)) * (np.abs(s) < 1)


def _transform(phase: Array) -> Array:
    """Return the Fourier transform (n,) of `_kernel` at wavenumbers (n,) in rad per lattice step."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    r = nodes * KERNEL_WIDTH / 2
    return np.cos(np.outer(phase, r)) @ (weights * _kernel(r)) * KERNEL_WIDTH / 2


class Basin:
    """A rectangle of a sea, with limits x and y, m, for fast evaluation of fields at any points.
    Fields are summed on a lattice and interpolated with a kernel (non-uniform FFT of type 2); errors are
    1e-7 of the elevation."""

    def __init__(self, sea: Sea, x: tuple[float, float], y: tuple[float, float]) -> None:
        self.sea, self.x, self.y = sea, x, y
        extent = max(x[1] - x[0], y[1] - y[0])
        step = min(sea.shortest / 4.0, extent)  # twice as fine as the shortest wave needs
        margin = KERNEL_WIDTH // 2
        self._step = step
        # beads, truth and images ask for the same instants again
        self._recent = lru_cache(REMEMBERED_FRAMES)(self._snapshot)
        self._origin = (x[0] - margin * step, y[0] - margin * step)
        count = [int(np.ceil((hi - lo) / step)) + 2 * margin + 1 for lo, hi in (x, y)]
        kx, ky = sea.axes
        gx, gy = (origin + step * np.arange(n) for origin, n in zip(self._origin, count, strict=True))
        self._ex = np.exp(1j * np.multiply.outer(kx, gx)) / _transform(kx * step)[:, None]
        self._ey = np.exp(1j * np.multiply.outer(gy, ky)) / _transform(ky * step)

    def snapshot(self, time: float, names: Sequence[str] = ("z",)) -> "Snapshot":
        """Return the fields `names` (of z, z_x, z_y, z_t, u, v) at `time`, s; call the result with x and
        y."""
        return self._recent(round(time, 12), tuple(names))

    def _snapshot(self, time: float, names: tuple[str, ...]) -> "Snapshot":
        values = self.sea.sums(self._ex, self._ey, time, names)
        offset = [self.sea.current["uv".index(name)] if name in ("u", "v") else 0.0 for name in names]
        stacked = np.stack([values[name] for name in names])
        return Snapshot(stacked, np.array(offset), self._origin, self._step)


class Snapshot:
    """Some fields of a sea at one instant, to evaluate at any x and y; `Basin.snapshot` makes it."""

    def __init__(self, values: Array, offset: Array, origin: tuple[float, float], step: float) -> None:
        self._values, self._offset, self._origin, self._step = values, offset, origin, step

    def __call__(self, x: Array, y: Array) -> Array:
        """Return the fields at points x, y, m, of any shape, as (fields, ...); NaN outside the basin.
        The fields are in the order in which `Basin.snapshot` was given their names."""
        out = np.empty((self._values.shape[0], x.size))
        _gather(x.ravel(), y.ravel(), self._values, *self._origin, self._step, out)
        return (out + self._offset[:, None]).reshape(-1, *x.shape)


@compiled(fastmath=True)
def _gather(x: Array, y: Array, values: Array, x0: float, y0: float, step: float, out: Array) -> None:
    # KERNEL_WIDTH is a constant of the module, so that the compiler unrolls the loops
    nf, ny, nx = values.shape
    wx, wy = np.empty(KERNEL_WIDTH), np.empty(KERNEL_WIDTH)
    for p in range(x.size):
        rx, ry = (x[p] - x0) / step, (y[p] - y0) / step
        jx, jy = int(np.floor(rx)) - KERNEL_WIDTH // 2 + 1, int(np.floor(ry)) - KERNEL_WIDTH // 2 + 1
        if jx < 0 or jy < 0 or jx + KERNEL_WIDTH > nx or jy + KERNEL_WIDTH > ny:
            out[:, p] = np.nan
            continue
        for g in range(KERNEL_WIDTH):
            sx, sy = 2.0 * (rx - jx - g) / KERNEL_WIDTH, 2.0 * (ry - jy - g) / KERNEL_WIDTH
            wx[g] = np.exp(KERNEL_BETA * (np.sqrt(max(1.0 - sx * sx, 0.0)) - 1.0))
            wy[g] = np.exp(KERNEL_BETA * (np.sqrt(max(1.0 - sy * sy, 0.0)) - 1.0))
        for f in range(nf):
            total = 0.0
            for i in range(KERNEL_WIDTH):
                row = 0.0
                for j in range(KERNEL_WIDTH):
                    row += wx[j] * values[f, jy + i, jx + j]
                total += wy[i] * row
            out[f, p] = total
