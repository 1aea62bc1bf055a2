"""Motion of cameras during a record, from the low-order part of eps_y at every step.

Water makes no eps_y whatever its shape, so what is constant or linear in it over the field belongs to the
cameras: one that shakes makes it vary from step to step (tilt, roll), one that is knocked makes it jump once.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.quality.patch_matching import PatchMatcher, rms_over_field
from wavefield.quality.remarks import CAMERA_LIMITS
from wavefield.quality.stabilized import shifts
from wavefield.robust import PER_MEDIAN
from wavefield.sampling import from_first_to_last
from wavefield.store.verdict import Remark
from wavefield.water import GRAVITY

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, LearnedRecord

Array = NDArray[np.float64]

MAX_STEPS = 600  # steps that are read, evenly over the record
MAX_NODES = 2000  # of each
MIN_NODES = 50  # of a step
MAX_KNOCKS = 3
MIN_STEPS_PER_SIDE = 3  # of a jump
PIECE = 64  # steps in which the motion of the mean level is separated from slow waves
MIN_FREEDOM = 3  # steps of a record more than slow waves can explain
SLOW_WAVES = 3e-3  # singular value, of the largest, down to which slow waves explain the mean level


@dataclass(frozen=True)
class CameraMotion:
    """Low-order part of eps_y over time."""

    steps: NDArray[np.intp]  # (n,): Which steps were read
    low: Array  # (n, 3): px: over the middle, at the right and at the upper edge against the middle
    std: Array  # (n, 3): Standard uncertainty, px


@dataclass(frozen=True)
class Knock:
    """A jump."""

    frame: int  # First frame (index in the record) after it
    size: float  # Rms over the field of what eps_y is more since, px


def camera_motion(cube: xr.Dataset, steps: Sequence[int] | None = None) -> CameraMotion:
    """Fit the low-order part of eps_y at steps of a cube."""
    count, ny, nx = cube.eps_y.shape
    every = slice(None, None, max(1, int(np.sqrt(ny * nx / MAX_NODES))))
    x, y = np.meshgrid(*(np.linspace(-1, 1, n)[every] for n in (nx, ny)))
    design = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=-1)
    chosen = from_first_to_last(count, MAX_STEPS) if steps is None else list(steps)
    values = cube.eps_y.isel(time=chosen, y=every, x=every).values / float(cube.attrs["pixel_size"])
    fits = {
        k: fit for k, one in zip(chosen, values) if (fit := _fit_low_order(design, one.ravel())) is not None
    }
    low, std = (np.array([fit[part] for fit in fits.values()]).reshape(-1, 3) for part in (0, 1))
    return CameraMotion(np.array(list(fits), int), low, std)


def _fit_low_order(design: Array, values: Array) -> tuple[Array, Array] | None:
    good = np.isfinite(values)
    if good.sum() < MIN_NODES:
        return None
    middle = np.median(values[good])
    spread = PER_MEDIAN * np.median(np.abs(values[good] - middle)) + 1e-6
    good &= np.abs(values - middle) < 4 * spread + 1.0
    A, b = design[good], values[good].astype(float)
    if len(b) < MIN_NODES:
        return None
    found = np.linalg.lstsq(A, b, rcond=None)[0]
    variance = float(np.var(b - A @ found))
    return found, np.sqrt(variance * np.diag(np.linalg.pinv(A.T @ A)))


def jump(low: Array) -> int | None:
    """The first step after a jump of a series (n, 3), px; None if it does not jump."""
    n = len(low)
    if n < 2 * MIN_STEPS_PER_SIDE:
        return None
    total, squares = np.cumsum(low, axis=0), float((low**2).sum())
    cuts = np.arange(MIN_STEPS_PER_SIDE, n - MIN_STEPS_PER_SIDE + 1)
    before, after = total[cuts - 1] / cuts[:, None], (total[-1] - total[cuts - 1]) / (n - cuts)[:, None]
    left = squares - (before**2).sum(axis=1) * cuts - (after**2).sum(axis=1) * (n - cuts)
    best = int(np.argmin(left))
    scatter = float(np.sqrt(max(left[best], 0.0) / max(n - 2, 1)))
    if rms_over_field(after[best] - before[best]) < max(CAMERA_LIMITS.jump, 2 * scatter):
        return None
    return int(cuts[best])


def knocks(cube: xr.Dataset, found: CameraMotion) -> list[Knock]:
    """Jumps of a record, each dated to a frame."""
    pieces = [(0, len(found.steps))]
    cuts: list[int] = []
    while pieces and len(cuts) < MAX_KNOCKS:
        a, b = pieces.pop(0)
        at = jump(found.low[a:b])
        if at is not None:
            cuts.append(a + at)
            pieces += [(a, a + at), (a + at, b)]
    out = []
    edges = [0, *sorted(cuts), len(found.steps)]
    for a, at, b in zip(edges, edges[1:], edges[2:]):
        before, after = (np.median(found.low[s], axis=0) for s in (slice(a, at), slice(at, b)))
        between = range(max(int(found.steps[at - 1]) - 1, 0), int(found.steps[at]) + 1)
        near = camera_motion(cube, list(between))
        along = (near.low - before) @ (after - before) / float((after - before) @ (after - before))
        # a step shows the mean of its two frames: the one in which the knock falls is half way
        whole = near.steps[along > 0.75]
        frame = int(whole[0]) if whole.size else int(found.steps[at])
        out.append(Knock(frame, rms_over_field(after - before)))
    return out


def shaking(found: CameraMotion, cuts: Sequence[int]) -> tuple[float, float]:
    """How far the picture of the cameras shakes from step to step."""
    edges = [0, *np.searchsorted(found.steps, cuts).tolist(), len(found.steps)]
    parts = [found.low[a:b] - found.low[a:b].mean(axis=0) for a, b in pairwise(edges) if b - a > 1]
    if not parts:
        return 0.0, np.inf
    rest = np.concatenate(parts)
    freedom = len(rest) - len(parts)
    variance = (rest**2).sum(axis=0) / freedom - np.mean(found.std**2, axis=0)
    power = max(float(variance[0] + (variance[1] + variance[2]) / 3), 0.0)
    noise = float(np.mean(found.std[:, 0] ** 2)) + power
    return float(np.sqrt(power)), float(np.sqrt(noise / (2 * freedom)))


def who(geometry: "GridGeometry", patch_matcher: PatchMatcher, frame: int, count: int) -> tuple[str, float]:
    """The camera that a knock moved (its picture alone has moved since), else `rig`.
    With how much its picture has moved, rms over the field, px.
    """
    sides = []
    for frames in (
        range(max(frame - MIN_STEPS_PER_SIDE, 0), frame),
        range(frame, min(frame + MIN_STEPS_PER_SIDE, count)),
    ):
        found = [
            shifts({name: patch_matcher.read(name, k) for name in geometry.cameras}, geometry) for k in frames
        ]
        sides.append([one for one in found if one])
    if not all(sides):
        return "rig", 0.0
    middle = [{name: np.median([one[name] for one in side], axis=0) for name in side[0]} for side in sides]
    moved = {name: rms_over_field(middle[1][name] - middle[0][name]) for name in middle[0]}
    first, *others = sorted(moved, key=lambda name: -moved[name])
    if len(moved) < 3 or moved[first] < 2 * moved[others[0]]:
        return "rig", 0.0
    return first, moved[first]


def remarks_on_mounts(
    cube: xr.Dataset, geometry: "GridGeometry", record: "LearnedRecord | None", patch_matcher: PatchMatcher
) -> Iterator[Remark]:
    """Remarks on cameras that move."""
    first_frame = int(cube.frame[0])
    yield from _turned_back(cube, first_frame)
    found = camera_motion(cube)
    if len(found.steps) < 2 * MIN_STEPS_PER_SIDE:
        return
    jumps = knocks(cube, found)
    for one in jumps:
        name, alone = who(geometry, patch_matcher, one.frame, cube.sizes["frame"])
        off = max(one.size, alone)  # eps_y of a cube is the mean of its pairs
        yield Remark(
            name,
            "moved",
            "grave" if off > 10 * CAMERA_LIMITS.motion else "remark",
            f"sight lines miss each other by {off:.2f} px more from frame {first_frame + one.frame} on",
            f"It was knocked between frames {first_frame + one.frame - 1} and {first_frame + one.frame}; z "
            "is off by about as much since then",
            "Run the two parts by themselves (`frames: {first, last}`), the second with a rig corrected by "
            "`wavefield refine`",
            {"frame": first_frame + one.frame, "px": off},
        )
    rms, std = shaking(found, [one.frame for one in jumps])
    if rms > max(CAMERA_LIMITS.jump, 3 * std):
        yield Remark(
            "cameras",
            "vibration",
            "remark" if rms > CAMERA_LIMITS.motion else "note",
            f"their sight lines miss each other by {rms:.3f} +- {std:.3f} px more or less from step to step",
            "The cameras tilt or roll on their mounts: z and velocities are off by about as much",
            "Stiffen the mounts and keep carriages, pumps and people away; `settings: {vibration: correct}` "
            "turns the images back",
            {"px": rms, "std": std},
        )


def level_motion(cube: xr.Dataset) -> float:
    """Rms motion of the mean level that no wave explains, m; NaN where a record does not determine it.

    The mean of z with a Blackman window suppresses waves shorter than a third of the field a thousandfold.
    Longer gravity waves on a current U have frequencies below sqrt(g k) + U k, k = 6 pi / side, and are
    fitted; what is left of a sound record is noise, and more is the motion of cameras along their parallax,
    which eps_y does not show.
    """
    count, ny, nx = cube.z.shape
    k = 6.0 * np.pi / min(np.ptp(cube.x.values), np.ptp(cube.y.values))
    current = cube[["u", "v"]].isel(time=from_first_to_last(count, 8)).mean()
    omega = np.sqrt(GRAVITY * k) + k * float(np.hypot(current.u, current.v))
    highest = omega / (2.0 * np.pi * float(cube.attrs["frame_rate"]))  # cycles per step
    window = np.outer(np.blackman(ny + 2)[1:-1], np.blackman(nx + 2)[1:-1])
    squares, freedom = 0.0, 0
    for start in range(0, count, PIECE):
        z = cube.z.isel(time=slice(start, start + PIECE)).values.astype(float)
        weight = np.where(np.isfinite(z), window, 0.0)
        full = weight.sum(axis=(1, 2)) > 0.98 * window.sum()  # holes would let waves in
        times = np.flatnonzero(full)
        mean = (weight * np.nan_to_num(z)).sum(axis=(1, 2))[full] / weight.sum(axis=(1, 2))[full]
        phase = 2.0 * np.pi * np.outer(times, np.linspace(0.0, highest, 2 * PIECE))
        basis, size, _ = np.linalg.svd(np.hstack([np.cos(phase), np.sin(phase)]), full_matrices=False)
        basis = basis[:, size > SLOW_WAVES * size[:1].max(initial=0.0)]
        if len(times) - basis.shape[1] >= MIN_FREEDOM:
            squares += float(np.sum(np.square(mean - basis @ (basis.T @ mean))))
            freedom += len(times) - basis.shape[1]
    return float(np.sqrt(squares / freedom)) if freedom else np.nan


def remark_on_level(motion: float, z_std: float, pixel: float) -> Iterator[Remark]:
    """Report a mean level that moves faster than waves do, rms, against the typical uncertainty of z, m."""
    if motion > z_std:
        yield Remark(
            "cameras",
            "vibration",
            "remark",
            f"the mean level moves by at least {1e3 * motion:.2g} mm rms ({motion / pixel:.2f} px), faster "
            "than waves as long as the field",
            f"A camera vibrates along the parallax: all of z moves by {motion / z_std:.1f} of its standard "
            "uncertainty, which `z_level_std` contains, and w accordingly",
            "Stiffen the mounts and keep carriages, pumps and people away",
            {"level_std_m": motion, "px": motion / pixel},
        )


def _turned_back(cube: xr.Dataset, first_frame: int) -> Iterator[Remark]:
    """What was corrected, of a cube that was measured so."""
    if "camera_shift" not in cube:
        return
    for name, low in zip(cube.attrs["cameras"], cube.camera_shift.values.astype(float)):
        known = np.flatnonzero(np.isfinite(low).all(axis=1))
        if not known.size:
            continue
        rms = float(np.sqrt(np.mean([rms_over_field(one) ** 2 for one in low[known]])))
        at = jump(low[known])
        when = "" if at is None else f", most of it from frame {first_frame + int(known[at])} on"
        if rms > CAMERA_LIMITS.jump / 5:
            yield Remark(
                name,
                "vibration",
                "note",
                f"its images were turned back by {rms:.3f} px rms across the sight lines{when}",
                "As the settings request (`vibration: correct`)",
                values={"px": rms} | ({} if at is None else {"frame": float(first_frame + known[at])}),
            )
