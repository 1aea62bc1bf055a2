"""Correct a rig with images of still, seeded water, and bring z = 0 to the water."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wavefield.pipeline.prepare import prepare
from wavefield.rig import Rig
from wavefield.rig.water_level import WaterPlane
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment

if TYPE_CHECKING:
    from wavefield.calibration.still_water import RigCheck

FRAMES = 10  # frames of the still-water record that are matched


def level_at_rest(
    experiment: Experiment,
    rig: str | Path | Rig | None = None,
    frames: int = FRAMES,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Rig, RigCheck, WaterPlane]:
    """Correct a rig with images of still, seeded water, and level it so that z = 0 is the water.
    ``rig`` replaces the rig of the experiment, and ``frames`` is the number of frames that are used.
    ``progress`` is called with the numbers of frames done and of all frames. Returns the corrected rig, a
    check of the given rig, and the plane of the water in the coordinates of the given rig."""
    from wavefield.calibration.still_water import refine_and_level
    from wavefield.measurement.elevation import matched_pixels

    prepared = prepare(experiment, rig)
    series = prepared.series

    def read(camera: str, frame: int) -> Any:
        return series[camera].read(frame).image

    count = len(next(iter(series.values())))
    matches = matched_pixels(read, evenly_spaced(count, frames), prepared.geometry, progress)
    return refine_and_level(prepared.rig, matches)


def plane_sentence(plane: WaterPlane) -> str:
    """Return a sentence on the height, the slope and the rms scatter of the plane of the water."""
    return (
        f"The water's plane: {1e3 * plane.height:+.3f} mm at the origin, slope {1e3 * plane.slope[0]:+.3f}, "
        f"{1e3 * plane.slope[1]:+.3f} mrad along x, y; rms about it {1e3 * plane.rms:.3f} mm."
    )
