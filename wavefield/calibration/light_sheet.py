"""Self-calibration on particle images: the plane of a light sheet, and cameras that have moved beside it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.disparity import Correlation, disparities, particles, ridge_length
from wavefield.calibration.still_water_correction import RigCheck, refine_and_level
from wavefield.errors import CalibrationError
from wavefield.measurement.frame import usable
from wavefield.measurement.rectify import rectify, sight_map
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.rig.pairs import pairs_of
from wavefield.rig.resolution import pixel_at
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment

Array = NDArray[np.float64]
Read = Callable[[str, int], NDArray[np.generic] | None]

_SIDES = 128, 64, 64, 64  # px: of the windows, pass after pass
_FEWEST = 60  # windows: what tells a plane, and a camera that moved
_ENOUGH = 100  # windows: no closer together than so many want
_STD = 0.2  # px: of a disparity, before its own scatter is known
_DONE = 0.05  # px: a pass that moves the sheet's image by less is the last
_LIGHT = 4.0  # standard deviations of a Gaussian sheet that make its thickness at 1/e2


@dataclass(frozen=True)
class LightSheet:
    """A rig in the frame of a light sheet."""

    rig: Rig  # z = 0 in the middle of the sheet
    height: float  # Of the sheet above the old z = 0, at the origin, metres
    slope: tuple[float, float]  # (float, float): Of the sheet in the old frame, along x and y
    thickness: float  # Where its light is above 1/e2, metres; NaN where the ridges do not tell
    before: float  # Disparity of the dewarped images, rms, px
    after: float
    check: RigCheck  # Whether a camera had moved
    windows: int  # What it rests on
    instants: int
    # By how much all places in the sheet may lie elsewhere together, because two cameras do not tell which of
    # them had moved, nor by how much along their parallax, metres; 0 where none has, or three tell
    elsewhere: float = 0.0

    @property
    def sentence(self) -> str:
        """All this for a person."""
        x, y = (1e3 * part for part in self.slope)
        return (
            f"light sheet: {1e3 * self.height:+.3f} mm at the origin, slope {x:+.2f}, {y:+.2f} mrad along "
            f"x, y; {1e3 * self.thickness:.2g} mm thick (1/e2); disparity {self.before:.2f} px before, "
            f"{self.after:.2f} px now ({self.windows} windows of {self.instants} instants); "
            f"{self._cameras()}"
        )

    def _cameras(self) -> str:
        check, who = self.check, " or ".join(self.check.faulty_cameras)
        if not who:
            return check.sentence
        text = f"(turned by about {check.angle:.3f} degrees, sight lines missed by {check.misfit:.2f} px)"
        if check.moved:
            return f"{who} had moved since the calibration {text} and is mended"
        return (
            f"{who} had moved since the calibration {text} and is mended; two cameras tell neither which nor "
            "by how much along their parallax: velocities hold, but all places together may lie some "
            f"{1e3 * self.elsewhere:.1f} mm elsewhere"
        )


def find_sheet(
    experiment: str | Path | Experiment,
    rig: str | Path | None = None,
    frames: int = 50,
    progress: Callable[[int, int], None] | None = None,
) -> LightSheet:
    """Bring z = 0 to a light sheet, and mend a camera that has moved, from the particles themselves.

    Parameters
    ----------
    experiment : path or Experiment
        Of cameras that see one light sheet.
    rig : path, optional
        In place of the one that the experiment names; calibrated on a target near the sheet.
    frames : int
        Instants to use, spread over the record.
    progress : callable, optional
        Told (passes over the instants done, most that there are).

    Returns
    -------
    LightSheet

    Raises
    ------
    CalibrationError
        If too few windows show what the cameras see in common.

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
    count = min(len(one) for one in series.values())
    instants = evenly_spaced(count, frames)
    return sheet_of(lambda name, k: series[name].read(k).image, instants, loaded, progress)


def sheet_of(
    read: Read, instants: Sequence[int], rig: Rig, progress: Callable[[int, int], None] | None = None
) -> LightSheet:
    """`find_sheet` of images that a function gives.

    Wieneke (2005), Exp. Fluids 39, 267: images are dewarped to z = 0 and correlated, the correlations of all
    instants summed; where their ridge lies, sight lines of the sheet's middle meet. What they miss mends the
    camera that moved, the plane through where they meet becomes z = 0, and all is done again until the
    disparity is gone.
    """
    axes, origin, elsewhere = np.eye(3), np.zeros(3), 0.0
    check: RigCheck | None = None
    before = last = float("nan")
    for number, side in enumerate(_SIDES):
        seen = _Pass(rig, side)
        used = seen.look(read, instants)
        if progress:
            progress(number + 1, len(_SIDES))
        matches = seen.matches()
        there = np.sum([np.isfinite(pixel).all(axis=1) for pixel in matches.values()], axis=0)
        good = int(np.count_nonzero(there >= 2))
        if good < _FEWEST:
            raise CalibrationError(_few(good, seen.count, used))
        rms = seen.rms()
        if check is None:
            before = rms
        elif rms > last - _DONE:
            break
        last = rms
        rig, found, plane = refine_and_level(rig, matches, _STD)
        origin, axes = origin + axes @ np.array([0.0, 0.0, plane.height]), axes @ plane.axes
        if check is None and not found.moved and found.faulty_cameras:
            # what is seen across the parallax may be as much along it, where it passes for the sheet's height
            elsewhere = found.misfit * seen.pixel
        check = check or found
    assert check is not None
    normal = axes[:, 2]
    slope = float(-normal[0] / normal[2]), float(-normal[1] / normal[2])
    height = float(origin @ normal / normal[2])
    note = {"height_m": height, "slope": list(slope), "instants": used, "elsewhere_m": elsewhere}
    kept = {name: stated for name, stated in rig.provenance.items() if name != "levelled"}  # that is of water
    rig = Rig(rig.cameras, {**kept, "light_sheet": note})
    return LightSheet(rig, height, slope, seen.thickness(), before, rms, check, good, used, elsewhere)


def _few(good: int, count: int, used: int) -> str:
    return (
        f"only {good} of {count} windows of {used} instants show the same particles in two cameras, "
        f"{_FEWEST} at least are needed: more instants, more light, a calibration nearer to the sheet, or "
        "frames of the same moments"
    )


class _Pass:
    """Windows of the images dewarped to z = 0, and what their correlations say."""

    def __init__(self, rig: Rig, side: int) -> None:
        self.rig = rig
        field = common_field(rig.cameras.values(), height=0.0, margin=4.0)
        self.pixel = max(pixel_at(rig[n], float(np.mean(field.x)), float(np.mean(field.y))) for n in rig)
        x, y = (np.arange(lo, hi, self.pixel) for lo, hi in (field.x, field.y))
        self.maps = {name: sight_map(rig[name], x, y) for name in rig}
        side = min(side, x.size, y.size) // 2 * 2
        step, rows, columns = side, range(0), range(0)
        while len(rows) * len(columns) < _ENOUGH and step > 4:
            step //= 2
            rows, columns = (range(0, n - side + 1, step) for n in (y.size, x.size))
        self.count = len(rows) * len(columns)
        half = (side - 1) / 2
        self.x, self.y = np.meshgrid(
            x[0] + self.pixel * (np.array(columns) + half), y[0] + self.pixel * (np.array(rows) + half)
        )
        self.pairs = pairs_of(rig, tuple(rig))
        self.sums = {pair: Correlation(rows, columns, side) for pair in self.pairs}

    def look(self, read: Read, instants: Sequence[int]) -> int:
        """Add instants; how many had the images of a pair."""
        used = 0
        for k in instants:
            flat = {}
            for name, (X, Y, seen) in self.maps.items():
                image = read(name, k)
                if image is not None and usable(image, self.rig[name].size):
                    flat[name] = particles(rectify(image, X, Y).astype(np.float32), seen)
            for (a, b), total in self.sums.items():
                if a in flat and b in flat:
                    total.add(flat[a], flat[b])
            used += any(a in flat and b in flat for a, b in self.pairs)
        self.planes = {pair: total.planes() for pair, total in self.sums.items()}
        self.found = {pair: disparities(plane) for pair, plane in self.planes.items()}
        return used

    def matches(self) -> dict[str, Array]:
        """Pixels of the same place of the sheet in each camera, (windows, 2); NaN where a camera has none."""
        reference = self.pairs[0][0]
        out = {reference: self._pixels(reference, np.zeros((*self.x.shape, 2)))}
        for (_, name), found in self.found.items():
            out[name] = self._pixels(name, found)
        return {name: out[name] for name in self.rig}

    def _pixels(self, name: str, shift: Array) -> Array:
        dx, dy = np.moveaxis(shift * self.pixel, -1, 0)
        return np.stack(self.rig[name].project(self.x + dx, self.y + dy, 0.0), axis=-1).reshape(-1, 2)

    def rms(self) -> float:
        """Disparity, px."""
        return float(np.sqrt(np.nanmean([np.sum(np.square(d), axis=-1) for d in self.found.values()])))

    def thickness(self) -> float:
        """Of the sheet at 1/e2, metres: both cameras' light makes the ridge, so it is narrower by root 2."""
        out = []
        for (a, b), planes in self.planes.items():
            lines = [np.stack(self.rig[n].sight_line(self.x, self.y), axis=-1) for n in (a, b)]
            along = (lines[1] - lines[0]) / self.pixel
            length = ridge_length(planes, self.sums[a, b].own(), self.found[a, b], along)
            out.append(_LIGHT * np.sqrt(2.0) * length / float(np.mean(np.linalg.norm(along, axis=-1))))
        return float(np.mean(out))
