"""A field that is sought by its spectrum: cosines, variance and spline, laid out when first asked for."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Modes, Prior, Spread
from wavefield.matching.one_thread import one_thread
from wavefield.measurement.regrid import thin_plate


class Sought:
    """A field that is sought by its spectrum; laid out when it is first asked for.

    Parameters
    ----------
    prior : Prior
        Its spectrum.
    shape : (int, int)
        Of the lattice, (ny, nx).
    smoothing : float
        Of its spline.
    wanted : ndarray of bool, (ny, nx), optional
        Blocks whose field is wanted; all if left out.
    """

    def __init__(
        self,
        prior: Prior,
        shape: tuple[int, int],
        smoothing: float,
        wanted: NDArray[np.bool_] | None = None,
    ) -> None:
        self.prior, self._shape, self._smoothing, self._wanted = prior, shape, smoothing, wanted

    @cached_property
    def modes(self) -> Modes:
        """Cosines of the field."""
        with one_thread():
            return Modes(self.prior, self._shape, self._wanted)

    @cached_property
    def spread(self) -> Spread:
        """Variance of the field."""
        with one_thread():
            return Spread(self.prior, self._shape)

    @cached_property
    def spline(self) -> NDArray[Any]:
        """From the field's cosines to those of its spline, (my, mx)."""
        my, mx = self.modes.shape
        return thin_plate(self._shape, self._smoothing)[:my, :mx]
