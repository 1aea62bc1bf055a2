"""The scatter of ring sums between segments: degrees of freedom that ask nothing of the waves."""

from collections.abc import Mapping
from typing import Any

import dask
import dask.array as da
import numpy as np
from numpy.typing import NDArray

from wavefield.waves.welch import LEAST_COUNT, Welch

Array = NDArray[Any]


def no_squares(name: str, shape: tuple[int, int]) -> dict[str, Array]:
    """Zeros for `take_in`, for rings and lines."""
    rings_, lines = shape
    return {
        f"{name} cells": np.zeros(shape),
        f"{name} k": np.zeros(rings_),
        f"{name} omega": np.zeros(lines),
    }


def lazy_squares(summed: Any, name: str, shape: tuple[int, int]) -> dict[str, Any]:
    """The sums of squares of a delayed dictionary, as lazy arrays."""
    return {
        key: da.from_delayed(summed[key], zeros.shape, float)
        for key, zeros in no_squares(name, shape).items()
    }


def take_in(sums: dict[str, Array], name: str, mine: Array) -> None:
    """Add one segment's ring sums, (2, rings, lines), and the squares that tell its scatter, to ``sums``."""
    sums[name] += mine
    sums[f"{name} cells"] += mine[0] ** 2
    sums[f"{name} k"] += mine[0].sum(axis=1) ** 2
    sums[f"{name} omega"] += mine[0].sum(axis=0) ** 2


def freedom(sums: Mapping[str, Any], name: str, welch: Welch, gaussian: bool) -> Any:
    """Degrees of freedom of E(k, omega), (rings, lines).

    Parameters
    ----------
    sums : mapping of str to array
        As `take_in` gives them.
    name : str
        Field.
    welch : Welch
        How they were taken.
    gaussian : bool
        Whether its lines are Gaussian: then from the spread of the energy over cells, else from the scatter
        between segments.

    Returns
    -------
    array, (rings, lines)
    """
    power = sums[name]
    if gaussian or welch.count < LEAST_COUNT:
        return _as_one(welch.freedom, power.shape[1:], power)
    return _as_one(welch.scatter, power.shape[1:], power[0], sums[f"{name} cells"]).clip(2, None)


def freedom_over(sums: Mapping[str, Any], name: str, axis: str, welch: Welch) -> Any:
    """Degrees of freedom of E(omega) or E(k), from the scatter between segments; NaN with fewer than four."""
    total = sums[name][0].sum(axis=0 if axis == "omega" else 1)
    return _as_one(welch.scatter, total.shape, total, sums[f"{name} {axis}"])


def _as_one(function: Any, shape: tuple[int, ...], *arrays: Any) -> Any:
    # small arrays: as one piece where they are lazy
    if isinstance(arrays[0], np.ndarray):
        return function(*arrays)
    return da.from_delayed(dask.delayed(function, pure=False)(*arrays), shape, float)
