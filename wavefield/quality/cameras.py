"""Cameras that are inconsistent with the others, and why: mirrored, swapped, late, blurred, covered, moved.

Every camera is compared with every other at some instants of the record, patch by patch. One that agrees with
none while the others agree among themselves is compared again as if its images were mirrored, another
camera's, or of another moment: what makes it agree is what is wrong with it.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.quality.patch_matching import (
    FLIPS,
    REACH,
    STILL,
    Pair,
    PairConsistency,
    PatchMatcher,
    agreement,
    compare,
    grounds,
    most_alike,
    rms_over_field,
)
from wavefield.quality.remarks import CAMERA_LIMITS
from wavefield.rig.field import pixel_at
from wavefield.robust import PER_MEDIAN
from wavefield.store.verdict import Remark

MAX_SCATTER = 0.4  # px of eps_y: more is not the same water
MIN_PATCHES = 6  # with fewer no camera is judged
# Planes on which patches of cameras that disagree are laid in turn: heights over the reach of the search in
# the widest pair, and slopes along either axis
LEVELS = 0.0, -1.5, 1.5, -3.0, 3.0
TILT = 0.15
MOST_TILTED = 30  # patches


class ConsistencyTable:
    """Agreements of all pairs at all instants."""

    def __init__(
        self, patch_matcher: PatchMatcher, names: list[str], frames: tuple[int, ...], threads: int = 1
    ) -> None:
        self.patch_matcher, self.names, self.frames = patch_matcher, names, frames
        self.pairs: list[Pair] = list(combinations(names, 2))
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda name: patch_matcher.patches(name, frames[0]), names))  # lays out its lens
            self.grounds = dict(zip(frames, pool.map(lambda k: grounds(patch_matcher, k, names), frames)))
            found = list(pool.map(lambda k: [self.compare(pair, k) for pair in self.pairs], frames))
            blurs = list(pool.map(lambda k: [blur(patch_matcher.read(name, k)) for name in names], frames))
        self.found: dict[Pair, list[PairConsistency]] = dict(zip(self.pairs, map(list, zip(*found))))
        self.blur: dict[str, list[float]] = dict(zip(names, map(list, zip(*blurs))))

    def compare(
        self, pair: Pair, frame: int, images: Pair | None = None, *, change: str = "", later: int = 0
    ) -> PairConsistency:
        """Images of the cameras of a pair, or of two others through the lenses of the pair.
        Those of the second may be changed, or of another moment.
        """
        patch_matcher, (a, b), (first, second) = self.patch_matcher, pair, images or pair
        found = []
        for plane in patch_matcher.planes:
            laid = partial(patch_matcher.sampled, plane=plane) if plane != STILL else patch_matcher.patches
            one, other = laid(first, frame, "", a), laid(second, frame + later, change, b)
            found.append(patch_matcher.on_still_water(compare(one, other), pair, plane))
        ground = self.grounds[frame][first] if first == a else None
        if not change and second == b and ground is not None:
            ground = ground & self.grounds[frame][second]
        return agreement(patch_matcher, pair, most_alike(found), ground)

    def level(self) -> float:
        """Fraction of patches from which on two cameras agree."""
        return max(
            CAMERA_LIMITS.agreement,
            CAMERA_LIMITS.agreement_to_best * max(score(found) for found in self.found.values()),
        )

    def good(self) -> list[Pair]:
        """Pairs of cameras that agree."""
        limit = self.level()
        return [pair for pair, found in self.found.items() if score(found) >= limit]

    def camera_numbers(self) -> dict[str, dict[str, list[float]]]:
        """Of every camera, over time."""
        return {
            name: {
                "blur": [round(value, 3) for value in self.blur[name]],
                "brightness": [round(self._brightness(name, k), 2) for k in self.frames],
                "coverage": [round(1 - value, 3) for value in covered(self, name)],
            }
            for name in self.names
        }

    def pair_numbers(self) -> dict[str, dict[str, list[float]]]:
        """Of every pair, over time."""
        return {
            "-".join(pair): {
                "agreement": [round(one.fraction, 3) for one in found],
                "eps_y": [round(rms_over_field(one.smooth), 3) for one in found],
            }
            for pair, found in self.found.items()
        }

    def _brightness(self, name: str, frame: int) -> float:
        return float(np.asarray(self.patch_matcher.read(name, frame)).mean())


def score(found: Sequence[PairConsistency]) -> float:
    """How well two cameras agree over some instants: patches found, nothing if they scatter."""
    scatter = [one.eps_y.std() for one in found if len(one.eps_y) >= 4]
    if not scatter or float(np.median(scatter)) >= MAX_SCATTER:
        return 0.0
    return float(np.mean([one.fraction for one in found]))


def blur(image: NDArray[np.generic] | None) -> float:
    """Standard deviation of the finest details of an image, px, from the correlation of neighbouring pixels.
    Unlike `bead_width`, also of images without beads and of any width.
    """
    if image is None:
        return float("nan")
    fine = np.asarray(image, np.float32)
    fine = fine - cv2.blur(fine, (15, 15))
    power = float((fine * fine).mean())
    if power <= 0:
        return float("nan")
    one, two = (
        [float((fine[k:] * fine[:-k]).mean()), float((fine[:, k:] * fine[:, :-k]).mean())] for k in (1, 2)
    )
    # two pixels apart over one: white noise has no part in either
    ratio = np.clip(np.array(two) / np.maximum(one, 1e-6 * power), 1e-4, 0.9999)
    return float(np.sqrt(-3 / (4 * np.log(np.sqrt(ratio.prod())))))


def covered(table: ConsistencyTable, name: str) -> list[float]:
    """Fraction of the patches in which a camera shows nothing where another shows something."""
    out = []
    for ground in table.grounds.values():
        others = np.mean([ground[other] for other in table.names if other != name], axis=0) > 0.5
        out.append(float((others & ~ground[name]).sum() / max(others.sum(), 1)))
    return out


@dataclass(frozen=True)
class CameraFaults:
    """What was found."""

    remarks: tuple[Remark, ...]  # What is wrong
    # Per camera: ``blur`` (px), ``brightness`` (grey levels), ``coverage`` (fraction); a value per instant
    cameras: Mapping[str, Mapping[str, list[float]]]
    # Per pair: ``agreement`` (fraction of patches), ``eps_y`` (px, smooth part), one value per instant
    pairs: Mapping[str, Mapping[str, list[float]]]
    frames: tuple[int, ...]  # The instants


def find_camera_faults(
    patch_matcher: PatchMatcher, count: int, frames: Sequence[int], threads: int = 1
) -> CameraFaults:
    """Compare cameras at some instants, and name what is wrong with them."""
    names = list(patch_matcher.rig)
    complete = tuple(k for k in frames if all(patch_matcher.read(name, k) is not None for name in names))
    if len(patch_matcher.x) < MIN_PATCHES or not complete or len(names) < 2:
        return CameraFaults((), {}, {}, complete)
    table = ConsistencyTable(patch_matcher, names, complete, threads)
    remarks = [*_covered(table), *_blurred(table)]
    if not set(names) <= {name for pair in table.good() for name in pair}:
        table = _on_other_planes(table, threads)
    inconsistent, explained = _inconsistent(table, count)
    own = {remark.subject: remark for remark in remarks}
    explained = [  # cameras that are too blurred or covered to match are not inconsistent
        replace(own[one.subject], weight="grave") if one.kind == "disagree" and one.subject in own else one
        for one in explained
    ]
    remarks = [remark for remark in remarks if remark.subject not in inconsistent] + explained
    remarks += _knocked(table, inconsistent) or _uneven(table, inconsistent)
    return CameraFaults(tuple(remarks), table.camera_numbers(), table.pair_numbers(), complete)


def _on_other_planes(table: ConsistencyTable, threads: int) -> ConsistencyTable:
    """The comparison with each patch on the plane where it is most alike, if more cameras agree then.
    Long waves higher than the search reaches take a small field up and down as a whole, and tilt it.
    """
    matcher = table.patch_matcher
    reach = REACH * matcher.pixel / max(float(np.median(matcher.parallax(pair))) for pair in table.pairs)
    tilts = (0.0, 0.0), *product((-TILT, TILT), repeat=2)
    planes = [(level * reach, x, y) for level in LEVELS for x, y in tilts]
    other = replace(matcher, planes=planes, most=MOST_TILTED)
    found = ConsistencyTable(other, table.names, table.frames, threads)
    return found if len(found.good()) > len(table.good()) else table


def _covered(table: ConsistencyTable) -> Iterator[Remark]:
    for name in table.names:
        fraction = float(np.median(covered(table, name)))
        if fraction > CAMERA_LIMITS.covered:
            yield Remark(
                name,
                "covered",
                "grave" if fraction > CAMERA_LIMITS.covered_grave else "remark",
                f"it shows nothing in {100 * fraction:.0f} % of the field where the others do",
                "That part is measured by the others, or not at all",
                "Check for objects in front of it and for missing light; draw lasting ones as a `mask:`",
                {"fraction": fraction},
            )


def _blurred(table: ConsistencyTable) -> Iterator[Remark]:
    """Cameras whose images are wider than those of the others both in pixels and on the water."""
    widths = {name: float(np.nanmedian(table.blur[name])) for name in table.names}
    rig, grid = table.patch_matcher.rig, table.patch_matcher.grid
    centre = float(np.mean(grid.x)), float(np.mean(grid.y))
    pixels = {name: pixel_at(rig[name], *centre) for name in table.names}
    for name, width in widths.items():
        others = [other for other in table.names if other != name]
        usual = float(np.median([widths[other] for other in others]))
        on_water = float(np.median([widths[other] * pixels[other] for other in others]))
        # beads have a size: a camera of smaller pixels has wider images of them without being blurred
        wider = min(width / max(usual, 1e-9), width * pixels[name] / max(on_water, 1e-12))
        if wider > CAMERA_LIMITS.blur_ratio and width > 1.0:
            yield Remark(
                name,
                "blurred",
                "remark",
                f"its images are blurred by {width:.1f} px, those of the other cameras by {usual:.1f} px",
                "Short waves are lost first",
                "Focus it, or leave it out (`surface: pairs`, `velocity: cameras`)",
                {"blur": width, "usual": usual},
            )


def _inconsistent(table: ConsistencyTable, count: int) -> tuple[set[str], list[Remark]]:
    """Cameras that agree with none, and what explains it."""
    good = table.good()
    if len(good) == len(table.pairs):
        return set(), []
    inconsistent = {name for name in table.names if not any(name in pair for pair in good)}
    if not inconsistent:  # a wide pair may see too different pictures; each still agrees with a third
        return set(), []
    level = table.level()
    if swap := _swapped(table, level):
        return set(table.names), [swap]
    consistent = [name for name in table.names if name not in inconsistent]
    remarks = [
        _explain(table, name, consistent or [n for n in table.names if n != name], level, count)
        for name in sorted(inconsistent)
    ]
    if not consistent:  # nobody agrees with anybody: what is explained goes first
        remarks = [one for one in remarks if one.kind != "disagree"][:1] or [_nobody(table)]
    return inconsistent, remarks


def _nobody(table: ConsistencyTable) -> Remark:
    best = max(score(found) for found in table.found.values())
    share = max(float(np.mean([one.fraction for one in found])) for found in table.found.values())
    sentence = (
        f"at best {100 * share:.0f} % of the patches of two cameras match (sound records: more than "
        f"{100 * CAMERA_LIMITS.agreement:.0f} %)"
    )
    if share > best:  # found, but of no use
        sentence += f", and their sight lines miss each other irregularly, by {MAX_SCATTER:g} px or more"
    return Remark(
        "cameras",
        "disagree",
        "grave",
        sentence,
        "No two of them see the same water: nothing can be measured",
        "Is the rig theirs, are the frames of the same moments (`offset`), is the water seeded?",
        {"agreement": best},
    )


def _swapped(table: ConsistencyTable, level: float) -> Remark | None:
    before = float(np.mean([score(found) for found in table.found.values()]))
    best, which = max(before + 0.1, level), None
    for one, other in table.pairs if len(table.names) > 2 else ():
        turned = {one: other, other: one}
        exchanged = {(a, b): (turned.get(a, a), turned.get(b, b)) for a, b in table.pairs}
        scores = [
            score([table.compare(pair, k, images) for k in table.frames[:2]])
            for pair, images in exchanged.items()
        ]
        if min(scores) > CAMERA_LIMITS.agreement / 2 and float(np.mean(scores)) > best:
            best, which = float(np.mean(scores)), (one, other)
    if which is None:
        return None
    return Remark(
        f"{which[0]} and {which[1]}",
        "swapped",
        "grave",
        f"{100 * best:.0f} % of their patches match when their images are exchanged, {100 * before:.0f} % as "
        "named",
        "Nothing measured with them is right",
        "Exchange their `images` in the experiment file, or their names in the rig",
        {"agreement": best, "as named": before},
    )


def _explain(table: ConsistencyTable, name: str, partners: Sequence[str], level: float, count: int) -> Remark:
    """What makes a camera agree with its partners, tried at two instants."""
    frames = table.frames[:2]
    tried: dict[tuple[str, str, str], list[PairConsistency]] = {}  # by kind, detail and partner
    for partner in partners:
        pair = (partner, name)
        for change in FLIPS:
            tried["mirrored", change, partner] = [table.compare(pair, k, change=change) for k in frames]
        for later in (-2, -1, 1, 2):
            key = "late" if later > 0 else "early", str(abs(later)), partner
            tried[key] = [table.compare(pair, k, later=later) for k in frames if 0 <= k + later < count]
        mirror = {k: count - 1 - 2 * k for k in frames if abs(count - 1 - 2 * k) > 1}
        tried["reversed", "", partner] = [table.compare(pair, k, later=n) for k, n in mirror.items()]
        for other in (n for n in table.names if n not in pair):
            tried["swapped", other, partner] = [table.compare((partner, other), k, pair) for k in frames]
    scores = {key: score(found) for key, found in tried.items()}
    (change, detail, _), best = max(scores.items(), key=lambda one: one[1])
    now = max(score(table.found[pair]) for pair in table.pairs if name in pair)
    if best < max(CAMERA_LIMITS.agreement, level, 2 * now):
        return _inconsistent_pairs(table, name, now)
    return _explained(name, change, detail, {"agreement": best, "as it is": now})


# Kind, finding and remedy for a camera that agrees with the others when its images are taken otherwise
_EXPLANATIONS = {
    "mirrored": (
        "mirrored",
        "its images are {}",
        "Correct its images, or calibrate it with target images of the same orientation",
    ),
    "swapped": (
        "swapped",
        "its images are those that {} would take",
        "Correct its `images` in the experiment file",
    ),
    "late": (
        "offset",
        "it agrees with the others when its frames are taken {} later",
        "Take {} from its `offset` in the experiment file",
    ),
    "early": (
        "offset",
        "it agrees with the others when its frames are taken {} before",
        "Add {} to its `offset` in the experiment file",
    ),
    "reversed": (
        "offset",
        "it agrees with the others when its record is run backwards",
        "Number its images in the order of time",
    ),
}


def _explained(name: str, change: str, detail: str, values: Mapping[str, float]) -> Remark:
    kind, found, remedy = (part.format(detail) for part in _EXPLANATIONS[change])
    return Remark(name, kind, "grave", found, "Nothing measured with it is right", remedy, values)


def _inconsistent_pairs(table: ConsistencyTable, name: str, now: float) -> Remark:
    usual = max(score(found) for found in table.found.values())
    others = f", {100 * usual:.0f} % among the others" if usual else ""
    return Remark(
        name,
        "disagree",
        "grave",
        f"{100 * now:.0f} % of its patches match those of any other camera{others}",
        "It does not see the same water as the others",
        "Is it sharp and bright, are its frames of the same moments, is the rig that of these images?",
        {"agreement": now, "usual": usual},
    )


def _knocked(table: ConsistencyTable, inconsistent: set[str]) -> list[Remark]:
    """Cameras whose sight lines miss those of the others by a smooth eps_y."""
    smooth = {
        pair: np.median([one.smooth for one in found if one.fraction > 0], axis=0)
        for pair, found in table.found.items()
        if not inconsistent & set(pair) and any(one.fraction > 0 for one in found)
    }
    missed = {pair: rms_over_field(value) for pair, value in smooth.items()}
    beyond = [pair for pair, value in missed.items() if value > CAMERA_LIMITS.epipolar_error]
    wrong = [pair for pair in beyond if _significance(table.found[pair]) > 4]
    if not wrong:
        return []
    most = max(missed[pair] for pair in wrong)
    faulty_cameras = [
        name
        for name in table.names
        if all(name in pair for pair in wrong)
        and all(value < most / 3 for pair, value in missed.items() if name not in pair)
    ]
    subject = faulty_cameras[0] if len(faulty_cameras) == 1 else "rig"
    between = " and of ".join("-".join(pair) for pair in wrong)
    sentence = (
        f"the sight lines of {between} miss each other by {most:.2f} px on the water (at most "
        f"{CAMERA_LIMITS.epipolar_error} px after a good calibration)"
    )
    return [_moved(subject, most, sentence, {f"eps_y {'-'.join(pair)}": px for pair, px in missed.items()})]


def _moved(subject: str, off: float, sentence: str, values: Mapping[str, float]) -> Remark:
    return Remark(
        subject,
        "moved",
        "grave" if off > CAMERA_LIMITS.epipolar_error_grave else "remark",
        sentence,
        "A camera has moved since the calibration, or the rig is another's: z is off by about as much, in px",
        "Correct the rig with a still-water record (`rest:`, or `wavefield refine`), or calibrate again",
        values,
    )


def _uneven(table: ConsistencyTable, inconsistent: set[str]) -> list[Remark]:
    """Pairs of cameras that see the same water at different heights: one has moved along the parallax.
    Which one cannot be determined: two pairs give one height more than there are unknowns.
    """
    worst, sure = 0.0, 0.0
    which: tuple[Pair, ...] = ()
    for first, second in combinations(table.pairs, 2):
        if first[0] != second[0] or inconsistent & {*first, *second}:
            continue  # both search the same camera's patches
        apart = [_apart(table, first, second, k) for k in range(len(table.frames))]
        values = np.concatenate(apart)
        if len(values) < MIN_PATCHES * 4:
            continue
        off = float(np.median(values))
        spread = float(PER_MEDIAN * np.median(np.abs(values - off)) / np.sqrt(len(values) / 4)) + 1e-3
        if abs(off) > abs(worst):
            worst, sure, which = off, abs(off) / spread, (first, second)
    if abs(worst) <= CAMERA_LIMITS.epipolar_error or sure < 6:
        return []
    names = " and ".join("-".join(pair) for pair in which)
    sentence = f"{names} see the same water at different heights, by {abs(worst):.2f} px along the parallax"
    return [_moved("rig", abs(worst), sentence, {"height": worst})]


def _apart(table: ConsistencyTable, first: Pair, second: Pair, k: int) -> NDArray[np.float64]:
    """Difference of the heights of two pairs in patches that both matched, px of parallax."""
    a, b = table.found[first][k], table.found[second][k]
    both, ia, ib = np.intersect1d(a.places, b.places, return_indices=True)
    parallax = np.minimum(table.patch_matcher.parallax(first), table.patch_matcher.parallax(second))[both]
    return np.asarray((a.height[ia] - b.height[ib]) * parallax / table.patch_matcher.pixel)


def _significance(found: Sequence[PairConsistency]) -> float:
    """The smooth part over its uncertainty."""
    one = max(found, key=lambda each: each.fraction)
    if len(one.eps_y) < 8:
        return 0.0
    return float(rms_over_field(one.smooth) / max(float(one.eps_y.std()) / np.sqrt(len(one.eps_y) - 3), 1e-3))
