"""Images in object stores (s3, gs, https ...), reached through fsspec; nothing is copied to this machine."""

import re

import numpy as np

from wavefield.errors import FrameError
from wavefield.images import decode_image
from wavefield.text import one_line

_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+://")


def is_remote(name: str) -> bool:
    """Whether a name is an address rather than a path.

    Examples
    --------
    >>> is_remote("s3://bucket/cam1.zarr"), is_remote("C://images/cam1"), is_remote("cam1/img_0.tif")
    (True, False, False)
    """
    return bool(_ADDRESS.match(name))


def list_remote(folder: str) -> list[str]:
    """Names of the files in a folder of an object store, in one listing."""
    from fsspec.core import url_to_fs

    try:
        files, inside = url_to_fs(folder)
        listed = files.ls(inside, detail=False)
    except Exception as error:  # each kind of store has errors of its own
        raise FrameError(_unreachable(folder, error)) from None
    return [str(name).rstrip("/").rsplit("/", 1)[-1] for name in listed]


def read_remote(address: str) -> np.ndarray:
    """Read one image, (row, column), from an object store."""
    from fsspec.core import url_to_fs

    try:
        files, inside = url_to_fs(address)
        data: bytes = files.cat_file(inside)
    except Exception as error:
        raise FrameError(_unreachable(address, error)) from None
    return decode_image(data, address)


def _unreachable(address: str, error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return f"{address}: there is nothing"
    words = one_line(error).rstrip(".")
    return f"{address} cannot be reached ({type(error).__name__}: {words})"
