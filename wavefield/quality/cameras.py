"""Find cameras that contradict the others, and the cause: mirrored, swapped, late, blurred, covered, moved.

Square patches of the images are resampled on the plane of the water at rest. Every pair of cameras is
compared by normalised correlation at a few frames. A point at height z appears displaced along the parallax
of the pair. Water of any shape causes no displacement across the parallax; such a displacement is called the
epipolar error, eps_y, and shows that the calibration or the timing is wrong.

Two cameras agree if enough of their patches match with an eps_y that is linear over the field. A camera that
agrees with no other is compared again with its images flipped, exchanged or shifted in time. This finds the
cause.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.grid import Grid
from wavefield.matching.patch_shifts import locate
from wavefield.quality.remarks import GRAVE_EPS_Y, MAX_EPS_Y, MAX_LOST, SIGNIFICANCE
from wavefield.rig import Rig
from wavefield.rig.field import pixel_at, pixel_size
from wavefield.rig.stereo import parallax
from wavefield.robust import PER_MEDIAN
from wavefield.store.verdict import Remark, Verdict, Weight

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Read = Callable[[str, int], NDArray[np.generic] | None]  # camera and frame to an image; None if missing
Pair = tuple[str, str]

SIDE = 32  # px: side of a patch
REACH = 40  # px: largest displacement that is searched
WHOLE = SIDE + 2 * REACH
MAX_PATCHES = 60  # in the field; 15 already give no false remarks in sound records
MIN_CORRELATION = 0.5  # a lower peak is not a match
INCONSISTENT = ("mirrored", "swapped", "offset", "disagree")  # kinds of remark: no other camera agrees
FLIPS: dict[str, tuple[slice, ...]] = {
    "mirrored": np.s_[:, ::-1],
    "upside down": np.s_[::-1, :],
    "turned by 180 degrees": np.s_[::-1, ::-1],
}
MAX_DEPARTURE = 1.5  # px between eps_y of a patch and the linear fit over the field; more is a wrong match
MAX_SCATTER = 0.4  # px: standard deviation of eps_y above which two cameras do not see the same water
MIN_PATCHES = 6  # needed for the linear fit of eps_y; with fewer no camera is judged
MIN_AGREEMENT = 0.2  # fraction of matched patches; sound pairs have more than 0.3
MAX_BLUR_RATIO = 1.6  # width of beads over that in the other cameras, in px and on the water


@dataclass
class PatchMatcher:
    """Resamples the images of the cameras at n square patches on the plane of the water at rest.
    All cameras see the patches. With its search margins, a patch has `WHOLE` x `WHOLE` pixels."""

    read: Read  # Returns the image of a camera at a frame
    rig: Rig  # Calibrated cameras
    grid: Grid  # Area of the water that is compared

    def __post_init__(self) -> None:
        self.pixel = float(pixel_size(self.rig, self.grid))
        self.pixels_of_patches = cache(self._pixels_of_patches)
        self.patches = cache(self.sampled)
        pitch = SIDE * self.pixel
        limits = (self.grid.x, self.grid.y)
        x, y = (np.arange(low + pitch / 2, high - pitch / 2 + 1e-9, pitch) for low, high in limits)
        X, Y = (v.ravel() for v in np.meshgrid(x, y))
        visible = np.ones(X.shape, bool)
        for camera in self.rig.cameras.values():
            for a, b in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
                visible &= camera.sees(X + a * pitch, Y + b * pitch, 0.0)
        chosen = np.flatnonzero(visible)
        chosen = chosen[np.linspace(0, max(len(chosen) - 1, 0), min(MAX_PATCHES, len(chosen))).astype(int)]
        self.x, self.y = X[chosen], Y[chosen]  # (n,): centres of the patches, m

    def _pixels_of_patches(self, name: str) -> tuple[Image, Image]:
        """Return image columns and rows of all patch pixels in camera ``name``, each (n * WHOLE, WHOLE)."""
        offset = (np.arange(WHOLE) - (WHOLE - 1) / 2) * self.pixel
        places = self.x[:, None, None] + offset, self.y[:, None, None] + offset[:, None]
        parts = np.stack(self.rig[name].project(*places, 0.0))
        column, row = parts.reshape(2, -1, WHOLE).astype(np.float32)
        return column, row

    def sampled(self, name: str, frame: int, through: str, change: str = "") -> Image | None:
        """Return grey levels (n, WHOLE, WHOLE) of patches in an image of camera ``name``, None if missing.
        They are located by the calibration of camera ``through``. ``change``, a key of `FLIPS`, flips the
        image first. The method `patches` does the same and keeps its results."""
        image = self.read(name, frame)
        if image is None:
            return None
        flat = np.ascontiguousarray(image[FLIPS[change]] if change else image, np.float32)
        # floating-point images often range from 0 to 1: scale them to 255, for which contrast limits are made
        largest = float(np.abs(flat).max()) if image.dtype.kind == "f" else 0.0
        if largest > 0:
            flat = flat * np.float32(255.0 / largest)
        places = self.pixels_of_patches(through)
        sampled = cv2.remap(flat, *places, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, np.nan)
        return np.asarray(sampled, np.float32).reshape(-1, WHOLE, WHOLE)

    def textured(self, name: str, frame: int) -> NDArray[np.bool_]:
        """Return a mask (n,), True for patches whose contrast is over a fifth of the median contrast.
        Contrast is the standard deviation of the grey levels of a patch without its search margins."""
        patches = self.patches(name, frame, name)
        assert patches is not None  # only frames that all cameras have are compared
        contrast = np.nan_to_num(middle(patches).std(axis=(1, 2)).astype(float))
        some = contrast[contrast > 0.5]
        return np.asarray(contrast > 0.2 * (np.median(some) if some.size else np.inf))

    def parallax(self, pair: Pair) -> tuple[Array, Array]:
        """Return the parallax of two cameras at the patches: unit vectors (n, 2) and lengths (n,), m/m.
        The parallax is the displacement between their images on z = 0 per metre of water height."""
        vectors = parallax(self.rig, pair, self.x, self.y).T
        length = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
        return vectors / length[:, None], length


def middle(patches: Image) -> Image:
    """Return patches (n, WHOLE, WHOLE) without their search margins, (n, SIDE, SIDE)."""
    return patches[:, REACH : REACH + SIDE, REACH : REACH + SIDE]


def compare(first: Image | None, second: Image | None) -> Array | None:
    """Return the displacements of patches from image ``first`` to ``second``, (n, 2), px along x and y.
    Both images are given as patches (n, WHOLE, WHOLE). NaN without a match; None without an image."""
    if first is None or second is None:
        return None
    moved = np.full((len(first), 2), np.nan)
    templates = np.ascontiguousarray(middle(first))
    usual = templates.mean(axis=(1, 2))
    sound = templates.std(axis=(1, 2)) >= 1e-3  # False where a template contains NaN
    for k in np.flatnonzero(sound).tolist():
        around = np.ascontiguousarray(np.where(np.isnan(second[k]), usual[k], second[k]))
        column, row, peak_correlation = locate(templates[k], around)
        if peak_correlation > MIN_CORRELATION:
            moved[k] = column - REACH, row - REACH
    return moved


@dataclass(frozen=True)
class PairConsistency:
    """Agreement of two cameras at one frame: fraction of patches that match, and their epipolar errors."""

    fraction: float  # Fraction of the patches that match with an eps_y near its linear fit over the field
    eps_y: Array  # (m,): Epipolar error of these patches, px on the water
    smooth: Array  # (3,): Linear fit of eps_y: px at mid-field, px per half width of the field along x and y
    places: NDArray[np.intp]  # (m,): Indices of these patches
    height: Array  # (m,): Height of the water there, from the displacement along the parallax, m


def agreement(
    patch_matcher: PatchMatcher, pair: Pair, moved: Array | None, ground: NDArray[np.bool_]
) -> PairConsistency:
    """Return the agreement of two cameras, from the patch displacements ``moved`` (n, 2), px, of `compare`.
    ``ground`` (n,) is True for the patches to use."""
    n = len(patch_matcher.x)
    if moved is None or not ground.any():
        return PairConsistency(0.0, np.zeros(0), np.zeros(3), np.zeros(0, np.intp), np.zeros(0))
    along, length = patch_matcher.parallax(pair)
    eps_y = moved[:, 1] * along[:, 0] - moved[:, 0] * along[:, 1]
    height = (moved * along).sum(axis=1) * patch_matcher.pixel / length
    good = ground & np.isfinite(eps_y)
    design = np.stack([np.ones(n), *(scaled(v) for v in (patch_matcher.x, patch_matcher.y))], axis=-1)
    smooth = np.array([np.median(eps_y[good]) if good.any() else 0.0, 0.0, 0.0])
    for _ in range(4):  # refit without outliers
        near = good & (np.abs(eps_y - design @ smooth) < MAX_DEPARTURE)
        if near.sum() < MIN_PATCHES:
            break
        smooth = np.linalg.lstsq(design[near], eps_y[near], rcond=None)[0]
    near = good & (np.abs(eps_y - design @ smooth) < MAX_DEPARTURE)
    fraction = float(near.sum() / ground.sum())
    return PairConsistency(fraction, eps_y[near], smooth, np.flatnonzero(near), height[near])


def scaled(v: Array) -> Array:
    """Return coordinates minus their mean, divided by half of their range: about -1 to 1."""
    return np.asarray((v - v.mean()) / max(float(np.ptp(v)) / 2, 1e-12))


def rms_over_field(smooth: Array) -> float:
    """Return the rms over the field, px, of an epipolar error that is linear in x and y.
    ``smooth`` holds its value at mid-field and its change per half width along x and along y, px."""
    return float(np.sqrt(smooth[0] ** 2 + (smooth[1] ** 2 + smooth[2] ** 2) / 3))


class ConsistencyTable:
    """Agreement of every pair of cameras at every sampled frame, and the blur and texture of each image.
    ``names`` are the cameras; ``frames`` are frames that all of them have."""

    def __init__(
        self, patch_matcher: PatchMatcher, names: list[str], frames: tuple[int, ...], threads: int = 1
    ) -> None:
        self.patch_matcher, self.names, self.frames = patch_matcher, names, frames
        self.pairs: list[Pair] = list(combinations(names, 2))
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda name: patch_matcher.patches(name, frames[0], name), names))  # fill caches
            textured = pool.map(lambda k: {name: patch_matcher.textured(name, k) for name in names}, frames)
            self.grounds = dict(zip(frames, textured))
            found = list(pool.map(lambda k: [self.compare(pair, k) for pair in self.pairs], frames))
            blurs = list(pool.map(lambda k: [blur(patch_matcher.read(name, k)) for name in names], frames))
        self.found: dict[Pair, list[PairConsistency]] = dict(zip(self.pairs, map(list, zip(*found))))
        self.blur: dict[str, list[float]] = dict(zip(names, map(list, zip(*blurs))))

    def compare(
        self, pair: Pair, frame: int, images: Pair | None = None, *, change: str = "", later: int = 0
    ) -> PairConsistency:
        """Compare the images of the two cameras of ``pair`` at a frame, or other images in their place.
        ``images`` names two cameras whose images are used with the calibrations of ``pair``. ``change``, a
        key of `FLIPS`, flips the second image, which is taken ``later`` frames after the first."""
        (a, b), (first, second) = pair, images or pair
        one = self.patch_matcher.patches(first, frame, a)
        found = compare(one, self.patch_matcher.patches(second, frame + later, b, change))
        ground = self.grounds[frame][first] if first == a else np.ones(len(self.patch_matcher.x), bool)
        if first == a and second == b and not change:
            ground = ground & self.grounds[frame][second]
        return agreement(self.patch_matcher, pair, found, ground)


def score(found: Sequence[PairConsistency]) -> float:
    """Return the mean fraction of the patches of two cameras that match; ``found`` has one element per frame.
    The score is 0 if the epipolar errors of the patches scatter as much as in wrong matches."""
    scatter = [one.eps_y.std() for one in found if len(one.eps_y) >= MIN_PATCHES]
    if not scatter or float(np.median(scatter)) >= MAX_SCATTER:
        return 0.0
    return float(np.mean([one.fraction for one in found]))


def blur(image: NDArray[np.generic] | None) -> float:
    """Return the standard deviation s, px, of Gaussian beads in an image; NaN if it shows none.
    The autocorrelation of such beads is r(d) = exp(-d^2 / (4 s^2)) at a lag of d px, which gives
    s^2 = 3 / (4 ln(r(1) / r(2)))."""
    assert image is not None  # only frames that all cameras have are compared
    fine = np.asarray(image, np.float32)
    fine = fine - cv2.blur(fine, (SIDE, SIDE))  # uneven light
    sizes = []
    for a in (fine, fine.T):
        one, two = float((a[1:] * a[:-1]).mean()), float((a[2:] * a[:-2]).mean())
        if one > two > 0:
            sizes.append(np.sqrt(0.75 / np.log(one / two)))
    return float(np.mean(sizes)) if sizes else float("nan")


def find_camera_faults(
    patch_matcher: PatchMatcher, count: int, frames: Sequence[int], threads: int = 1
) -> Verdict:
    """Compare all cameras at ``frames`` of a record of ``count`` frames, and return remarks on their faults.
    Frames that are missing in a camera are skipped. There are no remarks if there is only one camera, or if
    the area that all cameras see is too small."""
    names = list(patch_matcher.rig)
    complete = tuple(k for k in frames if all(patch_matcher.read(name, k) is not None for name in names))
    if len(patch_matcher.x) < MIN_PATCHES or not complete or len(names) < 2:
        return Verdict((), {}, complete)
    table = ConsistencyTable(patch_matcher, names, complete, threads)
    remarks = [*_covered(table), *_blurred(table)]
    inconsistent, explained = _inconsistent(table, count)
    own = {remark.subject: remark for remark in remarks}
    explained = [  # blur or cover explains why a camera matches no other
        replace(own[one.subject], weight="grave") if one.kind == "disagree" and one.subject in own else one
        for one in explained
    ]
    remarks = [remark for remark in remarks if remark.subject not in inconsistent] + explained
    remarks += _knocked(table, inconsistent) or _uneven(table, inconsistent)
    pairs = {
        "-".join(pair): {
            "agreement": [round(one.fraction, 3) for one in found],
            "eps_y": [round(rms_over_field(one.smooth), 3) for one in found],
        }
        for pair, found in table.found.items()
    }
    return Verdict(remarks, pairs, complete)


def _covered(table: ConsistencyTable) -> Iterator[Remark]:
    """Yield remarks on cameras without texture in a part of the field where most others see texture."""
    for name in table.names:
        covered = []
        for ground in table.grounds.values():
            others = np.mean([ground[other] for other in table.names if other != name], axis=0) > 0.5
            covered.append((others & ~ground[name]).sum() / max(others.sum(), 1))
        fraction = float(np.median(covered))
        if fraction > MAX_LOST:
            sentence = (
                f"its images have no texture in {100 * fraction:.0f} % of the field that the others see"
            )
            means = "That part is measured by the other cameras, or not at all"
            remedy = "Remove objects in front of it and check the light; draw fixed objects as a `mask:`"
            weight: Weight = "grave" if fraction > 0.5 else "remark"
            yield Remark(name, "covered", weight, sentence, means, remedy, {"fraction": fraction})


def _blurred(table: ConsistencyTable) -> Iterator[Remark]:
    """Yield remarks on cameras that show wider beads than the others do, both in px and on the water."""
    widths = {name: float(np.nanmedian(table.blur[name])) for name in table.names}
    rig, grid = table.patch_matcher.rig, table.patch_matcher.grid
    centre = float(np.mean(grid.x)), float(np.mean(grid.y))
    pixels = {name: pixel_at(rig[name], *centre) for name in table.names}
    for name, width in widths.items():
        others = [other for other in table.names if other != name]
        usual = float(np.median([widths[other] for other in others]))
        on_water = float(np.median([widths[other] * pixels[other] for other in others]))
        # a camera with smaller pixels shows beads over more pixels without being blurred
        wider = min(width / max(usual, 1e-9), width * pixels[name] / max(on_water, 1e-12))
        if wider > MAX_BLUR_RATIO and width > 1.0:
            sentence = (
                f"its images are blurred by {width:.1f} px, those of the other cameras by {usual:.1f} px"
            )
            means = "Short waves are damped or lost"
            remedy = "Focus it, or leave it out (`surface: pairs`, `velocity: cameras`)"
            yield Remark(name, "blurred", "remark", sentence, means, remedy, {"blur": width, "usual": usual})


def _inconsistent(table: ConsistencyTable, count: int) -> tuple[set[str], list[Remark]]:
    """Return the names of the cameras that agree with no other camera, and remarks on the causes.
    ``count`` is the number of frames of the record. If no two cameras agree, there is only one remark."""
    scores = {pair: score(found) for pair, found in table.found.items()}
    level = max(MIN_AGREEMENT, 0.5 * max(scores.values()))  # above, two cameras agree
    good = [pair for pair, value in scores.items() if value >= level]
    # views of two distant cameras may differ too much to match, while each agrees with a third camera
    inconsistent = {name for name in table.names if not any(name in pair for pair in good)}
    consistent = [name for name in table.names if name not in inconsistent]
    remarks = [
        _explain(table, name, consistent or [n for n in table.names if n != name], level, count)
        for name in sorted(inconsistent)
    ]
    if inconsistent and not consistent:  # no pair agrees: report one camera with a known cause, or all
        remarks = [one for one in remarks if one.kind != "disagree"][:1] or [_disagree(table)]
    return inconsistent, remarks


def _disagree(table: ConsistencyTable, name: str = "") -> Remark:
    """Return the remark that the camera ``name`` matches no other; without a name, that no cameras match."""
    best = max(score(found) for pair, found in table.found.items() if not name or name in pair)
    sentence = (
        f"at best {100 * best:.0f} % of the patches of two cameras match with a smooth epipolar error (sound "
        f"records: more than {100 * MIN_AGREEMENT:.0f} %)"
    )
    means = "It does not see the same water as the others" if name else "Nothing can be measured"
    remedy = (
        "Check that images are sharp, bright and seeded, that frames are of the same moments (`offset`), and "
        "that the rig belongs to these cameras"
    )
    return Remark(name or "cameras", "disagree", "grave", sentence, means, remedy, {"agreement": best})


# By kind of remark: the finding and the remedy if a camera agrees with the others after a change
_CAMERA_FAULTS = {
    "mirrored": (
        "its images are {}",
        "Correct its images, or calibrate it with target images of the same orientation",
    ),
    "swapped": (
        "its images match the others only as images of {}",
        "Correct its `images` in the experiment file",
    ),
    "offset": (
        "its frame numbers differ from those of the others by {}",
        "Subtract this from its `offset` in the experiment file",
    ),
}


def _explain(table: ConsistencyTable, name: str, partners: Sequence[str], level: float, count: int) -> Remark:
    """Find by trial why the camera ``name`` agrees with none of ``partners``, and return a remark on it.
    At two frames its images are flipped, used as images of another camera, or taken up to two frames earlier
    or later. The trial with most matching patches shows the cause; the matching fraction must reach
    ``level``. The record has ``count`` frames."""
    frames = table.frames[:2]
    tried: dict[tuple[str, str, str], list[PairConsistency]] = {}  # by kind, detail and partner
    for partner in partners:
        pair = (partner, name)
        for change in FLIPS:
            tried["mirrored", change, partner] = [table.compare(pair, k, change=change) for k in frames]
        for later in (-2, -1, 1, 2):
            found = [table.compare(pair, k, later=later) for k in frames if 0 <= k + later < count]
            tried["offset", f"{later:+d}", partner] = found
        for other in (n for n in table.names if n not in pair):
            tried["swapped", other, partner] = [table.compare((partner, other), k, pair) for k in frames]
    scores = {key: score(found) for key, found in tried.items()}
    (kind, detail, _), best = max(scores.items(), key=lambda one: one[1])
    now = max(score(table.found[pair]) for pair in table.pairs if name in pair)
    if best < max(MIN_AGREEMENT, level, 2 * now):
        return _disagree(table, name)
    sentence, remedy = _CAMERA_FAULTS[kind]
    means, values = "All results from this camera are wrong", {"agreement": best, "as it is": now}
    return Remark(name, kind, "grave", sentence.format(detail), means, remedy, values)


def _knocked(table: ConsistencyTable, inconsistent: set[str]) -> list[Remark]:
    """Return a list with one remark if the linear fit of eps_y of any pair is large and significant, else [].
    The remark names the camera that moved, or the rig if this camera is unknown. Cameras in
    ``inconsistent`` are skipped."""
    smooth = {
        pair: np.median([one.smooth for one in found if one.fraction > 0], axis=0)
        for pair, found in table.found.items()
        if not inconsistent & set(pair) and any(one.fraction > 0 for one in found)
    }
    missed = {pair: rms_over_field(value) for pair, value in smooth.items()}
    beyond = [pair for pair, value in missed.items() if value > MAX_EPS_Y]
    wrong = [pair for pair in beyond if _significance(table.found[pair]) > SIGNIFICANCE]
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
        f"{MAX_EPS_Y} px after a good calibration)"
    )
    return [_moved(subject, most, sentence, {f"eps_y {'-'.join(pair)}": px for pair, px in missed.items()})]


def _moved(subject: str, error: float, sentence: str, values: Mapping[str, float]) -> Remark:
    """Return the remark that camera ``subject`` has moved; the subject "rig" stands for an unknown camera.
    ``error`` is the resulting error, px on the water. ``sentence`` is the finding, with its ``values``."""
    return Remark(
        subject,
        "moved",
        "grave" if error > GRAVE_EPS_Y else "remark",
        sentence,
        "A camera has moved since the calibration, or the rig is of other cameras: z is wrong by about as "
        "many px",
        "Correct the rig with a still-water record (`rest:`, or `wavefield refine`), or calibrate again",
        values,
    )


def _uneven(table: ConsistencyTable, inconsistent: set[str]) -> list[Remark]:
    """Return a list with one remark if two pairs of cameras see the water at different heights, else [].
    An unknown camera has then moved along the parallax. Cameras in ``inconsistent`` are skipped."""
    matcher, worst, sure = table.patch_matcher, 0.0, 0.0
    which: tuple[Pair, ...] = ()
    for first, second in combinations(table.pairs, 2):
        if first[0] != second[0] or inconsistent & {*first, *second}:
            continue  # heights can be compared only at the patches of one common camera
        length = np.minimum(*(matcher.parallax(pair)[1] for pair in (first, second)))
        apart = []  # heights from the first pair minus those from the second, as px of parallax
        for one, other in zip(table.found[first], table.found[second]):
            both, i, j = np.intersect1d(one.places, other.places, return_indices=True)
            apart.append((one.height[i] - other.height[j]) * length[both] / matcher.pixel)
        values = np.concatenate(apart)
        if len(values) < MIN_PATCHES * 4:
            continue
        off = float(np.median(values))
        spread = float(PER_MEDIAN * np.median(np.abs(values - off)) / np.sqrt(len(values) / 4)) + 1e-3
        if abs(off) > abs(worst):
            worst, sure, which = off, abs(off) / spread, (first, second)
    if abs(worst) <= MAX_EPS_Y or sure < SIGNIFICANCE:
        return []
    names = " and ".join("-".join(pair) for pair in which)
    sentence = f"{names} see the same water at different heights, by {abs(worst):.2f} px along the parallax"
    return [_moved("rig", abs(worst), sentence, {"height": worst})]


def _significance(found: Sequence[PairConsistency]) -> float:
    """Return the rms over the field of the linear fit of eps_y, divided by its standard uncertainty.
    ``found`` has one element per frame; the frame with most matched patches is used."""
    one = max(found, key=lambda each: each.fraction)
    if len(one.eps_y) < MIN_PATCHES:
        return 0.0
    return float(rms_over_field(one.smooth) / max(float(one.eps_y.std()) / np.sqrt(len(one.eps_y) - 3), 1e-3))
