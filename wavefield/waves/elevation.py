"""Elevation spectra from the stereo elevation z, from the vertical velocity w, and from both combined.

z = eta + n_z at the times of the frames, with the true elevation eta. w dt is the difference of two
elevations, so w_hat = i w dt / (2 sin b), b = omega dt / 2, is the elevation at mid-time with a noise n_w.
n_z and n_w are independent, so the cross spectrum of z and w_hat contains the signal but neither noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from wavefield.variables import annotate
from wavefield.water import dispersion, wavenumber
from wavefield.waves.current import CurrentUsed
from wavefield.waves.dispersion_points import Water
from wavefield.waves.dof import with_interval
from wavefield.waves.gains import (
    MIN_SIGNAL_TO_NOISE,
    is_predicted,
    noise_of_displacement,
    path_factor,
    ring_gain,
    with_directions,
)
from wavefield.waves.products import WaveProduct, register
from wavefield.waves.spectra import density
from wavefield.waves.sums import MIN_AMPLITUDE
from wavefield.waves.welch import MIN_OVER_FILLED, Welch, inner, k_coords, omega_coords

Array = NDArray[Any]

MAX_DEPARTURE = 0.5  # chosen: of an intrinsic frequency from that of free waves, relative to the latter
_TABLE_K = np.geomspace(1e-3, 4e3, 6000)  # rad/m: waves of 6 km to 1.6 mm


def intrinsic_frequency(omega: Array, doppler_shift: Array, sigma: Array, dt: float) -> Array:
    """Return the frequency omega - k . U in a frame that moves with the water, rad/s; `doppler_shift` is k .
    U. The modulus is limited to 0.5 to 1.5 times the free-wave frequency `sigma`, or to omega if outside."""
    intrinsic = np.asarray(omega - doppler_shift)
    least = np.minimum(omega, (1 - MAX_DEPARTURE) * sigma)
    most = np.maximum(omega, np.minimum((1 + MAX_DEPARTURE) * sigma, np.pi / dt))
    return np.asarray(np.where(intrinsic < 0, -1.0, 1.0) * np.clip(np.abs(intrinsic), least, most))


NAMES = ("z", "w")
PAIRS = (("z", "w"),)
PLANES = ("z*w",)
METHODS = ("stereo", "w", "cross", "fusion")
BY_SOURCE = ["Ez", "dof_Ez", "low_Ez", "high_Ez", "valid_Ez"]
MIN_FREE_K = 0.5  # chosen, relative to free waves: leakage of the peak has smaller wavenumbers
MAX_FREE_DISTANCE = 0.3  # chosen, relative to the omega of free waves: cells further away contain only noise
MIN_TRUSTED_FRACTION = 0.9  # chosen: fraction of the cells near free waves that must be trusted in a line
MIN_LINES = 5  # below this line the factor 1 / omega^2 varies by more than a fifth within a line
LEARNED_WITHIN = 1.5  # chosen: a predicted signal-to-noise ratio is uncertain by this factor


def _white(noise: Array, use: Array) -> Array:
    """Return a white noise level (k,): the median over omega of `noise` (omega, k) where `use` is true."""
    noise = np.where(use, noise, np.nan)
    usable = np.isfinite(noise).any(axis=0)  # short records: some rings have no line away from free waves
    out: Array = np.zeros(noise.shape[1])
    out[usable] = np.nanmedian(noise[:, usable], axis=0).clip(min=0.0)
    return out


def _reach(omega: Array, valid: Array, signal: Array) -> tuple[float, float]:
    """Return the highest frequency, Hz, of the valid range that contains the spectral peak. Also return by
    how many decades `signal` falls from the peak to that frequency. Arrays are (omega,)."""
    peak = int(np.argmax(np.nan_to_num(signal)))
    index = peak
    while index + 1 < omega.size and valid[index + 1]:
        index += 1
    floor = signal[index]
    decades = float(np.log10(signal[peak] / floor)) if floor > 0 else np.nan
    return float(omega[index] / (2 * np.pi)), decades


def _smooth(values: Array) -> Array:
    return np.asarray(uniform_filter1d(values, 7, axis=0, mode="nearest"))


def _trusted_lines(trusted: Array, spectra: "_Elevations", water: Water) -> Array:
    """Return a mask (omega,): true where over 90 % of the values near free waves are trusted. `trusted`
    (omega, k) marks values whose signal exceeds three times the noise and whose gain is correctable."""
    k, waves = spectra.k, np.asarray(wavenumber(spectra.omega, *water))
    if spectra.speed:  # on a current, use the mean wavenumber of the energy
        energy = np.maximum(_smooth(spectra.zw), 0.0)
        waves = (energy * k).sum(axis=1) / np.maximum(energy.sum(axis=1), _tiny(spectra))
    place = np.rint(np.interp(waves, k, np.arange(k.size))).astype(int)
    near = np.clip(place[:, None] + np.arange(-1, 2), 0, k.size - 1)
    known = np.take_along_axis(trusted, near, axis=1).mean(axis=1)
    return np.asarray(_smooth(known) > MIN_TRUSTED_FRACTION)


@dataclass(frozen=True)
class _Gains:
    """Power gains (k,): of the spectra of z and w, 0 where too small, and of their cross spectrum."""

    z: Array
    w: Array
    zw: Array
    log_std: float = 0.0  # standard uncertainty of ln(S / N), from which gains S / (S + N) were predicted

    @property
    def std(self) -> tuple[Array, Array]:
        """Relative standard uncertainties of the amplitude gains of z and of w, two arrays (k,)."""
        z, w = (self.log_std * np.maximum(1.0 - np.sqrt(power), 0.0) for power in (self.z, self.w))
        return z, w

    @property
    def both_usable(self) -> Array:
        """Mask (k,): true where the gains of z and of w are both large enough for a correction."""
        return np.asarray((self.z > 0) & (self.w > 0))

    def elevation(self, cross: Array) -> Array:
        """Return the elevation spectrum (omega, k) from `cross` of z and w; 0 where a gain is too small."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.both_usable, cross / self.zw, 0.0)


def _gains(gain: xr.Dataset | None, k: Array) -> _Gains:
    """Return the power gains at wavenumbers `k`, rad/m; all gains are 1 if `gain` is None."""
    if gain is None:
        return _Gains(np.ones_like(k), np.ones_like(k), np.ones_like(k))
    z, w, both = (ring_gain(gain, *names, k) for names in (("z", "z"), ("w", "w"), ("z", "w")))
    z, w = (np.where(power > MIN_AMPLITUDE**2, power, 0.0) for power in (z, w))
    return _Gains(z, w, both, float(np.log(LEARNED_WITHIN)) if is_predicted(gain) else 0.0)


@dataclass(frozen=True)
class _Elevations:
    """Elevation spectra (omega, k): zz of z, ww of w integrated in time, and their cross spectrum zw."""

    omega: Array  # rad/s
    k: Array  # of the rings, rad/m
    dt: float  # time between frames, s
    zz: Array
    ww: Array
    zw: Array
    noise_factor: Array  # (omega, k): noise spectrum of w dt over that of the elevation integrated from w
    speed: float  # of the current, m/s

    @property
    def step(self) -> float:
        """Spacing of the wavenumbers, rad/m."""
        return float(self.k[1] - self.k[0])

    def over_k(self, array: Array) -> Array:
        """Return the integral over k, (omega,), of an array (omega, k)."""
        return np.asarray(array.sum(axis=1) * self.step)


def _elevations(
    ring: xr.Dataset, welch: Welch, w: xr.DataArray, zw: Array, current: tuple[float, float], water: Water
) -> _Elevations:
    """Return the elevation spectra from z and w, before noise is subtracted or gains are corrected. `w` is
    E(omega, ky, kx) of w, and `zw` is Re(i exp(i omega dt / 2) S) with the cross spectrum S of z and w."""
    dt, table, frames = welch.record.dt, welch.table, welch.frames
    ky, kx = np.meshgrid(w["ky"].values, w["kx"].values, indexing="ij")
    sigma, doppler_shift = dispersion(np.hypot(kx, ky), *water), kx * current[0] + ky * current[1]
    shares = table.shares.T.tocsr()
    area = np.asarray(shares.sum(axis=1)).ravel()
    out = np.zeros((3, welch.omega.size, table.k.size))
    for i, omega in enumerate(welch.omega[1:], 1):
        intrinsic = intrinsic_frequency(omega, doppler_shift, sigma, dt)
        to_z = dt / (2 * np.sin(intrinsic * dt / 2) * path_factor(intrinsic, dt, frames))
        shape = 1 / noise_of_displacement(intrinsic, dt, frames)
        planes = np.stack([w.values[i] * to_z**2, zw[i] * to_z, shape])
        flat = np.fft.ifftshift(planes, axes=(1, 2)).reshape(3, -1)
        out[:, i] = (shares @ flat.T).T
    cell = float(w["ky"][1] - w["ky"][0]) * float(w["kx"][1] - w["kx"][0])
    energy, cross = out[:2] * (cell / table.dk)
    with np.errstate(divide="ignore", invalid="ignore"):
        noise_factor = np.where(out[2] > 0, area / out[2], 0.0)
    of_z = ring["E"].sel(quantity="z").values
    return _Elevations(welch.omega, table.k, dt, of_z, energy, cross, noise_factor, float(np.hypot(*current)))


@dataclass(frozen=True)
class _Noise:
    """Noise (omega, k) of z and of the elevation integrated from w. There are also fits, in which the noise
    of z and of w dt is white in time, so that its spectrum depends on k only."""

    z: Array
    w: Array
    fit_z: Array  # from white_z
    fit_w: Array  # from white_dz
    white_z: Array  # (k,): fitted noise of z
    white_dz: Array  # (k,): fitted noise of w dt
    known: bool  # whether most rings have waves in less than half of their lines, so that a median is noise


def _noise(spectra: _Elevations, water: Water, gains: _Gains) -> _Noise:
    """Return the noise of z and of the elevation integrated from w, with fits of white noise in time.
    The noise is the part of each spectrum that the cross spectrum of z and w does not explain."""
    omega, k = spectra.omega, spectra.k
    use = (np.arange(omega.size) >= MIN_LINES) & (omega < 0.95 * omega[-1])
    # rings with too small a gain still contain some waves: there, the noise is taken away from free waves
    free = dispersion(k, *water)
    apart = np.abs(omega[:, None] - free) - np.maximum(MAX_FREE_DISTANCE * free, 4 * omega[1])
    off = apart > k * spectra.speed
    use = use[:, None] & (off | gains.both_usable)
    with np.errstate(divide="ignore", invalid="ignore"):
        eta = gains.elevation(spectra.zw)
        noise_z, noise_w = spectra.zz - gains.z * eta, spectra.ww - gains.w * eta
        white_z = _white(noise_z, use)
        white_dz = _white(noise_w * spectra.noise_factor, use)
        fit_w = np.where(omega[:, None] > 0, white_dz / spectra.noise_factor, np.inf)
    fit_z = np.broadcast_to(white_z, spectra.zz.shape)
    known = bool(((apart > 0).mean(axis=0) > 0.5).mean() > 0.5)
    tiny = _tiny(spectra)
    return _Noise(
        noise_z, noise_w, np.maximum(fit_z, tiny), np.maximum(fit_w, tiny), white_z, white_dz, known
    )


def _best(spectra: _Elevations, noise: _Noise, gains: _Gains) -> tuple[Array, Array, Array]:
    """Return three arrays (omega, k): the elevation spectrum from z and w, weighted by inverse variance; its
    noise; and the relative standard uncertainty of its amplitude that is due to the gains."""
    std_z, std_w = gains.std
    waves = np.maximum(gains.elevation(spectra.zw), 0.0)
    by_z = np.sqrt(gains.z) / (noise.fit_z + std_z**2 * gains.z * waves)
    by_w = np.sqrt(gains.w) / (noise.fit_w + std_w**2 * gains.w * waves)
    scale = np.maximum(by_z, by_w)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_z, by_w = by_z / scale, by_w / scale
        norm = by_z**2 * gains.z + by_w**2 * gains.w + 2 * by_z * by_w * gains.zw
        remaining = (by_z**2 * noise.fit_z + np.where(by_w > 0, by_w**2 * noise.fit_w, 0.0)) / norm
        power = (by_z**2 * spectra.zz + by_w**2 * spectra.ww + 2 * by_z * by_w * spectra.zw) / norm
        share = by_z * np.sqrt(gains.z) / (by_z * np.sqrt(gains.z) + by_w * np.sqrt(gains.w))
        std = share * std_z + (1 - share) * std_w  # errors of both gains are correlated
    some = scale > 0
    return np.where(some, power - remaining, 0.0), np.where(some, remaining, np.inf), np.where(some, std, 0.0)


def _tiny(spectra: _Elevations) -> float:
    return 1e-30 * max(float(spectra.zz.max()), 1e-300)


def _by_method(
    spectra: _Elevations, noise: _Noise, gains: _Gains, undo: bool
) -> tuple[tuple[Array, ...], tuple[Array, ...], tuple[Array, ...]]:
    """Return three tuples of one array (omega, k) per method in `METHODS`: energies, masks of trusted values,
    and relative gain uncertainties of energy. If `undo`, noise and gains are corrected; untrusted energies
    are 0."""
    best, remaining, std_best = _best(spectra, noise, gains)
    with np.errstate(divide="ignore", invalid="ignore"):
        signals = (
            (spectra.zz - noise.fit_z) / gains.z,
            (spectra.ww - noise.fit_w) / gains.w,
            gains.elevation(spectra.zw),
            best,
        )
        trusted = tuple(
            usable & (signal > MIN_SIGNAL_TO_NOISE * level)
            for signal, level, usable in zip(
                signals,
                (noise.fit_z / gains.z, noise.fit_w / gains.w, remaining, remaining),
                (gains.z > 0, gains.w > 0, gains.both_usable, (gains.z > 0) | (gains.w > 0)),
            )
        )
    if not undo:
        return (spectra.zz, spectra.ww, spectra.zw, best), trusted, (0.0 * best,) * len(METHODS)
    std_z, std_w = gains.std
    stds = 2 * std_z, 2 * std_w, std_z + std_w, 2 * std_best
    return tuple(np.where(t, signal, 0.0) for t, signal in zip(trusted, signals)), trusted, stds


def _freedom(
    ring: xr.Dataset, energies: Sequence[Array], remaining: Array, gain_variances: Array, tiny: float
) -> Array:
    """Return the degrees of freedom of E(omega), (methods, omega), lowered for subtracted noise and gain
    errors. `energies` are E(omega) by method and `remaining` noise; `gain_variances` are relative."""
    z, w = (ring["dof_omega"].sel(quantity=name).clip(min=1).values for name in NAMES)
    dof = np.stack([z, w, np.sqrt(z * w), np.sqrt(z * w)])
    zz, ww, zw, best = energies
    kept = np.ones_like(dof)
    kept[2] = np.clip(2 * zw**2 / np.maximum(zz * ww + zw**2, tiny**2), 1e-3, 1)
    kept[3] = np.clip(np.maximum(best, 0) / np.maximum(best + remaining, tiny), 1e-3, 1) ** 2
    return np.asarray(dof / (1 / kept + 0.5 * gain_variances * dof))


def fused_group(
    ring: xr.Dataset,
    ring_sums: dict[str, Array],
    welch: Welch,
    density_w: xr.DataArray,
    used: CurrentUsed,
    gain: xr.Dataset | None,
    depth: float,
    gamma: float,
) -> xr.Dataset:
    """Return elevation spectra ``Ez`` (source, omega), m2 s, and the noise of z and w. Sources are z
    ("stereo"), w integrated in time ("w"), the cross spectrum of these ("cross"), and z and w weighted by
    inverse noise ("fusion"). `ring_sums` are sums over segments; `density_w` is E(omega, ky, kx) of w."""
    zw = density(ring_sums.pop("map z*w"), welch)  # frees memory: no other product needs it
    water = depth, gamma
    spectra = _elevations(ring, welch, density_w, zw, used.velocity, water)
    gains = _gains(None if gain is None else with_directions(gain, density_w.sum("omega")), spectra.k)
    noise = _noise(spectra, water, gains)
    energies_k, trusted_k, stds_k = _by_method(spectra, noise, gains, gain is not None)
    energies = [spectra.over_k(energy) for energy in energies_k]
    tiny, omega = _tiny(spectra), spectra.omega
    square = [
        (spectra.over_k(energy_k * std) / np.maximum(np.abs(energy), tiny)) ** 2
        for energy_k, energy, std in zip(energies_k, energies, stds_k)
    ]
    # noise of z and w combined, and weight of z, if all rings are weighted alike
    inverse_z, inverse_w = (1 / spectra.over_k(fit) for fit in (noise.fit_z, noise.fit_w))
    remaining, weight = 1 / (inverse_z + inverse_w), inverse_z / (inverse_z + inverse_w)
    narrow = np.arange(omega.size) >= MIN_LINES  # lines in which the integration of w is accurate
    integrated = np.ones_like(narrow), narrow, narrow, (weight > 0.5) | narrow
    valid = [
        inner(omega.size)
        & _trusted_lines(trusted, spectra, water)
        & accurate
        & _at_waves(energy, spectra, water)
        for trusted, accurate, energy in zip(trusted_k, integrated, energies_k)
    ]
    dims, coords = ("source", "omega"), omega_coords(omega) | {"source": list(METHODS)}
    dof = xr.DataArray(_freedom(ring, energies, remaining, np.stack(square), tiny), dims=dims)
    parts = with_interval(xr.DataArray(energies, coords, dims), dof).assign(valid=(dims, valid))
    out = annotate(parts.rename(dict(zip(("E", "dof", "low", "high", "valid"), BY_SOURCE))), "spectra")
    out["noise_z"], out["noise_w"] = (("omega", spectra.over_k(array)) for array in (noise.z, noise.w))
    if gain is not None:
        known = trusted_k[-1] & ((gains.z > 0) | (gains.w > 0))
        out = out.assign_coords(k_coords(spectra.k))
        out["Ez_komega"] = (("omega", "k"), np.where(known, energies_k[-1], np.nan))
    for name, white in (("sigma_z", noise.white_z), ("sigma_dz", noise.white_dz)):
        sigma = np.sqrt(float(white.sum()) * spectra.step * np.pi / spectra.dt)
        out[name] = ((), sigma if noise.known else np.nan)
    positive = np.maximum(_smooth(energies[-1]), tiny)
    reach = np.array([_reach(omega, one, positive) for one in valid])
    out["range_frequency"], out["range_decades"] = ("source", reach[:, 0]), ("source", reach[:, 1])
    stated = {"water_depth": depth if np.isfinite(depth) else "deep", "surface_tension_over_density": gamma}
    out["Ez"].attrs |= used.attrs
    return annotate(out.assign_attrs(ring.attrs | used.attrs | stated), "fusion")


def _at_waves(energy: Array, spectra: _Elevations, water: Water) -> Array:
    """Return a mask (omega,): true where most of `energy` (omega, k) is near free waves or at larger k.
    Elsewhere most energy is leakage from the spectral peak."""
    along = dispersion(_TABLE_K, *water) + _TABLE_K * spectra.speed
    longest = np.interp(spectra.omega, along, _TABLE_K)  # free waves that propagate along the current
    shorter = spectra.k > MIN_FREE_K * longest[:, None]
    energy = np.maximum(energy, 0.0)
    total = _smooth(energy.sum(axis=1))
    return np.asarray(_smooth((energy * shorter).sum(axis=1)) > 0.5 * total)


def _elevation_spectra(fused: xr.Dataset, ring: xr.Dataset, filled: Mapping[str, float]) -> xr.Dataset:
    """Return the elevation spectra by method that `analyze` writes. They are valid where E(omega) of z or w,
    as used by the method, exceeds four times `filled`, the power of interpolation errors."""
    out = fused[BY_SOURCE].copy()
    step = float(ring["k"][1] - ring["k"][0])
    over_k = {name: ring["E"].sel(quantity=name).sum("k").values * step for name in NAMES}
    z, w = (over_k[name] > MIN_OVER_FILLED * filled[name] for name in NAMES)
    if any(filled.values()):
        out["valid_Ez"] = out["valid_Ez"] & np.stack([z, w, z & w, z | w])
    return annotate(out, "spectra")


register(
    WaveProduct(
        "fused",
        ("ring", "ring_sums", "welch", "density_w", "current", "gain", "depth", "gamma"),
        fused_group,
        pairs=PAIRS,
        planes=PLANES,
    ),
    WaveProduct("elevation_spectra", ("fused", "ring", "filled"), _elevation_spectra, group="spectra"),
    WaveProduct("fusion", ("fused",), lambda fused: fused.drop_vars(BY_SOURCE), group="fusion"),
)
