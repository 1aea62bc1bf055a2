"""Do the cameras take their frames at the same moment? What misses across the sight lines says it.

A camera that is late by tau sees every bead tau times its velocity further on. Along the parallax of two
cameras that is taken for height; across it no height does that, and the miss (eps_y) is tau times the
velocity across the sight lines, patch by patch: one regression over some instants gives tau. A camera that
has moved or shakes misses by something low-order in space (constant, tilt, roll), which every instant has of
its own and which is taken out.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wavefield.cubes.witness import ALIKE, SIDE, Array, Pair, Witness, compare
from wavefield.robust import PER_MEDIAN
from wavefield.store.verdict import Remark

_APART = 5  # blocks: nearer ones share their window, and say the same
_FEWEST = 40  # blocks of an instant
_SURE = 4.0  # standard deviations
_SHORTEST = 2e-5  # s: less is noted nowhere
_MATTERS = 0.1  # px that a bead moves meanwhile


@dataclass(frozen=True)
class Delay:
    """By how much one camera's frames are taken later than the others'.

    Parameters
    ----------
    seconds : float
        Negative if earlier.
    std : float
        Standard uncertainty, s.
    """

    seconds: float
    std: float


@dataclass(frozen=True)
class Sample:
    """What two cameras say of one instant.

    Parameters
    ----------
    miss : ndarray, (m,)
        eps_y, px on the water.
    velocity : ndarray, (m,)
        Of the beads across the sight lines, px per frame.
    low : ndarray, (m, 3)
        Constant, and places scaled to -1 to 1 along x and y.
    speed : float
        Of the beads in all directions, rms, px per frame.
    """

    miss: Array
    velocity: Array
    low: Array
    speed: float = 0.0


def sample(plan: Any, witness: Witness, pair: Pair, frame: int) -> Sample | None:
    """Miss and velocity all over what two cameras share at an instant.

    Parameters
    ----------
    plan : wavefield.measurement.Plan
        Matches the cameras.
    witness : Witness
        Their images, and how fast the second's beads move.
    pair : (str, str)
        One of the plan's.
    frame : int
        When; the second's frames before and after it are looked at, too.

    Returns
    -------
    Sample or None
        None where images are missing or next to nothing is found.
    """
    from wavefield.measurement import surface
    from wavefield.measurement.frame import ready, usable

    images = {name: witness.read(name, frame) for name in pair}
    if not all(usable(image, plan.rig[name].size) for name, image in images.items()):
        return None
    drift = _drift(witness, pair[1], frame)
    if drift is None:
        return None
    flat = [
        surface.prepare(ready(np.asarray(image), plan.binning[name]), name, plan)
        for name, image in images.items()
    ]
    match = surface.match_pair(flat[0], flat[1], pair, plan)
    cells = np.s_[::_APART, ::_APART]
    length = np.maximum(np.hypot(*match.parallax), 1e-12)
    x, y = (v[cells] for v in np.meshgrid(plan.lattice.x, plan.lattice.y))
    at = [(v + d[cells]).ravel() for v, d in zip((x, y), match.difference)]
    moved = drift(*at).reshape(*x.shape, 2) * witness.pixel
    p, q = (part[cells] / length[cells] for part in match.parallax)
    velocity = (q * moved[..., 0] - p * moved[..., 1]) / plan.pixel
    miss = match.eps_y[cells] / plan.pixel
    good = match.matched[cells] & np.isfinite(velocity) & np.isfinite(miss)
    if good.sum() < _FEWEST:
        return None
    low = np.stack([np.ones(good.sum()), _scaled(x[good]), _scaled(y[good])], axis=-1)
    speed = float(np.sqrt((moved[good] ** 2).sum(axis=1).mean())) / plan.pixel
    return Sample(miss[good].astype(float), velocity[good].astype(float), low, speed)


def _drift(witness: Witness, name: str, frame: int) -> Callable[[Array, Array], Array] | None:
    """How far what one camera shows at a place moves in a frame, px: from its frames before and after."""
    now = witness.patches(name, frame)
    before, after = (compare(now, witness.patches(name, frame + k)) for k in (-1, 1))
    if before is None or after is None:
        return None
    moved = (after.moved - before.moved) / 2
    known = (before.likeness > ALIKE) & (after.likeness > ALIKE) & np.isfinite(moved).all(axis=1)
    if known.sum() < 8:
        return None
    places, values = np.stack([witness.x, witness.y], axis=-1)[known], moved[known]
    width = SIDE * witness.pixel

    def at(x: Array, y: Array) -> Array:
        # straight lines through the patches around, weighted by their distance
        apart = (places[None] - np.stack([x, y], axis=-1)[:, None]) / width
        weight = np.exp(-0.5 * (np.nan_to_num(apart, nan=1e3) ** 2).sum(axis=2))
        design = np.concatenate([np.ones((*apart.shape[:2], 1)), np.nan_to_num(apart)], axis=2)
        normal = np.einsum("nk,nki,nkj->nij", weight, design, design) + 1e-6 * np.eye(3)
        right = np.einsum("nk,nki,kc->nic", weight, design, values)
        found = np.linalg.solve(normal, right)[:, 0]
        return np.where((weight.sum(axis=1) > 1.0)[:, None], found, np.nan)

    return at


def _scaled(v: Array) -> Array:
    return np.asarray((v - v.mean()) / max(float(np.ptp(v)) / 2, 1e-12))


def regress(samples: Sequence[Sample]) -> tuple[float, float] | None:
    """The delay of the second camera behind the first, in frames.

    Parameters
    ----------
    samples : sequence of Sample
        Of one pair of cameras, one for each instant.

    Returns
    -------
    delay, std : float
        Or None if there is too little to say.

    Notes
    -----
    Robust least squares (Huber at 2.5); every instant has a constant and slopes of its own. The uncertainty
    is that of instants, not of patches: residuals of one instant may depend on each other.
    """
    if len(samples) < 2:
        return None
    weights = [np.ones(len(s.miss)) for s in samples]
    delay = 0.0
    for _ in range(8):
        cleared = [_cleared(s, w) for s, w in zip(samples, weights)]
        power = sum(float((w * v * v).sum()) for (_, v), w in zip(cleared, weights))
        if power <= 0:
            return None
        delay = sum(float((w * v * y).sum()) for (y, v), w in zip(cleared, weights)) / power
        left = [y - delay * v for y, v in cleared]
        scale = PER_MEDIAN * float(np.median(np.abs(np.concatenate(left)))) + 1e-9
        weights = [np.minimum(1.0, 2.5 * scale / np.maximum(np.abs(r), 1e-12)) for r in left]
    scores = np.array([float((w * v * r).sum()) for w, (_, v), r in zip(weights, cleared, left)])
    count = len(samples)
    return delay, float(np.sqrt((scores**2).sum() * count / (count - 1))) / power


def _cleared(one: Sample, weight: Array) -> tuple[Array, Array]:
    """Miss and velocity without what a constant and slopes explain of them."""
    root = np.sqrt(weight)[:, None]
    both = np.stack([one.miss, one.velocity], axis=-1)
    fit = np.linalg.lstsq(root * one.low, root * both, rcond=None)[0]
    rest = both - one.low @ fit
    return rest[:, 0], rest[:, 1]


def delays(plan: Any, witness: Witness, frames: Sequence[int], rate: float) -> tuple[dict[str, Delay], float]:
    """By how much each camera's frames are taken later than those of most.

    Parameters
    ----------
    plan : wavefield.measurement.Plan
        Matches the cameras.
    witness : Witness
        The cameras.
    frames : sequence of int
        Instants, none of them the first or the last frame.
    rate : float
        Frames per second.

    Returns
    -------
    delays : dict of str to Delay
        Empty if there is too little to say; with two cameras the second's against the first's.
    speed : float
        Of the water in images, rms, px/s.
    """
    names = list(plan.surface_cameras)
    rows, values, spreads = [], [], []
    speeds: list[float] = []
    for a, b in plan.pairs:
        samples = [s for k in frames if (s := sample(plan, witness, (a, b), k)) is not None]
        speeds += [s.speed for s in samples]
        found = regress(samples)
        if found is not None:
            rows.append([float(name == b) - float(name == a) for name in names])
            values.append(found[0] / rate)
            spreads.append(max(found[1] / rate, 1e-7))
    if not rows or np.linalg.matrix_rank(rows) < len(names) - 1:
        return {}, 0.0
    design = np.array(rows) / np.array(spreads)[:, None]
    # only differences are known: the middle of the cameras, or the first of two, is taken for right
    design = np.vstack([design, np.eye(len(names))[:1] * 1e9])
    wanted = np.append(np.array(values) / spreads, 0.0)
    inverse = np.linalg.inv(design.T @ design)
    best = inverse @ design.T @ wanted
    usual = int(np.argsort(best)[(len(best) - 1) // 2]) if len(names) > 2 else 0
    out = {}
    for k, name in enumerate(names):
        difference = np.eye(len(names))[k] - np.eye(len(names))[usual]
        variance = float(difference @ inverse @ difference)
        out[name] = Delay(float(difference @ best), float(np.sqrt(max(variance, 0.0))))
    return out, rate * float(np.median(speeds))


def remarks(found: Mapping[str, Delay], speed: float) -> Iterator[Remark]:
    """What to say of delays.

    Parameters
    ----------
    found : mapping of str to Delay
        As from `delays`.
    speed : float
        Of the water in images, rms, px/s.

    Yields
    ------
    Remark
        For every camera whose frames surely are of other moments.
    """
    for name, one in found.items():
        if abs(one.seconds) < max(_SURE * one.std, _SHORTEST):
            continue
        off, word = abs(one.seconds) * speed, "later" if one.seconds > 0 else "earlier"
        yield Remark(
            name,
            "delayed",
            "remark" if off > _MATTERS else "note",
            f"its frames are taken {1e3 * abs(one.seconds):.3f} ms {word} than the others' "
            f"(+- {1e3 * one.std:.3f} ms): the water moves {off:.2f} px meanwhile",
            f"{_MATTERS} px at most",
            "trigger all cameras by one signal and give them one exposure time",
            {"delay": one.seconds, "std": one.std, "px": off},
        )


def sentence(found: Mapping[str, Delay]) -> str:
    """Delays of all cameras in a line.

    Parameters
    ----------
    found : mapping of str to Delay
        As from `delays`.

    Returns
    -------
    str

    Examples
    --------
    >>> sentence({"cam1": Delay(0.0, 0.0), "cam2": Delay(2e-4, 1e-5)})
    'cam2 is later than cam1 by 0.200 +- 0.010 ms'
    """
    first = next((name for name, one in found.items() if one.std == 0), "")
    words = [
        f"{name} is later than {first} by {1e3 * one.seconds:.3f} +- {1e3 * one.std:.3f} ms"
        for name, one in found.items()
        if name != first
    ]
    return "; ".join(words) or "too little moves, or matches, to tell"
