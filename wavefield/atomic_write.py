"""Write a file or folder completely or not at all, and never over anybody else's.

Every product ends with a mark: its kind, the identity of what it was made from, and a digest of its content.
A file that is there is replaced only by the same product of the same source, and only if its content is still
as this program wrote it. Everything else is left as it is.
"""

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import time
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from wavefield.errors import StoreError

_DRAFT = ".wavefield-"  # start of the name of a folder that holds an unfinished product
_REMOVALS, _PAUSE = 50, 0.05  # s: a chunk that is being written takes less than this in all
_DRAFT_NOTE = "unfinished output of wavefield: the next command that writes in this folder removes it\n"
_MARK = re.compile(rb"\n(?:# |<!-- )wavefield ([a-z ]+) ([0-9a-f]{16}) ([0-9a-f]{32})(?: -->)?\n\Z")
_MARK_BYTES = 200  # a mark is shorter
MARK_ATTRIBUTE = "wavefield_mark"  # of the root of a Zarr store


@dataclass(frozen=True)
class Product:
    """Something that this program writes, and what it is made from."""

    kind: str  # Such as "report" or "wave store", in small letters
    source: str = "0" * 16  # Identity of what it is made from: `identity_of`


def identity_of(*parts: object) -> str:
    """Sixteen hexadecimal digits that identify what a product is made from."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]


def file_names(folder: Path) -> list[str]:
    """Sorted paths of all files below a folder, relative to it; links count as files."""
    out = []
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(place, name))]
        out += [Path(place, name).relative_to(folder).as_posix() for name in (*files, *links)]
    return sorted(out)


def read_mark(path: Path) -> Product | None:
    """The product that the mark of a file or Zarr store names; None without a mark, or if it was changed."""
    try:
        if path.is_dir():
            mark = json.loads((path / "zarr.json").read_bytes())["attributes"][MARK_ATTRIBUTE]
            kind, source, digest = mark["kind"], mark["source"], mark["digest"]
        else:
            with path.open("rb") as stream:
                stream.seek(max(path.stat().st_size - _MARK_BYTES, 0))
                found = _MARK.search(stream.read())
            if found is None:
                return None
            kind, source, digest = (part.decode() for part in found.groups())
        return Product(kind, source) if digest == _digest(path) else None
    except PermissionError as error:
        raise write_error(path, error) from None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def has_mark(store: Path) -> bool:
    """Whether a Zarr store claims to be a product of this program."""
    with suppress(OSError):
        return MARK_ATTRIBUTE.encode() in (store / "zarr.json").read_bytes()
    return False


def write_mark(path: Path, product: Product) -> None:
    """Add the mark of a product to a finished file or Zarr store."""
    if path.is_dir():
        file = path / "zarr.json"
        data = json.loads(file.read_bytes())
        mark = {"kind": product.kind, "source": product.source, "digest": _digest(path)}
        data["attributes"] = data.get("attributes", {}) | {MARK_ATTRIBUTE: mark}
        file.write_text(json.dumps(data, indent=2), encoding="utf-8")
        return
    start, end = ("<!-- ", " -->") if path.suffix == ".html" else ("# ", "")
    with path.open("ab") as stream:
        stream.write(f"\n{start}wavefield {product.kind} {product.source} {_digest(path)}{end}\n".encode())


def _digest(path: Path) -> str:
    """Digest of a file, or of all files of a Zarr store, without the mark."""
    digest = hashlib.blake2b(digest_size=16)
    if path.is_dir():
        for name in file_names(path):
            content = (path / name).read_bytes()
            if name == "zarr.json":
                data = json.loads(content)
                data.get("attributes", {}).pop(MARK_ATTRIBUTE, None)
                content = json.dumps(data, sort_keys=True).encode()
            digest.update(f"{name} {len(content)}\n".encode() + content)
        return digest.hexdigest()
    with path.open("rb") as stream:
        size = path.stat().st_size
        stream.seek(max(size - _MARK_BYTES, 0))
        found = _MARK.search(stream.read())
        left = size - (len(found.group()) if found else 0)
        stream.seek(0)
        while left:
            part = stream.read(min(left, 1 << 22))
            digest.update(part)
            left -= len(part)
    return digest.hexdigest()


def check_replaceable(path: Path, product: Product | None = None, replace: bool = False) -> None:
    """Refuse to replace anything but the same product of the same source, unchanged since it was written."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return
    except OSError as error:  # a folder that is a file, a name that is too long
        raise write_error(path, error) from None
    if stat.S_ISLNK(mode):
        raise StoreError(
            f"{path} is a link, which is not replaced; name what it points to, or remove the link"
        )
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise StoreError(f"{path} is a pipe or a device, not a file; choose another name")
    if stat.S_ISDIR(mode) and not any(path.iterdir()):
        return
    if replace and stat.S_ISREG(mode):
        return
    found = read_mark(path)
    if product is not None and found == product:
        return
    if product is not None and found is not None and found.kind == product.kind:
        why = f"is a {found.kind} of something else"
    elif found is not None:
        why = f"is a {found.kind}"
    else:
        why = "was not written by wavefield, or was changed since"
    raise StoreError(f"{path} exists and {why}; it is left as it is: choose another name, or remove it first")


def refuse_input(path: Path, *inputs: object) -> None:
    """Refuse to write over, or into, a file or folder that the same command reads."""
    for one in inputs:
        if not isinstance(one, str | Path):
            continue
        read = Path(one).absolute()
        if os.path.exists(read) and os.path.exists(path) and path.samefile(read):
            raise StoreError(f"{path} is read by this command and not overwritten; choose another name")
        if read.is_dir() and (read / "zarr.json").is_file() and read.resolve() in path.resolve().parents:
            raise StoreError(f"{path} is inside {read}, which this command reads; choose another place")


@contextmanager
def atomic(
    path: str | Path, product: Product | None = None, *, replace: bool = False, inputs: Iterable[object] = ()
) -> Iterator[Path]:
    """Write a file or a folder under another name, and let it take its place when it is finished.
    Without a product nothing is replaced, with `replace` any plain file is.
    """
    path = Path(path)
    with writing(path):
        refuse_input(path, *inputs)
        path.parent.mkdir(parents=True, exist_ok=True)
        check_replaceable(path, product, replace)
        with _draft_folder(path) as folder:
            draft = folder / path.name
            yield draft
            if product is not None:
                write_mark(draft, product)
            if draft.is_file():
                make_durable([draft])
            check_replaceable(path, product, replace)  # it may have appeared meanwhile
            if path.is_dir():
                path.rename(folder / "old")
            elif path.exists() and draft.is_file():
                shutil.copymode(path, draft)
            draft.replace(path)
            make_durable([path.parent])


@contextmanager
def _draft_folder(path: Path) -> Iterator[Path]:
    """Make a locked folder for a draft next to a path, and first remove those of killed writers."""
    remove_leftovers(path)
    folder = path.with_name(f"{_DRAFT}{uuid.uuid4().hex}")  # named before a signal can come between
    try:
        folder.mkdir(mode=0o700)
        with FileLock(folder / "lock"):
            (folder / "note").write_text(f"{_DRAFT_NOTE}{path.name}", encoding="utf-8")
            try:
                yield folder
            finally:
                _put_back(folder, path)
    finally:
        _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a folder; try again while threads of Zarr still write into it."""
    for _ in range(_REMOVALS):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            break
        time.sleep(_PAUSE)


def _put_back(folder: Path, path: Path) -> None:
    """Give a replaced folder its name back if the new one did not come."""
    with suppress(OSError):
        if (folder / "old").is_dir() and not os.path.lexists(path):
            (folder / "old").rename(path)


def remove_leftovers(path: Path) -> None:
    """Remove drafts that killed writers left next to a path; a folder they had moved gets its name back."""
    with suppress(OSError):
        for entry in list(os.scandir(path.parent)):
            if not entry.name.startswith(_DRAFT):
                continue
            folder = Path(entry.path)
            with suppress(OSError, Timeout, UnicodeError):
                note, _, name = (folder / "note").read_text(encoding="utf-8").partition("\n")
                if f"{note}\n" == _DRAFT_NOTE:
                    with FileLock(folder / "lock", timeout=0):
                        _put_back(folder, path.with_name(name))
                    shutil.rmtree(folder, ignore_errors=True)


def make_durable(paths: Iterable[Path]) -> None:
    """Wait until files and folders are on the disk (fsync); those that do not exist are passed over."""
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


def write_text(path: str | Path, text: str, product: Product | None = None, *, replace: bool = False) -> None:
    """Write a text file (UTF-8), completely or not at all; parameters of `atomic`."""
    with atomic(path, product, replace=replace) as draft:
        draft.write_text(text, encoding="utf-8")


def check_writable(
    path: str | Path, product: Product | None = None, *, inputs: Iterable[object] = ()
) -> None:
    """Check that a file or folder can be written before work on it begins."""
    path = Path(path)
    with writing(path):
        refuse_input(path, *inputs)
        path.parent.mkdir(parents=True, exist_ok=True)
        check_replaceable(path, product)
        with _draft_folder(path) as folder:
            (folder / path.name).touch()


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an `OSError` while writing to a path into a `StoreError` with a remedy."""
    try:
        yield
    except OSError as error:
        raise write_error(path, error) from None


def write_error(path: Path, error: OSError) -> StoreError:
    """The error to raise for a failed write, with a sentence for the user."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return StoreError(
            f"the disk that holds {path} is full, or a quota is used up; nothing that was written is lost: "
            "free some room and run the same command again"
        )
    if error.errno in (errno.ENOTDIR, errno.EEXIST):
        return StoreError(f"{path} cannot be written: a folder in its path is a file; choose another place")
    if error.errno == errno.ENAMETOOLONG:
        return StoreError(
            f"{path.name[:40]}... cannot be written: its name is too long; choose a shorter one"
        )
    return StoreError(f"{path} cannot be written: {error.strerror or error}; check its disk and permissions")
