"""The best elevation from stereo and from the integrated vertical velocity, and the noise of either.

z = eta + n_z at frame times; w dt is the difference of two elevations, so w_hat = w i dt / (2 sin b), b =
omega dt / 2, is the elevation at mid-time with noise n_w. No rest record is needed to tell signal from noise.
"""

from typing import Any

import dask
import dask.array as da
import numpy as np
import xarray as xr
from scipy import fft

from wavefield.errors import CubeError
from wavefield.variables import CUBE_DIMS
from wavefield.water import dispersion, wavenumber
from wavefield.waves import kernels, spectra
from wavefield.waves.crosses import cross_spectra, need
from wavefield.waves.record import Record, fill, find_record, piece
from wavefield.waves.transfer import LEAST_GAIN, LEAST_SIGNAL
from wavefield.waves.units import product
from wavefield.waves.window_gain import read_gain, ring_gain
from wavefield.waves.windows import hann

NAMES = ("z", "w")
PAIRS = (("z", "w"),)
ROADS = ("stereo", "w", "cross", "fusion")
_OFF = 0.3  # of the ridge's omega: further off there is no free wave
_TRUSTED = 0.7  # share of the ridge's cells
_LOWEST = 1.2  # Hz: below it the integrated w holds little but drift


def _white(noise: np.ndarray, use: np.ndarray) -> np.ndarray:
    # level of each ring: the median passes over the ridge, where gains err, and over the nonlinear term in w
    level = np.nanmedian(np.where(use, noise, np.nan), axis=0)
    return np.nan_to_num(level).clip(min=0.0)


def _reach(omega: np.ndarray, valid: np.ndarray, signal: np.ndarray) -> tuple[float, float]:
    # up to where, from the peak on, a road is valid; and how far below the peak that is, in decades
    peak = int(np.argmax(np.nan_to_num(signal)))
    index = peak
    while index + 1 < omega.size and valid[index + 1]:
        index += 1
    floor = signal[index]
    decades = float(np.log10(signal[peak] / floor)) if floor > 0 else np.nan
    return float(omega[index] / (2 * np.pi)), decades


def _smooth(values: np.ndarray, width: int = 7) -> np.ndarray:
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1 / width), "valid")


def _gains(gain: xr.Dataset | None, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # power gains of z and w and the gain of their cross spectrum; 0 where they are not to be trusted
    if gain is None:
        return np.ones_like(k), np.ones_like(k), np.ones_like(k)
    z, w, both = (ring_gain(gain, *names, k) for names in (("z", "z"), ("w", "w"), ("z", "w")))
    return np.where(z > LEAST_GAIN, z, 0.0), np.where(w > LEAST_GAIN, w, 0.0), both


def _best(
    zz: np.ndarray,
    ww: np.ndarray,
    zw: np.ndarray,
    noise_z: np.ndarray,
    noise_w: np.ndarray,
    gain_z: np.ndarray,
    gain_w: np.ndarray,
    gain_zw: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    # z / H_z and w / H_w weighted by what their noise is then, in every cell: its spectrum and its noise
    by_z, by_w = np.sqrt(gain_z) / noise_z, np.sqrt(gain_w) / noise_w
    scale = np.maximum(by_z, by_w)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_z, by_w = by_z / scale, by_w / scale
        whole = by_z**2 * gain_z + by_w**2 * gain_w + 2 * by_z * by_w * gain_zw
        left = (by_z**2 * noise_z + np.where(by_w > 0, by_w**2 * noise_w, 0.0)) / whole
        power = (by_z**2 * zz + by_w**2 * ww + 2 * by_z * by_w * zw) / whole
    known = scale > 0
    return np.where(known, power - left, 0.0), np.where(known, left, np.inf)


def _on_ridge(trusted: np.ndarray, omega: np.ndarray, k: np.ndarray, depth: float) -> np.ndarray:
    # whether the waves' own cells are trusted: three rings about the ridge, seven lines
    place = np.rint(np.interp(wavenumber(omega, depth), k, np.arange(k.size))).astype(int)
    near = np.clip(place[:, None] + np.arange(-1, 2), 0, k.size - 1)
    return _smooth(np.take_along_axis(trusted, near, axis=1).mean(axis=1)) > _TRUSTED


def from_spectra(ring: xr.Dataset, depth: float = np.inf, gain: xr.Dataset | None = None) -> xr.Dataset:
    """Fusion from the power and cross spectra of z and w.

    Parameters
    ----------
    ring : Dataset
        As `cross_spectra` gives it for `NAMES` and `PAIRS`.
    depth : float
        Depth of the water, m: it says where the ridge is.
    gain : Dataset, optional
        Gain of the matching windows, to be undone (`window_gain`).

    Returns
    -------
    Dataset
        As `fusion` gives it.
    """
    ring = ring.compute()
    dt = float(ring.attrs["dt"])
    omega, k = ring["omega"].values, ring["k"].values
    b = omega * dt / 2
    step_k = float(k[1] - k[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        # z is half a step early: exp(i b) brings it to mid-time
        to_elevation = np.exp(1j * b) * 1j * dt / (2 * np.sin(b))
        factor_w = (dt / 2) ** 2 / np.sin(b) ** 2
    to_elevation[0], factor_w[0] = 0, 0
    cross_k = (ring["S_z_w"].values * to_elevation[:, None]).real
    zz_k, ww_k = ring["E_z"].values, ring["E_w"].values * factor_w[:, None]
    gain_z, gain_w, gain_zw = _gains(gain, k)
    sees_z, sees_w = gain_z > 0, gain_w > 0  # where a road still sees the waves

    use = (omega > 2 * np.pi * _LOWEST) & (omega < 0.95 * omega[-1])
    if use.sum() < 3:
        use = omega > 0
    # windows that leave too little to correct still leave some: noise is what is off the ridge there
    free = dispersion(k, depth)
    off = np.abs(omega[:, None] - free) > np.maximum(_OFF * free, 4 * omega[1])
    use = use[:, None] & (off | (sees_z & sees_w))
    shape = 4 * np.sin(b) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        eta_k = np.where(sees_z & sees_w, cross_k / gain_zw, 0.0)
        noise_z_k, noise_w_k = zz_k - gain_z * eta_k, ww_k - gain_w * eta_k
        white_z = _white(noise_z_k, use)
        white_dz = _white(noise_w_k * shape[:, None], use)
        fit_w_k = np.where(omega[:, None] > 0, white_dz / shape[:, None], np.inf)
    fit_z_k = np.broadcast_to(white_z, zz_k.shape)

    tiny = 1e-30 * max(float(zz_k.max()), 1e-300)
    fit_z_k, fit_w_k = np.maximum(fit_z_k, tiny), np.maximum(fit_w_k, tiny)
    best_k, left_k = _best(zz_k, ww_k, cross_k, fit_z_k, fit_w_k, gain_z, gain_w, gain_zw)
    if gain is None:
        energies_k: tuple[np.ndarray, ...] = (zz_k, ww_k, cross_k, best_k)
        trusted_k: tuple[np.ndarray, ...] | None = None
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            energies_k = ((zz_k - fit_z_k) / gain_z, (ww_k - fit_w_k) / gain_w, eta_k, best_k)
            trusted_k = tuple(
                there & (energy > LEAST_SIGNAL * noise)
                for energy, noise, there in zip(
                    energies_k,
                    (fit_z_k / gain_z, fit_w_k / gain_w, left_k, left_k),
                    (sees_z, sees_w, sees_z & sees_w, sees_z | sees_w),
                )
            )
        energies_k = tuple(np.where(t, e, 0.0) for t, e in zip(trusted_k, energies_k))
    zz, ww, zw, best = (array.sum(axis=1) * step_k for array in energies_k)
    noise_z, noise_w = (array.sum(axis=1) * step_k for array in (noise_z_k, noise_w_k))
    fit_z, fit_w = (array.sum(axis=1) * step_k for array in (fit_z_k, fit_w_k))
    displacement = float(white_dz.sum()) * step_k

    # of the fields as they are, all k alike: for time series
    precision_z, precision_w = 1 / fit_z, 1 / fit_w
    weight = precision_z / (precision_z + precision_w)
    residual_noise = 1 / (precision_z + precision_w)
    both = np.maximum(best + residual_noise, tiny)
    energies = dict(zip(ROADS, (zz, ww, zw, best)))

    dof = spectra.frequency_spectrum(ring.rename(E_z="E", dof_z="dof"))["dof"].values
    best_positive = np.maximum(_smooth(best), tiny)
    # a road is right within a factor 2 where its own noise stays below the signal; the noise-free roads where
    # the signal stands out of what is left by chance
    scatter_cross = np.sqrt((_smooth(zz) * _smooth(ww) + _smooth(zw) ** 2) / dof)
    scatter_best = _smooth(both) * np.sqrt(2 / dof)
    in_band = (np.arange(omega.size) >= 2) & (np.arange(omega.size) < omega.size - 1)
    valid = {
        "stereo": in_band & (fit_z < best_positive),
        "w": in_band & (fit_w < best_positive),
        "cross": in_band & (_smooth(zw) > 2 * scatter_cross / np.sqrt(7)),
        "fusion": in_band & (_smooth(best) > 2 * scatter_best / np.sqrt(7)),
    }
    if trusted_k is not None:
        on_ridge = [_on_ridge(trusted, omega, k, depth) for trusted in trusted_k]
        valid = {road: in_band & there for road, there in zip(ROADS, on_ridge)}
    reach = [_reach(omega, valid[road], best_positive) for road in ROADS]
    share = {
        "stereo": np.ones_like(zz),
        "w": np.ones_like(zz),
        "cross": np.clip(2 * zw**2 / np.maximum(zz * ww + zw**2, tiny**2), 1e-3, 1),
        "fusion": np.clip(np.maximum(best, 0) / np.maximum(both, tiny), 1e-3, 1) ** 2,
    }

    units = product((ring["E_z"].attrs["units"], 1), (spectra.K_UNITS, 1))
    texts = {
        "stereo": "elevation spectrum from stereo",
        "w": "elevation spectrum from integrated w",
        "cross": "elevation spectrum from the cross spectrum of stereo and integrated w",
        "fusion": "elevation spectrum from the best combination, noise taken off",
    }
    out = xr.Dataset(
        coords=spectra.omega_coords(omega)
        | {"road": ("road", list(ROADS), {"long_name": "road to the elevation"})}
    )
    for road in ROADS:
        energy = xr.DataArray(energies[road], dims="omega", attrs={"long_name": texts[road], "units": units})
        energy = energy.assign_coords(omega=out["omega"])
        parts = spectra.with_interval(
            energy,
            xr.DataArray(dof * share[road], dims="omega"),
        )
        flag = {"long_name": "right within a factor 2", "units": "1"}
        parts["valid"] = ("omega", valid[road], flag)
        names = {n: f"{n}_{road}" for n in ("dof", "low", "high", "valid")}
        out = out.assign(parts.rename({"E": f"Ez_{road}"} | names).data_vars)
    for name, values, text in (
        ("noise_z", noise_z, "noise of the stereo elevation"),
        ("noise_w", noise_w, "noise of the integrated w"),
        ("noise_z_fit", fit_z, "noise of the stereo elevation, white fit"),
        ("noise_w_fit", fit_w, "noise of the integrated w, fit of white displacement noise"),
    ):
        out[name] = ("omega", values, {"long_name": text, "units": units})
    out["weight_z"] = (
        "omega",
        weight,
        {"long_name": "weight of stereo in the best combination", "units": "1"},
    )
    wiener = best_positive / (best_positive + residual_noise)
    if trusted_k is not None:
        whole = np.where(trusted_k[-1], best_k, np.nan)
        text = "E(k, omega) of the elevation, best combination, windows undone, noise taken off"
        attrs = {"long_name": text, "units": product((units, 1), (spectra.K_UNITS, -1))}
        out = out.assign_coords(spectra.k_coords(k))
        out["Ez_komega"] = (("omega", "k"), whole, attrs)
    out["wiener"] = ("omega", wiener, {"long_name": "Wiener gain S / (S + N), for time series", "units": "1"})
    band = np.pi / dt
    out["sigma_z"] = (
        (),
        np.sqrt(float(white_z.sum()) * step_k * band),
        {"long_name": "noise of z, rms", "units": "m"},
    )
    out["sigma_dz"] = (
        (),
        np.sqrt(displacement * band),
        {"long_name": "noise of the displacement dz, rms", "units": "m"},
    )
    out["noise_coherence"] = (
        (),
        _noise_coherence(ring, zz_k, ww_k, cross_k, depth),
        {
            "long_name": "correlation of the noises of z and integrated w",
            "units": "1",
            "comment": "off the ridge, above it in k; NaN where the spectrum has no such place",
        },
    )
    out["range_frequency"] = (
        "road",
        [r[0] for r in reach],
        {"long_name": "right within a factor 2 up to", "units": "Hz"},
    )
    out["range_decades"] = (
        "road",
        [r[1] for r in reach],
        {"long_name": "decades below the peak up to there", "units": "1"},
    )
    out.attrs = dict(ring.attrs)
    return out


def _noise_coherence(ring: xr.Dataset, zz: np.ndarray, ww: np.ndarray, zw: np.ndarray, depth: float) -> float:
    # waves, bound ones too, have omega above the free relation's at their k or near it; below it there is but
    # noise
    free = dispersion(ring["k"].values, depth)
    omega = ring["omega"].values[:, None]
    off = (free > 1.6 * omega + 12) & ring["valid"].values & (omega > 2 * np.pi * 0.5)
    if off.sum() < 10:
        return float("nan")
    z, w, both = ((array * off).sum(axis=1) for array in (zz, ww, zw))
    lines = (z > 0) & (w > 0)
    # each line on the scale of its own noise
    return float((both[lines] / np.sqrt(z[lines] * w[lines])).mean()) if lines.any() else float("nan")


def fusion(
    cube: xr.Dataset,
    *,
    gain: Any = None,
    depth: float | None = None,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Elevation spectrum by four roads, the noise of each, and the weights of the best combination.

    Parameters
    ----------
    cube : Dataset
        z, z_t, w over (time, y, x), m and m/s.
    gain : path or Dataset, optional
        Gain of the matching windows (`window_gain`): it is undone, and all four roads have their noise taken
        off, where the gain of power exceeds 0.1 and the signal 3 times the noise.
    depth : float, optional
        Depth of the water, m; the attribute ``water_depth`` of the cube, or deep, if not given.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``Ez_stereo``, ``Ez_w``, ``Ez_cross``, ``Ez_fusion`` (omega, m2 s rad-1) with ``dof_``, ``low_``,
        ``high_``, ``valid_``; ``noise_z``, ``noise_w`` and their fits; ``weight_z``, ``wiener`` (omega);
        ``sigma_z``, ``sigma_dz`` (m); ``noise_coherence``; ``range_frequency`` (Hz), ``range_decades``
        (road); with a gain ``Ez_komega`` (omega, k) too, NaN where it cannot be trusted. Computed at once.

    Raises
    ------
    CubeError
        If a variable is missing, the record is shorter than a segment or no full rectangle is left.

    Notes
    -----
    N_z = S_zz - Re S_zw, N_w = S_ww - Re S_zw; weights inverse to the noise in every cell (k, omega), the
    noise fitted ring by ring as white in z and in the displacement. With gains H, S_zw / (H_z H_w) stands for
    the elevation and N / H^2 for the noise, so that the weight passes at short waves to what resolves them.
    It rests on independent noises: ``noise_coherence`` measures how far they are.
    """
    if depth is None:
        depth = float(cube.attrs.get("water_depth") or np.inf)
    gain = None if gain is None else read_gain(gain)
    return from_spectra(cross_spectra(cube, NAMES, PAIRS, segment=segment, record=record), depth, gain)


def _filter(
    pieces: list[Any],
    steps: np.ndarray,
    first: int,
    missing: np.ndarray,
    segment: int,
    dt: float,
    weight: np.ndarray,
    gain: np.ndarray,
) -> np.ndarray:
    z, z_t, w = (fill(np.asarray(part), missing) for part in pieces)
    # beyond the ends of a run the waves run backwards in time: z even, its rates odd
    inside = np.clip(steps, first, first + z.shape[0] - 1)
    mirrored = np.where(steps < first, 2 * first - 1 - steps, steps)
    last = first + z.shape[0]
    mirrored = np.where(steps >= last, 2 * last - 1 - steps, mirrored) - first
    sign = np.where(inside == steps, 1.0, -1.0).astype(z.dtype)[:, None, None]
    z, z_t, w = z[mirrored], z_t[mirrored] * sign, w[mirrored] * sign
    half = segment // 2
    shape = z.shape[1:]
    window = hann(segment).astype(z.dtype)[:, None]
    omega = 2 * np.pi * np.arange(half + 1) / (segment * dt)
    b = omega * dt / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        # numpy's signs: exp(+i omega t)
        integrate = -1j * dt / (2 * np.sin(b))
    integrate[0] = 0
    advance = np.exp(1j * b) * weight * gain
    integrate = integrate * (1 - weight) * gain
    out = np.zeros((half, *shape), z.dtype)
    for start, kept in ((0, slice(half, None)), (half, slice(0, half))):
        part = slice(start, start + segment)
        z_flat, z_t_flat = (array[part].reshape(segment, -1) for array in (z, z_t))
        frames = np.empty_like(z_flat)
        halves = [array[some] for array in (z_flat, z_t_flat) for some in (slice(half), slice(half, None))]
        given = *halves, z.dtype.type(dt), 0, frames[:half], frames[half:]
        kernels.frames(*given)
        lines = fft.rfft(frames * window, axis=0) * advance[:, None]
        lines += fft.rfft(w[part].reshape(segment, -1) * window, axis=0) * integrate[:, None]
        out += fft.irfft(lines, segment, axis=0)[kept].reshape(half, *shape).astype(z.dtype)
    return out


def fuse(
    cube: xr.Dataset,
    fusion: xr.Dataset,
    *,
    gain: xr.DataArray | None = None,
    record: Record | None = None,
) -> xr.DataArray:
    """Elevation as a time series from the best combination of stereo and integrated velocity.

    Parameters
    ----------
    cube : Dataset
        z, z_t, w over (time, y, x), m and m/s.
    fusion : Dataset
        As `fusion` gives it: its ``weight_z`` and segment are used.
    gain : DataArray, (omega,), optional
        A gain besides, such as ``fusion.wiener``, which gives the least error but too little variance.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    DataArray, (time, y, x)
        Elevation at mid-time over the rectangle and the runs, m; lazy where the cube is.

    Raises
    ------
    CubeError
        If a variable is missing or the record is shorter than the segment of ``fusion``.

    Notes
    -----
    Overlapping Hann-windowed segments, filtered without phase and added up.
    """
    need(cube, NAMES)
    names = ["z", "z_t", "w"]
    record = find_record(cube[names]) if record is None else record
    segment = int(fusion.attrs["segment"])
    if record.longest < segment:
        raise CubeError(
            f"the record has {record.longest} steps, less than one segment of the fusion, {segment}:"
            " take the fusion with a shorter segment"
        )
    half = segment // 2
    weight = fusion["weight_z"].values
    more = np.ones_like(weight) if gain is None else np.asarray(gain.values, float)
    task = dask.delayed(_filter, pure=False)
    bridged = np.asarray(record.bridged, int)
    ny, nx = record.shape
    dtype = cube["z"].dtype
    rows, steps_used = [], []
    for run in record.runs:
        if run[1] - run[0] < segment:
            continue
        for a in range(run[0], run[1], half):
            wanted = np.arange(a - half, a + 2 * half)
            lo, hi = max(a - half, run[0]), min(a + 2 * half, run[1])
            if hi - lo < 2 * half:  # the end of a run: enough to mirror
                lo = max(hi - 2 * half, run[0])
            area = slice(*record.y), slice(*record.x)
            pieces = [piece(cube[name], slice(lo, hi), *area) for name in names]
            missing = np.isin(np.arange(lo, hi), bridged)
            block = task(pieces, wanted, lo, missing, segment, record.dt, weight, more)
            count = min(half, run[1] - a)
            rows.append(da.from_delayed(block, (half, ny, nx), dtype)[:count])
            steps_used.append(np.arange(a, a + count))
    steps = np.concatenate(steps_used)
    out = xr.DataArray(
        da.concatenate(rows),
        {
            "time": cube["time"].isel(time=steps),
            "y": cube["y"].isel(y=slice(*record.y)),
            "x": cube["x"].isel(x=slice(*record.x)),
        },
        CUBE_DIMS,
        name="z",
        attrs={"long_name": "surface elevation, stereo and integrated velocity combined", "units": "m"},
    )
    return out if cube["z"].chunks is not None else out.compute()
