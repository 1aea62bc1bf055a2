"""Self-calibration on particle images: the plane of a light sheet, and cameras that have moved."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wavefield.calibration.sheet_windows import Read, SheetWindows
from wavefield.calibration.still_water_correction import RigCheck, refine_and_level
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment

SIDES = 128, 64, 64, 64  # px: of the windows, pass after pass
MIN_WINDOWS = 60  # by which a plane, and a camera that moved, can be fitted
DISPARITY_STD = 0.2  # px: in the first place
CONVERGED = 0.05  # px: a pass that reduces the disparity by less is the last


@dataclass(frozen=True)
class LightSheet:
    """A rig in the frame of a light sheet."""

    rig: Rig  # z = 0 in the middle of the sheet
    height: float  # Of the sheet above the old z = 0, at the origin, metres
    slope: tuple[float, float]  # Of the sheet in the old frame, along x and y
    thickness: float  # Between places where its light is 1/e2 of the brightest, metres; NaN if undetermined
    disparity_before: float  # Of the dewarped images, rms, px
    disparity: float  # After the correction
    check: RigCheck  # Whether a camera had moved
    windows: int  # Number of windows used
    instants: int
    # By how much all positions in the sheet may be shifted together, metres: two cameras do not show which of
    # them has moved, nor by how much along their parallax; 0 where none has moved, or three cameras show it
    position_ambiguity: float = 0.0

    @property
    def sentence(self) -> str:
        """All this for the user."""
        x, y = (1e3 * part for part in self.slope)
        return (
            f"light sheet: {1e3 * self.height:+.3f} mm at the origin, slope {x:+.2f}, {y:+.2f} mrad along "
            f"x, y; {1e3 * self.thickness:.2g} mm thick (1/e2); disparity {self.disparity_before:.2f} px "
            f"before, {self.disparity:.2f} px now ({self.windows} windows of {self.instants} instants); "
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
    """Bring z = 0 to a light sheet, and correct a camera that has moved, from the particles themselves.

    Parameters
    ----------
    experiment : path or Experiment
        Of cameras that see one light sheet.
    rig : path, optional
        In place of the one that the experiment names; calibrated on a target near the sheet.
    frames : int
        Instants to use, spread over the record.
    progress : callable, optional
        Called with (passes over the instants done, most that there are).

    Returns
    -------
    LightSheet

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
    """`find_sheet` of images that a function returns (Wieneke 2005, Exp. Fluids 39, 267).
    Repeats until the disparity of dewarped images is gone: cameras corrected, the sheet's plane made z = 0.
    """
    axes, origin, ambiguity = np.eye(3), np.zeros(3), 0.0
    check: RigCheck | None = None
    before = last = float("nan")
    for number, side in enumerate(SIDES):
        windows = SheetWindows(rig, side, read, instants)
        if progress:
            progress(number + 1, len(SIDES))
        matches = windows.matches()
        n_cameras = np.sum([np.isfinite(pixel).all(axis=1) for pixel in matches.values()], axis=0)
        count = int(np.count_nonzero(n_cameras >= 2))
        if count < MIN_WINDOWS:
            raise CalibrationError(
                f"only {count} of {windows.count} windows of {windows.instants} instants show the same "
                f"particles in two cameras, {MIN_WINDOWS} at least are needed: more instants, more light, a "
                "calibration nearer to the sheet, or frames of the same moments"
            )
        rms = windows.rms()
        if check is None:
            before = rms
        elif rms > last - CONVERGED:
            break
        last = rms
        rig, correction, plane = refine_and_level(rig, matches, DISPARITY_STD)
        origin, axes = origin + axes @ np.array([0.0, 0.0, plane.height]), axes @ plane.axes
        if check is None and not correction.moved and correction.faulty_cameras:
            # a misfit across the parallax may be as large along it, where it passes for the sheet's height
            ambiguity = correction.misfit * windows.pixel
        check = check or correction
    assert check is not None
    normal = axes[:, 2]
    slope = float(-normal[0] / normal[2]), float(-normal[1] / normal[2])
    height = float(origin @ normal / normal[2])
    used = windows.instants
    note = {"height_m": height, "slope": list(slope), "instants": used, "elsewhere_m": ambiguity}
    provenance = {
        key: value for key, value in rig.provenance.items() if key != "levelled"
    }  # that is of water
    rig = Rig(rig.cameras, {**provenance, "light_sheet": note})
    thickness = windows.thickness()
    return LightSheet(rig, height, slope, thickness, before, rms, check, count, used, ambiguity)
