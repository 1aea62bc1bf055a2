"""Corrections of the cameras from images of still, seeded water."""

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
    moved,
)
from wavefield.calibration.observations import MAX_MATCHES, MIN_MATCHES, Geometry, Observations
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
from wavefield.rig.lens import LENS, Array
from wavefield.rig.stereo import jacobians, solve_displacement, triangulate
from wavefield.rig.water_level import WaterPlane, level

MOVED_TURN = np.radians(1.0)  # prior of a camera that may have moved
MOVED_SHIFT = 0.005  # metres
CALIBRATED_TURN = np.radians(0.002)  # prior of a camera without a covariance in the rig's file
CALIBRATED_SHIFT = 2e-4  # metres
FREE_TERMS = {column for columns in TERMS.values() for column in columns}

Matches = Mapping[str, ArrayLike]  # by camera: pixels (n, 2) of the same points of the surface


def stack_matches(rig: Rig, matches: Matches) -> tuple[list[str], Array]:
    """Cameras in the rig's order, and their matched pixels, (n, cameras, 2)."""
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
    """Points x, y, z (n,), metres, where the sight lines of matched pixels meet, and the misfit in pixels.
    The misfit, (n, cameras, 2), is observed less re-projected, in the rig's order of the matches' cameras.
    """
    names, pixel = stack_matches(rig, matches)
    cameras = [rig[name] for name in names]
    apparent = np.stack([np.stack(c.unproject(*pixel[:, k].T)) for k, c in enumerate(cameras)])
    sight = np.stack([np.stack(c.sight_line(*p)) for c, p in zip(cameras, apparent)])
    point = np.stack(triangulate(apparent, sight)[:3], axis=-1)

    def misfit(point: Array) -> Array:
        return pixel - np.stack([np.stack(c.project(*point.T), -1) for c in cameras], axis=1)

    for _ in range(2):  # from least squares on the plane to least squares in pixels
        residual = misfit(point).reshape(len(point), -1)
        point = point + solve_displacement(jacobians(cameras, *point.T), residual)[0]
    return point[:, 0], point[:, 1], point[:, 2], misfit(point)


@dataclass(frozen=True)
class Solution:
    """Most probable parameters of the cameras, with their covariance."""

    x: Array  # (p,): Relative to the rig as it is
    misfit: float  # Robust distance of sight lines, px
    chi2: float  # With the prior's part


class SightLineFit:
    """Least squares of matched pixels for the cameras' parameters, with the calibration as prior."""

    def __init__(self, rig: Rig, matches: Matches, std: float):
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
        self.rig, self.std, self.n = rig, std, len(self.pixel)
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
        # no calibration determines a combination of parameters better than that
        self.covariance = (axes * np.maximum(value, 1e-12)) @ axes.T * np.outer(scale, scale)

    @property
    def matches(self) -> dict[str, Array]:
        """Matched pixels used in the fit, by camera."""
        return {name: self.pixel[:, k] for k, name in enumerate(self.names)}

    def rig_at(self, x: Array) -> Rig:
        """The rig with its cameras moved by parameters."""
        cameras = moved(self.start, self.layout, x).cameras(self.observations.sizes)
        return Rig({**self.rig.cameras, **dict(zip(self.names, cameras))}, self.rig.provenance)

    def solve(self, loose: Sequence[str]) -> Solution:
        """Most probable parameters if the cameras named may have moved."""
        covariance = self.covariance.copy()
        for name in loose:
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
        """Normalised residuals (n, 2 cameras, 1) and derivatives (n, 2 cameras, p), the points eliminated."""
        point = np.stack(sight_points(self.rig_at(x), self.matches)[:3], axis=-1)
        pixel, J, A = linearised(replace(self.start, offset=point), self.layout, x, self.observations)

        def by_point(values: Array) -> Array:
            """Reorder (cameras n, 2, ...) to (n, cameras, 2, ...); zero if a camera does not see a point."""
            own = np.moveaxis(values.reshape(len(self.names), self.n, 2, -1), 0, 1)
            return np.ascontiguousarray(np.where(self.visible[..., None, None], own, 0.0))

        r = by_point(pixel) - np.where(self.visible[..., None], self.pixel, 0.0)[..., None]
        r = r.reshape(self.n, -1, 1) / self.std
        J = by_point(J).reshape(*r.shape[:2], -1) / self.std
        # the residual that the point itself can remove is no misfit: project it out
        Q = np.linalg.qr(by_point(A).reshape(*r.shape[:2], 3))[0]
        return r - Q @ (Q.transpose(0, 2, 1) @ r), J - Q @ (Q.transpose(0, 2, 1) @ J)

    def angle(self, solution: Solution, name: str) -> float:
        """Angle by which a solution turns a camera, degrees."""
        k = self.layout.camera[self.names.index(name)]
        return float(np.degrees(np.linalg.norm(solution.x[k : k + 3])))

    def turn(self, solution: Solution, name: str) -> float:
        """By how much a solution's turn shifts a camera's image, px."""
        return self.rig[name].fx * float(np.radians(self.angle(solution, name)))

    def misfit(self, projected: Array) -> float:
        """Robust distance by which sight lines miss each other, px, from normalised residuals."""
        norm = np.sqrt(np.sum(projected.reshape(self.n, -1) ** 2, axis=1)) * self.std
        # each point's misfit, made comparable to a standard deviation by its degrees of freedom
        median = np.sqrt(2 * gammaincinv(self.visible.sum(axis=1) - 1.5, 0.5))  # of chi
        return float(np.median(norm / median))

    def misfit_at_start(self) -> float:
        """The same for the rig as it is."""
        residual = sight_points(self.rig, self.matches)[3]
        return self.misfit(np.where(self.visible[..., None], residual, 0.0).reshape(-1) / self.std)


def _prior(rig: Rig, names: list[str], observations: Observations) -> tuple[ParameterLayout, Array]:
    """Parameters of the cameras and their covariance, from the calibration if the rig's file holds it."""
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
    refused: bool = False  # Whether matches cannot correct the rig, which is left as it is


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
    rig : Rig
        As calibrated; the covariance in its file is the prior.
    matches : mapping of camera to array_like, (n, 2)
        Pixels of the same pieces of still water in each camera; NaN where a camera has none.
    std : float, default 0.1
        Standard uncertainty of a match per axis, px.

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
