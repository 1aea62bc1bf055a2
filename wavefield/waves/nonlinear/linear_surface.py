"""The linear surface: a measured elevation less the waves that its free waves force at second order."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import GRAVITY, dispersion, group_velocity, water_of, wavenumber
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.segments import Reader
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.nonlinear.forced_waves import MIN_DETUNING

Array = NDArray[Any]

ROUNDS = 3  # in which bound waves are removed from what forces them
STEPS = 384  # treated at once, with margins
SAMPLED = 0.5  # of the Nyquist wavenumber and frequency: sums of two such waves are sampled
SMALL = 0.4  # k times the rms elevation: the expansion about z = 0 needs less
NEAR_RELATION = 0.2  # of the frequency of free waves: what forces others is not farther from it
MARGIN = 1.0  # mean period and wavelength, at each edge: there the fields are tapered and the result is NaN
MAX_MARGIN = 0.3  # of a side
MIN_WAVELENGTHS = 1.5  # along the shorter side
PADDING = 1.25  # of each side
MAX_RATIO = 0.15  # of the rms of bound waves to that of the linear surface
# rms of the bound waves' error over theirs, of windows and of waves near resonance; of higher orders
ERROR_OF_WINDOWS, ERROR_NEAR_RESONANCE, ERROR_OF_ORDER = 0.06, 1.2, 1.0
MAX_NEAR_RESONANCE = 0.25  # of the forcing's power


@dataclass(frozen=True)
class _Block:
    """Steps and nodes of a piece in a larger periodic one, and its waves in numpy's signs."""

    shape: tuple[int, int, int]
    steps: tuple[float, float, float]  # dt, dy, dx
    margins: tuple[int, int, int]  # over which the fields are tapered, steps and nodes
    water: tuple[float, float]  # depth, m; surface tension over density
    current: tuple[float, float]

    @cached_property
    def size(self) -> tuple[int, ...]:
        return tuple(fft.next_fast_len(round(PADDING * n), real=True) for n in self.shape)

    @cached_property
    def window(self) -> Array:
        sides = []
        for n, margin in zip(self.shape, self.margins):
            inside = np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / margin
            sides.append(0.5 - 0.5 * np.cos(np.pi * np.minimum(inside, 1.0)))
        return np.asarray(sides[0][:, None, None] * sides[1][:, None] * sides[2], np.float32)

    @cached_property
    def waves(self) -> tuple[Array, Array, Array, Array]:
        """Frequency in the moving frame, (omega, ky, kx), ky, kx, and k (1 where it is 0)."""
        omega = 2 * np.pi * np.fft.fftfreq(self.size[0], self.steps[0])[:, None, None]
        ky = 2 * np.pi * np.fft.fftfreq(self.size[1], self.steps[1])[:, None]
        kx = 2 * np.pi * np.fft.rfftfreq(self.size[2], self.steps[2])[None]
        k = np.hypot(ky, kx)
        moving = omega + kx * self.current[0] + ky * self.current[1]
        return moving.astype("f4"), ky.astype("f4"), kx.astype("f4"), np.where(k > 0, k, 1.0).astype("f4")

    def forward(self, values: Array) -> Array:
        return np.asarray(fft.rfftn(values, self.size))

    def back(self, lines: Array) -> Array:
        return np.asarray(fft.irfftn(lines, self.size))

    def forcing_waves(self, highest: float) -> Array:
        """Which waves force others: near the dispersion relation, and sampled with their harmonics."""
        moving, ky, kx, k = self.waves
        sigma = dispersion(k, *self.water)
        cell = max(2 * np.pi / (n * step) for n, step in zip(self.shape[1:], self.steps[1:]))
        line = 2 * np.pi / (self.shape[0] * self.steps[0])
        reach = NEAR_RELATION * sigma + 2 * line + 2 * cell * group_velocity(k, *self.water)
        omega = np.abs(moving - kx * self.current[0] - ky * self.current[1])
        sampled = (k <= highest) & (np.hypot(ky, kx) > 0) & (omega <= SAMPLED * np.pi / self.steps[0])
        return np.asarray((np.abs(np.abs(moving) - sigma) < np.minimum(reach, 0.9 * sigma)) & sampled)

    def forced(self, lines: Array) -> tuple[Array, float]:
        """Transform of the waves that free waves force, and the part of the forcing near resonance."""
        moving, ky, kx, k = self.waves
        kh = np.minimum(k * min(self.water[0], 1e6), 300.0)
        q, stiffness = k * np.tanh(kh), GRAVITY + self.water[1] * k**2
        potential = 1j * moving / q * lines
        z, w = self.back(lines), self.back(1j * moving * lines)
        u, v = self.back(1j * kx * potential), self.back(1j * ky * potential)
        dynamic = self.forward(-0.5 * (u**2 + v**2 + w**2) - z * self.back(-(moving**2) * lines))
        kinematic = -1j * (kx * self.forward(z * u) + ky * self.forward(z * v))
        source = q * dynamic + 1j * moving * kinematic
        detuning = q * stiffness - moving**2
        away = np.abs(detuning) > MIN_DETUNING * q * stiffness
        away &= np.hypot(ky, kx) > 0
        gain = np.abs(source) / np.maximum(np.abs(detuning), MIN_DETUNING * q * stiffness)
        power = (gain**2).sum(dtype=float)
        near = (gain[~away] ** 2).sum(dtype=float)
        out = np.where(away, source / np.where(away, detuning, 1.0), 0.0)
        return out, float(near / power) if power > 0 else 0.0


@takes(a_cube)
def linear_surface(
    cube: xr.Dataset,
    *,
    current: tuple[float, float] = (0.0, 0.0),
    depth: float | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Elevation without the waves that are bound to others, by second-order theory.

    Parameters
    ----------
    cube : Dataset
        With z over (time, y, x), m. Read once, in pieces; computed at once.
    current : tuple of float
        Current along x and y, m/s (`fit_dispersion`).
    depth : float, optional
        Depth of the water, m; that of the cube, or deep, if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``z_linear`` and ``z_bound`` (time, y, x), m, NaN within a mean period of the ends of a run and a mean
        wavelength of the edges (three tenths of a side at most). ``linear_std``, m, the standard uncertainty
        of both by the method; ``bound_ratio``, rms of the bound waves over that of the linear surface;
        ``near_resonance``, part of the power of the bound waves that is too near to that of free ones to be
        separated. Attribute ``shortest``, m, the shortest waves whose bound waves are removed.

    Raises
    ------
    CubeError
        If the cube has no z, no run or side is long enough, or second order does not hold: bound waves above
        0.15 of the linear ones (exact waves of slope 0.3 have 0.14), or a quarter of their power near
        resonance (shallow water, small fields).

    Notes
    -----
    Waves near omega = sigma(k) + k . U have the potential phi_z = D eta at z = 0, D the derivative in the
    frame of the water, and force at second order

        D eta2 - phi2_z = -div(eta grad phi)
        D phi2 + (g - gamma laplacian) eta2 = -|grad phi|^2 / 2 - eta D phi_z,

    solved in (k, omega) at any depth (Hasselmann 1962; of waves of one direction in deep water that is the
    second order of the transform of Creamer et al. 1989). What is found is taken off z, and the rest forces
    anew, three times: what theory expects is removed, whether or not the measurement kept it. Left in are
    third harmonics, bound waves of waves shorter than ``shortest`` (k rms z = 0.4, or half the Nyquist
    wavenumber) and faster than half the Nyquist frequency, and those within 5 % of a free frequency.

    References
    ----------
    D. Creamer, F. Henyey, R. Schult and J. Wright, J. Fluid Mech. 205 (1989).

    Examples
    --------
    A Stokes wave of slope 0.12: its second harmonic goes.

    >>> t, y, x = np.arange(128) * 0.05, np.arange(80) * 0.02, np.arange(100) * 0.02
    >>> phase = 12 * x - dispersion(12.0) * t[:, None, None] + 0 * y[:, None]
    >>> z = 0.01 * np.cos(phase) + 6 * 0.01**2 * np.cos(2 * phase)
    >>> cube = xr.Dataset({"z": (("time", "y", "x"), z, {"units": "m"})}, {"time": t, "y": y, "x": x})
    >>> found = linear_surface(cube)
    >>> before, after = z[64, 40], found.z_linear[64, 40].dropna("x")
    >>> print(f"{before.max() / -before.min():.2f} {float(after.max() / -after.min()):.2f}")
    1.13 1.00
    """
    if "z" not in cube:
        raise CubeError("the cube has no 'z', from which bound waves are removed")
    field = validate(cube, "z")["z"]
    record = find_record(field) if record is None else record
    water = water_of(cube.attrs, depth)
    read = Reader([field], record)
    period, wavelength, highest = _scales(read, water)
    steps = record.dt, record.dy, record.dx
    margin = int(np.ceil(MARGIN * period / record.dt))
    nodes = [
        int(np.ceil(min(MARGIN * wavelength / h, MAX_MARGIN * n))) for n, h in zip(record.shape, steps[1:])
    ]
    shape = record.shape
    out = {
        name: np.full((field.sizes["time"], *shape), np.nan, np.float32) for name in ("z_linear", "z_bound")
    }
    inner = slice(nodes[0], shape[0] - nodes[0]), slice(nodes[1], shape[1] - nodes[1])
    sums = np.zeros(4)  # squares of linear and bound waves, near resonance, and their number
    for run in record.runs:
        for a, b in _pieces(run, margin):
            z = read(a - margin, b + margin, run)[0].astype(np.float32)
            block = _Block(z.shape, steps, (margin, nodes[0], nodes[1]), water, current)
            bound, near = _bound(block, z, highest)
            middle = (slice(margin, margin + b - a), *inner)
            out["z_bound"][a:b, inner[0], inner[1]] = bound[middle]
            out["z_linear"][a:b, inner[0], inner[1]] = z[middle] - bound[middle]
            size = bound[middle].size
            linear = float(((z - bound)[middle] ** 2).sum(dtype=float))
            sums += linear, float((bound[middle] ** 2).sum(dtype=float)), near * size, size
    if not sums[3]:
        raise CubeError(
            f"no run is longer than two mean periods of the waves, {2 * period:.2g} s: choose a longer record"
        )
    return _label(field, record, out, sums, highest)


def _scales(read: Reader, water: tuple[float, float]) -> tuple[float, float, float]:
    """Mean period, s, its wavelength, m, and the largest wavenumber whose bound waves are removed."""
    record, sums = read.record, np.zeros(3)
    for run in record.runs:
        for (z,) in read.blocks(run, STEPS):
            z = z.astype(float) - z.mean()
            rate = np.diff(z, axis=0) / record.dt
            sums += (z**2).sum() / z.size * len(z), (rate**2).sum() / z.size * len(z), len(z)
    if not sums[1] > 0:
        raise CubeError("the elevation does not change in time: there are no waves")
    omega = float(np.sqrt(sums[1] / sums[0]))
    wavelength = 2 * np.pi / float(wavenumber(omega, *water))
    shorter = min(n * step for n, step in zip(record.shape, (record.dy, record.dx)))
    if shorter < MIN_WAVELENGTHS * wavelength:
        raise CubeError(
            f"the field is {shorter:.2g} m wide, and the waves have a mean length of {wavelength:.2g} m:"
            f" bound waves need {MIN_WAVELENGTHS} of them"
        )
    highest = min(SAMPLED * np.pi / max(record.dy, record.dx), SMALL / np.sqrt(sums[0] / sums[2]))
    return 2 * np.pi / omega, wavelength, highest


def _pieces(run: tuple[int, int], margin: int) -> list[tuple[int, int]]:
    """Steps that a run gives results at, cut into pieces."""
    first, last = run[0] + margin, run[1] - margin
    if last <= first:
        return []
    edges = np.linspace(first, last, -(-(last - first) // STEPS) + 1).astype(int).tolist()
    return list(pairwise(edges))


def _bound(block: _Block, z: Array, highest: float) -> tuple[Array, float]:
    """Bound waves of a piece, and the part of their power near resonance."""
    lines, forcing, near = block.forward(z * block.window), block.forcing_waves(highest), 0.0
    bound = np.zeros_like(lines)
    for _ in range(ROUNDS):
        bound, near = block.forced(np.where(forcing, lines - bound, 0))
    steps, ny, nx = block.shape
    return block.back(bound)[:steps, :ny, :nx], near


def _label(
    field: xr.DataArray, record: Record, out: dict[str, Array], sums: Array, highest: float
) -> xr.Dataset:
    linear, bound = np.sqrt(sums[:2] / sums[3])
    ratio, near = bound / linear, sums[2] / sums[3]
    if ratio > MAX_RATIO or near > MAX_NEAR_RESONANCE:
        raise CubeError(
            f"second-order theory does not hold for these waves: bound ones have {ratio:.2g} times the rms of"
            f" the others ({MAX_RATIO} at most), and {100 * near:.0f} % of their power is near resonance"
            f" ({100 * MAX_NEAR_RESONANCE:.0f} % at most): the water is shallow, the waves are steep or the"
            " field is small"
        )
    axes = {"time": field["time"], "y": field["y"][slice(*record.y)], "x": field["x"][slice(*record.x)]}
    data: dict[str, Any] = {name: (("time", "y", "x"), values) for name, values in out.items()}
    std = bound * np.hypot(ERROR_OF_WINDOWS + ERROR_NEAR_RESONANCE * near, ERROR_OF_ORDER * ratio)
    data |= {"linear_std": ((), std), "bound_ratio": ((), ratio), "near_resonance": ((), near)}
    result = xr.Dataset(data, axes, {"shortest": 2 * np.pi / highest})
    return annotate(result, "linear_surface")
