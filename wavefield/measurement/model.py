"""Values learned from a record (a series of frames); estimators, gains and convergence that use them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.matching.kernels import BLOCK
from wavefield.matching.map_field import Modes
from wavefield.matching.map_variance import PosteriorVariance
from wavefield.matching.spectrum import Prior
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.regrid import interpolation_gain, local_coefficients, spline_prefilter
from wavefield.one_thread import one_thread
from wavefield.variables import EXACT_SIX

Float = NDArray[Any]


@dataclass(frozen=True)
class LearnedRecord:
    """Bead widths, spectra and noise of a record (a series of frames), learned from samples by `learn`.
    Fields with one value per camera hold pairs (name of the camera, value)."""

    beads: tuple[tuple[str, float], ...]  # widths of beads in the images of every camera, raw px; 0: texture
    elevation: Prior  # of z on the rectified lattice, metres
    displacement: tuple[tuple[str, Prior], ...]  # per frame, of every velocity camera, px of binned images
    # variance of the matched displacement of every velocity camera over the field, px^2: the largest among
    # the sample steps
    motion: tuple[tuple[str, float], ...] = ()
    # kind of the paths that give velocities with the smallest error: through 4 frames (4), through 6 smoothed
    # frames, with less noise (6), or through 6 exactly (7); see `path_weights`
    path_frames: int = EXACT_SIX
    # standard deviation of the rise per frame of waves shorter than blocks, 0 without any, and their
    # wavelength, metres (`ripple_rise`)
    ripples: tuple[float, float] = (0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return the learned values as plain data (numbers, strings, lists), to be stored with a cube."""
        return {
            "beads": dict(self.beads),
            "elevation": self.elevation.to_dict(),
            "displacement": {name: prior.to_dict() for name, prior in self.displacement},
            "motion": dict(self.motion),
            "path_frames": self.path_frames,
            "ripples": list(self.ripples),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> LearnedRecord:
        """Make a record from the data that `to_dict` returned; ExperimentError if an entry is missing."""
        try:
            rise, wavelength = map(float, data["ripples"])
            return cls(
                tuple((str(name), float(width)) for name, width in data["beads"].items()),
                Prior.from_dict(data["elevation"]),
                tuple((str(name), Prior.from_dict(p)) for name, p in data["displacement"].items()),
                tuple((str(name), float(variance)) for name, variance in data["motion"].items()),
                int(data["path_frames"]),
                (rise, wavelength),
            )
        except KeyError as missing:
            raise ExperimentError(
                f"the learned record lacks {missing}: another version of wavefield made it; leave it out to "
                "learn the record again"
            ) from None


class FieldModel:
    """Estimator of a field on a lattice of `shape` (ny, nx), with the learned spectrum `prior`.
    If `inner` (ny, nx) is given, only holes (unmatched blocks) inside it tighten the solver's tolerance. With
    `whole_beads`, each bead counts in one block only (`scores_at`). Tables are computed at first use."""

    def __init__(
        self,
        prior: Prior,
        shape: tuple[int, int],
        inner: NDArray[np.bool_] | None = None,
        whole_beads: bool = False,
    ) -> None:
        self.prior, self._shape, self._inner, self.whole_beads = prior, shape, inner, whole_beads

    @cached_property
    def modes(self) -> Modes:
        """Cosine modes of the field, with the solver for the most probable (MAP) field."""
        with one_thread():
            return Modes(self.prior, self._shape, self._inner)

    @cached_property
    def spread(self) -> PosteriorVariance:
        """Posterior variance of the field: a function of the inverse variances (ny, nx) of the blocks."""
        with one_thread():
            return PosteriorVariance(self.prior, self._shape)

    @cached_property
    def _spline(self) -> Float:
        """Factors (my, mx) from cosine coefficients of a field to cosine coefficients of its cubic spline."""
        my, mx = self.modes.shape
        return spline_prefilter(self._shape)[:my, :mx]

    def splined(self, waves: Float, rest: Float) -> Float:
        """Return the cubic-spline coefficients (ny, nx, c) of the sum of two fields with c components.
        `waves` (c, my, mx) are cosine coefficients of one field; the smooth field `rest` is (c, ny, nx)."""
        out = np.moveaxis(self.modes.field(waves * self._spline), 0, -1) + local_coefficients(rest)
        return np.ascontiguousarray(out, np.float32)


def elevation_model(geometry: GridGeometry, prior: Prior, beads: Mapping[str, float]) -> FieldModel:
    """Make the estimator of z, metres, on the blocks of the rectified images.
    `beads` are bead widths by camera; unless one is 0 (a texture), each bead counts in one block only."""
    return FieldModel(prior, geometry.lattice.shape, _inner_blocks(geometry), all(beads.values()))


def displacement_model(geometry: GridGeometry, camera: str, prior: Prior) -> FieldModel:
    """Make the estimator of a camera's displacement from frame to frame, px of its binned image."""
    return FieldModel(prior, geometry.sights[camera].lattice.shape)


class Model:
    """Estimators of elevation and displacements for one geometry, from a learned record.

    Parameters
    ----------
    geometry : GridGeometry
        Rig, grid and settings; defines the lattices.
    record : LearnedRecord
        Spectra, noise and beads from sample frames (`learn`).
    """

    def __init__(self, geometry: GridGeometry, record: LearnedRecord) -> None:
        self._geometry, self.record = geometry, record
        # estimators of z, metres, and of the displacement of every velocity camera, px of its binned image
        self.elevation = elevation_model(geometry, record.elevation, dict(record.beads))
        self.displacement = {
            name: displacement_model(geometry, name, prior) for name, prior in record.displacement
        }

    def __reduce__(self) -> tuple[object, ...]:  # a process that loads the pickle computes the rest, once
        return _cached, (self._geometry, self.record)


def _inner_blocks(geometry: GridGeometry) -> NDArray[np.bool_]:
    """Return a mask (ny, nx), True for blocks that the reference and another camera see.
    The outermost 7 blocks of this area are left out."""
    reference, *others = (geometry.views[name].visible_blocks for name in geometry.surface_cameras)
    both = np.minimum(reference, np.max(others, axis=0)) > 0.99
    return np.asarray(cv2.erode(both.view(np.uint8), np.ones((15, 15), np.uint8)) > 0)


@lru_cache(maxsize=4)
def _cached(geometry: GridGeometry, record: LearnedRecord) -> Model:
    return Model(geometry, record)


# The images are evaluated at the match, then at every solution of the MAP field, until solutions converge.
MIN_EVALUATIONS = 2
MAX_EVALUATIONS = 6  # needed by short steep waves, which the windows of matching damp
# rms change of the displacement between solutions at which they have converged. A limit of 0.07 px instead
# makes z from noisy images 4 % worse, because a third evaluation follows their noise.
MAX_CHANGE_PX = 0.15
MAX_RELATIVE_CHANGE = 0.05  # the same relative to the rms of the displacement, for seas of short waves alone
NEGLIGIBLE_CHANGE_PX = 0.05  # rms change at which solutions have converged whatever the relative change
MAX_FIELD_PX = 1e4  # larger displacements exceed any image: the images contain too little information
OSCILLATION_RATIO = 0.7  # solutions oscillate if a change exceeds this fraction of the change before


class Convergence:
    """Decide when successive solutions of a MAP field have converged; `scale` is px per unit of the field."""

    def __init__(self, scale: float = 1.0) -> None:
        self._scale, self._evaluations, self._change = scale, 0, np.inf
        self._allowed, self._diverged = MAX_CHANGE_PX, False

    @property
    def converged(self) -> bool:
        """True if the images need not be evaluated again."""
        return self._diverged or (self._evaluations >= MIN_EVALUATIONS and self._change <= self._allowed)

    def next(
        self, modes: Modes, waves: Float, solved: Float, block_mean: Float | None
    ) -> tuple[Float, Float]:
        """Return a tuple: cosine coefficients (c, my, mx) to continue with, and their field's block means.
        The coefficients are `solved`; the mean of `solved` and the previous `waves` if solutions oscillate;
        `waves` if the field exceeds any image. `block_mean` (c, ny, nx) belongs to `waves`."""
        after = modes.block_mean(solved)
        self._diverged = not self._scale * float(np.abs(after).max()) < MAX_FIELD_PX  # true for NaN as well
        if self._diverged:
            return waves, modes.block_mean(waves)
        self._evaluations += 1
        if block_mean is None:
            return solved, after
        change = self._scale * float(np.sqrt(np.mean(np.square(after - block_mean))))
        relative = MAX_RELATIVE_CHANGE * self._scale * float(after.std())
        self._allowed = min(MAX_CHANGE_PX, max(NEGLIGIBLE_CHANGE_PX, relative))
        limit = max(OSCILLATION_RATIO * self._change, self._allowed)
        self._change = change
        if self._evaluations > MIN_EVALUATIONS and change > limit:
            half = np.float32(0.5)
            return half * (waves + solved), half * (block_mean + after)
        return solved, after


# Amplitude gain of the measurement for waves, by linear theory: MAP estimate and interpolation to nodes.
PLACES = 3  # positions along x and along y over which the gain of velocities is averaged
DIRECTIONS = 8  # directions in the stored table, over half a turn
WAVENUMBERS = 200  # wavenumbers in the stored table, up to the diagonal Nyquist wavenumber of the grid


def tabulated(geometry: GridGeometry, record: LearnedRecord | None) -> dict[str, Float]:
    """Return the table of amplitude gains stored with a cube: ``gain_z``, ``gain_u``, ... (8, 200), by name.
    Its rows are for ``direction`` (8,), rad, over half a turn, its columns for ``k`` (200,), rad/m, which the
    table contains too. Gains are NaN if `record` is None; ``gain_z`` also for a light sheet."""
    k = np.linspace(0, np.sqrt(2) * np.pi / geometry.grid.step, WAVENUMBERS)
    direction = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    unknown = np.full((DIRECTIONS, WAVENUMBERS), np.nan)
    found = dict.fromkeys("zuvw", unknown)
    if record is not None:
        found = gains(geometry, record, k * np.cos(direction[:, None]), k * np.sin(direction[:, None]))
        if geometry.z_is_known:
            found["z"] = unknown
    return {"direction": direction, "k": k} | {f"gain_{name}": values for name, values in found.items()}


def gains(geometry: GridGeometry, record: LearnedRecord, kx: Float, ky: Float) -> dict[str, Float]:
    """Return the amplitude gain (measured over true) of z, u, v, w, by name, for wavenumbers kx, ky, rad/m.

    The most probable (MAP) field has the gain S / (S + N), with the learned spectrum S and noise N of the
    blocks. For velocities, each camera's displacement has this gain in its own pixels, and least squares over
    the cameras gives the gain of u, v, w. This is averaged over the grid, because pixels of an oblique camera
    are much longer on the far water. The gain of interpolation in time (`path_gain`) is not included.
    """
    step = BLOCK * geometry.pixel
    z = _gain_between_blocks(record.elevation, kx * step, ky * step)[0]
    x, y = (np.linspace(*side, 2 * PLACES + 1)[1::2] for side in (geometry.grid.x, geometry.grid.y))
    velocity = np.mean([_gain_of_velocity(at, geometry, record, kx, ky) for at in product(x, y)], axis=0)
    return {"z": z} | {name: velocity[..., i, i] for i, name in enumerate("uvw")}


def shortest_carried(geometry: GridGeometry, record: LearnedRecord) -> dict[str, float]:
    """Return the wavelength, m, at which the direction-averaged gain is 1/2, for each of z, u, v, w.
    It is two grid steps if the gain exceeds 1/2 at all wavenumbers of the grid."""
    k = np.linspace(0.0, np.pi / geometry.grid.step, 600)
    angle = np.arange(8)[:, None] * np.pi / 8
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    out = {}
    for name, gain in gains(geometry, record, kx, ky).items():
        below = np.flatnonzero(gain.mean(axis=0) < 0.5)
        out[name] = float(2 * np.pi / k[max(below[0], 1)]) if below.size else 2.0 * geometry.grid.step
    return out


def _gain_of_velocity(
    place: tuple[float, float], geometry: GridGeometry, record: LearnedRecord, kx: Float, ky: Float
) -> Float:
    """Return matrices (..., 3, 3) that turn true into measured (dx, dy, dz), at `place` (x, y), metres.
    kx, ky (...) are wavenumbers, rad/m."""
    jacobians: list[Any] = [
        geometry.sights[name].camera.jacobian(*place, 0.0) for name, _ in record.displacement
    ]
    inverse = np.linalg.pinv(np.concatenate(jacobians))
    out = np.zeros((*np.broadcast_shapes(np.shape(kx), np.shape(ky)), 3, 3))
    for i, ((_, prior), jacobian) in enumerate(zip(record.displacement, jacobians)):
        q = np.stack([kx, ky], axis=-1) @ (BLOCK * np.linalg.inv(jacobian[:, :2]))
        gain = _gain_between_blocks(prior, q[..., 0], q[..., 1])
        for n in range(2):
            out += gain[min(n, len(gain) - 1), ..., None, None] * np.outer(inverse[:, 2 * i + n], jacobian[n])
    return out


def _gain_between_blocks(prior: Prior, qx: Float, qy: Float) -> Float:
    """Return the gain (measured over true) of a MAP field interpolated between blocks, (components, ...).
    qx, qy (...) are wavenumbers, rad per block."""
    gain: Float = prior.gain(qx, qy)
    return gain * interpolation_gain(qx) * interpolation_gain(qy)
