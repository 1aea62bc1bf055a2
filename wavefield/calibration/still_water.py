"""Check whether cameras have moved since the calibration, and correct them from images of still water.

A match is a set of pixels of one point of the water surface, at most one per camera. The misfit is the
distance, px, by which the sight lines of matches miss each other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from wavefield.calibration.bundle import (
    HUBER_LIMIT,
    TERMS,
    ParameterLayout,
    huber,
    layout,
    linearised,
    minimise,
    stepped,
)
from wavefield.calibration.observations import MAX_MATCHES, MIN_MATCHES, Geometry, Observations
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
from wavefield.rig.lens import LENS, Array
from wavefield.rig.stereo import jacobians, solve_displacement, triangulate
from wavefield.rig.water_level import WaterPlane, level

MOVED_TURN = np.radians(1.0)  # prior standard deviations of a camera that may have moved, each axis
MOVED_SHIFT = 0.005  # m
CALIBRATED_TURN = np.radians(0.002)  # and of a camera that has not, if the rig file has no covariance
CALIBRATED_SHIFT = 2e-4  # m
MATCH_STD = 0.1  # px, chosen: standard uncertainty of a match per axis
FREE_TERMS = {column for columns in TERMS.values() for column in columns}  # lens parameters that a fit has

Matches = Mapping[str, ArrayLike]  # by camera: pixels (n, 2) of the same n points of the surface


def stack_matches(rig: Rig, matches: Matches) -> tuple[list[str], Array]:
    """Return the names of the matched cameras in the rig's order, and the matched pixels (n, cameras, 2).
    Raises a CalibrationError for fewer than two cameras, an unknown camera, or arrays of a wrong shape."""
    names = [name for name in rig if name in matches]
    unknown = [name for name in matches if name not in rig.cameras]
    if unknown:
        raise CalibrationError(f"matches are given for {', '.join(unknown)}, which the rig does not have")
    if len(names) < 2:
        raise CalibrationError("matches of two cameras at least are needed to check a rig")
    pixel = np.stack([np.asarray(matches[name], float) for name in names], axis=1)
    if pixel.ndim != 3 or pixel.shape[2] != 2:
        raise CalibrationError("matches are arrays (n, 2) of pixels, of the same length for all cameras")
    return names, pixel


def sight_points(rig: Rig, matches: Matches) -> tuple[Array, Array, Array, Array]:
    """Return the point nearest to the sight lines of each match, x, y, z, (n,) each, m, and residuals.
    The residuals are observed minus projected pixels, (n, cameras, 2)."""
    names, pixel = stack_matches(rig, matches)
    cameras = [rig[name] for name in names]
    apparent = np.stack([np.stack(c.unproject(*pixel[:, k].T)) for k, c in enumerate(cameras)])
    sight = np.stack([np.stack(c.sight_line(*p)) for c, p in zip(cameras, apparent)])
    point = np.stack(triangulate(apparent, sight)[:3], axis=-1)

    def misfit(point: Array) -> Array:
        return pixel - np.stack([np.stack(c.project(*point.T), -1) for c in cameras], axis=1)

    for _ in range(2):  # triangulation minimises distances on the plane z = 0; minimise them in pixels
        residual = misfit(point).reshape(len(point), -1)
        point = point + solve_displacement(jacobians(cameras, *point.T), residual)
    return point[:, 0], point[:, 1], point[:, 2], misfit(point)


@dataclass(frozen=True)
class Solution:
    """Camera parameters that best explain matched pixels; the result of `SightLineFit.solve`."""

    x: Array  # (p,): Steps from the calibrated rig
    misfit: float  # Robust distance by which sight lines then miss each other, px
    chi2: float  # Huber's loss of the matches and of the prior


class SightLineFit:
    """Least-squares fit of a rig's cameras to matched pixels, whose standard uncertainty is `MATCH_STD`.
    The calibration of the rig is the prior; the rig's provenance holds its covariance."""

    def __init__(self, rig: Rig, matches: Matches):
        self.names, pixel = stack_matches(rig, matches)
        in_two = np.isfinite(pixel).all(axis=2).sum(axis=1) >= 2
        usable = np.flatnonzero(in_two & np.isfinite(sight_points(rig, matches)[2]))
        if len(usable) < MIN_MATCHES:
            raise CalibrationError(
                f"{len(usable)} matches between cameras: {MIN_MATCHES} at least are needed to check a rig"
            )
        count = min(MAX_MATCHES, len(usable))
        self.pixel = pixel[usable[np.linspace(0, len(usable) - 1, count).astype(int)]]
        self.visible = np.isfinite(self.pixel).all(axis=2)
        self.rig, self.n = rig, len(self.pixel)
        cameras = [rig[name] for name in self.names]
        self.start = Geometry(
            np.array([[getattr(c, term) for term in LENS] for c in cameras]),
            np.stack([c.R for c in cameras]),
            np.stack([c.T for c in cameras]),
            np.eye(3)[None],
            np.zeros((1, 3)),
            np.zeros((self.n, 3)),
        )
        self.observations = Observations.of_points(
            tuple(self.names), tuple(c.size for c in cameras), ("world",), self.n
        )
        self.layout, covariance = _prior(rig, self.names, self.observations)
        scale = np.sqrt(np.diag(covariance))
        value, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
        # keep the covariance invertible: a calibration may determine some combinations far too well
        self.covariance = (axes * np.maximum(value, 1e-12)) @ axes.T * np.outer(scale, scale)

    @property
    def matches(self) -> dict[str, Array]:
        """The matched pixels (n, 2) that the fit uses, by camera; NaN if a camera does not see the point."""
        return {name: self.pixel[:, k] for k, name in enumerate(self.names)}

    def rig_at(self, x: Array) -> Rig:
        """Return the calibrated rig, changed by the parameter step x (p,)."""
        cameras = stepped(self.start, self.layout, x).cameras(self.observations.sizes)
        return Rig({**self.rig.cameras, **dict(zip(self.names, cameras))}, self.rig.provenance)

    def solve(self, free: Sequence[str]) -> Solution:
        """Return the most probable parameters if only the cameras named in `free` may have moved."""
        covariance = self.covariance.copy()
        for name in free:
            k = self.layout.camera[self.names.index(name)]
            covariance[range(k, k + 6), range(k, k + 6)] += np.repeat([MOVED_TURN**2, MOVED_SHIFT**2], 3)
        scale = np.sqrt(np.diag(covariance))
        root = np.linalg.cholesky(covariance / np.outer(scale, scale))
        prior = np.linalg.inv(root) / scale

        def with_jacobian(x: Array) -> tuple[Array, Array]:
            r, J = self._linearised(x)
            return np.concatenate([r.ravel(), prior @ x]), np.concatenate([J.reshape(-1, len(x)), prior])

        x, _ = minimise(
            lambda x: with_jacobian(x)[0], with_jacobian, np.zeros(len(self.layout.names)), HUBER_LIMIT, 1e-6
        )
        r = with_jacobian(x)[0]
        return Solution(x, self.misfit(r[: self.pixel.size]), huber(r, HUBER_LIMIT))

    def _linearised(self, x: Array) -> tuple[Array, Array]:
        """Return normalised residuals (n, 2C, 1) of C cameras, and derivatives (n, 2C, p) by x (p,), at x.
        The component that a shift of the matched point in space would explain is removed from both."""
        point = np.stack(sight_points(self.rig_at(x), self.matches)[:3], axis=-1)
        pixel, J, A = linearised(replace(self.start, offset=point), self.layout, x, self.observations)

        def by_point(values: Array) -> Array:
            """Reorder (C n, 2, ...) to (n, C, 2, ...), with 0 where a camera does not see the point."""
            own = np.moveaxis(values.reshape(len(self.names), self.n, 2, -1), 0, 1)
            return np.ascontiguousarray(np.where(self.visible[..., None, None], own, 0.0))

        r = by_point(pixel) - np.where(self.visible[..., None], self.pixel, 0.0)[..., None]
        r = r.reshape(self.n, -1, 1) / MATCH_STD
        J = by_point(J).reshape(*r.shape[:2], -1) / MATCH_STD
        # eliminate the points: project out the residuals that a shift of each point removes
        Q = np.linalg.qr(by_point(A).reshape(*r.shape[:2], 3))[0]
        return r - Q @ (Q.transpose(0, 2, 1) @ r), J - Q @ (Q.transpose(0, 2, 1) @ J)

    def angle(self, solution: Solution, name: str) -> float:
        """Return the angle, degrees, by which `solution` turns the camera `name` from its calibrated pose."""
        k = self.layout.camera[self.names.index(name)]
        return float(np.degrees(np.linalg.norm(solution.x[k : k + 3])))

    def image_shift(self, solution: Solution, name: str) -> float:
        """Return the image shift, px, caused by the rotation of camera `name` in `solution`."""
        return self.rig[name].fx * float(np.radians(self.angle(solution, name)))

    def misfit(self, projected: Array) -> float:
        """Return the robust distance, px, by which sight lines miss each other.
        `projected` are residuals over `MATCH_STD`, without what shifts of the points explain."""
        norm = np.sqrt(np.sum(projected.reshape(self.n, -1) ** 2, axis=1)) * MATCH_STD
        # normalise by the median of a chi distribution with 2 cameras - 3 degrees of freedom
        median = np.sqrt(2 * gammaincinv(self.visible.sum(axis=1) - 1.5, 0.5))
        return float(np.median(norm / median))

    def misfit_at_start(self) -> float:
        """Return the robust distance by which sight lines miss each other in the calibrated rig, px."""
        residual = sight_points(self.rig, self.matches)[3]
        return self.misfit(np.where(self.visible[..., None], residual, 0.0).reshape(-1) / MATCH_STD)


def _prior(rig: Rig, names: list[str], observations: Observations) -> tuple[ParameterLayout, Array]:
    """Return the layout of the camera parameters and the prior covariance (p, p) of these parameters.
    The covariance comes from the rig's provenance. Without it, only camera poses are free, and default
    uncertainties are used."""
    stated = rig.provenance.get("covariance")
    columns: dict[str, list[str]] = {name: [] for name in names}
    if stated:
        for parameter in stated["parameters"]:
            name, column = parameter.rsplit(" ", 1)
            if name in columns and column in FREE_TERMS:
                columns[name].append(column)
    models = [
        [term for term, parts in TERMS.items() if all(part in columns[name] for part in parts)]
        for name in names
    ]
    plan = layout(observations, models, 0)
    if stated:
        order = {parameter: k for k, parameter in enumerate(stated["parameters"])}
        full = np.zeros((len(order), len(order)))
        for k, row in enumerate(stated["lower"]):
            full[k, : k + 1] = full[: k + 1, k] = row
        rows = [order[parameter] for parameter in plan.names]
        return plan, full[np.ix_(rows, rows)]
    covariance = np.zeros((len(plan.names), len(plan.names)))
    for k in plan.camera:
        covariance[range(k, k + 6), range(k, k + 6)] = np.repeat([CALIBRATED_TURN**2, CALIBRATED_SHIFT**2], 3)
    return plan, covariance


MIN_CHI2_DIFFERENCE = 40.0  # for one explanation to be better: with six parameters, 5 standard deviations
SHARP_MISFIT_PX = 0.3  # px: misfit of sharp images that were taken at one moment
MAX_TURN_RATIO = 20.0  # image shift by a camera's turn, over the misfit that the turn removes
WRONG_RIG_PX = 5.0  # px: a larger misfit means a wrong rig, not a moved camera
_WRONG_RIG = (
    "the rig does not fit these images; check the names of its cameras, the image size and crop, and, if the "
    "rig was converted, its lens terms"
)
_OTHER_CAUSES = "are the frames of the same moments (`offset`), sharp and bright, and is the rig theirs?"

Solutions = Mapping[str | None, Solution]  # by the camera that may have moved; None: no camera


@dataclass(frozen=True)
class RigCheck:
    """Result of `check_rig`: the distance by which sight lines miss, and the camera that has moved."""

    misfit: float  # Robust distance by which sight lines miss, px
    expected: float  # This distance after the best correction of the cameras, px
    moved: str | None  # The camera that has moved; None if none has, or if several explain the misfit
    faulty_cameras: tuple[str, ...]  # Cameras whose motion explains the misfit about equally well
    angle: float  # Angle by which the moved camera has turned, degrees
    sentence: str  # The result for the user
    refused: bool = False  # Whether matches cannot correct the rig, which then stays unchanged


def check_rig(rig: Rig, matches: Matches) -> RigCheck:
    """Check whether a camera has moved since the calibration, from matches on any water surface.

    Parameters
    ----------
    rig : Rig
        The calibrated rig. If its provenance holds no covariance of the parameters, defaults are used.
    matches : mapping of camera to array_like, (n, 2)
        Pixels of the same n points of the surface in each camera; NaN where a camera does not see a point.
        The surface may move.

    Returns
    -------
    RigCheck
        The misfit before and after a correction, px, and the camera that has moved.

    Raises
    ------
    CalibrationError
        If there are fewer than two cameras or fifty matches, or the rig does not have one of the cameras.
    """
    return _check(SightLineFit(rig, matches))[0]


def _check(problem: SightLineFit) -> tuple[RigCheck, Solutions]:
    """Decide whether a camera has moved, and which; return this result and the fits that were compared.
    The key of a fit is the name of the camera that was free to move, or None if none was."""
    solutions: dict[str | None, Solution] = {None: problem.solve(())}
    for name in problem.names:
        solutions[name] = problem.solve((name,))
    before = problem.misfit_at_start()
    expected = min(solution.misfit for solution in solutions.values())

    def unchanged(sentence: str, refused: bool) -> tuple[RigCheck, Solutions]:
        return RigCheck(before, expected, None, (), 0.0, sentence, refused), solutions

    if before > WRONG_RIG_PX and expected > SHARP_MISFIT_PX:
        return unchanged(f"sight lines miss by {before:.1f} px: {_WRONG_RIG}", refused=True)
    # normalise chi-squared by the misfit that remains, because the stated one may be wrong
    unit = max(expected / MATCH_STD, 1e-9) ** 2
    chi2 = {name: solution.chi2 / unit for name, solution in solutions.items()}
    # Matches hardly distinguish a turn of a camera from a shift that compensates it. A solution that turns a
    # camera much, but removes little misfit, is such a pair of turn and shift: that camera has not moved.
    turn = {name: problem.image_shift(solutions[name], name) for name in problem.names}
    removed = {name: np.sqrt(max(before**2 - solutions[name].misfit ** 2, 0.0)) for name in problem.names}
    movable = [name for name in problem.names if turn[name] < MAX_TURN_RATIO * removed[name]]
    best = min(movable or problem.names, key=lambda name: chi2[name])
    gain = chi2[None] - chi2[best]
    # sight lines also meet if the misfit is below the error of a match and no motion explains it
    meet = before < 1.1 * expected or (not movable and before < MATCH_STD)
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
    """Return the result of a check: camera `best` has moved, or no motion explains a large misfit.
    `faulty` are the cameras whose motion explains the misfit about equally well. `before` and `after` are the
    misfits, px, before and after the correction; `angle`, degrees, is the rotation of `best`."""
    if after > max(0.5 * before, SHARP_MISFIT_PX):
        text = f"sight lines miss by {before:.2f} px, and by {after:.2f} px with one turned: {_OTHER_CAUSES}"
        return RigCheck(before, after, None, faulty, angle, text)
    text = (
        f"{' or '.join(faulty)} has moved since the calibration (turned by about {angle:.3f} degrees): "
        f"sight lines miss by {before:.2f} px, and by {after:.2f} px once that is corrected; "
        "refine the rig from a record of still water"
    )
    return RigCheck(before, after, best if len(faulty) == 1 else None, faulty, angle, text)


def _refined(problem: SightLineFit, solution: Solution, check: RigCheck) -> Rig:
    """Return the rig with the cameras of `solution`; its provenance gets a summary named ``refined``."""
    note = {
        "misfit_before_px": check.misfit,
        "misfit_after_px": solution.misfit,
        "moved": list(check.faulty_cameras),
        "matches": problem.n,
    }
    return Rig(problem.rig_at(solution.x).cameras, {**problem.rig.provenance, "refined": note})


def refine_and_level(rig: Rig, matches: Matches) -> tuple[Rig, RigCheck, WaterPlane]:
    """Correct the cameras of a rig from matches on still water, and bring z = 0 to the water's plane.

    Parameters
    ----------
    rig : Rig
        The calibrated rig; the covariance in its provenance is the prior, with defaults if there is none.
    matches : mapping of camera to array_like, (n, 2)
        Pixels of the same n points of still water in each camera; NaN where a camera does not see a point.

    Returns
    -------
    rig : Rig
        The corrected rig, with z = 0 on the water.
    check : RigCheck
        The misfit before and after the correction, px, and the camera that had moved.
    plane : WaterPlane
        The water's plane before levelling; its ``rms``, metres, is the flatness of the measured water.

    Raises
    ------
    CalibrationError
        If there are too few cameras or matches, or an unknown camera, as in `check_rig`.
    RigError
        If the points of the water are on a line.
    """
    problem = SightLineFit(rig, matches)
    check, solutions = _check(problem)
    candidates: dict[str | None, Rig] = {None: rig}
    if not check.refused:
        names = check.faulty_cameras or (None,)
        candidates = {name: _refined(problem, solutions[name], check) for name in names}
    levelled = {name: level(new, *sight_points(new, matches)[:3]) for name, new in candidates.items()}
    tilt = {name: float(np.hypot(*plane.slope)) for name, (_, plane) in levelled.items()}
    best = min(tilt, key=lambda name: tilt[name])
    if len(tilt) > 1:
        # Sight lines alone do not tell which of these cameras has moved. But the rig was level with the
        # water, and correcting a wrong camera tilts the water's plane.
        faulty = tuple(name for name in check.faulty_cameras if tilt[name] < 3.0 * tilt[best])
        angle = problem.angle(solutions[best], str(best))
        check = _moved_camera(str(best), faulty, angle, check.misfit, check.expected)
    return levelled[best][0], check, levelled[best][1]
