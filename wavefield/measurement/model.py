"""What was learned of a record, laid out on the lattices of a geometry: the fields that are estimated."""

from __future__ import annotations

from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Modes, PosteriorVariance, Prior
from wavefield.matching.one_thread import one_thread
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.regrid import local_coefficients, thin_plate

Float = NDArray[np.floating]


class FieldModel:
    """A field that is estimated with a prior spectrum: cosines, variance and spline, computed on first use.
    shape is that of its lattice of blocks; inner (ny, nx) are the blocks whose fit counts, all by default.
    """

    def __init__(
        self,
        prior: Prior,
        shape: tuple[int, int],
        smoothing: float = 0.0,
        inner: NDArray[np.bool_] | None = None,
    ) -> None:
        self.prior, self._shape, self._smoothing, self._inner = prior, shape, smoothing, inner

    @cached_property
    def modes(self) -> Modes:
        """Cosines of the field."""
        with one_thread():
            return Modes(self.prior, self._shape, self._inner)

    @cached_property
    def spread(self) -> PosteriorVariance:
        """Variance of the field."""
        with one_thread():
            return PosteriorVariance(self.prior, self._shape)

    @cached_property
    def _spline(self) -> Float:
        """Gain from the field's cosines to those of its spline, (my, mx)."""
        my, mx = self.modes.shape
        return thin_plate(self._shape, self._smoothing)[:my, :mx]

    def splined(self, waves: Float, rest: Float) -> Float:
        """Spline coefficients (ny, nx, c) of a field: cosines (c, my, mx) and a rest (c, ny, nx)."""
        out = np.moveaxis(self.modes.field(waves * self._spline), 0, -1) + local_coefficients(rest)
        return np.ascontiguousarray(out, np.float32)


class Model:
    """Elevation and displacements as a record's spectra, noise and transfer describe them.

    Parameters
    ----------
    geometry : GridGeometry
        Its lattices.
    record : LearnedRecord
        What sample frames gave (`learn`).
    previous : Model, optional
        Of the same geometry: fields of the same spectrum are taken over from it.

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

    def __init__(self, geometry: GridGeometry, record: LearnedRecord, previous: Model | None = None) -> None:
        self._geometry, self.record = geometry, record
        if previous is not None and previous.record.elevation == record.elevation:
            self.elevation: FieldModel = previous.elevation
        else:
            shape, smoothing = geometry.lattice.shape, geometry.settings.smoothing
            self.elevation = FieldModel(record.elevation, shape, smoothing, _inner_blocks(geometry))
        self.displacement: dict[str, FieldModel] = {}
        for name, prior in record.displacement:
            before = None if previous is None else previous.displacement.get(name)
            if before is None or before.prior != prior:
                before = FieldModel(prior, geometry.sights[name].lattice.shape)
            self.displacement[name] = before

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
