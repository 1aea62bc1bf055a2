"""Files that a run writes next to the store: its lock, its log, and the folder for output of Slurm jobs."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from wavefield.atomic_write import check_replaceable, writing
from wavefield.errors import StoreError

log = logging.getLogger("wavefield.run")


def _is_log(path: Path) -> bool:
    """Return whether a file is empty or begins like a log of wavefield, with date, time and log level."""
    with path.open("rb") as stream:
        line = stream.readline(200)
    return not line or re.match(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} [A-Z]+ ", line) is not None


def log_path(store: Path) -> Path:
    """Return the path of the log file of the runs that write a store: cube.log for cube.zarr."""
    return store.with_suffix(".log")


def jobs_folder(store: Path) -> Path:
    """Return the absolute path of the folder for the output of Slurm jobs: cube.jobs for cube.zarr."""
    return store.absolute().with_suffix(".jobs")


@contextmanager
def log_file(store: Path) -> Iterator[None]:
    """Context manager: append the messages of a run to the log file next to the store that it writes."""
    with writing(store):
        store.parent.mkdir(parents=True, exist_ok=True)
        path = log_path(store)
        check_replaceable(path, replace=path.is_file() and _is_log(path))  # the log is appended to
        handler = logging.FileHandler(log_path(store), delay=False)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    handler.handleError = lambda record: None  # type: ignore[method-assign]  # a full disk must not hide the cause
    level = log.level
    log.setLevel(logging.INFO)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        with suppress(OSError):
            handler.close()


@contextmanager
def locked(store: Path) -> Iterator[None]:
    """Context manager: lock a store by a file next to it; StoreError if another run holds the lock.
    The operating system releases the lock when the process that holds it ends, even if it is killed."""
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
