"""Finding a calibration target in an image, whatever its kind."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.dots import find_dots
from wavefield.calibration.points import Image, TargetPoints
from wavefield.calibration.printed import find_aprilgrid, find_charuco, find_chessboard
from wavefield.calibration.strings import find_strings
from wavefield.calibration.target import Target
from wavefield.calibration.two_level import find_two_level
from wavefield.errors import CalibrationError

FINDERS = {
    "strings": find_strings,
    "chessboard": find_chessboard,
    "dots": find_dots,
    "charuco": find_charuco,
    "aprilgrid": find_aprilgrid,
    "two-level": find_two_level,
}
INVERTIBLE = ("charuco", "aprilgrid")  # the finders of chessboards and dots accept both polarities
MIN_SIDE = 32  # px
MIN_CONTRAST = 4.0 / 255.0  # of the brightest grey
MAX_SATURATED = 0.2  # of the image: if nothing is found in more, overexposure is named as the cause


def find_target(image: NDArray[np.generic], target: Target) -> TargetPoints:
    """Find the nodes of a calibration target in one image.

    Parameters
    ----------
    image : ndarray, (row, column), any real dtype
        The image; bright where the strings are white.
    target : Target
        Kind and dimensions of the target.

    Returns
    -------
    TargetPoints
        Indices of the nodes found, their pixel coordinates and standard uncertainties.

    Raises
    ------
    CalibrationError
        If the image is empty or overexposed, or shows no such target, or a mirrored one, or too little of it.
    """
    grey = scaled(image)
    try:
        return _find_either_print(grey, target)
    except CalibrationError as error:
        saturated = float(np.mean(grey >= grey.max()))
        if saturated > MAX_SATURATED:
            raise CalibrationError(
                f"{error}; {saturated:.0%} of the image is overexposed: photograph it again with less light"
            ) from None
        raise


def _find_either_print(grey: Image, target: Target) -> TargetPoints:
    """The target as it is, or as a board that was printed white on black."""
    try:
        return FINDERS[target.kind](grey, target)
    except CalibrationError:
        if target.kind not in INVERTIBLE:
            raise
        try:
            found = FINDERS[target.kind](np.float32(255.0) - grey, target)
        except CalibrationError:
            pass
        else:
            return replace(found, notes=(*found.notes, "printed white on black"))
        raise


def scaled(image: NDArray[np.generic]) -> Image:
    """The image as float32 with its brightest patch at 255, refused when it cannot show a target."""
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < MIN_SIDE:
        raise CalibrationError(
            f"a target image must be one grey image of {MIN_SIDE} px or more, not {image.shape}"
        )
    grey = image.astype(np.float32)
    if not np.isfinite(grey).all():
        raise CalibrationError("the image holds values that are not numbers; export it from the camera again")
    # hot pixels and sparkles are no part of a target, whose marks are more than a few pixels wide
    grey = np.minimum(grey, cv2.medianBlur(grey, 5).max())
    low, high = float(grey.min()), float(grey.max())
    if high - low < MIN_CONTRAST * max(abs(high), 1e-12):
        raise CalibrationError(
            "the image is empty: all its pixels have one grey; check light, cap and exposure"
        )
    return np.asarray(grey * np.float32(255.0 / high))
