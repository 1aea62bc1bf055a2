"""Free waves, near the dispersion relation, and bound waves, which are forced off it."""

from dataclasses import dataclass, replace
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
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.segments import Reader, segment_length, spatial_window
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import LOWEST, omega_coords
from wavefield.waves.estimation.windows import CORRELATED_CELLS, hann
from wavefield.waves.nonlinear.forced_waves import forced_elevation
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.plane_input import plane_of

Array = NDArray[Any]

RELATION_CELLS = (
    2.0  # half width in cells of the k plane: a Hann window leaves 5e-4 of a wave's energy beyond
)
STRIP_CELLS = 0.5  # width of the strip next to the relation, from which bound waves under it are estimated
MIN_VISIBLE = 0.5  # of the bound waves that theory expects: with less, the rest is no measurement
STRIP_SUFFICES = 0.8  # of the bound waves visible: then the strip determines those under the relation
UNDER_ERROR, LEAKAGE_ERROR = 0.5, 0.2  # of the bound waves under the relation, and of the leakage taken off
PAIRS = 100_000  # of simulated waves, whose bound waves are averaged
SIMULATED_WAVES = 600  # single waves whose leakage through the windows is averaged
NEAR_CELLS = 5  # cells to either side of a simulated wave
NOISE_LINES = 0.75  # of the Nyquist frequency: the noise is estimated from the lines above
MIN_WINDOW = 0.2  # of the spatial window: nearer to the edge its quotient is not given
MIN_SPEED_ON_CURRENT = 0.3  # of the group velocity: a current that slows waves more smears them over all k


class CellKind(IntEnum):
    """Content of a cell of the (k, omega) space."""

    FREE = 0
    STRIP = 1  # next to the relation
    HARMONIC = 2  # second harmonic of a single wave
    SUM = 3  # faster than a free wave of its length: forced by two at their sum
    DIFFERENCE = 4  # the other side of the relation


@dataclass(frozen=True)
class RelationCut:
    """Which cells of the (k, omega) space hold free waves."""

    depth: float = np.inf  # m
    gamma: float = GAMMA  # surface tension over density, m3/s2
    current: tuple[float, float] = (0.0, 0.0)  # along x and y, m/s
    reach: float = 1.0  # half width of the relation, rad/m
    strip: float = 0.0  # width of the strip next to it, rad/m

    def distances(self, omega: Array, ky: Array, kx: Array) -> tuple[Array, Array]:
        """Distance in k, rad/m, from the dispersion relation and from its second harmonic."""
        k = np.hypot(ky, kx)
        doppler_shift = kx * self.current[0] + ky * self.current[1]
        intrinsic = np.maximum(omega - doppler_shift, 0.0)
        k_table, sigma, speeds = self._free_waves
        distance = k - np.interp(intrinsic, sigma, k_table, left=0.0)
        if any(self.current):
            with np.errstate(divide="ignore", invalid="ignore"):
                along = np.nan_to_num(doppler_shift / k)
            # to first order: the current of this cell is taken for that of the relation in its direction
            slowed = 1 + along / np.interp(intrinsic, sigma, speeds)
            distance /= np.clip(slowed, MIN_SPEED_ON_CURRENT, 1 / MIN_SPEED_ON_CURRENT)
        return distance, k - 2 * np.interp(intrinsic / 2, sigma, k_table, left=0.0)

    @cached_property
    def _free_waves(self) -> tuple[Array, Array, Array]:
        """Wavenumber, frequency and group velocity."""
        k = np.geomspace(1e-3, 4e3, 6000)
        speed = group_velocity(np.maximum(k, 0.1), self.depth, self.gamma)
        return k, dispersion(k, self.depth, self.gamma), speed

    def kind(self, from_relation: Array, from_harmonic: Array) -> NDArray[np.int8]:
        """`CellKind` of cells at these distances."""
        distance = np.abs(from_relation)
        out = np.where(from_relation > 0, np.int8(CellKind.DIFFERENCE), np.int8(CellKind.SUM))
        out[np.abs(from_harmonic) < self.reach] = CellKind.HARMONIC
        out[distance < self.reach + self.strip] = CellKind.STRIP
        out[distance < self.reach] = CellKind.FREE
        return out


def _hann_line(distance: Array, length: int) -> Array:
    """Energy of a Hann window of `length` samples at distances in cells."""
    turn = np.exp(-2j * np.pi * np.multiply.outer(distance, np.arange(length)) / length)
    return np.asarray(np.abs(turn @ hann(length)) ** 2)


@dataclass(frozen=True)
class _Axes:
    """Axes of a spectrum, rad/s and rad/m."""

    omega: Array
    ky: Array
    kx: Array

    @property
    def steps(self) -> tuple[float, float, float]:
        return self.omega[1], self.ky[1] - self.ky[0], self.kx[1] - self.kx[0]


def _draw(energy: Array, kinds: Array, axes: _Axes, cut: RelationCut) -> tuple[Array, Array, Array]:
    """Frequencies and wave vectors omega, ky, kx of free waves of the same energy, on the relation."""
    rng = np.random.default_rng(0)
    weight = np.where(kinds == CellKind.FREE, energy, 0.0).ravel()
    weight[: LOWEST * energy[0].size] = 0.0
    quantiles = weight.sum() * (np.arange(SIMULATED_WAVES) + 0.5) / SIMULATED_WAVES
    cells = np.unravel_index(np.searchsorted(np.cumsum(weight), quantiles), energy.shape)
    # frequency is resolved far better than the wave vector: its length follows from that and its direction
    omega, ky, kx = (
        axis[cell] + step * rng.uniform(-0.5, 0.5, SIMULATED_WAVES)
        for axis, cell, step in zip((axes.omega, axes.ky, axes.kx), cells, axes.steps)
    )
    for _ in range(4):
        relative = cut.distances(omega, ky, kx)[0] / np.maximum(np.hypot(ky, kx), 1e-9)
        ky, kx = ky * (1 - relative), kx * (1 - relative)
    return omega, ky, kx


def _leakage(energy: Array, kinds: Array, axes: _Axes, cut: RelationCut) -> tuple[Array, float]:
    """Fraction of the energy of free waves that leaks to each kind of cell, and the windows' width squared.
    Single waves are drawn from the cells of free waves and passed through the windows.
    """
    total, width = _through_windows(_draw(energy, kinds, axes, cut), axes, cut)
    return total / total.sum(), width


def _through_windows(waves: tuple[Array, Array, Array], axes: _Axes, cut: RelationCut) -> tuple[Array, float]:
    """Energy of single waves (omega, ky, kx) by kind of cell, off the lowest lines; squared width."""
    near = np.arange(-NEAR_CELLS, NEAR_CELLS + 1)
    sizes = 2 * (axes.omega.size - 1), axes.ky.size, axes.kx.size
    places, lines = [], []
    for axis, (true, step, size) in enumerate(zip(waves, axes.steps, sizes)):
        cell = np.rint(true / step)[:, None] + near
        shape = [near.size if axis == other else 1 for other in range(3)]
        places.append((cell * step).reshape(-1, *shape))
        lines.append(_hann_line(cell - true[:, None] / step, size).reshape(-1, *shape))
    from_relation, from_harmonic = cut.distances(*np.broadcast_arrays(*places))
    power = lines[0] * lines[1] * lines[2] * (places[0] > (LOWEST - 0.5) * axes.steps[0])
    kind = cut.kind(from_relation, from_harmonic)
    total = np.bincount(kind.ravel(), power.ravel(), len(CellKind))
    free = kind == CellKind.FREE
    return total, float((power * from_relation**2)[free].sum() / power[free].sum())


def _bound_by_kind(energy: Array, kinds: Array, axes: _Axes, cut: RelationCut) -> tuple[Array, float]:
    """Waves that pairs of free waves force: shares of kinds of cells; variance over that squared."""
    omega, ky, kx = _draw(energy, kinds, axes, cut)
    sigma = omega - kx * cut.current[0] - ky * cut.current[1]
    rng = np.random.default_rng(1)
    i, j = rng.integers(0, omega.size, (2, PAIRS))
    i, j = i[i != j], j[i != j]
    parts = []
    for sign in (1, -1):
        gain = forced_elevation(
            (kx[i], ky[i], sigma[i]), (kx[j], ky[j], sigma[j]), sign, cut.depth, cut.gamma
        )
        parts.append((gain**2, omega[i] + sign * omega[j], ky[i] + sign * ky[j], kx[i] + sign * kx[j]))
    weight, o, y, x = (np.concatenate(part) for part in zip(*parts))
    strength = float(weight.sum()) / i.size
    flip = np.where(o < 0, -1.0, 1.0)
    weight = np.where(flip * o < (LOWEST - 0.5) * axes.omega[1], 0.0, weight)
    quantiles = weight.sum() * (np.arange(SIMULATED_WAVES) + 0.5) / SIMULATED_WAVES
    chosen = np.searchsorted(np.cumsum(weight), quantiles)
    total, _ = _through_windows(tuple((flip * part)[chosen] for part in (o, y, x)), axes, cut)
    return np.asarray(total / total.sum()), strength


@takes(plane_of("z"))
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
    density : DataArray or Dataset
        Spectrum (omega, ky, kx) of the elevation (`spectrum`), m2 per rad/s and (rad/m)2; of a field
        (time, y, x) or of the z of a cube it is computed.
    depth : float
        Depth of the water, m; by default that of the cube, or deep.
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
        ``sum_fraction``, ``difference_fraction``, its parts near the second harmonic's relation and on either
        side of the dispersion relation; ``noise_fraction``; ``E_free``, ``E_bound``, ``E_harmonic`` (omega),
        m2 s; ``ridge_reach`` and ``ridge_width``, the half width used for the relation and its own width
        beyond that of the windows, rad/m.
        Attributes ``current``, ``gamma``, ``depth`` as given.

    Raises
    ------
    CubeError
        If there is no energy near the dispersion relation, if less than half of the waves bound to these free
        ones are off it at this depth, window and current, or if the windows spread more energy there than
        bound waves have by theory.

    Notes
    -----
    Two free waves force one at the sum of their frequencies and wave vectors and one at the difference, off
    omega = sigma(k) + k . U; a wave with itself forces 2 omega at 2 k. The relation is taken two cells of the
    k plane wide on either side, times its measured width over that of the windows. Subtracted from the energy
    off it are the leakage of free waves through the windows (averaged over simulated waves) and the noise
    (median over the highest frequencies, cell by cell). Pairs of the free waves are drawn, and the waves they
    force at second order (Sharma and Dean 1981) passed through the windows. Where more than a fifth of these
    is under the relation, what is left is divided by the part that is off it; elsewhere the bound energy
    under the relation is taken to be that of the strip of half a cell next to it. The uncertainty joins
    chance, half of what is added under the relation, and a fifth of the leakage. The two lowest lines are
    left out: removing the trend in time leaves 1e-4 of the variance there. Energy that breaking or wind
    spreads off the relation counts as bound.

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
    axes = _Axes(*(density[name].values.astype(float) for name in ("omega", "ky", "kx")))
    values = density.values
    cell = float(max(axes.steps[1:]))
    cut = RelationCut(depth, gamma, current, RELATION_CELLS * cell, STRIP_CELLS * cell)
    kinds, second_moment, total = _sort(values, axes, cut)
    if not total > 0:
        raise CubeError("the spectrum has no energy on the dispersion relation: check depth and current")
    _, window_width = _leakage(values, kinds, axes, cut)
    own_width = max(second_moment / total - window_width, 0.0)
    if own_width > 0.1 * window_width:
        cut = replace(cut, reach=cut.reach * float(np.sqrt(1 + own_width / window_width)))
        kinds, _, _ = _sort(values, axes, cut)
    leakage, _ = _leakage(values, kinds, axes, cut)
    high = axes.omega > NOISE_LINES * axes.omega[-1]
    high[-1] = False
    noise = np.median(values[high], axis=0) if high.sum() >= 4 else np.zeros_like(values[0])
    energies = _energies(values, kinds, noise, leakage, dof)
    share, strength = _bound_by_kind(values, kinds, axes, cut)
    visible = float(share[CellKind.HARMONIC :].sum())
    if visible < MIN_VISIBLE:
        raise CubeError(
            f"only {100 * visible:.0f} % of the waves bound to these free ones are off the dispersion"
            f" relation at this depth, window and current ({100 * MIN_VISIBLE:.0f} % are needed):"
            " choose a larger area"
        )
    free = float(energies.by_line[CellKind.FREE].sum()) * float(np.prod(axes.steps))
    if energies.leaked * float(np.prod(axes.steps)) > visible * strength * free**2:
        raise CubeError(
            "the windows spread more energy of the free waves off the dispersion relation than the waves"
            " bound to them have there by theory: choose a larger area or longer segments"
        )
    return _label(energies, visible, axes, cut, float(np.sqrt(own_width)))


def _sort(values: Array, axes: _Axes, cut: RelationCut) -> tuple[Array, float, float]:
    """Kinds of all cells; energy of free waves times squared distance from the relation, and that energy."""
    ky, kx = np.meshgrid(axes.ky, axes.kx, indexing="ij")
    kinds = np.empty(values.shape, np.int8)
    second_moment = total = 0.0
    for i, omega in enumerate(axes.omega):
        from_relation, from_harmonic = cut.distances(np.full(ky.shape, omega), ky, kx)
        kinds[i] = cut.kind(from_relation, from_harmonic)
        if i >= LOWEST:
            free = np.where(kinds[i] == CellKind.FREE, values[i], 0.0)
            second_moment += float((free * from_relation**2).sum(dtype=float))
            total += float(free.sum(dtype=float))
    return kinds, second_moment, total


@dataclass(frozen=True)
class _Energies:
    """Energies of the kinds of cells, noise and leakage subtracted."""

    by_line: Array  # (kinds, omega)
    noise: float
    leaked: float  # of the free waves, subtracted from the others
    chance: float  # relative variance of the energy off the relation


def _energies(values: Array, kinds: Array, noise: Array, leakage: Array, dof: float | None) -> _Energies:
    by_line = np.zeros((len(CellKind), values.shape[0]))
    total_noise = squares = 0.0
    for i in range(LOWEST, values.shape[0]):
        line = values[i].astype(float)
        by_line[:, i] = np.bincount(kinds[i].ravel(), (line - noise).ravel(), len(CellKind))
        total_noise += float(noise.sum())
        squares += float((line[kinds[i] > CellKind.STRIP] ** 2).sum())
    free = by_line[CellKind.FREE] / leakage[CellKind.FREE]
    by_line[1:] -= leakage[1:, None] * free  # on each line in proportion to its free waves
    by_line[0] = free
    off = abs(float(by_line[1:].sum()))
    chance = np.nan if dof is None else 2 / dof * CORRELATED_CELLS**3 * squares / max(off**2, 1e-30)
    return _Energies(by_line, total_noise, float(leakage[1:].sum() * free.sum()), chance)


def _label(
    energies: _Energies, visible: float, axes: _Axes, cut: RelationCut, own_width: float
) -> xr.Dataset:
    cell = float(np.prod(axes.steps[1:]))
    lines = energies.by_line
    sums = {kind: float(lines[kind].sum()) for kind in CellKind}
    off = sum(sums[kind] for kind in CellKind if kind > CellKind.STRIP)
    total, bound_lines = sum(sums.values()), lines[CellKind.HARMONIC :].sum(axis=0)
    if visible < STRIP_SUFFICES:
        bound_lines = bound_lines / visible
    else:  # measured: that under the relation is as much as next to it
        bound_lines = bound_lines + lines[CellKind.STRIP] * (2.0 if sums[CellKind.STRIP] > 0 else 1.0)
    bound = float(bound_lines.sum())
    corrections = np.hypot(UNDER_ERROR * (bound - off), LEAKAGE_ERROR * energies.leaked)
    spectra = {
        "E_free": lines.sum(axis=0) - bound_lines,
        "E_bound": bound_lines,
        "E_harmonic": lines[CellKind.HARMONIC],
    }
    scalars = {
        "bound_fraction": bound / total,
        "bound_fraction_std": np.hypot(np.sqrt(energies.chance) * bound, corrections) / total,
        "harmonic_fraction": sums[CellKind.HARMONIC] / total,
        "sum_fraction": sums[CellKind.SUM] / total,
        "difference_fraction": sums[CellKind.DIFFERENCE] / total,
        "noise_fraction": energies.noise / (total + energies.noise),
        "ridge_reach": cut.reach,
        "ridge_width": own_width,
    }
    out = {name: xr.Variable("omega", values * cell) for name, values in spectra.items()}
    out |= {name: xr.Variable((), value) for name, value in scalars.items()}
    attrs = {"depth": cut.depth, "gamma": cut.gamma, "current": list(cut.current)}
    return annotate(xr.Dataset(out, omega_coords(axes.omega), attrs), "bound")


@takes(a_cube)
def free_and_bound_fields(
    cube: xr.Dataset, split: xr.Dataset, *, segment: int | None = None, record: Record | None = None
) -> xr.Dataset:
    """Elevation of the free and of the bound waves in time and space.

    Parameters
    ----------
    cube : Dataset
        With z over (time, y, x), m. Computed segment by segment.
    split : Dataset
        The result of `free_and_bound`.
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
    along the relation as the spectrum was; the Hann windows in space are divided out. Mean and trend of a
    segment count as bound waves, and so does noise off the relation.

    Examples
    --------
    A wave and its second harmonic; of the split only the variables used here.

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
    cut = RelationCut(
        float(split.attrs["depth"]),
        float(split.attrs["gamma"]),
        tuple(split.attrs["current"]),
        float(split["ridge_reach"]),
    )
    shape = (ny, nx // 2 + 1)
    # in numpy's signs a wave along k is at -omega, or at -k
    free_cells = np.empty((segment, *shape), bool)
    for i, o in enumerate(-omega):
        sign = 1.0 if o >= 0 else -1.0
        distances = cut.distances(np.full(shape, abs(o)), *np.broadcast_arrays(sign * ky, sign * kx))
        free_cells[i] = cut.kind(*distances) == CellKind.FREE
    window = spatial_window(ny, nx)
    divisor = np.where(window > MIN_WINDOW, window, np.nan)
    out = {name: np.full((field.sizes["time"], ny, nx), np.nan, np.float32) for name in ("z_free", "z_bound")}
    read = Reader([field], record)
    for run in record.runs:
        free = np.zeros((run[1] - run[0], ny, nx), np.float32)
        starts = range(run[0], run[1] - segment + 1, half)
        for a in starts:
            block = read(a, a + segment, run)[0] * window * hann(segment)[:, None, None]
            lines = fft.fft(fft.rfftn(block, axes=(1, 2)), axis=0, overwrite_x=True)
            lines *= free_cells
            back = fft.irfft2(fft.ifft(lines, axis=0, overwrite_x=True), (ny, nx), axes=(1, 2))
            free[a - run[0] : a - run[0] + segment] += back
        if len(starts) < 2:
            continue
        covered = slice(run[0] + half, starts[-1] + half)  # by two segments
        quotient = free[half : covered.stop - run[0]] / divisor
        out["z_free"][covered] = quotient
        z = [read(a, min(a + half, covered.stop), run)[0] for a in range(covered.start, covered.stop, half)]
        out["z_bound"][covered] = np.concatenate(z) - quotient
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
