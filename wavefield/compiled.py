"""Compile inner loops with numba, and keep the compiled code on disk for later processes."""

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
from numba.core import serialize

Loop = TypeVar("Loop", bound=Callable[..., Any])

_ENDING = ".nbc"
_DIGEST_BYTES = hashlib.sha256().digest_size


def compiled(*signature: object, **options: object) -> Callable[[Loop], Loop]:
    """Decorator: compile a loop over plain arrays with numba, and keep the compiled code on disk.
    `signature` are numba's function types, or lists of them: the loop is compiled for these immediately, and
    for no others. Without a signature it is compiled when first called. `options` are arguments of
    `numba.njit`. The loop runs without the GIL (global interpreter lock)."""
    njit: Any = numba.njit  # its type hints do not accept options as a mapping

    def decorate(loop: Loop) -> Loop:
        try:
            out: Any = njit(cache=True, nogil=True, **options)(loop)
        except RuntimeError:  # no folder for the cache can be written
            out = njit(nogil=True, **options)(loop)
        cache: Any = getattr(out, "_cache", None)
        if hasattr(cache, "_cache_file"):  # absent if compilation or the cache is switched off
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
    """The files with the compiled code of one loop, one file for each combination of argument types.
    A file's name contains a hash of sources, types and processor, so that processes need no lock and no
    index. numba calls the methods `save` and `load`."""

    def __init__(self, folder: Path, base: str, loop: Callable[..., object]) -> None:
        self._folder, self._base = folder, base
        self._sources = _digest_of_sources(Path(loop.__code__.co_filename).parent)

    def save(self, key: object, data: object) -> None:
        """Write compiled code (`data`) for `key`, numba's key of argument types and processor.
        Files compiled from earlier sources are removed. If the disk cannot be written, do nothing."""
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
            if not old.name.startswith(f"{self._base}.{self._sources}"):  # compiled from earlier sources
                with suppress(OSError):
                    old.unlink()

    def load(self, key: object) -> Any:
        """Return the compiled code for `key`, numba's key of argument types and processor.
        None if there is no such file, or if it is damaged."""
        try:
            stored = self._path(key).read_bytes()
        except OSError:
            return None
        content = stored[_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() != stored[:_DIGEST_BYTES]:
            return None
        identity, data = pickle.loads(content)
        return data if identity == self._identity(key) else None

    def _identity(self, key: object) -> str:
        return f"{numba.__version__} {key!r}"

    def _path(self, key: object) -> Path:
        digest = hashlib.sha256(self._identity(key).encode()).hexdigest()[:20]
        return self._folder / f"{self._base}.{self._sources}-{digest}{_ENDING}"


@functools.cache
def _digest_of_sources(folder: Path) -> str:
    """Return one digest of all Python files in a folder that contain compiled loops.
    One digest serves all loops, because compiled code includes the loops that it calls in other files."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        source = path.read_bytes()
        if b"compiled" in source:
            digest.update(source)
    return digest.hexdigest()[:12]
