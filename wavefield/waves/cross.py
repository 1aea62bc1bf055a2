"""Power and cross spectra of several fields of a cube, and the coherence of z_t with w and u . grad z."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves.current import delayed_current
from wavefield.waves.dof import independent_samples, of_products, ring_freedom, with_interval
from wavefield.waves.gains import MIN_SIGNAL_TO_NOISE, correction, with_directions
from wavefield.waves.inputs import a_cube, takes
from wavefield.waves.products import WaveProduct, register
from wavefield.waves.record import Record
from wavefield.waves.spectra import E_k, E_omega
from wavefield.waves.sums import NAMES, Requested, segment_sums, sources, transforms
from wavefield.waves.welch import CHANCE, Reader, Welch, add_sums, k_coords, omega_coords

Array = NDArray[Any]

# dimensions of the results
_DIMS = {
    "E": ("quantity", "omega", "k"),
    "dof": ("quantity", "omega", "k"),
    "dof_omega": ("quantity", "omega"),
    "dof_k": ("quantity", "k"),
    "S": ("pair", "omega", "k"),
    "samples": ("pair", "omega", "k"),
    "samples_k": ("pair", "k"),
}


def _estimates(
    sums: Mapping[str, Array], names: Sequence[str], pairs: Sequence[tuple[str, str]], welch: Welch
) -> dict[str, Array]:
    freedom = {name: ring_freedom(sums, name, welch) for name in names}
    if "nl" in names:
        waves = next(name for name in ("w", "rise", *names) if name in names)
        freedom["nl"] = of_products(freedom["nl"], sums[waves][0].sum(axis=0), freedom[waves]["omega"])
    out = {"E": [sums[name][0] * welch.ring_density for name in names]}
    for name, axes in (("dof", "both"), ("dof_omega", "omega"), ("dof_k", "k")):
        out[name] = [freedom[of][axes] for of in names]
    if pairs:
        products = [sums[f"{a}*{b}"] for a, b in pairs]
        out["S"] = [(real + 1j * imaginary) * welch.ring_density for real, imaginary in products]
        number = [
            independent_samples(sums, a, b, (freedom[a]["k"], freedom[b]["k"]), welch) for a, b in pairs
        ]
        out["samples"], out["samples_k"] = ([of_pair[axes] for of_pair in number] for axes in ("both", "k"))
    # sums are over (k, omega)
    return {name: np.swapaxes(stack, 1, -1) for name, stack in zip(out, map(np.stack, out.values()))}


def label(
    sums: Mapping[str, Array], names: Sequence[str], pairs: Sequence[tuple[str, str]], welch: Welch
) -> xr.Dataset:
    """Return the Dataset of `cross_spectra` from `sums` over segments (see `sums.add_segment`)."""
    coords: dict[str, Any] = {"quantity": list(names)} | omega_coords(welch.omega) | k_coords(welch.table.k)
    if pairs:
        coords["pair"] = ["*".join(pair) for pair in pairs]
    found = _estimates(sums, names, pairs, welch)
    out: dict[str, Any] = {name: (_DIMS[name], values) for name, values in found.items()}
    out = out | {"valid": (("omega", "k"), welch.valid)} | dict(welch.ring_variables)
    return annotate(annotate(xr.Dataset(out, coords, welch.attrs), "spectra"), "cross")


def checked_fields(cube: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """Return the variables of a cube that `names` need, in m and m/s; CubeError if one is missing."""
    fields = sources(names)
    for field in fields:
        if field not in cube:
            raise CubeError(f"the cube has no {field!r}: spectra of {', '.join(names)} need it")
    return validate(cube, *fields)


@takes(a_cube)
def cross_spectra(
    cube: xr.Dataset,
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]] = (),
    *,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Return power spectra E (quantity, omega, k) of `names` and cross spectra S (pair, omega, k) of `pairs`.
    Names are z, z_t, u, v, w, nl = (u - U) . grad z and rise = z_t + U . grad z, with the mean velocity U. S
    of "a*b" is <conj(a) b>. ``dof``: degrees of freedom of E; ``samples``: independent samples of S."""
    cube = checked_fields(cube, names)
    welch = Welch.of(cube, segment, record)
    # the current decides how long waves stay in the window, and so the degrees of freedom
    welch = with_mean_current(cube, welch) if {"u", "v"} <= {*cube} else welch
    return label(segment_sums(cube, Requested(names, pairs), welch), names, pairs, welch)


def with_mean_current(cube: xr.Dataset, welch: Welch) -> Welch:
    """Return a copy of `welch` whose current is the mean of u and v over the cube."""
    mean, _ = delayed_current(cube, welch.record).compute()
    return replace(welch, current=(float(mean[0]), float(mean[1])))


def _corrected(ring: xr.Dataset, gain: xr.Dataset) -> xr.Dataset:
    """Return `ring`, from `cross_spectra`, with E corrected for the gain of the measurement. A mask
    ``valid_k`` (quantity, k) is added: false for rise, for nl, and where the gain of the field is below
    0.5."""
    names = ring["quantity"].values
    factor, valid = np.ones((names.size, ring.sizes["k"])), np.zeros((names.size, ring.sizes["k"]), bool)
    for i, name in enumerate(names):
        if name not in ("rise", "nl"):
            factor[i], valid[i] = correction(gain, "z" if name == "z_t" else name, ring["k"].values)
    by_k = ("quantity", "k")
    return ring.assign(E=ring["E"] * xr.DataArray(factor, dims=by_k), valid_k=(by_k, valid))


def _spectra(
    ring: xr.Dataset,
    gain: xr.Dataset | None,
    plane_w: xr.DataArray,
    welch: Welch,
    filled: Mapping[str, float],
) -> xr.Dataset:
    """Return the spectra that `analyze` writes: E(k, omega), E(k) and E(omega), with 95 % intervals.
    ``valid`` is false where E is below four times `filled`, the power that interpolated nodes add."""
    valid = ring["valid"]
    for name, added in filled.items():
        if added:
            valid = valid & welch.over_filled(ring["E"].sel(quantity=name, drop=True), added)
    if gain is not None:
        ring = _corrected(ring, with_directions(gain, plane_w))
    out = ring.drop_dims("pair").assign(valid=valid).assign(with_interval(ring["E"], ring["dof"]))
    for axis, spectrum in (("k", E_k(ring)), ("omega", E_omega(ring))):
        out = out.assign({f"{name}_{axis}": spectrum[name] for name in ("E", "dof", "low", "high")})
    return annotate(out, "spectra")


register(
    WaveProduct(
        "ring",
        ("ring_sums", "pairs", "welch"),
        lambda sums, pairs, welch: label(sums, NAMES, pairs, welch),
    ),
    WaveProduct("spectra", ("ring", "gain", "plane_w", "welch", "filled"), _spectra, group="spectra", cost=2),
)


COHERENCE_NAMES = ("rise", "w", "nl")
COHERENCE_PAIRS = (("rise", "w"), ("rise", "nl"), ("w", "nl"))
# pair that sets the number of samples of each term; w is the largest part of tot, w - u . grad z
TERMS = {"w": "rise*w", "nl": "rise*nl", "tot": "rise*w"}


def significance_level(samples: Any) -> Any:
    """Return the squared coherence that unrelated signals exceed in 5 % of cases. `samples`, a number or an
    array, is the number of independent samples of the signals."""
    more = np.maximum(samples - 1, 1e-9)
    return 1 - CHANCE ** (1 / more)


def _above_noise(energy: xr.DataArray) -> xr.DataArray:
    """Return a mask (k,): true where the sum of `energy` (omega, k) over omega exceeds three times the noise.
    The noise at each k is estimated as the median over omega times the number of frequencies."""
    noise = energy.median("omega") * energy.sizes["omega"]
    return energy.sum("omega") > MIN_SIGNAL_TO_NOISE * noise


def coherence_group(ring: xr.Dataset) -> xr.Dataset:
    """Return the Dataset of `coherence` from `ring`, the `cross_spectra` of rise, w, nl and their pairs."""
    rise, w, nl = (ring["E"].sel(quantity=name, drop=True) for name in COHERENCE_NAMES)
    rise_w, rise_nl, w_nl = (ring["S"].sel(pair="*".join(pair), drop=True) for pair in COHERENCE_PAIRS)
    terms = xr.Variable("term", list(TERMS))
    # cross spectrum with z_t, and power, of each term; the term nl is -u . grad z
    cross = xr.concat([rise_w, -rise_nl, rise_w - rise_nl], terms)
    power = xr.concat([w, nl, w + nl - 2 * w_nl.real], terms)
    pairs = xr.DataArray(list(TERMS.values()), dims="term")
    out: dict[str, Any] = {}
    for ending, x, y, xy, samples in (
        ("", rise.sum("omega"), power.sum("omega"), cross.sum("omega"), ring["samples_k"]),
        ("_komega", rise, power, cross, ring["samples"]),
    ):
        out[f"C{ending}"] = xy / np.sqrt(x * y.sel(term="tot", drop=True))
        both = x * y
        out[f"gamma2{ending}"] = np.abs(xy) ** 2 / both.where(both > 0)
        number = samples.sel(pair=pairs).drop_vars("pair").clip(min=1)
        out[f"samples{ending}"] = number
        out[f"level{ending}"] = significance_level(number)
    # z_t and w are measured from the same images, so their noise is coherent, too
    out["valid"] = _above_noise(rise) & _above_noise(w) & ring["valid"].any("omega")
    return annotate(xr.Dataset(out, attrs=ring.attrs), "coherence")


@takes(a_cube)
def coherence(cube: xr.Dataset, *, segment: int | None = None) -> xr.Dataset:
    """Coherence of z_t with w, with -u . grad z and with w - u . grad z, for each k and for each (k, omega).

    Parameters
    ----------
    cube : Dataset
        z (m), z_t, u, v, w (m/s) over (time, y, x). A cube on disk is read once, in pieces.
    segment : int, optional
        Steps of a Welch segment, even; by default about a quarter of the longest run of steps, 64 to 512.

    Returns
    -------
    Dataset
        All variables are dimensionless. Over (term, k), for the terms w, nl (-u . grad z) and tot (their
        sum): the complex coherence ``C``, with the same norm for all terms; the squared coherence ``gamma2``;
        the number of independent ``samples``; and ``level``, the gamma2 that unrelated signals exceed in 5 %
        of cases. Variables such as ``C_komega`` are the same quantities over (term, omega, k). ``valid`` (k)
        is true where z_t and w exceed three times their noise; elsewhere, the noise itself may be coherent.

    Raises
    ------
    CubeError
        If a variable is missing, the record is shorter than a segment or fewer than 8 x 8 nodes are measured.

    Notes
    -----
    All terms refer to a frame that moves with U, the mean of u, v over the record: z_t stands for z_t + U .
    grad z, and u for u - U. C = <conj(z_t) a> / sqrt(<|z_t|^2> <|w - u . grad z|^2>) for a term a, with <>
    the mean over segments and directions and, for C(k), the sum over omega >= 0. C of tot is the sum of C of
    w and C of nl, and |C| of w may exceed 1. In gamma2, <|a|^2> replaces <|w - u . grad z|^2>; its mean is
    1 / samples for unrelated signals.

    Examples
    --------
    In linear waves, the rate of rise is w.

    >>> import wavefield as wf
    >>> found = wf.coherence(wf.open_cube("sea.zarr"))
    >>> bool(found.gamma2.sel(term="w").where(found.valid).min() > 0.99)
    True
    """
    ring = cross_spectra(cube, COHERENCE_NAMES, COHERENCE_PAIRS, segment=segment)
    return coherence_group(ring)


register(WaveProduct("coherence", ("ring",), coherence_group, group="coherence", pairs=COHERENCE_PAIRS))


@takes(a_cube)
def plane_coherence(cube: xr.Dataset) -> xr.Dataset:
    """Coherence of z_t with w, -u . grad z and w - u . grad z at each wave vector, and averaged over rings.

    Parameters
    ----------
    cube : Dataset
        z (m), z_t, u, v, w (m/s) over (time, y, x). A cube on disk is read once, in pieces.

    Returns
    -------
    Dataset
        ``plane_C`` (term, ky, kx), dimensionless, the modulus of the coherence at wave vectors (rad/m) with
        kx >= 0, for the terms w, nl (-u . grad z) and tot (their sum); ``mean_C`` (term, k), its mean over
        each ring of |k|. Attribute ``steps``, the number of steps used.

    Raises
    ------
    CubeError
        If a variable is missing, the record is shorter than a segment or fewer than 8 x 8 nodes are measured.

    Notes
    -----
    |<conj(z_t) a>| / sqrt(<|z_t|^2> <|w - u . grad z|^2>) for a term a, with the covariance <> over time of
    spatial transforms (Aubourg et al., Exp. Fluids, 2019), in a frame that moves with the mean of u, v. N
    independent samples of unrelated signals give about 0.9 / sqrt(N); `coherence` does not have this bias.

    Examples
    --------
    >>> from wavefield import open_cube, waves
    >>> waves.plane_coherence(open_cube("sea.zarr")).plane_C.dims
    ('term', 'ky', 'kx')
    """
    cube = checked_fields(cube, COHERENCE_NAMES)
    welch = with_mean_current(cube, Welch.of(cube))
    record, fields = welch.record, sources(COHERENCE_NAMES)
    read = Reader([cube[field] for field in fields], record)
    sums: dict[str, Array] = {}
    for run in record.runs:
        for blocks in read.blocks(run):
            parts = transforms(dict(zip(fields, blocks)), Requested(COHERENCE_NAMES), welch)
            precise = {n: parts[n].astype(np.complex128) for n in COHERENCE_NAMES}
            sums = add_sums(sums, _plane_sums(precise))
    steps = record.steps_in_runs()
    ny, nx = record.shape
    kx = 2 * np.pi * np.fft.rfftfreq(nx, record.dx)
    ky = np.fft.fftshift(2 * np.pi * np.fft.fftfreq(ny, record.dy))
    table = welch.table
    ring = np.rint(np.hypot(ky[:, None], kx) / table.dk - table.k[0] / table.dk).astype(int)
    inside = (ring >= 0) & (ring < table.k.size)
    count = np.bincount(ring[inside], minlength=table.k.size)
    values = _plane_coherences({n: part / steps for n, part in sums.items()})
    plane = np.fft.fftshift(values.reshape(len(TERMS), ny, nx // 2 + 1), axes=1)
    total = np.array([np.bincount(ring[inside], part[inside], table.k.size) for part in plane])
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    out = {"plane_C": (("term", "ky", "kx"), plane), "mean_C": (("term", "k"), mean)}
    coords = {"term": list(TERMS), "ky": ky, "kx": kx} | k_coords(table.k)
    return annotate(xr.Dataset(out, coords, {"steps": steps}), "wave_vectors")


def _plane_sums(parts: dict[str, Array]) -> dict[str, Array]:
    """Return sums over time, each (wave vectors,), of z_t, w, -nl and of the products in `_plane_coherences`.
    `parts` are spatial Fourier transforms (wave vectors, steps) of rise, w and nl; rise serves as z_t."""
    z_t, w, nl = (parts[name] for name in COHERENCE_NAMES)
    return {
        "z_t": z_t.sum(axis=1),
        "w": w.sum(axis=1),
        "nl": -nl.sum(axis=1),
        "z_t*w": (z_t.conj() * w).sum(axis=1),
        "z_t*nl": -(z_t.conj() * nl).sum(axis=1),
        "power": (np.abs(z_t) ** 2).sum(axis=1),
        "total": (np.abs(w - nl) ** 2).sum(axis=1),
    }


def _plane_coherences(mean: dict[str, Array]) -> Array:
    """Return the moduli (3, wave vectors) of the coherences of z_t with w, with -nl and with w - nl. nl is u
    . grad z. `mean` is a result of `_plane_sums` divided by the number of steps."""
    power = mean["power"] - np.abs(mean["z_t"]) ** 2
    total = mean["total"] - np.abs(mean["w"] + mean["nl"]) ** 2
    norm = np.sqrt(np.maximum(power * total, 1e-300))
    w, nl = (mean[f"z_t*{n}"] - mean["z_t"].conj() * mean[n] for n in ("w", "nl"))
    return np.asarray(np.abs(np.stack([w, nl, w + nl])) / norm)
