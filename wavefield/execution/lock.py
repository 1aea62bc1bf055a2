"""The lock of a store: a file next to it that one run at a time can make, on local and network disks.

A run that was killed cannot remove its lock. It is taken for dead when its process is gone, seen from the
same machine, or when the lock has not been touched for a while, seen from another. To remove a dead run's
lock one needs a second lock, named after the first, so that nobody ever removes the lock of the run that
came next.
"""

import json
import os
import socket
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from wavefield.atomic_write import writing
from wavefield.errors import StoreError
from wavefield.file_access import accessing

_TOUCH = 10.0  # s between signs of life
_DEAD = 90.0  # s without one, seen from another machine


class Lock:
    """The right to write a store; made by `hold`."""

    def __init__(self, store: Path) -> None:
        self.store = store
        self.path = store.with_name(f".{store.name}.lock")
        self._owner = {"token": uuid.uuid4().hex, **_this_process()}
        self._lost = False
        self._over = threading.Event()

    @classmethod
    @contextmanager
    def hold(cls, store: Path) -> Iterator["Lock"]:
        """Hold the lock of a store, or refuse at once."""
        lock = cls(store)
        with writing(store), accessing(store, StoreError, "locking"):
            store.parent.mkdir(parents=True, exist_ok=True)
            lock._take()
        thread = threading.Thread(target=lock._live, name="wavefield-lock", daemon=True)
        thread.start()
        try:
            yield lock
        finally:
            lock._over.set()
            thread.join()
            lock._remove_own()

    def check(self) -> None:
        """Make sure that the lock is still held."""
        if self._lost:
            raise StoreError(
                f"another run took over {self.store} while this one gave no sign of life; nothing is lost"
            )

    def _take(self) -> None:
        if self._create(self.path):
            return
        held = _read(self.path)
        if held is not None and self.path.stat().st_size and "token" not in held:
            raise StoreError(
                f"{self.path} is not a lock that wavefield wrote; move it, or choose another name"
            )
        if held is not None and _is_alive(self.path, held):
            raise StoreError(
                f"another run is writing {self.store} ({_words(held)}); wait for it, or stop it. If no such "
                f"run is there, remove {self.path}"
            )
        if held is not None:
            self._remove_dead(held)
        if not self._create(self.path):
            raise StoreError(f"another run is writing {self.store}; wait for it, or stop it")

    def _create(self, path: Path) -> bool:
        try:  # exclusive on network disks too
            number = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            return False
        try:
            with os.fdopen(number, "w") as stream:
                stream.write(json.dumps(self._owner))
        except OSError:  # a full disk: a lock without an owner would block later runs
            path.unlink(missing_ok=True)
            raise
        return True

    def _remove_dead(self, held: dict[str, object]) -> None:
        right = self.path.with_name(f"{self.path.name}.{held.get('token', 'empty')}")
        if not self._create(right):
            raise StoreError(
                f"another run is taking over {self.store}; wait for it. If there is none, remove {right}"
            )
        try:
            # read again: whoever had the right before may have taken the lock since
            now = _read(self.path)
            if now is not None and now.get("token") == held.get("token"):
                self.path.unlink(missing_ok=True)
        finally:
            right.unlink(missing_ok=True)

    def _remove_own(self) -> None:
        right = self.path.with_name(f"{self.path.name}.{self._owner['token']}")
        with suppress(OSError):
            if self._create(right):  # else another run is just taking this one for dead
                if self._is_ours():
                    self.path.unlink(missing_ok=True)
                right.unlink(missing_ok=True)

    def _is_ours(self) -> bool:
        held = _read(self.path)
        return held is not None and held.get("token") == self._owner["token"]

    def _live(self) -> None:
        while not self._over.wait(_TOUCH):
            with suppress(OSError):  # a disk that is away for a moment
                if not self._is_ours():
                    self._lost = True
                    return
                os.utime(self.path)


def _this_process() -> dict[str, Any]:
    process = psutil.Process()
    return {"machine": _machine(), "host": socket.gethostname(), "pid": process.pid, "since": _since(process)}


def _since(process: psutil.Process) -> int:
    return round(float(process.create_time()))


def _machine() -> str:
    """What a process number belongs to: a host since it was started, or a container on it."""
    words = [socket.gethostname()]
    with suppress(OSError):
        words.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
        words.append(os.readlink("/proc/self/ns/pid"))
    return " ".join(words)


def _read(path: Path) -> dict[str, Any] | None:
    """Content of a lock; empty while it is being written, None if there is none."""
    try:
        data = json.loads(path.read_text() or "{}")
    except FileNotFoundError:
        return None
    except ValueError:
        return {}
    return data if isinstance(data, dict) else {}


def _is_alive(path: Path, held: dict[str, Any]) -> bool:
    if held.get("machine") == _machine():
        try:
            return abs(_since(psutil.Process(held["pid"])) - int(held["since"])) <= 1
        except psutil.NoSuchProcess:
            return False
    return _age(path) < _DEAD


def _age(path: Path) -> float:
    """Seconds since a file was touched, by the clock of its disk."""
    now = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    try:
        now.touch()
        return now.stat().st_mtime - path.stat().st_mtime
    except FileNotFoundError:  # released meanwhile
        return 0.0
    finally:
        now.unlink(missing_ok=True)


def _words(held: dict[str, object]) -> str:
    if "host" not in held:
        return "it has just begun"
    return f"process {held['pid']} of {held['host']}"
