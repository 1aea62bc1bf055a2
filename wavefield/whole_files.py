"""Writing a file or a folder whole or not at all."""

import errno
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from wavefield.errors import StoreError


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Write a file or a folder under another name, and let it take its place when it is finished.

    Parameters
    ----------
    path : path
        What is to be there in the end; its folder is made.

    Yields
    ------
    Path
        Name beside it to write to. When the block ends well it replaces `path`; otherwise it is removed, and
        what was there before stays.

    Raises
    ------
    StoreError
        If it cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "a.txt"
    >>> with whole(path) as draft:
    ...     written = draft.write_text("all of it")
    >>> path.read_text()
    'all of it'
    """
    path = Path(path)
    mark = f"{uuid.uuid4().hex[:8]}.partial"
    draft, old = path.with_name(f".{path.name}.{mark}"), path.with_name(f".{path.name}.old.{mark}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield draft
        if path.is_dir() and not path.is_symlink():  # a folder is not replaced in one go
            path.rename(old)
        draft.replace(path)
    except OSError as error:
        if old.exists() and not path.exists():
            old.rename(path)
        raise write_error(path, error) from None
    finally:
        for left in (draft, old):
            _remove(left)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file (UTF-8), whole or not at all.

    Parameters
    ----------
    path : path
        The file; its folder is made.
    text : str
        All of it.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    with whole(path) as draft:
        draft.write_text(text, encoding="utf-8")


def check_writable(path: str | Path) -> None:
    """Make sure that a file can be written, before the work that ends in it.

    Parameters
    ----------
    path : path
        The file; its folder is made.

    Raises
    ------
    StoreError
        If it cannot.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise StoreError(f"{path} is a folder; name a file to write")
        draft = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.partial")
        draft.touch()
        draft.unlink()
    except OSError as error:
        raise write_error(path, error) from None


def remove_leftovers(path: Path) -> None:
    """Remove what killed writers of a file or folder left beside it and in it.

    Parameters
    ----------
    path : path
        As it was given to `whole`.
    """
    for folder, _, names in os.walk(path):
        for name in names:
            if name.endswith(".partial"):
                (Path(folder) / name).unlink(missing_ok=True)
    for left in path.parent.glob(f".{path.name}.*.partial"):
        _remove(left)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def write_error(path: Path, error: OSError) -> StoreError:
    """Turn a failed write into a sentence.

    Parameters
    ----------
    path : path
        What was to be written.
    error : OSError
        What went wrong.

    Returns
    -------
    StoreError
    """
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StoreError(
            f"the disk that holds {path} is full; nothing that was written is lost: free some room "
            "and run the same command again to go on"
        )
    return StoreError(f"{path} cannot be written: {error.strerror or error}; check its disk and permissions")
