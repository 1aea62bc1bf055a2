"""Writing a file or a folder completely or not at all, and never in place of what others wrote."""

import errno
import json
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from wavefield.errors import StoreError

_HEAD_BYTES = 4096  # of a file in which its mark must be
CHECKSUMS = "checksums.json"  # in a store: what its files must be


@dataclass(frozen=True)
class OwnFile:
    """A kind of file or folder that this program writes."""

    name: str  # With its article, such as "a wave store"
    # Whether an existing file or folder is one that this program wrote, by its contents
    recognize: Callable[[Path], bool]
    folder: bool = False  # Whether it is a folder


def marked(*marks: bytes, start: bytes = b"") -> Callable[[Path], bool]:
    """Recognize a file by how it starts and by marks near its start, all of which it must have."""

    def recognize(path: Path) -> bool:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        return head.startswith(start) and all(mark in head for mark in marks)

    return recognize


def zarr_store(title: str, *names: str) -> Callable[[Path], bool]:
    """Recognize a Zarr store by its attributes; it must hold nothing but files of a Zarr store."""

    def recognize(path: Path) -> bool:
        attributes = json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]
        ours = str(attributes.get("title", "")).startswith(title) and all(n in attributes for n in names)
        return ours and all(_ZARR_FILE.fullmatch(name) for name in file_names(path))

    return recognize


_ZARR_FILE = re.compile(rf"(.*/)?(zarr\.json|c(/\d+)*|{re.escape(CHECKSUMS)})(\.[0-9a-f]{{32}}\.partial)?")


def files_named(pattern: str, recognize: Callable[[Path], bool]) -> Callable[[Path], bool]:
    """Recognize a folder by all of its files: their names and their contents."""
    return lambda folder: all(
        re.fullmatch(pattern, name) and recognize(folder / name) for name in file_names(folder)
    )


# written where a caller names it, or read and saved again: replaced whatever it holds
ANY_FILE = OwnFile("a file", lambda path: True)
NEW_FILE = OwnFile("a file to be replaced", lambda path: False)
_PAGE = marked(b'<meta name="generator" content="wavefield', start=b"<!doctype html>")
_PAGE_BEFORE = marked(b":root { --ink: #1b1f24; --soft: #4d5661;", start=b"<!doctype html>")
PAGE = OwnFile("a page", lambda path: _PAGE(path) or _PAGE_BEFORE(path))
RIG = OwnFile(
    "a rig file",
    lambda path: marked(b"\ncameras:", start=b"units: {")(path) and b"\nprovenance:" in path.read_bytes(),
)


def file_names(folder: Path) -> list[str]:
    """Names of all files in a folder and below it, relative to it, in order; links count as files."""
    out = []
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(place, name))]
        out += [Path(place, name).relative_to(folder).as_posix() for name in (*files, *links)]
    return sorted(out)


def check_replaceable(path: Path, product: OwnFile) -> None:
    """Refuse to replace what is not a product of the same kind."""
    if path.is_symlink():
        raise StoreError(
            f"{path} is a link, which is not replaced; name what it points to, or remove the link"
        )
    if not path.exists():
        return
    if path.is_dir() != product.folder:
        there = "folder" if path.is_dir() else "file"
        raise StoreError(f"{path} is a {there}, which {product.name} does not replace; choose another name")
    try:
        if product.folder and not any(path.iterdir()):
            return
        ours = product.recognize(path)
    except PermissionError as error:
        raise write_error(path, error) from None
    except Exception:  # whatever a library makes of foreign or damaged bytes
        ours = False
    if not ours:
        more = ", or holds other files too" if product.folder else ""
        raise StoreError(
            f"{path} exists and is not {product.name} that wavefield wrote (or it is damaged{more}); it is "
            "left as it is: choose another name, or remove it first"
        )


def refuse_input(path: Path, *inputs: object) -> None:
    """Refuse to write over a file that the same command reads."""
    for one in inputs:
        if isinstance(one, str | Path) and Path(one).exists() and path.exists() and path.samefile(one):
            raise StoreError(f"{path} is read by this command and not overwritten; name another file with -o")


@contextmanager
def atomic(path: str | Path, product: OwnFile) -> Iterator[Path]:
    """Write a file or a folder under another name, and let it take its place when it is finished.
    A folder that it replaces is ``.NAME.xxxxxxxx.old`` until then; the next `atomic` restores one left so.
    """
    path = Path(path)
    mark = uuid.uuid4().hex[:8]
    draft, old = path.with_name(f".{path.name}.{mark}.partial"), path.with_name(f".{path.name}.{mark}.old")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        restore_old(path)
        check_replaceable(path, product)
        yield draft
        if draft.is_file():
            make_durable([draft])
        check_replaceable(path, product)  # it may have appeared meanwhile
        if path.is_dir():
            path.rename(old)
        elif path.exists() and draft.is_file():
            shutil.copymode(path, draft)
        draft.replace(path)
        make_durable([path.parent])
    except OSError as error:
        raise write_error(path, error) from None
    finally:
        with suppress(OSError):
            restore_old(path)
        _remove(draft)


def restore_old(path: Path) -> None:
    """Give an old folder its name back if the new one did not come; remove it if it did."""
    for left in _left_beside(path, "old"):
        if not path.exists() and not path.is_symlink():
            left.rename(path)
        else:
            _remove(left)


def make_durable(paths: Iterable[Path]) -> None:
    """Have files and folders written to the disk before going on; those that do not exist are passed over."""
    for path in paths:
        try:
            number = os.open(path, os.O_RDONLY)
        except (FileNotFoundError, NotADirectoryError, PermissionError):  # Windows opens no folders
            continue
        try:
            os.fsync(number)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):  # disks without such a call
                raise
        finally:
            os.close(number)


def write_text(path: str | Path, text: str, product: OwnFile) -> None:
    """Write a text file (UTF-8), completely or not at all."""
    with atomic(path, product) as draft:
        draft.write_text(text, encoding="utf-8")


def check_writable(path: str | Path, product: OwnFile) -> None:
    """Make sure that a file or a folder can be written, before the work that ends in it."""
    path = Path(path)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        restore_old(path)
        check_replaceable(path, product)
        draft = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.partial")
        draft.touch()
        draft.unlink()


def remove_leftovers(path: Path) -> None:
    """Remove what killed writers of a file or folder left next to it and in it."""
    for folder, _, names in os.walk(path):
        for name in names:
            if re.search(r"\.[0-9a-f]{32}\.partial$", name):  # as Zarr names them
                (Path(folder) / name).unlink(missing_ok=True)
    restore_old(path)
    for left in _left_beside(path, "partial"):
        _remove(left)


def _left_beside(path: Path, ending: str) -> list[Path]:
    pattern = re.compile(rf"\.{re.escape(path.name)}\.[a-z0-9_]{{8}}\.{ending}")
    if not path.parent.is_dir():
        return []
    return sorted(entry for entry in path.parent.iterdir() if pattern.fullmatch(entry.name))


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn a failure to write to a path into a sentence."""
    try:
        yield
    except OSError as error:
        raise write_error(path, error) from None


def write_error(path: Path, error: OSError) -> StoreError:
    """Turn a failed write into a sentence."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StoreError(
            f"the disk that holds {path} is full; nothing that was written is lost: free some room "
            "and run the same command again to go on"
        )
    return StoreError(f"{path} cannot be written: {error.strerror or error}; check its disk and permissions")
