"""A still-water record: it corrects the rig, and gives the height of the beads above the water."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.pipeline.prepare import prepare
from wavefield.rig import Rig
from wavefield.rig.water_level import WaterPlane
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment
from wavefield.store.verdict import Remark
from wavefield.text import spell_uncertain

if TYPE_CHECKING:
    from wavefield.calibration.still_water import RigCheck

FRAMES = 10  # of the record at rest that are matched
BEAD_HEIGHTS_M = 1e-4, 2e-3  # of visible beads above the water, if they are plausible


def level_at_rest(
    experiment: Experiment,
    rig: str | Path | Rig | None = None,
    frames: int = FRAMES,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Rig, RigCheck, WaterPlane]:
    """Correct and level a rig with a record of still, seeded water."""
    from wavefield.calibration.still_water import refine_and_level
    from wavefield.measurement.tie_points import matched_pixels

    prepared = prepare(experiment, rig)
    series = prepared.series

    def read(camera: str, frame: int) -> Any:
        return series[camera].read(frame).image

    count = len(next(iter(series.values())))
    matches = matched_pixels(read, evenly_spaced(count, frames), prepared.geometry, progress)
    return refine_and_level(prepared.rig, matches)


def plane_sentence(plane: WaterPlane) -> str:
    """Where the water was, for a person."""
    return (
        f"The water's plane: {1e3 * plane.height:+.3f} mm at the origin, slope {1e3 * plane.slope[0]:+.3f}, "
        f"{1e3 * plane.slope[1]:+.3f} mrad along x, y; rms about it {1e3 * plane.rms:.3f} mm."
    )


def remark_on_rest(experiment: Experiment, rig: Rig, level_std: float = float("nan")) -> Remark:
    """Report whether z = 0 is the still water; ``level_std`` is the uncertainty of z = 0, metres."""
    found = rig.provenance.get("levelled")
    if experiment.settings.get("sheet_thickness") is not None:
        return _remark_on_sheet(experiment, rig)
    if isinstance(found, dict) and {"height_m", "rms_m", "points"} <= set(found):
        height, rms = 1e3 * float(found["height_m"]), 1e3 * float(found["rms_m"])
        stated = float(experiment.settings.get("bead_height", 0.0)) > 0
        return Remark(
            "rig",
            "levelled",
            "note",
            f"z = 0 is the water at rest: {found['points']} points of it were {height:+.2f} mm from the "
            f"target's plane, {rms:.2f} mm rms about their own",
            remedy=""
            if stated or not BEAD_HEIGHTS_M[0] < height / 1e3 < BEAD_HEIGHTS_M[1]
            else "if that plane was the water's level beads show so far above it: "
            f"`settings: {{bead_height: {height / 1e3:.2g}}}` corrects u and v for it",
            values={"height_m": height / 1e3, "rms_m": rms / 1e3},
        )
    if isinstance(found, dict) and "camera_height_m" in found:
        tilt, height = found["tilt_std_deg"], found["camera_height_std_m"]
        certain = f"its tilt is uncertain by {tilt:.2g} degrees, " if np.isfinite(tilt) else ""
        certain += f"{next(iter(rig))} is {spell_uncertain(found['camera_height_m'], height, 'm')} above it"
        certain += "" if np.isfinite(height) else ", uncertainty unknown"
        return Remark(
            "rig",
            "levelled",
            "note",
            f"z = 0 is the mean surface of moving water: {found['by']}; {certain}",
        )
    if experiment.rest:
        return Remark(
            "rig",
            "not levelled",
            "remark",
            "it was not corrected with the still-water record that the experiment names",
            "z = 0 on the water at rest",
            f"run `wavefield calibrate {experiment.path.name}` again, or `wavefield refine "
            f"{experiment.path.name}` where the rig is another program's",
        )
    return Remark(
        "rig",
        "no rest",
        "note",
        "no still-water record, so z = 0 is the target's plane"
        + (f", uncertain by {1e3 * level_std:.2g} mm" if level_std > 0 else "")
        + ": visible beads are above the water, which lowers u and v of 12 cm waves by about 2 %",
        "z = 0 on the still water",
        "record some twenty frames of still, seeded water and name them with the key `rest`",
        {"level_std_m": level_std} if level_std > 0 else {},
    )


def _remark_on_sheet(experiment: Experiment, rig: Rig) -> Remark:
    found = rig.provenance.get("light_sheet")
    if isinstance(found, dict) and "height_m" in found:
        height, elsewhere = float(found["height_m"]), float(found.get("elsewhere_m", 0.0))
        if elsewhere > 0:
            return Remark(
                "rig",
                "light sheet",
                "remark",
                "a camera had moved since the calibration, two cameras show neither which nor by how much "
                "along "
                f"their parallax: all places in the sheet may be some {1e3 * elsewhere:.1f} mm elsewhere",
                "cameras that stood still since the calibration",
                "calibrate again, or add a third camera",
                values={"height_m": height, "elsewhere_m": elsewhere},
            )
        return Remark(
            "rig",
            "light sheet",
            "note",
            "z = 0 is the middle of the light sheet, which was "
            f"{round(1e3 * height, 2) + 0.0:+.2f} mm from the target's plane",
            values={"height_m": height},
        )
    return Remark(
        "rig",
        "light sheet",
        "remark",
        "z = 0 is the target's plane: the position of the light sheet has not been determined",
        "the cameras' displacements at one place of the sheet",
        f"run `wavefield rig sheet {experiment.path.name} -o sheet.yaml`, and use that rig",
    )
