"""Write files and folders completely or not at all, and protect existing ones.

Most outputs of wavefield carry a mark: the kind of output, the identity of the data from which it was made,
and a digest of its content. Such an output is replaced only by one of the same kind from the same data, and
only if its content is unchanged since wavefield wrote it.
"""

import atexit
import errno
import functools
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

_DRAFT = ".wavefield-"  # start of the name of a folder with an unfinished output
_REMOVALS, _PAUSE = 50, 0.05  # attempts, and seconds between; Zarr writes a chunk in less
_DRAFT_NOTE = "unfinished output of wavefield: the next command that writes in this folder removes it\n"
_MARK = re.compile(rb"\n(?:# |<!-- )wavefield ([a-z ]+) ([0-9a-f]{16}) ([0-9a-f]{32})(?: -->)?\n\Z")
_MARK_BYTES = 200  # a mark is shorter
MARK_ATTRIBUTE = "wavefield_mark"  # of the root of a Zarr store


@dataclass(frozen=True)
class Product:
    """The kind of an output and the data from which it was made, as the mark in the output states them."""

    kind: str  # Such as "report" or "wave store", in small letters
    source: str = "0" * 16  # Identity of the data from which the output is made (`identity_of`)


def identity_of(*parts: object) -> str:
    """Return sixteen hexadecimal digits that identify `parts`: a hash of their JSON text."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]


def file_names(folder: Path) -> list[str]:
    """Return the sorted paths, relative to a folder, of all files at any depth in this folder.
    Links to folders are not followed, and count as files."""
    out = []
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(place, name))]
        out += [Path(place, name).relative_to(folder).as_posix() for name in (*files, *links)]
    return sorted(out)


def read_mark(path: Path) -> Product | None:
    """Return the `Product` (kind and source) that wavefield wrote into the mark of a file or Zarr store.
    None without a mark, or if the content was changed after it was marked. StoreError if the user may not
    read the file."""
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
    """Return whether a Zarr store has a mark of wavefield, even if its content was changed later."""
    with suppress(OSError):
        return MARK_ATTRIBUTE.encode() in (store / "zarr.json").read_bytes()
    return False


def write_mark(path: Path, product: Product) -> None:
    """Mark a finished file (at its end) or Zarr store (in its attributes) as an output of wavefield.
    The mark contains the kind and source in `product`, and a digest of the content."""
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
    """Return a digest of the content, without the mark, of a file or of all files of a Zarr store."""
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
    """Raise StoreError if `path` exists and must not be replaced.
    An empty folder may be replaced, and so may an unchanged output of the kind and source in `product`. If
    `replace` is true, any plain file may be replaced. Links, pipes and devices are never replaced."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return
    except OSError as error:  # such as a name that is too long, or a file in place of a folder
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
    """Raise StoreError if the output `path` is one of `inputs`, or lies inside a Zarr store in `inputs`.
    `inputs` are the files and stores that the same command reads; entries that are not paths are ignored."""
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
    """Context manager: yield a temporary path for an output, which is renamed to `path` at the end.
    If the block raises an error, `path` stays as it was. With a `product`, the output is marked with this
    kind and source, and may replace an unchanged output of the same kind and source. With `replace` it may
    replace any plain file. `inputs` are files and stores that the same command reads. Raises StoreError if
    something at `path` must not be replaced, if `path` is one of `inputs`, or if it cannot be written."""
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
            check_replaceable(path, product, replace)  # a file may have appeared in the meantime
            if path.is_dir():
                path.rename(folder / "old")
            elif path.exists() and draft.is_file():
                shutil.copymode(path, draft)
            draft.replace(path)
            make_durable([path.parent])


@contextmanager
def _draft_folder(path: Path) -> Iterator[Path]:
    """Context manager: yield a new, locked folder next to `path` for drafts, and remove it at the end.
    Such folders that killed processes left behind are removed at the start."""
    remove_leftovers(path)
    folder = path.with_name(f"{_DRAFT}{uuid.uuid4().hex}")
    at_exit = functools.partial(shutil.rmtree, folder, ignore_errors=True)
    atexit.register(at_exit)  # a signal may arrive between two lines of this function
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
    atexit.unregister(at_exit)  # after an error threads may still write into the folder: it is removed again


def _remove(folder: Path) -> None:
    """Remove a folder and its content. An interruption by a signal is raised after the removal.
    Attempts are repeated for some seconds, since threads of Zarr may still write into the folder."""
    stop: BaseException | None = None
    for _ in range(_REMOVALS):
        try:
            shutil.rmtree(folder, ignore_errors=True)
            if not folder.exists():
                break
            time.sleep(_PAUSE)
        except KeyboardInterrupt as interruption:
            stop = interruption
        except OSError as error:  # interrupted, rmtree may close a folder twice
            stop = error.__context__ or error
    if stop is not None:
        raise stop


def _put_back(folder: Path, path: Path) -> None:
    """Move the earlier output from `folder`/old back to `path`, if nothing is at `path` (after a failure)."""
    with suppress(OSError):
        if (folder / "old").is_dir() and not os.path.lexists(path):
            (folder / "old").rename(path)


def remove_leftovers(path: Path) -> None:
    """Remove the unfinished outputs that killed processes have left in the folder of `path`.
    If such a process had moved an earlier output away to replace it, put this output back."""
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
    """Wait until files and folders are stored on the disk (fsync); OSError if the disk fails.
    Paths that do not exist, or that the user may not read, are skipped."""
    for path in paths:
        try:
            number = os.open(path, os.O_RDONLY)
        except (FileNotFoundError, NotADirectoryError, PermissionError):  # Windows cannot open folders
            continue
        try:
            os.fsync(number)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):  # file systems without fsync
                raise
        finally:
            os.close(number)


def write_text(path: str | Path, text: str, product: Product | None = None, *, replace: bool = False) -> None:
    """Write a text file (UTF-8), completely or not at all. With a `product`, mark it with kind and source.
    It may replace an unchanged file with the same mark and, with `replace`, any plain file."""
    with atomic(path, product, replace=replace) as draft:
        draft.write_text(text, encoding="utf-8")


def check_writable(
    path: str | Path, product: Product | None = None, *, inputs: Iterable[object] = ()
) -> None:
    """Raise StoreError if `atomic` with the same arguments could not write `path`.
    The folder that contains `path` is created if it is absent."""
    path = Path(path)
    with writing(path):
        refuse_input(path, *inputs)
        path.parent.mkdir(parents=True, exist_ok=True)
        check_replaceable(path, product)
        with _draft_folder(path) as folder:
            (folder / path.name).touch()


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Context manager: turn an OSError raised in it into a StoreError that names `path` and a remedy."""
    try:
        yield
    except OSError as error:
        raise write_error(path, error) from None


def write_error(path: Path, error: OSError) -> StoreError:
    """Return the StoreError to raise in place of `error`, which occurred while `path` was written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return StoreError(
            f"the disk that holds {path} is full, or a quota is used up; nothing that was written is lost: "
            "free some room and run the same command again"
        )
    return StoreError(f"{path} cannot be written: {error.strerror or error}; check its disk and permissions")
