"""The learned record, and the fields to estimate with it on the lattices of a geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.matching import Prior
from wavefield.matching.map_field import Modes
from wavefield.matching.map_variance import PosteriorVariance
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.regrid import local_coefficients, spline_prefilter
from wavefield.one_thread import one_thread
from wavefield.variables import EXACT_SIX

Float = NDArray[Any]


@dataclass(frozen=True)
class LearnedRecord:
    """Beads, spectra and noise of a record, from sample frames (`learn`).

    Parameters
    ----------
    beads : tuple of (str, float)
        Width of the beads' images per camera, raw px; 0 where a camera sees a texture.
    elevation : Prior
        Of z on the rectified lattice, metres.
    displacement : tuple of (str, Prior)
        Of each velocity camera's displacement from frame to frame, px of the binned image.
    motion : tuple of (str, float)
        Largest variance over the field of each camera's matched displacement in the sample steps, px^2.
    path_frames : int
        Of the paths of velocities and of the rate of rise, the kind with the smallest error: 4, 6 or 7
        (`PATH_WEIGHTS`).
    ripples : (float, float)
        Standard deviation of the rise from frame to frame by waves that blocks do not resolve, and their
        wavelength, metres (`ripple_rise`); 0 without any.
    """

    beads: tuple[tuple[str, float], ...]
    elevation: Prior
    displacement: tuple[tuple[str, Prior], ...]
    motion: tuple[tuple[str, float], ...] = ()
    path_frames: int = EXACT_SIX
    ripples: tuple[float, float] = (0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a recipe.

        Returns
        -------
        dict
        """
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
        """Inverse of `to_dict`.

        Parameters
        ----------
        data : mapping
            As given by `to_dict`.

        Returns
        -------
        LearnedRecord

        Raises
        ------
        ExperimentError
            If it is that of another version of the measurement.
        """
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
    """Estimator of a field with a prior spectrum; modes, variance and spline are computed on first use.
    shape is that of the lattice of blocks; inner (ny, nx) are the blocks whose fit counts, by default all.
    With whole beads the blocks' scores are those of `scores_at`.
    """

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
        """Cosine modes of the field."""
        with one_thread():
            return Modes(self.prior, self._shape, self._inner)

    @cached_property
    def spread(self) -> PosteriorVariance:
        """Variance of the estimated field."""
        with one_thread():
            return PosteriorVariance(self.prior, self._shape)

    @cached_property
    def _spline(self) -> Float:
        """Gain from the field's cosines to those of its spline, (my, mx)."""
        my, mx = self.modes.shape
        return spline_prefilter(self._shape)[:my, :mx]

    def splined(self, waves: Float, rest: Float) -> Float:
        """Spline coefficients (ny, nx, c) of a field: cosines (c, my, mx) and a rest (c, ny, nx)."""
        out = np.moveaxis(self.modes.field(waves * self._spline), 0, -1) + local_coefficients(rest)
        return np.ascontiguousarray(out, np.float32)


def elevation_model(geometry: GridGeometry, prior: Prior, beads: Mapping[str, float]) -> FieldModel:
    """The elevation on the rectified lattice, metres, given the widths of the beads' images."""
    return FieldModel(prior, geometry.lattice.shape, _inner_blocks(geometry), all(beads.values()))


def displacement_model(geometry: GridGeometry, camera: str, prior: Prior) -> FieldModel:
    """The displacement of one camera, px of its binned image."""
    return FieldModel(prior, geometry.sights[camera].lattice.shape)


class Model:
    """Estimators of elevation and displacements for one geometry, from a learned record.

    Parameters
    ----------
    geometry : GridGeometry
        Its lattices.
    record : LearnedRecord
        Spectra, noise and beads from sample frames (`learn`).

    Attributes
    ----------
    record : LearnedRecord
        As given.
    elevation : FieldModel
        Of z on the rectified lattice, metres.
    displacement : dict of str to FieldModel
        Of each velocity camera, px of its binned image.

    Notes
    -----
    Pickles as its parameters; the copy is computed anew, once per process.
    """

    def __init__(self, geometry: GridGeometry, record: LearnedRecord) -> None:
        self._geometry, self.record = geometry, record
        self.elevation = elevation_model(geometry, record.elevation, dict(record.beads))
        self.displacement = {
            name: displacement_model(geometry, name, prior) for name, prior in record.displacement
        }

    def __reduce__(self) -> tuple[object, ...]:
        return _cached, (self._geometry, self.record)


def _inner_blocks(geometry: GridGeometry) -> NDArray[np.bool_]:
    """(ny, nx): blocks well inside what the reference and a partner see of the water at rest."""
    reference, *others = (geometry.views[name].visible_blocks for name in geometry.surface_cameras)
    both = np.minimum(reference, np.max(others, axis=0)) > 0.99
    return np.asarray(cv2.erode(both.view(np.uint8), np.ones((15, 15), np.uint8)) > 0)


@lru_cache(maxsize=4)
def _cached(geometry: GridGeometry, record: LearnedRecord) -> Model:
    return Model(geometry, record)


MIN_EVALUATIONS = 2  # of the images: where matching led, and where the first solution leads
MAX_EVALUATIONS = 6  # where windows have left much of short steep waves and solutions still change
# rms change of the displacement from one solution to the next, at which they have converged. With one limit
# of 0.07 px for all, z of noisy images is 4 % worse: a third evaluation follows their noise.
MAX_CHANGE_PX = 0.15
MAX_RELATIVE_CHANGE = 0.05  # of the displacement's own rms: the same where there are short waves alone
NEGLIGIBLE_CHANGE_PX = 0.05  # rms: always converged
MAX_FIELD_PX = 1e4  # wider than images: no displacement, the images show too little of one
OSCILLATION_RATIO = 0.7  # of the change before: solutions that change by more oscillate


class Convergence:
    """Change of the solution between evaluations, and when to stop; `scale` is px per unit of the field."""

    def __init__(self, scale: float = 1.0) -> None:
        self._scale, self._evaluations, self._change = scale, 0, np.inf
        self._allowed, self._diverged = MAX_CHANGE_PX, False

    @property
    def converged(self) -> bool:
        """Whether no further evaluation is needed."""
        return self._diverged or (self._evaluations >= MIN_EVALUATIONS and self._change <= self._allowed)

    def next(self, modes: Modes, waves: Float, solved: Float, seen: Float | None) -> tuple[Float, Float]:
        """Coefficients to continue with, and the field that blocks see; averaged if solutions oscillate.
        The previous ones are returned if the solution is not a plausible displacement.
        """
        after = modes.seen(solved)
        self._diverged = not self._scale * float(np.abs(after).max()) < MAX_FIELD_PX  # NaN is none either
        if self._diverged:
            return waves, modes.seen(waves)
        self._evaluations += 1
        if seen is None:
            return solved, after
        change = self._scale * float(np.sqrt(np.mean(np.square(after - seen))))
        relative = MAX_RELATIVE_CHANGE * self._scale * float(after.std())
        self._allowed = min(MAX_CHANGE_PX, max(NEGLIGIBLE_CHANGE_PX, relative))
        limit = max(OSCILLATION_RATIO * self._change, self._allowed)
        self._change = change
        if self._evaluations > MIN_EVALUATIONS and change > limit:
            half = np.float32(0.5)
            return half * (waves + solved), half * (seen + after)
        return solved, after
