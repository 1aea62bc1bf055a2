"""Numba's compiler as the inner loops use it, in words that a type checker can read."""

import functools
import hashlib
import os
import pickle
import uuid
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import caching, serialize

Loop = TypeVar("Loop", bound=Callable[..., Any])

_ENDING = ".nbc"
_DIGEST_BYTES = hashlib.sha256().digest_size


def compiled(*signature: object, **options: object) -> Callable[[Loop], Loop]:
    """Compile a function of plain arrays at its first call, keep the result on disk, run it without the lock.
    Every process compiles it where it cannot be kept; any number of them may do so at once.
    """
    njit: Any = numba.njit  # its own types take the options one by one

    def decorate(loop: Loop) -> Loop:
        try:
            out: Any = njit(cache=True, nogil=True, **options)(loop)
        except RuntimeError:  # no folder to keep it in: neither beside the sources nor at home
            out = njit(nogil=True, **options)(loop)
        cache: Any = getattr(out, "_cache", None)
        if hasattr(cache, "_cache_file"):  # compiling may be switched off, or nothing be kept
            cache._cache_file = _CompiledFiles(Path(cache.cache_path), cache._impl.filename_base, loop)
        for one in signature:
            for types in one if isinstance(one, list) else [one]:
                out.compile(types)
        if signature and hasattr(out, "disable_compile"):
            out.disable_compile()
        loop = out
        return loop

    return decorate


class _CompiledFiles:
    """Keeps each compiled form of a loop in a file of its own, in place of numba's numbered files and index.
    Its name follows from sources, types and processor: processes need no lock. Damaged files are not used.
    """

    def __init__(self, folder: Path, base: str, loop: Callable[..., object]) -> None:
        self._folder, self._base = folder, base
        self._sources = _digest_of_sources(Path(loop.__code__.co_filename).parent)

    def save(self, key: object, data: object) -> None:
        """Keep compiled code; where there is no room for it, the next process compiles again."""
        content = serialize.dumps((self._identity(key), data))
        path = self._path(key)
        new = path.with_name(f"{path.name}.tmp.{uuid.uuid4().hex[:16]}")
        try:
            new.write_bytes(hashlib.sha256(content).digest() + content)
            os.replace(new, path)
        except OSError:
            with suppress(OSError):
                new.unlink()
        for old in self._folder.glob(f"{self._base}.*"):
            if not old.name.startswith(f"{self._base}.{self._sources}"):  # of sources that have changed since
                with suppress(OSError):
                    old.unlink()

    def load(self, key: object) -> Any:
        """Read compiled code; None where there is none that can be used."""
        try:
            stored = self._path(key).read_bytes()
        except OSError:
            return None
        content = stored[_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() != stored[:_DIGEST_BYTES]:
            return None
        identity, data = pickle.loads(content)
        return data if identity == self._identity(key) else None

    def flush(self) -> None:
        """Remove what is kept of this loop."""
        for path in self._folder.glob(f"{self._base}.*"):
            path.unlink(missing_ok=True)

    def _identity(self, key: object) -> str:
        return f"{numba.__version__} {key!r}"

    def _path(self, key: object) -> Path:
        digest = hashlib.sha256(self._identity(key).encode()).hexdigest()[:20]
        return self._folder / f"{self._base}.{self._sources}-{digest}{_ENDING}"


@functools.cache
def _digest_of_sources(folder: Path) -> str:
    """Of all sources with loops in a folder: the compiled form of one contains those that it calls."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        source = path.read_bytes()
        if b"compiled" in source:
            digest.update(source)
    return digest.hexdigest()[:12]


def clear_compiled() -> int:
    """Remove the compiled code that processes of this program have kept on this machine."""
    locators: list[Any] = [caching.InTreeCacheLocator, caching.UserWideCacheLocator]
    config: Any = numba.config
    if config.CACHE_DIR:
        locators.append(caching.UserProvidedCacheLocator)
    removed = 0
    for source in Path(__file__).parent.rglob("__init__.py"):
        for locator in locators:
            for path in Path(locator(clear_compiled, str(source)).get_cache_path()).glob("*.nb[ci]"):
                with suppress(OSError):
                    path.unlink()
                    removed += 1
    return removed
