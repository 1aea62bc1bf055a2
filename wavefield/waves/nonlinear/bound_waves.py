"""Free and bound waves: what lies on the ridge of the dispersion relation, and what is forced beside it."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import GAMMA, dispersion, group_velocity
from wavefield.waves.dispersion_relation.current_used import CurrentUsed
from wavefield.waves.estimation.segments import Reader, segment_length, spatial_window
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import LOWEST
from wavefield.waves.estimation.windows import hann
from wavefield.waves.products import Product, register

Array = NDArray[Any]

_REACH = 2.0  # cells of the k plane: a Hann window leaves 5e-4 of a wave's energy beyond
_BESIDE = 0.5  # cells: the strip beside the ridge that tells what bound waves lie under it
_DRAWN = 600  # waves drawn to see what the windows leave where
_AROUND = 5  # cells to either side of a drawn wave
_FLOOR = 0.75  # of the Nyquist frequency: noise is looked for above
_ALIKE = 1 + 2 * (4 / 9 + 1 / 36)  # cells that a Hann window makes of one, along an axis
_EDGE = 0.2  # of the spatial window: nearer to the edge its quotient is not given
_SLOWEST = 0.3  # of the group velocity: a current that holds waves up more smears them over all k


class Kind(IntEnum):
    """What a cell of the (k, omega) space holds."""

    FREE = 0
    BESIDE = 1  # the strip beside the ridge
    HARMONIC = 2  # second harmonic of a single wave
    SUM = 3  # shorter in time than a free wave of its length: forced by two at their sum
    DIFFERENCE = 4  # the other side of the ridge


@dataclass(frozen=True)
class Split:
    """Where free waves are."""

    depth: float = np.inf  # Depth, m, and surface tension over density, m3/s2
    gamma: float = GAMMA
    current: tuple[float, float] = (0.0, 0.0)  # Along x and y, m/s
    reach: float = 1.0  # Half the width of the ridge, rad/m
    strip: float = 0.0  # Width of the strip beside it, rad/m

    def apart(self, omega: Array, ky: Array, kx: Array) -> tuple[Array, Array]:
        """Distance from the ridge and from its second harmonic.

        With omega, ky, kx, rad/m.
        """
        k = np.hypot(ky, kx)
        drift = kx * self.current[0] + ky * self.current[1]
        still = np.maximum(omega - drift, 0.0)
        table, sigma, speeds = self._free
        free = np.interp(still, sigma, table, left=0.0)
        ridge = k - free
        if any(self.current):
            with np.errstate(divide="ignore", invalid="ignore"):
                along = np.nan_to_num(drift / k)
            # the current of this cell stands for that of the ridge on its ray
            ridge /= np.clip(1 + along / np.interp(still, sigma, speeds), _SLOWEST, 1 / _SLOWEST)
        return ridge, k - 2 * np.interp(still / 2, sigma, table, left=0.0)

    @cached_property
    def _free(self) -> tuple[Array, Array, Array]:
        # free waves: wavenumber, frequency and group velocity
        k = np.geomspace(1e-3, 4e3, 6000)
        speed = group_velocity(np.maximum(k, 0.1), self.depth, self.gamma)
        return k, dispersion(k, self.depth, self.gamma), speed

    def kind(self, omega: Array, ky: Array, kx: Array) -> NDArray[np.int8]:
        """`Kind` of cells; arrays of one shape as in `apart`."""
        return self.kind_at(*self.apart(omega, ky, kx))

    def kind_at(self, ridge: Array, harmonic: Array) -> NDArray[np.int8]:
        """`Kind` of cells at these distances from the ridge and its second harmonic, rad/m (`apart`)."""
        off = np.abs(ridge)
        out = np.where(ridge > 0, np.int8(Kind.DIFFERENCE), np.int8(Kind.SUM))
        out[np.abs(harmonic) < self.reach] = Kind.HARMONIC
        out[off < self.reach + self.strip] = Kind.BESIDE
        out[off < self.reach] = Kind.FREE
        return out


def _line(distance: Array, length: int) -> Array:
    # energy of a Hann window of `length` samples at a distance in cells
    turn = np.exp(-2j * np.pi * np.multiply.outer(distance, np.arange(length)) / length)
    return np.asarray(np.abs(turn @ hann(length)) ** 2)


@dataclass(frozen=True)
class _Grid:
    omega: Array
    ky: Array
    kx: Array
    segment: int

    @classmethod
    def of(cls, density: xr.DataArray) -> "_Grid":
        omega, ky, kx = (density[name].values.astype(float) for name in ("omega", "ky", "kx"))
        return cls(omega, ky, kx, 2 * (omega.size - 1))

    @property
    def steps(self) -> tuple[float, float, float]:
        return self.omega[1], self.ky[1] - self.ky[0], self.kx[1] - self.kx[0]

    @property
    def cell(self) -> float:
        return float(max(self.steps[1:]))

    def plane(self) -> tuple[Array, Array]:
        ky, kx = np.meshgrid(self.ky, self.kx, indexing="ij")
        return ky, kx


def _leaks(energy: Array, kinds: Array, grid: _Grid, split: Split) -> tuple[Array, float]:
    """What the windows make of free waves: fraction in each kind, and variance across the ridge."""
    rng = np.random.default_rng(0)
    weight = np.where(kinds == Kind.FREE, energy, 0.0).ravel()
    weight[: LOWEST * energy[0].size] = 0.0
    chosen = np.searchsorted(np.cumsum(weight), weight.sum() * (np.arange(_DRAWN) + 0.5) / _DRAWN)
    line, row, column = np.unravel_index(chosen, energy.shape)
    steps = grid.steps
    # frequency is resolved far better than the wave vector: its length follows from that and its direction
    omega, ky, kx = (
        axis[at] + step * rng.uniform(-0.5, 0.5, _DRAWN)
        for axis, at, step in zip((grid.omega, grid.ky, grid.kx), (line, row, column), steps)
    )
    for _ in range(4):
        longer = split.apart(omega, ky, kx)[0] / np.maximum(np.hypot(ky, kx), 1e-9)
        ky, kx = ky * (1 - longer), kx * (1 - longer)
    near = np.arange(-_AROUND, _AROUND + 1)
    places, lines = [], []
    for true, step, size in zip((omega, ky, kx), steps, (grid.segment, grid.ky.size, grid.kx.size)):
        at = np.rint(true / step)[:, None] + near
        places.append(at * step)
        lines.append(_line(at - true[:, None] / step, size))
    shape = _DRAWN, near.size, near.size, near.size
    full = [
        np.broadcast_to(p.reshape(_DRAWN, *(near.size if i == j else 1 for j in range(3))), shape)
        for i, p in enumerate(places)
    ]
    power = lines[0][:, :, None, None] * lines[1][:, None, :, None] * lines[2][:, None, None, :]
    ridge, harmonic = split.apart(*full)
    found = split.kind_at(ridge, harmonic)
    total = np.bincount(found.ravel(), power.ravel(), len(Kind))
    inside = found == Kind.FREE
    return total / total.sum(), float((power * ridge**2)[inside].sum() / power[inside].sum())


def free_and_bound(
    density: xr.DataArray,
    depth: float = np.inf,
    *,
    gamma: float = GAMMA,
    current: tuple[float, float] = (0.0, 0.0),
    dof: float | None = None,
) -> xr.Dataset:
    """Split the spectrum of the elevation into waves that are free and waves bound to others.

    Parameters
    ----------
    density : DataArray, (omega, ky, kx)
        Spectrum of the elevation (`spectrum`), m2 per rad/s and (rad/m)2.
    depth : float
        Depth of the water, m.
    gamma : float
        Surface tension over density, m3/s2.
    current : tuple of float
        Current along x and y, m/s (`fit_dispersion`).
    dof : float, optional
        Degrees of freedom of a cell (``spectrum(...).dof``), for the uncertainty.

    Returns
    -------
    Dataset
        ``bound_fraction`` and ``bound_fraction_std``, of the variance; ``harmonic_fraction``,
        ``sum_fraction``, ``difference_fraction``, its parts on the second harmonic's ridge and on either side
        of the ridge; ``noise_fraction``; ``E_free``, ``E_bound``, ``E_harmonic`` (omega), m2 s;
        ``ridge_reach`` and ``ridge_width``, the half width given to the ridge and its own width beyond the
        windows', rad/m.
        Attributes ``current``, ``gamma``, ``depth`` as given.

    Raises
    ------
    CubeError
        If no energy lies on the ridge.

    Notes
    -----
    Two free waves force one at the sum of their frequencies and wave vectors and one at the difference, which
    lie off omega = sigma(k) + k . U; a wave with itself forces 2 omega at 2 k. The ridge is two cells of the
    k plane wide on either side, times what its measured width has over that of the windows. From what lies
    beside it is taken off what the windows leave there of the free waves (the windows' own lines, at waves
    drawn from the ridge) and the noise (median over the highest frequencies, cell by cell); what lies under
    the ridge is taken to be as much as the strip of half a cell beside it holds. The uncertainty joins chance
    with half of these two corrections. The two lowest lines are left out: taking off the trend in time leaves
    1e-4 of the variance there. Energy that breaking or wind spreads beside the ridge counts as bound.

    Examples
    --------
    A wave with a second harmonic of a tenth of its amplitude: a hundredth of the variance is bound.

    >>> from wavefield.waves.spectra.field_spectra import spectrum
    >>> axes = {"time": np.arange(128) * 0.05, "y": np.arange(24) * 0.05, "x": np.arange(32) * 0.05}
    >>> phase = 12.3 * axes["x"] - 10.98 * axes["time"][:, None, None] + 0 * axes["y"][:, None]
    >>> wave = 0.01 * np.cos(phase) + 0.001 * np.cos(2 * phase)
    >>> z = xr.DataArray(wave, axes, ("time", "y", "x"), attrs={"units": "m"})
    >>> split = free_and_bound(spectrum(z, segment=64).E)  # doctest: +SKIP
    >>> print(f"{float(split.bound_fraction):.2f}")  # doctest: +SKIP
    0.01
    """
    grid = _Grid.of(density)
    values = density.values
    ky, kx = grid.plane()
    cell = grid.cell
    split = Split(depth, gamma, current, _REACH * cell, _BESIDE * cell)
    kinds, second, total = _sort(values, grid, split, ky, kx)
    if not total > 0:
        raise CubeError("the spectrum holds no energy on the dispersion relation: check depth and current")
    _, window = _leaks(values, kinds, grid, split)
    own = max(second / total - window, 0.0)
    if own > 0.1 * window:
        wider = split.reach * float(np.sqrt(1 + own / window))
        split = Split(depth, gamma, current, wider, split.strip)
        kinds, _, _ = _sort(values, grid, split, ky, kx)
    leaks, _ = _leaks(values, kinds, grid, split)
    high = grid.omega > _FLOOR * grid.omega[-1]
    high[-1] = False
    floor = np.median(values[high], axis=0) if high.sum() >= 4 else np.zeros_like(values[0])
    return _label(_Parts.of(values, kinds, floor, leaks, dof), grid, split, float(np.sqrt(own)))


def _sort(values: Array, grid: _Grid, split: Split, ky: Array, kx: Array) -> tuple[Array, float, float]:
    # kinds of all cells; energy on the ridge times squared distance, and energy on the ridge
    kinds = np.empty(values.shape, np.int8)
    second = total = 0.0
    for i, omega in enumerate(grid.omega):
        ridge, harmonic = split.apart(np.full(ky.shape, omega), ky, kx)
        kinds[i] = split.kind_at(ridge, harmonic)
        if i >= LOWEST:
            inside = np.where(kinds[i] == Kind.FREE, values[i], 0.0)
            second += float((inside * ridge**2).sum(dtype=float))
            total += float(inside.sum(dtype=float))
    return kinds, second, total


@dataclass(frozen=True)
class _Parts:
    by_line: Array  # (kinds, omega), noise and leakage taken off
    noise: float
    leaked: float  # of the free waves, taken off the rest
    chance: float  # relative variance of what is off the ridge

    @classmethod
    def of(cls, values: Array, kinds: Array, floor: Array, leaks: Array, dof: float | None) -> "_Parts":
        by_line = np.zeros((len(Kind), values.shape[0]))
        noise = squares = 0.0
        for i in range(LOWEST, values.shape[0]):
            line, kind = values[i].astype(float), kinds[i].ravel()
            by_line[:, i] = np.bincount(kind, (line - floor).ravel(), len(Kind))
            noise += float(floor.sum())
            squares += float((line[kinds[i] > Kind.BESIDE] ** 2).sum())
        free = by_line[Kind.FREE] / leaks[Kind.FREE]
        # on each line as much as lies there of free waves
        by_line[1:] -= leaks[1:, None] * free
        by_line[0] = free
        off = abs(float(by_line[1:].sum()))
        chance = np.nan if dof is None else 2 / dof * _ALIKE**3 * squares / max(off**2, 1e-30)
        return cls(by_line, noise, float(leaks[1:].sum() * free.sum()), chance)


def _label(parts: _Parts, grid: _Grid, split: Split, own: float) -> xr.Dataset:
    step = float(np.prod(grid.steps[1:]))
    lines = parts.by_line
    # under the ridge lies as much as in the strip beside it
    under = max(float(lines[Kind.BESIDE].sum()), 0.0)
    energies = {kind: float(lines[kind].sum()) for kind in Kind}
    bound = sum(energies[kind] for kind in Kind if kind != Kind.FREE) + under
    total = energies[Kind.FREE] - under + bound
    guessed = 0.5 * np.hypot(under, parts.leaked)
    std = np.hypot(np.sqrt(parts.chance) * bound, guessed) / total
    spectra = {
        "E_free": lines[Kind.FREE] - lines[Kind.BESIDE],
        "E_bound": lines[1:].sum(axis=0) + lines[Kind.BESIDE],
        "E_harmonic": lines[Kind.HARMONIC],
    }
    out: dict[str, Any] = {name: ("omega", values * step) for name, values in spectra.items()}
    out |= {
        "bound_fraction": ((), bound / total),
        "bound_fraction_std": ((), std),
        "harmonic_fraction": ((), energies[Kind.HARMONIC] / total),
        "sum_fraction": ((), energies[Kind.SUM] / total),
        "difference_fraction": ((), energies[Kind.DIFFERENCE] / total),
        "noise_fraction": ((), parts.noise / (total + parts.noise)),
        "ridge_reach": ((), split.reach),
        "ridge_width": ((), own),
    }
    coords = {"omega": ("omega", grid.omega), "frequency": ("omega", grid.omega / (2 * np.pi))}
    attrs = {"depth": split.depth, "gamma": split.gamma, "current": list(split.current)}
    return annotate(xr.Dataset(out, coords, attrs), "bound")


def free_and_bound_fields(
    cube: xr.Dataset, split: xr.Dataset, *, segment: int | None = None, record: Record | None = None
) -> xr.Dataset:
    """Elevation of the free and of the bound waves over time and place.

    Parameters
    ----------
    cube : Dataset
        With z over (time, y, x), m. Computed segment by segment.
    split : Dataset
        As `free_and_bound` gives it.
    segment : int, optional
        Steps that are filtered at a time; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``z_free``, ``z_bound`` (time, y, x), m, over the rectangle of the record. They are NaN within half a
        segment of the ends of a run and near the edges, where windows leave too little.

    Raises
    ------
    CubeError
        If the cube has no z or is shorter than a segment.

    Notes
    -----
    Windowed segments overlapping by half, whose Hann windows in time add up to one, are transformed and cut
    along the ridge as the spectrum was; the Hann windows in space are divided out. Mean and trend of a
    segment go with the bound waves, and so does noise off the ridge.

    Examples
    --------
    A wave and its second harmonic; of the split only what is needed here.

    >>> axes = {"time": np.arange(128) * 0.05, "y": np.arange(24) * 0.05, "x": np.arange(32) * 0.05}
    >>> phase = 12.3 * axes["x"] - 10.98 * axes["time"][:, None, None] + 0 * axes["y"][:, None]
    >>> wave = 0.01 * np.cos(phase) + 0.001 * np.cos(2 * phase)
    >>> cube = xr.Dataset({"z": (("time", "y", "x"), wave, {"units": "m"})}, axes)
    >>> attrs = {"depth": np.inf, "gamma": GAMMA, "current": (0.0, 0.0)}
    >>> split = xr.Dataset({"ridge_reach": 10.5}, attrs=attrs)
    >>> found = free_and_bound_fields(cube, split, segment=64)
    >>> print(f"{1e3 * float(found.z_free.std()):.1f} mm, {1e3 * float(found.z_bound.std()):.1f} mm")
    7.1 mm, 0.8 mm
    """
    field = validate(cube, "z")["z"]
    record = find_record(field) if record is None else record
    segment = segment_length(record, segment)
    (ny, nx), half = record.shape, segment // 2
    omega = 2 * np.pi * np.fft.fftfreq(segment, record.dt)
    ky = 2 * np.pi * np.fft.fftfreq(ny, record.dy)[:, None]
    kx = 2 * np.pi * np.fft.rfftfreq(nx, record.dx)[None, :]
    cut = Split(
        float(split.attrs["depth"]),
        float(split.attrs["gamma"]),
        tuple(split.attrs["current"]),
        float(split["ridge_reach"]),
    )
    shape = (ny, nx // 2 + 1)
    # a wave that goes along k lies at -omega in numpy's signs, or at -k
    keep = np.empty((segment, *shape), bool)
    for i, o in enumerate(-omega):
        sign = 1.0 if o >= 0 else -1.0
        line = np.full(shape, abs(o))
        keep[i] = cut.kind(line, *np.broadcast_arrays(sign * ky, sign * kx)) == Kind.FREE
    window = spatial_window(ny, nx)
    there = window > _EDGE
    out = {name: np.full((field.sizes["time"], ny, nx), np.nan, np.float32) for name in ("z_free", "z_bound")}
    read = Reader([field], record)
    for run in record.runs:
        free = np.zeros((run[1] - run[0], ny, nx), np.float32)
        starts = range(run[0], run[1] - segment + 1, half)
        for a in starts:
            block = read(a, a + segment, run)[0] * window * hann(segment)[:, None, None]
            lines = fft.rfftn(block, axes=(1, 2))
            lines = fft.fft(lines, axis=0, overwrite_x=True)
            lines *= keep
            back = fft.irfft2(fft.ifft(lines, axis=0, overwrite_x=True), (ny, nx), axes=(1, 2))
            free[a - run[0] : a - run[0] + segment] += back
        if len(starts) < 2:
            continue
        # where two segments overlap
        inner = slice(run[0] + half, starts[-1] + half)
        quotient = free[half : starts[-1] + half - run[0]] / np.where(there, window, np.nan)
        out["z_free"][inner] = quotient
        whole = np.concatenate(
            [read(a, min(a + half, inner.stop), run)[0] for a in range(inner.start, inner.stop, half)]
        )
        out["z_bound"][inner] = whole - quotient
    axes = {"time": field["time"], "y": field["y"][slice(*record.y)], "x": field["x"][slice(*record.x)]}
    data = {name: (("time", "y", "x"), values) for name, values in out.items()}
    return annotate(xr.Dataset(data, axes))


def _group(density: xr.DataArray, depth: float, gamma: float, used: CurrentUsed, dof: float) -> xr.Dataset:
    split = free_and_bound(density, depth, gamma=gamma, current=used.velocity, dof=dof)
    return split.assign_attrs(used.attrs)


register(
    Product(
        "bound",
        ("density_z", "depth", "gamma", "fitted_or_given_current", "cell_dof"),
        _group,
        group="bound",
        without="No bound waves",
        cost=4,
    )
)
