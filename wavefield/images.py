"""Reading and writing one image file."""

from pathlib import Path

import cv2
import numpy as np
import tifffile

from wavefield.errors import FrameError


def read_image(path: str | Path) -> np.ndarray:
    """Read one grey image: TIFF, PNG, BMP, JPEG.

    Parameters
    ----------
    path : path
        Image file.

    Returns
    -------
    ndarray, (row, column), uint8, uint16 or float32
        The image; colour is turned to grey.

    Raises
    ------
    FrameError
        If the file is missing, empty, truncated or not an image.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise FrameError(f"{path}: no such image") from None
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror}") from None
    image = None
    if raw[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        try:
            image = tifffile.imread(path, key=0)
        except Exception as error:
            raise FrameError(f"{path} is corrupt or truncated: {error}") from None
    elif raw:
        image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise FrameError(
            f"{path} is {'not an image or corrupt' if raw else 'empty'}; copy it again from the camera"
        )
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    return image


def write_image(path: str | Path, image: np.ndarray) -> None:
    """Write one grey image; the ending of the name chooses the format (TIFF uncompressed, PNG).

    Parameters
    ----------
    path : path
        File to write; its folder is made.
    image : ndarray, (row, column), uint8 or uint16
        The image.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() in (".tif", ".tiff"):
        tifffile.imwrite(path, image)
    elif not cv2.imwrite(str(path), image):
        raise FrameError(f"{path} cannot be written")
