"""Find the plane of a light sheet from images of the particles in it (self-calibration of stereo PIV).

The images are dewarped: resampled onto z = 0. If the sheet is elsewhere, the dewarped images of two cameras
are shifted against each other; this shift is the disparity. Correlations in windows, summed over instants,
measure it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.calibration.observations import MIN_MATCHES, OUTLIER_DEVIATIONS
from wavefield.calibration.points import Image, Mask
from wavefield.calibration.still_water import RigCheck, refine_and_level
from wavefield.errors import CalibrationError
from wavefield.measurement.images import usable
from wavefield.measurement.rectify import rectify, sight_map
from wavefield.rig import Rig
from wavefield.rig.field import common_field, pixel_at
from wavefield.rig.lens import Array
from wavefield.rig.rig import pairs_of
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment

LIGHT_SCALE = 4.0  # px: wider variations of brightness are illumination, not particles
MAX_BRIGHTNESS = 4.0  # standard deviations: limit of brightness, so that few bright particles do not dominate
SMOOTHING = 1.5  # px: standard deviation of the Gaussian that joins the peaks of single particles
PEAK_LEVEL = 0.5  # of the maximum; correlations above it belong to the peak


def particles(image: Image, visible: Mask) -> Image:
    """Return an image of particles with unit variance: illumination removed, bright particles clipped.
    Pixels outside the mask `visible` are ignored and become zero."""
    weight = cv2.GaussianBlur(visible.astype(np.float32), (0, 0), LIGHT_SCALE)
    light = cv2.GaussianBlur(np.where(visible, image, np.float32(0)), (0, 0), LIGHT_SCALE)
    rest = np.where(visible, image - light / np.maximum(weight, 1e-3), np.float32(0))
    spread = np.float32(np.sqrt(np.mean(np.square(rest[visible])))) if visible.any() else np.float32(0)
    if not spread > 0:
        return np.zeros_like(rest)
    out: Image = np.clip(rest / spread, -MAX_BRIGHTNESS, MAX_BRIGHTNESS)
    return out


@dataclass
class Correlation:
    """Cross-correlations between the images of two cameras, in square windows, summed over many instants."""

    rows: Sequence[int]  # First image row of each row of windows
    columns: Sequence[int]  # First image column of each column of windows
    side: int  # Of the square windows, px

    def __post_init__(self) -> None:
        half = self.side // 2 + 1
        shape = len(self.rows), len(self.columns), self.side, half
        self._sum = np.zeros(shape, np.complex64)
        edge = np.hanning(self.side + 2)[1:-1]
        self._taper = np.sqrt(np.outer(edge, edge)).astype(np.float32)

    def add(self, a: Image, b: Image) -> None:
        """Add the correlation of one instant. a and b are the images of the two cameras, from `particles`."""
        for i, row in enumerate(self.rows):
            lines = slice(row, row + self.side)
            pieces = np.stack([[q[lines, c : c + self.side] for c in self.columns] for q in (a, b)])
            spectrum = scipy.fft.rfft2(pieces * self._taper, workers=1)
            self._sum[i] += np.conj(spectrum[0]) * spectrum[1]

    def disparities(self) -> Array:
        """Return the shift of the second camera's image against the first in each window, px along x and y.
        The shape is (rows of windows, columns of windows, 2). Windows without a clear peak are NaN."""
        planes = scipy.fft.fftshift(scipy.fft.irfft2(self._sum, s=(self.side, self.side)), axes=(-2, -1))
        smooth = [cv2.GaussianBlur(one, (0, 0), SMOOTHING) for one in planes.reshape(-1, *planes.shape[-2:])]
        return np.array([_centre(np.asarray(one)) for one in smooth]).reshape(*planes.shape[:2], 2)


def _centre(plane: Image) -> tuple[float, float]:
    """Return the position (x, y) of the peak of a correlation `plane`, px from zero shift.
    It is NaN if the peak is insignificant or at the edge."""
    middle, peak = plane.shape[0] // 2, _peak(plane)
    background = plane[~cv2.dilate(peak.view(np.uint8), np.ones((9, 9), np.uint8)).view(bool)]
    if not background.size or plane.max() - np.median(background) < OUTLIER_DEVIATIONS * background.std():
        return np.nan, np.nan
    row, column = np.nonzero(peak)
    weight = plane[peak] - PEAK_LEVEL * plane.max()
    if row.min() == 0 or column.min() == 0 or max(row.max(), column.max()) == plane.shape[0] - 1:
        return np.nan, np.nan
    return float(weight @ column / weight.sum()) - middle, float(weight @ row / weight.sum()) - middle


def _peak(plane: Image) -> Mask:
    """Return a mask of the peak of a correlation: connected points over half of the maximum."""
    top = np.unravel_index(int(plane.argmax()), plane.shape)
    _, parts = cv2.connectedComponents((plane > PEAK_LEVEL * plane.max()).astype(np.uint8))
    return np.asarray(parts == parts[top])


Read = Callable[[str, int], NDArray[np.generic] | None]  # reads the image of a camera at a frame


class SheetWindows:
    """Measures the shift between the dewarped images of each pair of cameras, in windows `side` px wide.
    `read` reads the images, for the frame numbers `instants`."""

    def __init__(self, rig: Rig, side: int, read: Read, instants: Sequence[int]) -> None:
        self.rig = rig
        field = common_field(rig.cameras.values(), height=0.0, margin=4.0)
        self.pixel = max(pixel_at(rig[n], float(np.mean(field.x)), float(np.mean(field.y))) for n in rig)
        x, y = (np.arange(lo, hi, self.pixel) for lo, hi in (field.x, field.y))
        side = min(side, x.size, y.size) // 2 * 2
        step, rows, columns = side, range(0), range(0)
        while len(rows) * len(columns) < 2 * MIN_MATCHES and step > 4:
            step //= 2
            rows, columns = (range(0, n - side + 1, step) for n in (y.size, x.size))
        self.count = len(rows) * len(columns)
        middle = (side - 1) / 2
        self.x, self.y = np.meshgrid(
            x[0] + self.pixel * (np.array(columns) + middle), y[0] + self.pixel * (np.array(rows) + middle)
        )
        self.pairs = pairs_of(rig, tuple(rig))
        self._correlations = {pair: Correlation(rows, columns, side) for pair in self.pairs}
        self.instants = self._add(read, instants, x, y)
        self._disparities = {pair: total.disparities() for pair, total in self._correlations.items()}

    def _add(self, read: Read, instants: Sequence[int], x: Array, y: Array) -> int:
        """Add the correlations of all frames `instants`; return how many of the frames were usable.
        Images are resampled at positions x, y, m, on z = 0."""
        maps = {name: sight_map(self.rig[name], x, y) for name in self.rig}
        used = 0
        for k in instants:
            flat = {}
            for name, (X, Y, visible) in maps.items():
                image = read(name, k)
                if image is not None and usable(image, self.rig[name].size):
                    flat[name] = particles(rectify(image, X, Y).astype(np.float32), visible)
            pairs = [(a, b) for a, b in self.pairs if a in flat and b in flat]
            for a, b in pairs:
                self._correlations[a, b].add(flat[a], flat[b])
            used += bool(pairs)
        return used

    def matches(self) -> dict[str, Array]:
        """Return pixels (windows, 2) of the same particles in each window, by camera; NaN if unknown."""
        reference = self.pairs[0][0]
        out = {reference: self._pixels(reference, np.zeros((*self.x.shape, 2)))}
        out |= {name: self._pixels(name, shift) for (_, name), shift in self._disparities.items()}
        return {name: out[name] for name in self.rig}

    def _pixels(self, name: str, shift: Array) -> Array:
        dx, dy = np.moveaxis(shift * self.pixel, -1, 0)
        return np.stack(self.rig[name].project(self.x + dx, self.y + dy, 0.0), axis=-1).reshape(-1, 2)

    def rms(self) -> float:
        """Return the rms disparity over all pairs of cameras and windows, px of the dewarped images."""
        squares = [np.sum(np.square(shift), axis=-1) for shift in self._disparities.values()]
        return float(np.sqrt(np.nanmean(squares)))


SIDES = 128, 64, 64  # px: side of the windows in each pass; a fourth pass changes nothing


@dataclass(frozen=True)
class LightSheet:
    """Result of `find_sheet`: a rig with z = 0 in the light sheet, and the sheet's place in the old frame."""

    rig: Rig  # z = 0 in the middle of the sheet
    height: float  # Height of the sheet above the old z = 0 at the origin, metres
    slope: tuple[float, float]  # Slope of the sheet in the old frame, along x and y
    disparity_before: float  # Rms disparity before the correction, px
    disparity: float  # Rms disparity after the correction, px
    check: RigCheck  # Whether a camera had moved
    windows: int  # Number of windows with a disparity
    instants: int  # Number of instants used
    # Possible common shift of all positions in the sheet, metres. Two cameras do not show which of them has
    # moved, nor how far along their parallax. It is 0 if none has moved, or if a third camera shows which.
    position_ambiguity: float = 0.0

    @property
    def sentence(self) -> str:
        """Sentence for the user: position of the sheet, disparities, and cameras that have moved."""
        x, y = (1e3 * part for part in self.slope)
        return (
            f"light sheet: {1e3 * self.height:+.3f} mm at the origin, slope {x:+.2f}, {y:+.2f} mrad along "
            f"x, y; disparity {self.disparity_before:.2f} px before, {self.disparity:.2f} px now "
            f"({self.windows} windows of {self.instants} instants); "
            f"{self._moved_cameras()}"
        )

    def _moved_cameras(self) -> str:
        check = self.check
        if not check.faulty_cameras:
            return check.sentence
        text = (
            f"{' or '.join(check.faulty_cameras)} had moved since the calibration (turned by about "
            f"{check.angle:.3f} degrees, sight lines missed by {check.misfit:.2f} px) and is corrected"
        )
        if check.moved:
            return text
        return (
            f"{text}; two cameras show neither which has moved nor by how much along their parallax: "
            f"velocities are valid, but all positions together may be shifted by some "
            f"{1e3 * self.position_ambiguity:.1f} mm"
        )


def find_sheet(
    experiment: str | Path | Experiment,
    rig: str | Path | None = None,
    frames: int = 50,
    progress: Callable[[int, int], None] | None = None,
) -> LightSheet:
    """Bring z = 0 to a light sheet, from images of its particles, and correct cameras that have moved.

    Parameters
    ----------
    experiment : path or Experiment
        An experiment whose cameras see the same light sheet.
    rig : path, optional
        A rig to use instead of the experiment's, calibrated on a target near the sheet.
    frames : int
        Number of instants to use, spread over the record.
    progress : callable, optional
        Called with (passes over the images done, number of passes).

    Returns
    -------
    LightSheet
        The corrected rig, and the height (metres) and slope of the sheet in the old frame.

    Raises
    ------
    CalibrationError
        If too few windows show the same particles in two cameras.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.find_sheet("experiment.yaml")  # doctest: +SKIP
    >>> found.rig.save("rig.yaml")  # doctest: +SKIP
    """
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    series = experiment.open_frames()
    loaded = experiment.load_rig(rig, series)
    instants = evenly_spaced(min(len(one) for one in series.values()), frames)
    return fit_sheet(lambda name, k: series[name].read(k).image, instants, loaded, progress)


def fit_sheet(
    read: Read, instants: Sequence[int], rig: Rig, progress: Callable[[int, int], None] | None = None
) -> LightSheet:
    """Find the light sheet from images of particles (Wieneke 2005, Exp. Fluids 39, 267).
    `read` returns the image of a camera at a frame number; `instants` are the frame numbers to use. Each of
    three passes measures the disparity, corrects the cameras, and moves z = 0 to the sheet."""
    axes, origin, ambiguity = np.eye(3), np.zeros(3), 0.0
    check: RigCheck | None = None
    before = float("nan")
    for number, side in enumerate(SIDES):
        windows = SheetWindows(rig, side, read, instants)
        if progress:
            progress(number + 1, len(SIDES))
        matches = windows.matches()
        n_cameras = np.sum([np.isfinite(pixel).all(axis=1) for pixel in matches.values()], axis=0)
        count = int(np.count_nonzero(n_cameras >= 2))
        if count < MIN_MATCHES:
            raise CalibrationError(
                f"only {count} of {windows.count} windows of {windows.instants} instants show the same "
                f"particles in two cameras, {MIN_MATCHES} at least are needed: more instants, more light, a "
                "calibration nearer to the sheet, or frames of the same moments"
            )
        rms = windows.rms()
        if check is None:
            before = rms
        rig, correction, plane = refine_and_level(rig, matches)
        origin, axes = origin + axes @ np.array([0.0, 0.0, plane.height]), axes @ plane.axes
        if check is None and not correction.moved and correction.faulty_cameras:
            # an error along the parallax looks like a height of the sheet; assume it as large as that across
            ambiguity = correction.misfit * windows.pixel
        check = check or correction
    assert check is not None
    normal = axes[:, 2]
    slope = float(-normal[0] / normal[2]), float(-normal[1] / normal[2])
    height = float(origin @ normal / normal[2])
    used = windows.instants
    note = {"height_m": height, "slope": list(slope), "instants": used, "elsewhere_m": ambiguity}
    # `levelled` would mean that z = 0 is the water
    provenance = {key: value for key, value in rig.provenance.items() if key != "levelled"}
    rig = Rig(rig.cameras, {**provenance, "light_sheet": note})
    return LightSheet(rig, height, slope, before, rms, check, count, used, ambiguity)
