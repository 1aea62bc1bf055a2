"""Refuse to open pipes and devices, which may block the program for ever."""

import os
import stat
from contextlib import suppress
from pathlib import Path

from wavefield.errors import WavefieldError


def refuse_pipe(path: str | Path, error: type[WavefieldError]) -> None:
    """Raise `error` if `path` is a pipe or a device, which may block the program that reads it for ever."""
    with suppress(OSError, ValueError):  # missing files are reported when they are read
        mode = os.stat(path).st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise error(
                f"{path} is a pipe or a device, which may never end; put a file of the same name there"
            )
