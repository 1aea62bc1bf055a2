"""Compare the cameras in one step: the results of different pairs of cameras should agree."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.displacement import flows
from wavefield.measurement.elevation import PairMatch, match_pair, surface, windowed
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import Images, images_of
from wavefield.measurement.model import Model, shortest_carried
from wavefield.measurement.paths import EVEN_TIMES
from wavefield.measurement.record import learn
from wavefield.measurement.velocity import velocity
from wavefield.one_thread import one_thread
from wavefield.variables import Quality

Pair = tuple[str, str]
Frames = Mapping[str, Sequence[NDArray[Any] | None]]

MAX_TRIED_STEPS = 12  # steps that are tried, nearest first, if frames are missing or bad


@dataclass(frozen=True)
class Diagnosis:
    """Errors, elevations and displacements of each pair of cameras in one step; NaN where not measured."""

    # (ny, nx): elevation at the first frame from each pair alone, metres; pairs are those of the geometry,
    # which contain the reference, and the direct pairs of the other cameras
    z: dict[Pair, NDArray[Any]]
    eps_y: dict[Pair, NDArray[Any]]  # (n,): epipolar error of all matched blocks, with rejected ones, metres
    # rms of eps_y over |dD|, metres: the standard uncertainty of z if the matching error is isotropic
    z_std: dict[Pair, float]
    # (ny, nx): for a direct pair (1, 2) and the reference 3, elevation from the difference (x_1 - x_3) -
    # (x_2 - x_3) of two displacements, minus that from direct matching, metres
    recombined: dict[Pair, NDArray[Any]]
    moved: dict[Pair, NDArray[Any]]  # (3, ny, nx): displacement dx, dy, dz by each pair alone, metres
    # (ny, nx): misfit of the displacements in the images, px of the binned images: of each pair alone, and of
    # all cameras that measure the velocity
    eps_piv: dict[tuple[str, ...], NDArray[Any]]
    carried: dict[str, float]  # wavelength at which the gain of z, u, v, w is one half, metres
    noise: dict[str, float]  # median standard uncertainty of z and of dx, dy, dz per step, metres
    widths: dict[str, float]  # width of the beads in the images of every camera, px; 0 for a texture

    def errors(self) -> Iterator[tuple[str, str, str, NDArray[Any]]]:
        """Yield each error between cameras as a tuple (quantity, cameras, unit, values).
        An example is ("eps_y", "cam1-cam2", "m", array). The array is NaN where not measured."""
        for pair, values in self.eps_y.items():
            yield "eps_y", "-".join(pair), "m", values
            yield "sigma_z", "-".join(pair), "m", np.array([self.z_std[pair]])
        for one, other in combinations(self.z, 2):
            yield "z", f"{'-'.join(one)} minus {'-'.join(other)}", "m", self.z[one] - self.z[other]
        for pair, values in self.recombined.items():
            yield "z_recombined", "-".join(pair), "m", values
        for cameras, values in self.eps_piv.items():
            yield "eps_piv", "-".join(cameras), "pixel", values
        for one, other in combinations(self.moved, 2):
            for name, values in zip(("dx", "dy", "dz"), self.moved[one] - self.moved[other]):
                yield name, f"{'-'.join(one)} minus {'-'.join(other)}", "m", values


def rms_within(values: NDArray[Any]) -> tuple[float, float]:
    """Return a tuple: the rms of the values that are not outliers, and the fraction that are outliers.
    Outliers exceed three times the rms of all values. NaN and infinite values are ignored."""
    values = values[np.isfinite(values)]
    if values.size == 0:
        return float("nan"), 0.0
    large = np.abs(values) > 3.0 * np.sqrt(np.mean(np.square(values)))
    return float(np.sqrt(np.mean(np.square(values[~large])))), float(large.mean())


@one_thread()
def diagnose(
    frames: Frames,
    geometry: GridGeometry,
    model: Model | None = None,
    masks: Frames | None = None,
) -> Diagnosis:
    """Compare the elevations and displacements that different pairs of cameras measure in one step.

    `frames` holds the first and second frame of each camera; `masks`, True on pixels to ignore, has the same
    form. A `model` of None is learned from these frames. ValueError if a frame is missing or unusable, if
    nothing can be matched, or for a light sheet.
    """
    if geometry.z_is_known:
        raise ValueError("cameras of a light sheet are not matched with each other: no pairs to compare")
    geometry, model, first, second = _learned(frames, geometry, model, masks or {})
    record = model.record
    flat = first.rectified()
    surfaces = [surface(one, geometry, model.elevation) for one in (flat, second.rectified())]
    if surfaces[0] is None or surfaces[1] is None:
        raise ValueError("the frames cannot be matched: nothing to compare with")
    # each pair of the geometry (reference and another camera), and each two of the other cameras
    pairs = [*geometry.pairs, *combinations([b for _, b in geometry.pairs], 2)]
    matches = {(a, b): match_pair(flat[a], flat[b], (a, b), geometry) for a, b in pairs}
    eps_y = {pair: match.eps_y[match.matched] for pair, match in matches.items()}
    lengths = {pair: np.hypot(*match.parallax)[match.matched] for pair, match in matches.items()}
    z_std = {pair: rms_within(eps_y[pair] / lengths[pair])[0] for pair in matches}
    z = {pair: windowed([match], geometry) for pair, match in matches.items()}
    recombined = {}
    for a, b in (pair for pair in matches if pair not in geometry.pairs):
        both = _difference_of(matches[geometry.reference, b], matches[geometry.reference, a])
        recombined[a, b] = windowed([both], geometry) - z[a, b]
    moved, eps_piv, d_std = _moved(
        (first, second), 0.5 * (surfaces[0].z + surfaces[1].z), matches, geometry, model
    )
    z_variance = surfaces[0].noise + surfaces[0].missing + surfaces[0].epipolar ** 2
    noise = {"z": float(np.sqrt(np.median(z_variance)))} | dict(zip(("dx", "dy", "dz"), d_std))
    return Diagnosis(
        z,
        eps_y,
        z_std,
        recombined,
        moved,
        eps_piv,
        shortest_carried(geometry, record),
        noise,
        dict(record.beads),
    )


def _learned(
    frames: Frames, geometry: GridGeometry, model: Model | None, masks: Frames
) -> tuple[GridGeometry, Model, Images, Images]:
    """Return a tuple: geometry, model, prepared images of the first frames, and of the second frames.
    If `model` is None, it is learned from these frames. ValueError if that fails or a frame is not usable."""
    instants = [{n: frames[n][k] for n in frames} for k in (0, 1)]
    covered = [{n: masks[n][k] for n in masks} for k in (0, 1)]
    if model is None:
        settings = replace(geometry.settings, velocity_cameras=geometry.cameras)
        geometry = GridGeometry(geometry.rig, geometry.grid, settings)
        record = learn([(instants[0], instants[1])], geometry, [(covered[0], covered[1])])
        if record is None:
            raise ValueError("the frames cannot be matched: nothing to compare with")
        model = Model(geometry, record)
    beads = dict(model.record.beads)
    first, second = (images_of(frame, geometry, beads, hidden) for frame, hidden in zip(instants, covered))
    for view in (first, second):
        if view.missing:
            raise ValueError(f"camera {sorted(view.missing)[0]} has no usable frame: nothing to compare with")
    return geometry, model, first, second


def _difference_of(one: PairMatch, other: PairMatch) -> PairMatch:
    """Return the match from camera a to camera b, from the matches c to b (`one`) and c to a (`other`).
    Displacements and parallaxes of `other` are subtracted from those of `one`."""
    d, parallax = one.difference - other.difference, one.parallax - other.parallax
    eps_y = (parallax[1] * d[0] - parallax[0] * d[1]) / np.hypot(*parallax)
    rejected, matched = one.rejected | other.rejected, one.matched & other.matched
    return PairMatch(one.pair, d, parallax, eps_y, rejected, matched, one.found)  # on the lattice of `one`


def _moved(
    views: tuple[Images, Images],
    middle: NDArray[Any],
    pairs: Collection[Any],
    geometry: GridGeometry,
    model: Model,
) -> tuple[dict[Pair, NDArray[Any]], dict[tuple[str, ...], NDArray[Any]], list[float]]:
    """Return a tuple: displacements by pair, misfits by group of cameras, and three standard uncertainties.
    The first two are `moved` (m) and `eps_piv` (px) of `Diagnosis`; the last is a list, the medians for dx,
    dy, dz, m. `views` are the images of the first and second frames; `middle` (ny, nx) is the mean elevation
    of these frames, metres."""
    moved: dict[Pair, NDArray[Any]] = {}
    eps_piv: dict[tuple[str, ...], NDArray[Any]] = {}
    moves = flows(views[0].in_time(), views[1].in_time(), geometry.settings.piv, model)
    d_std = [float("nan")] * 3
    for cameras in dict.fromkeys((*pairs, geometry.velocity_cameras)):
        if not set(cameras) <= set(moves):
            continue  # this camera does not measure velocity
        flows_of = {name: moves[name] for name in cameras}
        step = velocity((None, flows_of, None), middle, geometry, model.record.path_frames, EVEN_TIMES)
        assert step is not None  # every camera has both frames
        measured = (step.quality & Quality.FILLED) == 0
        eps_piv[cameras] = np.where(measured, step.eps_piv, np.nan)
        if cameras in pairs:
            moved[cameras[0], cameras[1]] = np.where(measured, step.d, np.nan)
        if cameras == geometry.velocity_cameras and measured.any():
            variance = step.noise * step.noise_factor + step.missing
            d_std = [float(np.sqrt(np.nanmedian(one[measured]))) for one in variance]
    return moved, eps_piv, d_std


def diagnose_around(
    read: Callable[[str, int], NDArray[Any] | None],
    steps: int,
    geometry: GridGeometry,
    model: Model | None,
    middle: int,
) -> Diagnosis | None:
    """Run `diagnose` in the step nearest to step number `middle` in which it succeeds, of `steps` steps.
    `read(camera, frame)` gives an image or None. Returns None if the MAX_TRIED_STEPS nearest steps fail."""
    for step in sorted(range(steps), key=lambda step: abs(step - middle))[:MAX_TRIED_STEPS]:
        frames = {name: [read(name, step + k) for k in (0, 1)] for name in geometry.cameras}
        try:
            return diagnose(frames, geometry, model)
        except ValueError:  # a frame is missing or bad
            continue
    return None
