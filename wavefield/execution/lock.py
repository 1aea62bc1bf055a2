"""Lock a store, so that only one run at a time writes it.

The operating system releases the lock when its process ends, even if it is killed.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from wavefield.atomic_write import writing
from wavefield.errors import StoreError


@contextmanager
def locked(store: Path) -> Iterator[None]:
    """Context manager: lock a store by a file next to it; StoreError if another run holds the lock."""
    path = store.with_name(f".{store.name}.lock")
    lock = FileLock(path, timeout=0)
    with writing(store):
        store.parent.mkdir(parents=True, exist_ok=True)
        if path.is_symlink() or (path.exists() and (not path.is_file() or path.stat().st_size)):
            raise StoreError(f"{path} is not a lock that wavefield wrote; move it, or choose another name")
        try:
            lock.acquire()
        except Timeout:
            raise StoreError(f"another run is writing {store}; wait for it, or stop it") from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # before the release, after which another run may hold the file
        lock.release()
