"""Do the cameras take their frames at the same moment? What misses across the sight lines says it.

A camera that is late by tau sees every bead tau times its velocity further on. Along the parallax of two
cameras that is taken for height; across it no height does that, and the miss (eps_y) is tau times the
velocity across the sight lines, patch by patch: one regression over some instants gives tau. A camera that
has moved or shakes misses by something low-order in space (constant, tilt, roll), which every instant has of
its own and which is taken out.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.cubes.witness import ALIKE, REACH, SIDE, Array, Pair, Witness, compare, pairs_of_all
from wavefield.store.verdict import Remark

_ROUNDS = 6
_FINE = 1 / 32  # px: cv2.remap knows no finer places
_FEWEST = 60  # patches over all instants
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
    """

    miss: Array
    velocity: Array
    low: Array


def register(
    first: NDArray[np.float32], second: NDArray[np.float32], start: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Find the middle of each patch in another to a few thousandths of a pixel, however it is sheared.

    Parameters
    ----------
    first, second : ndarray, (n, SIDE + 2 REACH, SIDE + 2 REACH)
        As from `Witness.patches`.
    start : ndarray, (n, 2)
        By how much they moved, to a pixel; NaN where that is not known.

    Returns
    -------
    moved : ndarray, (n, 2)
        By how much, px.
    good : ndarray of bool, (n,)
        Whether the patches are alike there.

    Notes
    -----
    Gauss-Newton with the mean of both gradients; shift, shear, gain and offset of every patch.
    """
    n, side = len(first), SIDE + 2 * REACH
    template = first[:, REACH : REACH + SIDE, REACH : REACH + SIDE]
    axis = (np.arange(SIDE) - (SIDE - 1) / 2) / (SIDE / 2)
    u, v = np.broadcast_to(axis, (SIDE, SIDE)), np.broadcast_to(axis[:, None], (SIDE, SIDE))
    tall = np.ascontiguousarray(second.reshape(n * side, side), np.float32)
    good = np.isfinite(start).all(axis=1) & np.isfinite(template).all(axis=(1, 2))
    shift = np.where(good[:, None], start, 0.0)
    shear = np.zeros((n, 2, 2))
    inner = np.arange(SIDE) + REACH
    top = np.arange(n)[:, None, None] * side
    step = np.zeros((n, 8))
    likeness = np.zeros(n)
    flat = np.where(good[:, None, None], template, 0.0)
    slope_t = np.gradient(flat, axis=(2, 1))
    for _ in range(_ROUNDS):
        shift = np.round(np.clip(shift + step[:, :2], -REACH + 2, REACH - 2) / _FINE) * _FINE
        shear = np.clip(shear + step[:, 2:6].reshape(n, 2, 2), -4.0, 4.0)
        column = (
            inner + shift[:, 0, None, None] + shear[:, 0, 0, None, None] * u + shear[:, 0, 1, None, None] * v
        )
        row = inner[:, None] + shift[:, 1, None, None]
        row = row + shear[:, 1, 0, None, None] * u + shear[:, 1, 1, None, None] * v
        good &= (np.abs(column - side / 2).max(axis=(1, 2)) < side / 2 - 3) & (
            np.abs(row - side / 2).max(axis=(1, 2)) < side / 2 - 3
        )
        at = [
            (part + offset).reshape(-1, SIDE).astype(np.float32) for part, offset in ((column, 0), (row, top))
        ]
        seen = cv2.remap(tall, at[0], at[1], cv2.INTER_CUBIC).reshape(n, SIDE, SIDE)
        good &= np.isfinite(seen).all(axis=(1, 2))
        seen = np.where(good[:, None, None], seen, 0.0)
        gx, gy = ((a + b) / 2 for a, b in zip(slope_t, np.gradient(seen, axis=(2, 1))))
        one = np.ones_like(seen)
        design = np.stack([gx, gy, gx * u, gx * v, gy * u, gy * v, seen, one], axis=-1).reshape(n, -1, 8)
        normal = np.einsum("nki,nkj->nij", design, design)
        normal += (1e-9 * np.trace(normal, axis1=1, axis2=2) + 1e-9)[:, None, None] * np.eye(8)
        wanted = np.einsum("nki,nk->ni", design, (flat - seen).reshape(n, -1))
        step = np.linalg.solve(normal, wanted[..., None])[..., 0]
        step[:, :6] = np.clip(step[:, :6], -1.0, 1.0)
        likeness = _likeness(flat, seen)
    moved = shift + step[:, :2]
    good &= (likeness > ALIKE) & (np.abs(step[:, :2]).max(axis=1) < 0.1)
    return moved, good & (np.abs(moved - np.nan_to_num(start)).max(axis=1) < 2.0)


def _likeness(a: NDArray[np.float32], b: NDArray[np.float32]) -> Array:
    a, b = (v - v.mean(axis=(1, 2), keepdims=True) for v in (a, b))
    power = np.sqrt((a * a).sum(axis=(1, 2)) * (b * b).sum(axis=(1, 2)))
    return np.asarray((a * b).sum(axis=(1, 2)) / np.maximum(power, 1e-9), float)


def sample(witness: Witness, pair: Pair, frame: int) -> Sample | None:
    """Miss and velocity of all patches that two cameras share at an instant.

    Parameters
    ----------
    witness : Witness
        The cameras.
    pair : (str, str)
        Which two; the second's velocity is taken.
    frame : int
        When; the second's frames before and after it are looked at, too.

    Returns
    -------
    Sample or None
        None where images are missing or next to nothing is found.
    """
    first, second = witness.patches(pair[0], frame), witness.patches(pair[1], frame)
    found, drift = compare(first, second), _drift(witness, pair[1], frame)
    if first is None or second is None or found is None or drift is None:
        return None
    moved, good = register(first, second, found.moved)
    across = witness.across(pair)[1]
    x, y = witness.x + moved[:, 0] * witness.pixel, witness.y + moved[:, 1] * witness.pixel
    miss, velocity = (moved * across).sum(axis=1), (drift(x, y) * across).sum(axis=1)
    good &= np.isfinite(velocity) & np.isfinite(miss)
    if good.sum() < 8:
        return None
    low = np.stack([np.ones(len(miss)), _scaled(witness.x), _scaled(witness.y)], axis=-1)
    return Sample(miss[good], velocity[good], low[good])


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
    if len(samples) < 2 or sum(len(s.miss) for s in samples) < _FEWEST:
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
        scale = 1.4826 * float(np.median(np.abs(np.concatenate(left)))) + 1e-9
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


def delays(witness: Witness, frames: Sequence[int], rate: float) -> dict[str, Delay]:
    """By how much each camera's frames are taken later than those of most.

    Parameters
    ----------
    witness : Witness
        The cameras.
    frames : sequence of int
        Instants, none of them the first or the last frame.
    rate : float
        Frames per second.

    Returns
    -------
    dict of str to Delay
        Empty if there is too little to say; with two cameras the second's against the first's.
    """
    names = list(witness.rig)
    rows, values, spreads = [], [], []
    for a, b in pairs_of_all(names):
        found = regress([s for k in frames if (s := sample(witness, (a, b), k)) is not None])
        if found is not None:
            rows.append([float(name == b) - float(name == a) for name in names])
            values.append(found[0] / rate)
            spreads.append(max(found[1] / rate, 1e-7))
    if not rows or np.linalg.matrix_rank(rows) < len(names) - 1:
        return {}
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
    return out


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
