"""Numba's compiler as the inner loops use it, in words that a type checker can read."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Loop = TypeVar("Loop", bound=Callable[..., Any])


def compiled(*signature: Any, **options: Any) -> Callable[[Loop], Loop]:
    """Compile a function of plain arrays at its first call, keep the result on disk, run it without the lock.

    Parameters
    ----------
    *signature, **options
        As those of `numba.njit`.

    Returns
    -------
    callable
        The decorator: what it decorates keeps its type.
    """
    njit: Any = numba.njit  # its own types take the options one by one
    decorate: Callable[[Loop], Loop] = njit(*signature, cache=True, nogil=True, **options)
    return decorate
