"""Directional spectrum of the free waves. `water` is (depth in m, surface tension over density in m3/s2)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, group_velocity, wavenumber
from wavefield.waves import rings
from wavefield.waves.current import NO_CURRENT, CurrentUsed
from wavefield.waves.dispersion_fit import fit_dispersion
from wavefield.waves.dispersion_points import (
    HALF_WIDTH,
    MIN_HALF_WIDTH,
    SECTORS,
    SHORTEST_WAVES,
    PlaneSpectrum,
)
from wavefield.waves.dof import correlation_at
from wavefield.waves.elevation import intrinsic_frequency
from wavefield.waves.gains import MIN_SIGNAL_TO_NOISE, elevation_from_w
from wavefield.waves.inputs import is_cube
from wavefield.waves.products import Noted, WaveProduct, register
from wavefield.waves.spectra import a_plane
from wavefield.waves.welch import Welch, frames_of, interval

Array = NDArray[Any]

_HANN = np.array([*rings.HANN_CORRELATION[:0:-1], *rings.HANN_CORRELATION])  # of neighbouring cells
# The energy lies on a thin ridge, so cells are correlated more than by their windows. Ratio of the variances
# of the direction: 1.9, 1.9 and 1.6 in 20 Gaussian seas each of directional spreading s = 5, 20 and 50
RIDGE_CORRELATION = 1.6
# The same for the energy of a single sector, which has fewer cells. Tuned on random seas: intervals of
# D(theta) hold 90 % with 1 and 96 % with 1.6
SECTOR_CORRELATION = 1.3


def packet_correlation(
    ky: Array, kx: Array, omega: Array, water: tuple[float, float], current: tuple[float, float], dof: float
) -> Array:
    """Return the factor (ky, kx) by which waves that stay in the field for several segments raise a
    spectrum's variance. `ky`, `kx` (rad/m) and `omega` (rad/s) are the axes of the spectrum. Each of its
    values has `dof` degrees of freedom."""
    k = np.maximum(np.hypot(ky[:, None], kx), 1e-9)
    speed = group_velocity(k, *water) / k
    velocity = speed * kx + current[0], speed * ky[:, None] + current[1]
    lengths = 2 * np.pi / (kx[1] - kx[0]), 2 * np.pi / (ky[1] - ky[0])
    count = max(19 * dof / 36, 1.0)  # number of half-overlapping segments
    crossing = correlation_at(velocity, 2 * np.pi / (omega[1] - omega[0]), lengths, round(count))
    white = 1 + (1 - 1 / count) / 18  # white noise in segments that overlap by half, Hann window
    return np.maximum(crossing / white, 1.0)


def sector_covariances(shares: Array, energy: Array, dof: float) -> Array:
    """Return the covariance matrix (sectors, sectors) of the energies in sectors of direction. `shares`
    (sectors, cells) is the area fraction of each cell (ky, kx) inside each sector. Each value of `energy`
    (frequency, ky, kx) has `dof` degrees of freedom; Hann windows correlate neighbouring values."""
    lines, ny, nx = energy.shape
    reach = min(2, lines - 1)
    over_lines = ndimage.convolve1d(energy, _HANN[2 - reach : 3 + reach], axis=0, mode="constant")
    planes = shares.reshape(-1, ny, nx)
    out = np.zeros((shares.shape[0],) * 2)
    for s, part in enumerate(planes):
        used = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
        if not used[0].size:
            continue
        box = tuple(slice(max(int(some[0]) - 2, 0), int(some[-1]) + 3) for some in used)
        smoothed = part[box] * over_lines[:, *box]
        for axis in (1, 2):
            smoothed = ndimage.convolve1d(smoothed, _HANN, axis=axis, mode="constant")
        product = (smoothed * energy[:, *box]).sum(axis=0)
        out[s] = 2 / dof * (planes[:, *box] * product).sum(axis=(1, 2))
    return out


def sector_freedom(levels: Array, covariances: Array) -> Array:
    """Return the degrees of freedom of each sector's fraction of the total energy, (sectors,). `levels`
    (sectors,) are the energies of the sectors, and `covariances` (sectors, sectors) their covariances."""
    total = max(levels.sum(), 1e-300)
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.diag(covariances) / levels**2 - 2 * covariances.sum(axis=1) / (levels * total)
    return np.asarray(2 / np.maximum(own + covariances.sum() / total**2, 1e-12))


def harmonic_stds(levels: Array, covariances: Array, theta: Array) -> tuple[float, float]:
    """Return standard uncertainties of the first harmonic of D(theta), along and across the mean direction.
    `levels` (sectors,) are energies at directions `theta`, rad, with the covariance matrix `covariances`."""
    total = max(levels.sum(), 1e-300)
    turned = np.exp(1j * theta)
    first = (levels * turned).sum() / total
    by_level = (turned - first) / total * np.exp(-1j * np.angle(first))
    along, across = (float(part @ covariances @ part) for part in (by_level.real, by_level.imag))
    return np.sqrt(max(along, 0.0)), np.sqrt(max(across, 0.0))


BLUR_UNCERTAINTY = 0.2  # chosen: relative uncertainty of the resolution that is subtracted from the spread
STEP_HZ = 0.1  # width and distance of frequency bands: two lines of segments of 20 s
LOWEST_HZ = 0.5  # chosen: below it, the elevation integrated from w is mostly drift


def in_still_water(density: xr.DataArray, lines: Array, current: tuple[float, float]) -> Array:
    """Return E(k, omega + k . U), (lines, ky, kx), the spectrum in a frame that moves with the current U,
    m/s. `lines` are indices of omega. E is zero where omega + k . U exceeds the highest frequency."""
    values = density.values
    if not any(current):
        return np.asarray(values[lines], float)
    omega, ky, kx = (density[name].values for name in ("omega", "ky", "kx"))
    shift = (current[1] * ky[:, None] + current[0] * kx) / (omega[1] - omega[0])
    row, column = np.meshgrid(np.arange(ky.size), np.arange(kx.size), indexing="ij")
    mirror_row, mirror_column = (np.abs(k[:, None] + k).argmin(axis=1) for k in (ky, kx))
    out = np.empty((lines.size, *shift.shape))
    for i, line in enumerate(lines):
        place = line + shift
        backwards = place < 0  # E(-k, -omega) = E(k, omega)
        place = np.abs(place)
        low = np.minimum(np.floor(place).astype(int), omega.size - 1)
        high = np.minimum(low + 1, omega.size - 1)
        y = np.where(backwards, mirror_row[row], row)
        x = np.where(backwards, mirror_column[column], column)
        part = place - low
        out[i] = (1 - part) * values[low, y, x] + part * values[high, y, x]
        out[i][place > omega.size - 1] = 0
    return out


class _RingSectors:
    """For a ring of |k|, computes the area fractions of cells (ky, kx) in `count` sectors of direction."""

    def __init__(self, ky: Array, kx: Array, count: int) -> None:
        n = rings.SUPERSAMPLING
        part = (np.arange(n) + 0.5) / n - 0.5
        sub_y = ky[:, None, None, None] + (part * (ky[1] - ky[0]))[:, None, None]
        sub_x = kx[:, None] + part * (kx[1] - kx[0])
        self.count, self.width = count, 2 * np.pi / count
        self.cells = ky.size * kx.size
        self.cell_area = float((ky[1] - ky[0]) * (kx[1] - kx[0]))
        radius = np.hypot(sub_y, sub_x)  # (ky, part, kx, part)
        turn = np.arctan2(sub_y, sub_x) % (2 * np.pi)
        sector = np.floor(turn / self.width).astype(int) % count
        cell = np.arange(self.cells).reshape(ky.size, 1, kx.size, 1)
        by_radius = np.argsort(radius, axis=None)  # a ring is a slice of the sorted parts
        self.radius = radius.ravel()[by_radius]
        self.place = (sector * self.cells + cell).ravel()[by_radius]  # in (sectors, cells)

    def shares(self, centre: float, half: float) -> tuple[Array, Array]:
        """Return the area fraction of each cell in each sector of a ring, (sectors, cells), and the coverage
        (sectors,). The ring is |k| = `centre` +- `half`, rad/m. The coverage is the fraction of a sector
        inside the k plane."""
        first = np.searchsorted(self.radius, centre - half, "right")
        ring = slice(first, np.searchsorted(self.radius, centre + half, "left"))
        parts = np.bincount(self.place[ring], minlength=self.count * self.cells)
        out = parts.reshape(self.count, self.cells) / rings.SUPERSAMPLING**2
        area = self.width / 2 * ((centre + half) ** 2 - max(centre - half, 0.0) ** 2)
        return out, out.sum(axis=1) * self.cell_area / area


def directions(
    density: xr.DataArray | xr.Dataset,
    frequency: Sequence[float] | Array | None = None,
    depth: float | None = None,
    *,
    current: tuple[float, float] | None = None,
    segment: int | None = None,
) -> xr.Dataset:
    """Directional spectrum of the waves on the dispersion relation.

    Parameters
    ----------
    density : DataArray or Dataset
        A cube, whose spectrum of w is converted to one of elevation. Or a spectrum E(omega, ky, kx), a result
        of `spectrum`, or a field over (time, y, x), whose spectrum is used unchanged.
    frequency : sequence of float, optional
        Centres of the frequency bands in a frame that moves with the water, Hz. Bands are at least 0.1 Hz
        wide. By default all bands that segment and grid resolve.
    depth : float, optional
        Depth of the water, m; by default that stored with the input, or deep water.
    current : tuple of float, optional
        Velocity of the water along x and y, m/s; by default it is fitted to the dispersion relation.
    segment : int, optional
        Steps of a Welch segment, even, for a cube or field; by default a quarter of the longest run of steps.

    Returns
    -------
    Dataset
        Over (frequency, theta), with theta the direction of propagation in 24 sectors: ``D``, the
        directional density in 1/rad; its degrees of freedom ``dof``; ``low`` and ``high``, the limits of
        the 95 % interval as factors of D. Over frequency: ``energy``, the spectrum of the waves per Hz, for
        a cube in m2/Hz; ``direction`` and ``spread``, the mean direction and directional spread, rad, with
        standard uncertainties ``direction_std`` and ``spread_std``; ``r1`` and ``r2``, the moduli of the
        first two harmonics of D; ``isotropy``, 1 less the larger of r1 and r2. All of these but ``energy``
        are NaN where the grid does not resolve waves or waves are below three times the noise; uncertainties
        and ``dof`` are NaN for an E(omega, ky, kx) without degrees of freedom. ``efth`` (freq, dir), the same
        spectrum per Hz and degree as in oceanography (and in the package wavespectra): ``dir`` is the
        direction that waves come from, in degrees clockwise from the y axis.

    Raises
    ------
    CubeError
        If the input is of another kind, if no frequency is resolved, if a frequency exceeds the Nyquist
        frequency, or if the current is not given and `fit_dispersion` fails.

    Notes
    -----
    The spectrum is first shifted to the frame of the water, E(k, omega + k . U). Cells (ky, kx) near the
    dispersion relation are divided between sectors by area, and the energy of a sector by the fraction of it
    that the k plane samples. The spread is sqrt(2 (1 - r1)) less the resolution in quadrature: a Hann window
    of length L blurs k by (2 pi / L) / sqrt(3); cells and sectors blur it by their width over sqrt(12). D,
    the harmonics and ``efth`` are not corrected for this blur.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.directions(wf.open_cube("sea.zarr"), [1.8, 2.2])
    >>> found.D.dims, found.efth.dims
    (('frequency', 'theta'), ('freq', 'dir'))
    """
    plane, stated = a_plane(density, "directions", segment)
    water = stated.get("depth", np.inf) if depth is None else depth, stated.get("gamma", GAMMA)
    if current is None:
        try:
            fit = fit_dispersion(plane, water[0], gamma=water[1])
        except CubeError as error:
            raise CubeError(f"{error}; or give the current") from None
        current = float(fit["current_x"]), float(fit["current_y"])
    if is_cube(density):
        plane = elevation_density(plane, current, frames_of(density), water)
    if frequency is None:
        frequency = resolved_frequencies(plane, *water)
    return _directions(plane, frequency, water, current, stated.get("dof"))


def elevation_density(
    density: xr.DataArray, current: tuple[float, float], frames: int, water: tuple[float, float]
) -> xr.DataArray:
    """Return E(omega, ky, kx) of the elevation, the time integral of w, from the spectrum `density` of w. w
    is integrated in a frame that moves at `current`, m/s. `frames` is the result of `frames_of`."""
    omega, ky, kx = np.meshgrid(
        *(density[name] for name in ("omega", "ky", "kx")), indexing="ij", sparse=True
    )
    dt, sigma = np.pi / float(omega.max()), dispersion(np.hypot(ky, kx), *water)
    intrinsic = intrinsic_frequency(omega, kx * current[0] + ky * current[1], sigma, dt)
    with np.errstate(invalid="ignore"):
        factor = np.where(omega > 0, elevation_from_w(intrinsic, dt, frames), 0.0)
    return density.transpose("omega", "ky", "kx") * factor


def resolved_frequencies(density: xr.DataArray, depth: float, gamma: float) -> Array:
    """Return the centres, Hz, of the frequency bands that segment length and grid resolve."""
    lines = density["omega"].values / (2 * np.pi)
    shortest = dispersion(SHORTEST_WAVES * _largest_k(density), depth, gamma) / (2 * np.pi)
    return np.arange(max(LOWEST_HZ, 3 * lines[1]), min(shortest, 0.9 * lines[-1]), max(STEP_HZ, lines[1]))


def _largest_k(density: xr.DataArray) -> float:
    return float(min(density["kx"].max(), density["ky"].max()))


def above_noise(
    density: xr.DataArray, found: xr.Dataset, water: tuple[float, float], current: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return a mask (frequency,): true where waves are resolved and exceed three times the noise.
    `found` is a result of `directions` for the spectrum `density`; only its ``frequency`` (Hz) is used."""
    spectrum = PlaneSpectrum.of(density, water)
    frequency = found["frequency"].values
    centres = wavenumber(2 * np.pi * frequency, *water)
    omega = spectrum.omega
    cells = np.flatnonzero(spectrum.k < SHORTEST_WAVES * _largest_k(density))
    shift = current[0] * spectrum.kx[cells] + current[1] * spectrum.ky[cells]
    out = centres <= SHORTEST_WAVES * _largest_k(density)
    for i in np.flatnonzero(out):
        half_width = max(HALF_WIDTH * centres[i], MIN_HALF_WIDTH * spectrum.cell)
        ring = np.abs(spectrum.k[cells] - centres[i]) < half_width
        line = np.rint((2 * np.pi * frequency[i] + shift[ring]) / omega[1]).astype(int)
        inside = (line >= 0) & (line < omega.size)
        at = line[inside], cells[ring][inside]
        out[i] = spectrum.energy[at].sum() > MIN_SIGNAL_TO_NOISE * spectrum.noise[at].sum()
    return np.asarray(out)


def oceanographic(found: xr.Dataset) -> xr.DataArray:
    """Return ``efth`` (freq, dir), the spectrum per Hz and degree, from a result of `directions`.
    ``dir`` is the direction that waves come from, in degrees clockwise from the y axis."""
    compass = (270 - np.degrees(found["theta"].values)) % 360
    order = np.argsort(compass)
    energy = (found["energy"] * found["D"] * np.pi / 180).values[:, order]
    coords = {"freq": found["frequency"].values, "dir": compass[order]}
    out = annotate(xr.Dataset({"efth": (("freq", "dir"), energy)}, coords), "direction")["efth"]
    out.attrs["comment"] = (
        "blurred by the windows: a spread computed from it, such as dspr of wavespectra, is too large;"
        " the variable spread is corrected for the blur"
    )
    return out


def _directions(
    density: xr.DataArray,
    frequency: Sequence[float] | Array,
    water: tuple[float, float],
    current: tuple[float, float],
    dof: float | None,
) -> xr.Dataset:
    """Return the Dataset of `directions` from `density`, E(omega, ky, kx), at the frequencies `frequency`,
    Hz. `dof` are the degrees of freedom of one value of E. If it is None, all uncertainties are NaN."""
    frequency = np.atleast_1d(np.asarray(frequency, float))
    lines = density["omega"].values / (2 * np.pi)
    if not frequency.size:
        raise CubeError("segment and grid resolve no frequency: choose a longer segment or a finer grid")
    if frequency.max() > lines[-1]:
        raise CubeError(f"{frequency.max():g} Hz is outside the spectrum, which ends at {lines[-1]:g} Hz")
    ky, kx = density["ky"].values, density["kx"].values
    cells = float(ky[1] - ky[0]), float(kx[1] - kx[0])
    plane = _RingSectors(ky, kx, SECTORS)
    theta = (np.arange(SECTORS) + 0.5) * plane.width
    centres = wavenumber(2 * np.pi * frequency, *water)
    levels, degrees = np.empty((frequency.size, SECTORS)), np.full((frequency.size, SECTORS), np.nan)
    stds = np.full((2, frequency.size), np.nan)
    if dof is not None:
        packets = packet_correlation(ky, kx, density["omega"].values, water, current, dof)
    for i, (f, centre) in enumerate(zip(frequency, centres)):
        # a line on the boundary of two bands belongs to one of them
        band = np.flatnonzero(np.abs(lines - f) < max(STEP_HZ, lines[1]) / 2 * (1 - 1e-9))
        if not band.size:
            band = np.array([np.abs(lines - f).argmin()])
        energy = in_still_water(density, band, current)
        half_width = max(HALF_WIDTH * centre, MIN_HALF_WIDTH * max(cells))
        shares, coverage = plane.shares(float(centre), half_width)
        to_level = np.divide(plane.cell_area / band.size, coverage, out=np.zeros(SECTORS), where=coverage > 0)
        levels[i] = shares @ energy.sum(axis=0).ravel() * to_level
        if dof is not None:
            covariances = sector_covariances(shares, energy * np.sqrt(packets), dof)
            covariances *= np.outer(to_level, to_level)
            degrees[i] = sector_freedom(levels[i], SECTOR_CORRELATION * covariances)
            stds[:, i] = harmonic_stds(levels[i], RIDGE_CORRELATION * covariances, theta)
    found = _label(frequency, centres, levels, degrees, cells, stds)
    clear = xr.DataArray(above_noise(density, found, water, current), dims="frequency")
    known = {name: found[name].where(clear) for name in found if name != "energy"}
    return found.assign(known).assign(efth=oceanographic(found))


def _label(
    frequency: Array, centres: Array, levels: Array, degrees: Array, cells: tuple[float, float], stds: Array
) -> xr.Dataset:
    """Return the Dataset of `directions`, without ``efth``, from sector energies `levels` (frequency,
    sectors). `centres` (frequency,) are wavenumbers, and `cells` the spacings of ky and kx, rad/m. `degrees`
    are degrees of freedom of `levels`, and `stds` (2, frequency) uncertainties from `harmonic_stds`."""
    sectors = levels.shape[1]
    width = 2 * np.pi / sectors
    theta = (np.arange(sectors) + 0.5) * width
    total = levels.sum(axis=1, keepdims=True)
    values = np.divide(levels, total * width, out=np.full(levels.shape, np.nan), where=total > 0)
    first, second = ((values * np.exp(1j * m * theta)).sum(axis=1) * width for m in (1, 2))
    mean = np.angle(first)
    # variance of k across the mean direction, in cells squared: 1/3 by the Hann window and 1/12 by the cell
    across = np.hypot(cells[0] * np.cos(mean), cells[1] * np.sin(mean)) / np.asarray(centres)
    blur = 5 / 12 * across**2 + width**2 / 12
    spread = np.sqrt(np.maximum(2 * (1 - np.abs(first)) - blur, 0))
    along, across = stds
    # an isotropic sea has a first harmonic by chance
    beyond_chance = np.sqrt(np.maximum(np.abs(first) ** 2 - along**2 - across**2, 1e-18))
    # in quadrature: the bias of r1 by chance, and the uncertainty of the resolution
    along = np.sqrt(along**2 + (across**2 / (2 * np.abs(first))) ** 2 + (BLUR_UNCERTAINTY * blur / 2) ** 2)
    uniform = np.pi / np.sqrt(3)  # rad: standard deviation of a direction that is uniform over the circle
    low, high = interval(degrees)
    dims = ("frequency", "theta")
    out = xr.Dataset(
        {
            "D": (dims, values),
            "dof": (dims, degrees),
            "low": (dims, low),
            "high": (dims, high),
            "energy": ("frequency", 2 * np.pi * total[:, 0]),
            "direction": ("frequency", mean % (2 * np.pi)),
            "spread": ("frequency", spread),
            "direction_std": ("frequency", np.minimum(across / beyond_chance, uniform)),
            "spread_std": ("frequency", along / np.sqrt(spread**2 + along)),
            "r1": ("frequency", np.abs(first)),
            "r2": ("frequency", np.abs(second)),
            "isotropy": ("frequency", 1 - np.maximum(np.abs(first), np.abs(second))),
        },
        {"frequency": ("frequency", frequency), "theta": ("theta", theta)},
    )
    return annotate(out, "direction")


def direction_group(
    density: xr.DataArray, depth: float, gamma: float, used: CurrentUsed, welch: Welch
) -> xr.Dataset | Noted:
    """Return the directional spectrum that `analyze` writes, from `density`, E(omega, ky, kx) of w.
    If the current is unknown, ``efth`` is left out and a note for the user is added."""
    water = depth, gamma
    elevation = elevation_density(density, used.velocity, welch.frames, water)
    frequency = resolved_frequencies(density, *water)
    out = _directions(elevation, frequency, water, used.velocity, welch.dof)
    out = out.rename({name: f"{name}_D" for name in ("dof", "low", "high")}).assign_attrs(used.attrs)
    out["energy"].attrs["units"] = "m2 Hz-1"
    if used.source == NO_CURRENT:
        notes = ["No directional spectrum of wave heights (efth): the current is not known."]
        return Noted(out.drop_dims(["freq", "dir"]), notes)
    return out


register(
    WaveProduct(
        "direction",
        ("density_w", "depth", "gamma", "current", "welch"),
        direction_group,
        group="direction",
        without="No directions",
        cost=3,
    )
)
