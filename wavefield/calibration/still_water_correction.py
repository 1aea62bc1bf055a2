"""After the fact: has a camera moved, and how to mend the rig from matches between its cameras.

Matched pixels of any record over-determine the rig: the sight lines of one bead must meet. What they
cannot tell is where the water's plane is; that takes a record at rest.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from wavefield.calibration.least_squares import minimise
from wavefield.calibration.observations import Geometry, Observations
from wavefield.calibration.parameters import TERMS, ParameterLayout, layout, linearised, moved
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
from wavefield.rig.epipolar import epipolar_distance
from wavefield.rig.lens import LENS, Array
from wavefield.rig.stereo import jacobians, solve_displacement, triangulate
from wavefield.rig.water_level import WaterPlane, level
from wavefield.robust import robust_std

MOST = 3000  # matches used: more tell no more
KNOCK_ANGLE = np.radians(1.0)  # what a knocked camera may have turned
KNOCK_SHIFT = 0.005  # and shifted, metres
ALIKE = 40.0  # difference of chi2 that tells two explanations apart
UNLIKE = 0.3  # px: sharp images of one moment match better than this
FAR = 20.0  # times what it mends: a knock does not move the image further than that
ASTRAY = 5.0  # px: no knocked camera, but another rig
_ASTRAY = (
    "the rig does not fit these images; are its cameras named as theirs, is it of this image size and crop, "
    "and did its lens come through the conversion?"
)
_OTHERWISE = "are the frames of the same moments (`offset`), sharp and bright, and is the rig theirs?"
FREE = ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y")

Matches = Mapping[str, ArrayLike]


@dataclass(frozen=True)
class RigCheck:
    """Whether the sight lines of matched pixels meet."""

    misfit: float  # Robust scatter by which they miss, px
    expected: float  # What it would be if no camera had moved, px: with all cameras free to move
    # The camera that has moved; None if none has, or if several fit alike (see ``suspects``)
    moved: str | None
    faulty_cameras: tuple[str, ...]  # Cameras whose motion explains the misfit about equally well
    angle: float  # By how much the moved camera has turned, degrees
    sentence: str  # All this for a person
    refused: bool = False  # Whether the rig is beyond mending by matches: `refine` leaves it as it is


def sight_points(rig: Rig, matches: Matches) -> tuple[Array, Array, Array, Array]:
    """Points where the sight lines of matched pixels meet.

    With matches (n, 2); returns x, y, z (n,): Metres; misfit (n, N, 2): Observed less re-projected pixels in
    the order of the matches' cameras, px.
    """
    names, pixel = _stack(rig, matches)
    apparent = np.stack([np.stack(rig[name].unproject(*pixel[:, k].T)) for k, name in enumerate(names)])
    sight = np.stack([np.stack(rig[name].sight_line(*p)) for name, p in zip(names, apparent)])
    point = np.stack(triangulate(apparent, sight)[:3], axis=-1)
    cameras = [rig[name] for name in names]
    for _ in range(2):  # from least squares on the plane to least squares in pixels
        miss = pixel - np.stack([np.stack(c.project(*point.T), -1) for c in cameras], axis=1)
        step = solve_displacement(jacobians(cameras, *point.T), miss.reshape(len(point), -1))[0]
        point = point + step
    miss = pixel - np.stack([np.stack(c.project(*point.T), -1) for c in cameras], axis=1)
    return point[:, 0], point[:, 1], point[:, 2], miss


def _stack(rig: Rig, matches: Matches) -> tuple[list[str], Array]:
    names = [name for name in rig if name in matches]
    strange = [name for name in matches if name not in rig.cameras]
    if strange:
        raise CalibrationError(f"matches are given for {', '.join(strange)}, which the rig does not have")
    if len(names) < 2:
        raise CalibrationError("matches of two cameras at least are needed to check a rig")
    pixel = np.stack([np.asarray(matches[name], float) for name in names], axis=1)
    if pixel.ndim != 3 or pixel.shape[2] != 2:
        raise CalibrationError("matches are arrays (n, 2) of pixels, of the same length for all cameras")
    return names, pixel


class _Problem:
    """Misfit of matched pixels as a function of the cameras' parameters, with their prior."""

    def __init__(self, rig: Rig, matches: Matches, std: float):
        self.names, pixel = _stack(rig, matches)
        keep = (np.isfinite(pixel).all(axis=2).sum(axis=1) >= 2) & np.isfinite(sight_points(rig, matches)[2])
        if keep.sum() < 50:
            raise CalibrationError(
                f"{keep.sum()} matches between cameras: fifty at least are needed to check a rig"
            )
        chosen = np.flatnonzero(keep)
        chosen = chosen[np.linspace(0, len(chosen) - 1, min(MOST, len(chosen))).astype(int)]
        self.pixel = pixel[chosen]
        n, C = self.pixel.shape[:2]
        self.seen = np.isfinite(self.pixel).all(axis=2)
        self.rig, self.std, self.n, self.C = rig, std, n, C
        cameras = [rig[name] for name in self.names]
        self.start = Geometry(
            np.array([[getattr(c, term) for term in LENS] for c in cameras]),
            np.stack([c.R for c in cameras]),
            np.stack([c.T for c in cameras]),
            np.eye(3)[None],
            np.zeros((1, 3)),
            np.zeros((n, 3)),
        )
        self.observations = Observations(
            tuple(self.names),
            ("world",),
            tuple(c.size for c in cameras),
            np.zeros((n, 2), np.int64),
            1.0,
            np.tile(np.arange(C), n),
            np.zeros(n * C, np.int64),
            np.repeat(np.arange(n), C),
            np.where(self.seen[..., None], self.pixel, 0.0).reshape(-1, 2),
            np.full(n * C, std),
        )
        self.layout, covariance = _prior(rig, self.names, self.observations)
        scale = np.sqrt(np.diag(covariance))
        value, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
        # what the calibration knows better than that is known by no one
        self.covariance = (axes * np.maximum(value, 1e-12)) @ axes.T * np.outer(scale, scale)

    def geometry(self, x: Array) -> Geometry:
        return moved(self.start, self.layout, x)

    def rig_at(self, x: Array) -> Rig:
        g = self.geometry(x)
        new = {
            name: g.camera(k, self.observations.sizes[k]) if (k := self._index(name)) is not None else camera
            for name, camera in self.rig.cameras.items()
        }
        return Rig(new, self.rig.provenance)

    def _index(self, name: str) -> int | None:
        return self.names.index(name) if name in self.names else None

    def solve(self, loose: tuple[str, ...]) -> tuple[Array, float, float]:
        """Most probable parameters if the cameras named may have been knocked: (x, misfit px, chi2)."""
        covariance = self.covariance.copy()
        for name in loose:
            k = self.layout.camera[self.names.index(name)]
            covariance[range(k, k + 6), range(k, k + 6)] += np.repeat([KNOCK_ANGLE**2, KNOCK_SHIFT**2], 3)
        scale = np.sqrt(np.diag(covariance))
        root = np.linalg.cholesky(covariance / np.outer(scale, scale))
        prior = np.linalg.inv(root) / scale

        def with_jacobian(x: Array) -> tuple[Array, Array]:
            point = np.stack(sight_points(self.rig_at(x), self._matches())[:3], axis=-1)
            begin = replace(self.start, offset=point)
            pixel, J, A = linearised(begin, self.layout, x, self.observations)
            seen = self.seen[..., None, None]
            shape = (self.n, self.C, 2, -1)
            r = np.where(seen[..., 0], (pixel - self.observations.pixel).reshape(self.n, self.C, 2), 0.0)
            J = np.where(seen, J.reshape(shape), 0.0).reshape(self.n, 2 * self.C, -1) / self.std
            A = np.where(seen, A.reshape(shape), 0.0).reshape(self.n, 2 * self.C, 3)
            r = r.reshape(self.n, 2 * self.C, 1) / self.std
            # what the point itself takes up is no misfit: project it out
            Q = np.linalg.qr(A)[0]
            r, J = r - Q @ (Q.transpose(0, 2, 1) @ r), J - Q @ (Q.transpose(0, 2, 1) @ J)
            return (
                np.concatenate([r.ravel(), prior @ x]),
                np.concatenate([J.reshape(-1, len(x)), prior]),
            )

        x, _, _ = minimise(
            lambda x: with_jacobian(x)[0], with_jacobian, np.zeros(len(self.layout.names)), 4.0, 1e-6
        )
        r = with_jacobian(x)[0]
        matched = r[: 2 * self.n * self.C]
        loss = np.where(np.abs(r) <= 4.0, r * r, 8.0 * np.abs(r) - 16.0)
        return x, self.misfit(matched), float(loss.sum())

    def angle(self, x: Array, name: str) -> float:
        """By how much parameters turn a camera, degrees."""
        k = self.layout.camera[self.names.index(name)]
        return float(np.degrees(np.linalg.norm(x[k : k + 3])))

    def turn(self, x: Array, name: str) -> float:
        """By how much parameters turn a camera, px of its image."""
        return self.rig[name].fx * float(np.radians(self.angle(x, name)))

    def _matches(self) -> dict[str, Array]:
        return {name: self.pixel[:, k] for k, name in enumerate(self.names)}

    def misfit(self, projected: Array) -> float:
        """Robust scatter of a pixel, px, from residuals of which three per point were taken up."""
        norm = np.sqrt(np.sum(projected.reshape(self.n, -1) ** 2, axis=1)) * self.std
        # each point's misfit, made comparable to a standard deviation by its degrees of freedom
        median = np.sqrt(2 * gammaincinv(self.seen.sum(axis=1) - 1.5, 0.5))  # of chi
        return float(np.median(norm / median))


def _prior(rig: Rig, names: list[str], observations: Observations) -> tuple[ParameterLayout, Array]:
    """Parameters of the cameras and their covariance, from the calibration if the rig carries it."""
    stated = rig.provenance.get("covariance")
    requested: dict[str, list[str]] = {name: [] for name in names}
    if stated:
        for parameter in stated["parameters"]:
            name, what = parameter.rsplit(" ", 1)
            if name in requested and what in FREE:
                requested[name].append(what)
    plan = layout(observations, [_terms(requested[name]) for name in names], 0)
    covariance = np.zeros((len(plan.names), len(plan.names)))
    if stated:
        known = {parameter: k for k, parameter in enumerate(stated["parameters"])}
        full = np.zeros((len(known), len(known)))
        for k, row in enumerate(stated["lower"]):
            full[k, : k + 1] = full[: k + 1, k] = row
        pick = [known[parameter] for parameter in plan.names]
        covariance = full[np.ix_(pick, pick)]
    else:
        for k in plan.camera:
            covariance[range(k, k + 6), range(k, k + 6)] = np.repeat([np.radians(0.002) ** 2, 2e-4**2], 3)
    return plan, covariance


def _terms(columns: list[str]) -> list[str]:
    return [term for term, parts in TERMS.items() if all(part in columns for part in parts)]


def check_rig(rig: Rig, matches: Matches, std: float = 0.1) -> RigCheck:
    """Check on any record whether a camera has moved since the calibration.

    Parameters
    ----------
    rig : Rig
        As calibrated; its file carries the covariance.
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
    return _check(_Problem(rig, matches, std))[0]


def _check(problem: _Problem) -> tuple[RigCheck, dict[str | None, tuple[Array, float, float]]]:
    found: dict[str | None, tuple[Array, float, float]] = {None: problem.solve(())}
    for name in problem.names:
        found[name] = problem.solve((name,))
    misfit_as_it_is = _misfit_at_start(problem)
    expected = min(f[1] for f in found.values())
    # in units of the scatter that is there, not of the one stated
    unit = max(expected / problem.std, 1e-9) ** 2
    chi2 = {name: f[2] / unit for name, f in found.items()}
    before = misfit_as_it_is
    if before > ASTRAY and expected > UNLIKE:
        text = f"sight lines miss by {before:.1f} px: {_ASTRAY}"
        return RigCheck(before, expected, None, (), 0.0, text, refused=True), found
    motion = {name: problem.turn(found[name][0], name) for name in problem.names}
    # a turn that would move the image much further than it mends, but for a shift that undoes it, is no
    # knock: matches do not tell the two apart
    repaired = {name: np.sqrt(max(before**2 - found[name][1] ** 2, 0.0)) for name in problem.names}
    movable = [name for name in problem.names if motion[name] < FAR * repaired[name]]
    best = min(movable or problem.names, key=lambda name: chi2[name])
    gain = chi2[None] - chi2[best]
    # what no knock explains, and is less than a match's own error, is nothing
    meet = before < 1.1 * expected or (not movable and before < problem.std)
    if not movable and gain >= ALIKE and not meet:
        angle = problem.angle(found[best][0], best)
        text = (
            f"sight lines miss by {before:.2f} px; turning {best} by {angle:.2f} degrees would mend "
            f"{before - found[best][1]:.2f} px and turn its view by {motion[best]:.0f} px, so it is no "
            "knock and is not mended: calibrate again, or look for what the lens model lost on its way"
        )
        return RigCheck(before, expected, None, (), 0.0, text, refused=True), found
    if gain < ALIKE or meet:
        text = f"no camera has moved: sight lines meet within {misfit_as_it_is:.2f} px"
        if misfit_as_it_is > UNLIKE:
            text = f"sight lines miss by {misfit_as_it_is:.2f} px, and no camera has moved: {_OTHERWISE}"
        return RigCheck(misfit_as_it_is, expected, None, (), 0.0, text), found
    faulty_cameras = tuple(n for n in movable if chi2[n] - chi2[best] < max(ALIKE, 1e-4 * gain))
    return _verdict(problem, found, best, faulty_cameras, misfit_as_it_is, expected), found


def _verdict(
    problem: _Problem,
    found: Mapping[str | None, tuple[Array, float, float]],
    best: str,
    faulty_cameras: tuple[str, ...],
    before: float,
    after: float,
) -> RigCheck:
    angle = problem.angle(found[best][0], best)
    if after > max(0.5 * before, UNLIKE):
        text = f"sight lines miss by {before:.2f} px, and by {after:.2f} px with one turned: {_OTHERWISE}"
        return RigCheck(before, after, None, faulty_cameras, angle, text)
    text = (
        f"{' or '.join(faulty_cameras)} has moved since the calibration (turned by about {angle:.3f} "
        f"degrees): "
        f"sight lines miss by {before:.2f} px, and by {after:.2f} px once that is mended; "
        "refine the rig from a record at rest"
    )
    return RigCheck(before, after, best if len(faulty_cameras) == 1 else None, faulty_cameras, angle, text)


def _misfit_at_start(problem: _Problem) -> float:
    miss = sight_points(problem.rig, problem._matches())[3]
    return problem.misfit(np.where(problem.seen[..., None], miss, 0.0).reshape(-1) / problem.std)


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
        Refined. Level it afterwards (`refine_and_level`): sight lines say nothing of the water's plane.
    check : RigCheck
        What had been wrong.
    """
    problem = _Problem(rig, matches, std)
    verdict, found = _check(problem)
    if verdict.refused:
        return rig, verdict
    # where several cameras may be at fault, all of them are set free: the prior shares the motion out
    solution = (
        problem.solve(verdict.faulty_cameras) if len(verdict.faulty_cameras) > 1 else found[verdict.moved]
    )
    return _refined(problem, solution, verdict), verdict


def _refined(problem: _Problem, solution: tuple[Array, float, float], verdict: RigCheck) -> Rig:
    x, after, _ = solution
    note = {
        "misfit_before_px": verdict.misfit,
        "misfit_after_px": after,
        "moved": list(verdict.faulty_cameras),
        "matches": problem.n,
    }
    return Rig(problem.rig_at(x).cameras, {**problem.rig.provenance, "refined": note})


def refine_and_level(rig: Rig, matches: Matches, std: float = 0.1) -> tuple[Rig, RigCheck, WaterPlane]:
    """Refine a rig from a record at rest, and bring z = 0 to the water's plane.

    Parameters
    ----------
    rig, matches, std
        As `refine`, of a record of the water at rest.

    Returns
    -------
    rig : Rig
        Refined and levelled.
    check : RigCheck
        What had been wrong.
    plane : Plane
        The water's plane before levelling; its ``rms`` says how flat it was.
    """
    problem = _Problem(rig, matches, std)
    verdict, found = _check(problem)
    candidates: dict[str | None, Rig] = {None: rig}
    if not verdict.refused:
        names = verdict.faulty_cameras or (None,)
        candidates = {name: _refined(problem, found[name], verdict) for name in names}
    levelled = {name: level(new, *sight_points(new, matches)[:3]) for name, new in candidates.items()}
    tilt = {name: float(np.hypot(*plane.slope)) for name, (_, plane) in levelled.items()}
    best = min(tilt, key=lambda name: tilt[name])
    if len(tilt) > 1:
        # sight lines alone do not tell these apart; but the target lay on the water, so the wrong
        # explanation tilts the water's plane
        faulty_cameras = tuple(name for name in verdict.faulty_cameras if tilt[name] < 3.0 * tilt[best])
        verdict = _verdict(problem, found, str(best), faulty_cameras, verdict.misfit, verdict.expected)
    return levelled[best][0], verdict, levelled[best][1]


def misfit(rig: Rig, matches: Matches) -> dict[tuple[str, str], float]:
    """Robust distance of matched pixels from each other's epipolar lines.

    With matches (n, 2); returns (camera, camera): Per pair of cameras, px in the second one's image.
    """
    names, pixel = _stack(rig, matches)
    out = {}
    for i, a in enumerate(names):
        for j in range(i + 1, len(names)):
            d = epipolar_distance(rig[a], rig[names[j]], *pixel[:, i].T, *pixel[:, j].T)
            out[a, names[j]] = robust_std(d[np.isfinite(d)])
    return out
