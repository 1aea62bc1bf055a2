"""After the calibration: has a camera moved, and the correction of a rig from matches between its cameras.

Matched pixels of any record over-determine the rig: the sight lines of one bead must meet. They do not
determine the water's plane; that takes a record of still water.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.sight_line_fit import Matches, SightLineFit, Solution, sight_points
from wavefield.rig import Rig
from wavefield.rig.water_level import WaterPlane, level

MIN_CHI2_DIFFERENCE = 40.0  # for one explanation to be better than another
SHARP_MISFIT_PX = 0.3  # sharp images of one moment match better than this
MAX_TURN_RATIO = 20.0  # a camera's turn moves its image by no more than this times the misfit that it removes
WRONG_RIG_PX = 5.0  # a larger misfit is no moved camera, but another rig
_WRONG_RIG = (
    "the rig does not fit these images; are its cameras named as theirs, is it of this image size and crop, "
    "and did its lens come through the conversion?"
)
_OTHER_CAUSES = "are the frames of the same moments (`offset`), sharp and bright, and is the rig theirs?"

Solutions = Mapping[str | None, Solution]  # by the camera that is free to have moved


@dataclass(frozen=True)
class RigCheck:
    """Whether the sight lines of matched pixels meet."""

    misfit: float  # Robust distance by which they miss, px
    expected: float  # What it would be if no camera had moved, px: with all cameras free to move
    moved: str | None  # The camera that has moved; None if none has, or if several fit alike
    faulty_cameras: tuple[str, ...]  # Cameras whose motion explains the misfit about equally well
    angle: float  # By how much the moved camera has turned, degrees
    sentence: str  # All this for the user
    refused: bool = False  # Whether matches cannot correct the rig: `refine` leaves it as it is


def check_rig(rig: Rig, matches: Matches, std: float = 0.1) -> RigCheck:
    """Check on any record whether a camera has moved since the calibration.

    Parameters
    ----------
    rig : Rig
        As calibrated; its file holds the covariance.
    matches : mapping of camera to array_like, (n, 2)
        Pixels of the same pieces of surface in each camera; NaN where a camera has none.
        The surface may move.
    std : float, default 0.1
        Standard uncertainty of a match per axis, px.

    Returns
    -------
    RigCheck

    Raises
    ------
    CalibrationError
        If there are fewer than two cameras or fifty matches.
    """
    return _check(SightLineFit(rig, matches, std))[0]


def _check(problem: SightLineFit) -> tuple[RigCheck, Solutions]:
    solutions: dict[str | None, Solution] = {None: problem.solve(())}
    for name in problem.names:
        solutions[name] = problem.solve((name,))
    before = problem.misfit_at_start()
    expected = min(solution.misfit for solution in solutions.values())

    def unchanged(sentence: str, refused: bool) -> tuple[RigCheck, Solutions]:
        return RigCheck(before, expected, None, (), 0.0, sentence, refused), solutions

    if before > WRONG_RIG_PX and expected > SHARP_MISFIT_PX:
        return unchanged(f"sight lines miss by {before:.1f} px: {_WRONG_RIG}", refused=True)
    # in units of the misfit that remains, not of the one stated
    unit = max(expected / problem.std, 1e-9) ** 2
    chi2 = {name: solution.chi2 / unit for name, solution in solutions.items()}
    # a turn that would move the image much further than the misfit it removes, but for a shift that undoes
    # it, is no camera that has moved: matches do not distinguish the two
    turn = {name: problem.turn(solutions[name], name) for name in problem.names}
    removed = {name: np.sqrt(max(before**2 - solutions[name].misfit ** 2, 0.0)) for name in problem.names}
    movable = [name for name in problem.names if turn[name] < MAX_TURN_RATIO * removed[name]]
    best = min(movable or problem.names, key=lambda name: chi2[name])
    gain = chi2[None] - chi2[best]
    # a misfit below a match's own error, which no motion explains, is none
    meet = before < 1.1 * expected or (not movable and before < problem.std)
    if meet or gain < MIN_CHI2_DIFFERENCE:
        sentence = f"no camera has moved: sight lines meet within {before:.2f} px"
        if before > SHARP_MISFIT_PX:
            sentence = f"sight lines miss by {before:.2f} px, and no camera has moved: {_OTHER_CAUSES}"
        return unchanged(sentence, refused=False)
    if not movable:
        return unchanged(
            f"sight lines miss by {before:.2f} px; turning {best} by "
            f"{problem.angle(solutions[best], best):.2f} degrees would remove "
            f"{before - solutions[best].misfit:.2f} px and turn its view by {turn[best]:.0f} px, so it has "
            "not moved and is not corrected: calibrate again, or check whether a conversion lost lens terms",
            refused=True,
        )
    faulty = tuple(n for n in movable if chi2[n] - chi2[best] < max(MIN_CHI2_DIFFERENCE, 1e-4 * gain))
    angle = problem.angle(solutions[best], best)
    return _moved_camera(best, faulty, angle, before, expected), solutions


def _moved_camera(best: str, faulty: tuple[str, ...], angle: float, before: float, after: float) -> RigCheck:
    if after > max(0.5 * before, SHARP_MISFIT_PX):
        text = f"sight lines miss by {before:.2f} px, and by {after:.2f} px with one turned: {_OTHER_CAUSES}"
        return RigCheck(before, after, None, faulty, angle, text)
    text = (
        f"{' or '.join(faulty)} has moved since the calibration (turned by about {angle:.3f} degrees): "
        f"sight lines miss by {before:.2f} px, and by {after:.2f} px once that is corrected; "
        "refine the rig from a record of still water"
    )
    return RigCheck(before, after, best if len(faulty) == 1 else None, faulty, angle, text)


def refine(rig: Rig, matches: Matches, std: float = 0.1) -> tuple[Rig, RigCheck]:
    """Refine a rig so that the sight lines of matched pixels meet.

    Parameters
    ----------
    rig : Rig
        As calibrated; the covariance in its file is the prior.
    matches : mapping of camera to array_like, (n, 2)
        Pixels of the same pieces of surface in each camera; NaN where a camera has none.
    std : float, default 0.1
        Standard uncertainty of a match per axis, px.

    Returns
    -------
    rig : Rig
        Refined. Level it afterwards (`refine_and_level`): sight lines do not determine the water's plane.
    check : RigCheck
        What had been wrong.
    """
    problem = SightLineFit(rig, matches, std)
    check, solutions = _check(problem)
    if check.refused:
        return rig, check
    faulty = check.faulty_cameras
    # where several cameras may have moved, all of them are free: the prior distributes the motion
    solution = problem.solve(faulty) if len(faulty) > 1 else solutions[check.moved]
    return _refined(problem, solution, check), check


def _refined(problem: SightLineFit, solution: Solution, check: RigCheck) -> Rig:
    note = {
        "misfit_before_px": check.misfit,
        "misfit_after_px": solution.misfit,
        "moved": list(check.faulty_cameras),
        "matches": problem.n,
    }
    return Rig(problem.rig_at(solution.x).cameras, {**problem.rig.provenance, "refined": note})


def refine_and_level(rig: Rig, matches: Matches, std: float = 0.1) -> tuple[Rig, RigCheck, WaterPlane]:
    """Refine a rig from a record of still water, and bring z = 0 to the water's plane.

    Parameters
    ----------
    rig, matches, std
        As `refine`, of a record of still water.

    Returns
    -------
    rig : Rig
        Refined and levelled.
    check : RigCheck
        What had been wrong.
    plane : WaterPlane
        The water's plane before levelling; its ``rms`` states how flat it was.
    """
    problem = SightLineFit(rig, matches, std)
    check, solutions = _check(problem)
    candidates: dict[str | None, Rig] = {None: rig}
    if not check.refused:
        names = check.faulty_cameras or (None,)
        candidates = {name: _refined(problem, solutions[name], check) for name in names}
    levelled = {name: level(new, *sight_points(new, matches)[:3]) for name, new in candidates.items()}
    tilt = {name: float(np.hypot(*plane.slope)) for name, (_, plane) in levelled.items()}
    best = min(tilt, key=lambda name: tilt[name])
    if len(tilt) > 1:
        # sight lines alone do not distinguish these; but the target was level with the water, so the wrong
        # explanation tilts the water's plane
        faulty = tuple(name for name in check.faulty_cameras if tilt[name] < 3.0 * tilt[best])
        angle = problem.angle(solutions[best], str(best))
        check = _moved_camera(str(best), faulty, angle, check.misfit, check.expected)
    return levelled[best][0], check, levelled[best][1]
