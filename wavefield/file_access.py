"""Files that may never answer: pipes are refused, and what takes long to be read or written is reported."""

import logging
import os
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from wavefield.errors import WavefieldError

log = logging.getLogger("wavefield.run")

_POLL_S = 5.0
_POLLS = 4  # that find the same access under way: a process that was suspended itself counts none meanwhile


@dataclass(eq=False)
class _Access:
    words: str  # what is done with which file
    polls: int = 0  # that found it under way


_under_way: dict[int, _Access] = {}
_lock = threading.Lock()
_watcher: threading.Thread | None = None


@contextmanager
def accessing(path: str | Path, error: type[WavefieldError], action: str = "reading") -> Iterator[None]:
    """Refuse a pipe or a device in place of a file, and log a warning when an access takes 15 to 20 s.
    A pipe without a writer, or a file system that does not answer, blocks its reader for ever.
    """
    access = _Access(f"{action} {path}")
    _under_way[id(access)] = access
    _start_watcher()
    try:
        with suppress(OSError, ValueError):  # what is not there is reported by its reader
            mode = os.stat(path).st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise error(
                    f"{path} is a pipe or a device, which may never end; put a file of the same name there"
                )
        yield
    finally:
        del _under_way[id(access)]


def _start_watcher() -> None:
    global _watcher
    if _watcher is None or not _watcher.is_alive():  # a forked process begins without
        with _lock:
            if _watcher is None or not _watcher.is_alive():
                _watcher = threading.Thread(target=_watch, name="wavefield-file-access", daemon=True)
                _watcher.start()


def _watch() -> None:
    while True:
        time.sleep(_POLL_S)
        for access in list(_under_way.values()):
            access.polls += 1
            if access.polls == _POLLS:
                log.warning(
                    "%s has taken over %.0f s, and goes on: if it does not end, check that its file system "
                    "answers (`ls`), or stop this command and go on later",
                    access.words,
                    (_POLLS - 1) * _POLL_S,
                )
