"""Reading and writing image files: one grey image at a time."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import tifffile

from wavefield.atomic_write import ANY_FILE, atomic
from wavefield.errors import FrameError, StoreError
from wavefield.file_access import accessing
from wavefield.images.davis_image import read_buffer
from wavefield.images.dng import read_dng
from wavefield.images.jpeg_scan import is_damaged
from wavefield.images.plain_tiff import read_plain_tiff
from wavefield.images.tiff_page import page_of, read_page

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # damage is reported here
TIFF_ENDINGS = (".tif", ".tiff")
TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
FILE_ENDS = {".png": b"IEND", ".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}
CONVERTED = (np.uint8, np.uint16, np.float32)  # colour images of these types are made grey by OpenCV
LUMINANCE = np.array([0.114, 0.587, 0.299])  # of blue, green, red, as OpenCV has it
TAIL_BYTES = 4096  # at the end of a complete file, which contain these


def read_image(path: str | Path, page: int | None = None) -> np.ndarray:
    """Read one grey image, (row, column), as stored: TIFF, PNG, BMP, JPEG, DNG, LaVision's IM7.
    Of a file of several images the page has to be named; raises `FrameError`.
    """
    with accessing(path, FrameError):
        return _read(path, page)


def _read(path: str | Path, page: int | None) -> np.ndarray:
    ending = Path(path).suffix.lower()
    if ending == ".im7":
        return read_buffer(path, page or None)
    if ending == ".dng":
        return read_dng(path)
    if ending in TIFF_ENDINGS:
        return _checked(_read_tiff(Path(path), page), str(path))
    with _quiet():
        image = _read_file(path)
    if image is None:
        image = _read_otherwise(Path(path), page)
    return _checked(image, str(path))


def _read_tiff(path: Path, page: int | None) -> np.ndarray:
    """Read a page of a TIFF file: plain ones at once, others by OpenCV as far as their tags allow it."""
    if page is None and (image := read_plain_tiff(path)) is not None:
        return image
    try:
        with tifffile.TiffFile(path) as tiff:
            found = page_of(tiff, page, str(path))
    except FrameError:
        raise
    except Exception:  # perhaps another kind of image under this name; else it is reported what is wrong
        found = page or 0
    if not isinstance(found, int):
        return found
    with _quiet(), suppress(cv2.error):
        if not found:
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        else:
            image = next(iter(cv2.imreadmulti(str(path), found, 1, flags=cv2.IMREAD_UNCHANGED)[1]), None)
        if image is not None:
            return image
    return _read_otherwise(path, found)


def _checked(image: np.ndarray, name: str) -> np.ndarray:
    """The image in grey, refused if a damaged header gave it another number of dimensions."""
    if image.ndim not in (2, 3) or not image.size:
        raise FrameError(f"{name} is corrupt: its header is that of no image; copy it again from the camera")
    return grey(image)


def decode_image(data: bytes, name: str) -> np.ndarray:
    """Read one grey image, (row, column), from the bytes of a file that is neither DNG nor IM7."""
    image: np.ndarray | None
    if data[:4] in TIFF_STARTS:
        try:
            with tifffile.TiffFile(BytesIO(data)) as tiff:
                found = page_of(tiff, None, name)
                if isinstance(found, int):
                    image = _decoded(data, name) if not found else None
                    image = read_page(tiff, found) if image is None else image
                else:
                    image = found
        except FrameError:
            raise
        except Exception as error:
            raise FrameError(f"{name} is corrupt or truncated: {error}") from None
    else:
        image = _decoded(data, name)
    if image is None:
        state = "not an image, corrupt or truncated" if data else "empty"
        raise FrameError(f"{name} is {state}; copy it again from the camera")
    return _checked(image, name)


def _decoded(data: bytes, name: str) -> np.ndarray | None:
    last = FILE_ENDS.get(Path(name).suffix.lower(), b"")
    jpeg = data[:3] == b"\xff\xd8\xff"
    if not data or last not in data[-TAIL_BYTES:] or (jpeg and is_damaged(data)):
        return None
    with _quiet(), suppress(cv2.error):
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return None


def grey(image: np.ndarray) -> np.ndarray:
    """Luminance of a colour image, blue first as OpenCV reads it; a grey one is returned as it is."""
    if image.ndim == 2:
        return image
    if image.shape[2] < 3:
        return np.ascontiguousarray(image[..., 0])
    if image.dtype in CONVERTED:
        return cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_BGR2GRAY)
    luminance = image[..., :3] @ LUMINANCE
    return np.asarray(np.rint(luminance) if image.dtype.kind in "iu" else luminance, image.dtype)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep OpenCV from printing about damage of a file that it does not name."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        if before != cv2.utils.logging.LOG_LEVEL_SILENT:  # else another thread is reading and sets it back
            cv2.utils.logging.setLogLevel(before)


def _read_file(path: str | Path) -> np.ndarray | None:
    """Read an image with OpenCV; None if it is damaged or of another kind."""
    try:
        if Path(path).suffix.lower() in FILE_ENDS:
            # checked beforehand: OpenCV decodes the rest of a truncated file, and its libraries complain
            return _decoded(Path(path).read_bytes(), str(path))
        return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    except (cv2.error, OSError):
        return None


def _read_otherwise(path: Path, page: int | None) -> np.ndarray:
    """Read what OpenCV cannot, or report what is wrong with the file."""
    try:
        with path.open("rb") as stream:
            start = stream.read(4)
    except FileNotFoundError:
        raise FrameError(f"{path}: no such image") from None
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror}") from None
    if start in TIFF_STARTS:
        try:
            with tifffile.TiffFile(path) as tiff:
                found = page_of(tiff, page, str(path))
                return read_page(tiff, found) if isinstance(found, int) else found
        except FrameError:
            raise
        except Exception as error:
            raise FrameError(f"{path} is corrupt or truncated: {error}") from None
    state = "not an image, corrupt or truncated" if start else "empty"
    raise FrameError(f"{path} is {state}; copy it again from the camera")


def write_image(path: str | Path, image: np.ndarray) -> None:
    """Write one grey image atomically, as uncompressed TIFF or as PNG by the name's ending."""
    path = Path(path)
    try:
        with atomic(path, ANY_FILE) as draft:
            if path.suffix.lower() in TIFF_ENDINGS:
                tifffile.imwrite(draft, image)
            else:
                draft.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())
    except StoreError as error:
        raise FrameError(str(error)) from None
    except cv2.error:
        raise FrameError(
            f"{path} cannot be written: {path.suffix or 'no ending'} is no image format"
        ) from None


def made_even(image: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """A copy of an image, (row, column), with an even grey where it is covered.

    Examples
    --------
    >>> made_even(np.array([[1, 1, 9, 9]]), np.array([[False, False, True, True]]))
    array([[1, 1, 1, 1]])
    """
    free = image[::8, ::8][~covered[::8, ::8]]
    out = image.copy()
    out[covered] = np.partition(free, free.size // 2)[free.size // 2] if free.size else 0
    return out
