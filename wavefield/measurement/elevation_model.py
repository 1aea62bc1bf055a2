"""A field that is sought by its spectrum: cosines, variance and spline, laid out when first asked for."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Modes, PosteriorVariance, Prior, Slopes
from wavefield.matching.one_thread import one_thread
from wavefield.measurement.regrid import thin_plate


class FieldModel:
    """A field that is sought by its spectrum; laid out when it is first asked for.

    With shape (int, int); wanted (ny, nx).
    """

    def __init__(
        self,
        prior: Prior,
        shape: tuple[int, int],
        smoothing: float,
        requested: NDArray[np.bool_] | None = None,
    ) -> None:
        self.prior, self._shape, self._smoothing, self._requested = prior, shape, smoothing, requested

    @cached_property
    def modes(self) -> Modes:
        """Cosines of the field."""
        with one_thread():
            return Modes(self.prior, self._shape, self._requested)

    @cached_property
    def spread(self) -> PosteriorVariance:
        """Variance of the field."""
        with one_thread():
            return PosteriorVariance(self.prior, self._shape)

    @cached_property
    def spline(self) -> NDArray[Any]:
        """From the field's cosines to those of its spline, (my, mx)."""
        my, mx = self.modes.shape
        return thin_plate(self._shape, self._smoothing)[:my, :mx]

    @cached_property
    def _beyond(self) -> tuple[NDArray[Any], NDArray[Any]]:
        gain = thin_plate(self._shape, self._smoothing)
        return self.modes.edge.truncated_profiles(self.modes.shape, (gain[:, 0], gain[0]))

    def splined(self, waves: NDArray[Any], slopes: Slopes) -> NDArray[Any]:
        """Spline coefficients of the field.

        With waves (c, my, mx); returns (ny, nx, c).
        """
        out = self.modes.field(waves * self.spline) + self.modes.edge.field(slopes, self._beyond)
        return np.ascontiguousarray(np.moveaxis(out, 0, -1), np.float32)
