"""Numba's compiler as the inner loops use it, in words that a type checker can read."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import numba

Loop = TypeVar("Loop", bound=Callable[..., Any])


def compiled(*signature: Any, **options: Any) -> Callable[[Loop], Loop]:
    """Compile a function of plain arrays at its first call, keep the result on disk, run it without the lock.

    Where the disk has no room, or no folder can be written, it is compiled in every process.
    """
    njit: Any = numba.njit  # its own types take the options one by one

    def decorate(loop: Loop) -> Loop:
        try:
            out: Any = njit(cache=True, nogil=True, **options)(loop)
        except RuntimeError:  # no folder to keep it in: neither beside the sources nor at home
            out = njit(nogil=True, **options)(loop)
        _live_with_full_disks(getattr(out, "_cache", None))
        for one in signature:
            for types in one if isinstance(one, list) else [one]:
                out.compile(types)
        if signature and hasattr(out, "disable_compile"):
            out.disable_compile()
        loop = out
        return loop

    return decorate


def _live_with_full_disks(cache: Any) -> None:
    """What cannot be kept is compiled again by the next process: a full home folder is no reason to stop."""
    if cache is None:  # compiling is switched off
        return
    save = cache.save_overload

    def save_if_there_is_room(*what: Any) -> None:
        with suppress(OSError):
            save(*what)

    cache.save_overload = save_if_there_is_room
