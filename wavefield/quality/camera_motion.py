"""Cameras that are late, shake or were knocked, from the epipolar errors (eps_y) of moving water.

Water makes no eps_y whatever its shape. What is constant or linear in it over the field belongs to the
mounts: a camera that shakes makes it vary from step to step (tilt, roll), one that is knocked makes it jump
once.

A camera that is late by tau sees every bead tau times its velocity further on. Along the parallax of two
cameras that is taken for height; across it no height does that, and eps_y is tau times the velocity across
the sight lines, patch by patch: one regression over some instants gives tau. The low-order part, which
every instant has of its own, is taken out before. The rows of a rolling shutter are read one after the
other: the delay then grows with the difference between the rows in which two cameras show a place.

Both sides of the regression must have one resolution, or tau is too large: they are means over one patch.
The velocity is the mean of the steps before and after the frame, which is 5 % low for 2 Hz waves at 20 frames
per second; so much is added to the uncertainty.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.quality.cameras import (
    SIDE,
    Array,
    Pair,
    rms_over_field,
    scaled,
)
from wavefield.quality.remarks import CAMERA_LIMITS
from wavefield.robust import PER_MEDIAN
from wavefield.sampling import from_first_to_last
from wavefield.store.verdict import Remark
from wavefield.water import GRAVITY

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, LearnedRecord
    from wavefield.rig import Camera

MIN_PATCHES = 12  # of an instant
BIAS = 0.05  # of a delay, because water turns between the steps whose velocity is taken
_CELLS = 3  # along either side: parts of the field whose errors are independent
SIGNIFICANCE = 4.0  # standard deviations
MAX_READOUT_STD = 2e-3  # s: from the first row to the last; a less certain one is not determined
MAX_STD_INTERVALS = 0.5  # of the frames: a less certain delay is not determined,
MAX_INTERVALS = 1.5  # nor a longer one: water does not keep its velocity for so long,
MIN_VELOCITY = 0.03  # px per frame, rms beside constant and slopes: what moves less is noise of the matching


@dataclass(frozen=True)
class Delay:
    """Delay of one camera's frames relative to the others."""

    seconds: float  # Negative if earlier
    std: float  # Standard uncertainty, s


@dataclass(frozen=True)
class Sample:
    """Matches of two cameras at one instant, patch by patch."""

    miss: Array  # (m,): Mean eps_y, px on the water
    velocity: Array  # (m,): Of the beads across the sight lines, px per frame
    low: Array  # (m, 3): Constant, and places scaled to -1 to 1 along x and y
    speed: float = 0.0  # Of the beads in all directions, px per frame
    rows: Array | None = None  # (m,): By how many rows from the middle the second camera shows it lower


class LazyInstant(NamedTuple):
    """A frame, its images and how the water moves; both are read on demand."""

    images: Callable[[], Mapping[str, NDArray[Any] | None]]  # By camera
    displacement: Callable[[], NDArray[np.floating]]  # (3, ny, nx): Per frame, m; NaN: not measured


class Synchrony(NamedTuple):
    """Whether the cameras, and the rows of their images, are read at the same moment."""

    delays: dict[str, Delay]  # Of each camera's frames behind those of most
    speed: float = 0.0  # Of the beads, px/s
    row_time: Delay | None = None  # Of each row behind the one above it, beyond what is stated
    rows: int = 0  # Of the highest image


def sample(
    geometry: "GridGeometry", pair: Pair, flat: Mapping[str, Any], displacement: NDArray[np.floating]
) -> Sample | None:
    """Mismatch and velocity in patches at an instant; None if too few are known.

    ``displacement`` (3, ny, nx): of the nodes per frame, metres, NaN where it is not measured.
    """
    from wavefield.measurement.pair import match_pair

    if not all(name in flat for name in pair):
        return None
    match = match_pair(flat[pair[0]], flat[pair[1]], pair, geometry)
    x, y = np.meshgrid(geometry.lattice.x, geometry.lattice.y)
    first, second = (geometry.rig[name] for name in pair)
    x, y = (v - _sight(first, axis, v) * match.height for axis, v in enumerate((x, y)))  # of the water
    column, row = (
        np.rint((v - side[0]) / geometry.grid.step)
        for v, side in zip((x, y), (geometry.grid.x, geometry.grid.y))
    )
    ny, nx = displacement.shape[1:]
    good = match.matched & (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
    x, y, eps_y = x[good], y[good], match.eps_y[good]
    dx, dy, dz = displacement[:, row[good].astype(np.intp), column[good].astype(np.intp)]
    dx, dy = dx + _sight(second, 0, x) * dz, dy + _sight(second, 1, y) * dz  # in the second image
    p, q = (match.parallax / np.hypot(*match.parallax))[:, good]
    values = np.stack([x, y, eps_y, q * dx - p * dy, np.hypot(dx, dy)])
    x, y, miss, velocity, speed = _patch_means(
        values[:, np.isfinite(values).all(axis=0)], SIDE * geometry.pixel
    )
    if x.size < MIN_PATCHES:
        return None
    miss, velocity, speed = (v / geometry.pixel for v in (miss, velocity, speed))
    rows = [c.project(x, y, 0.0)[1] - 0.5 * (c.size[1] - 1) for c in (first, second)]  # from the middle
    stated = dict(geometry.settings.row_delays)
    late = stated.get(pair[1], 0.0) * rows[1] - stated.get(pair[0], 0.0) * rows[0]
    low = np.stack([np.ones(x.size), scaled(x), scaled(y)], axis=-1)
    return Sample(miss - late * velocity, velocity, low, float(speed.mean()), rows[1] - rows[0])


def _sight(camera: "Camera", axis: int, v: Array) -> Array:
    """Horizontal displacement of sight lines along an axis per height of the water."""
    return np.asarray((v - camera.centre[axis]) / -camera.centre[2])


def _patch_means(values: Array, side: float) -> Array:
    """Means over the patches that are at least half full of values (n, blocks) that begin with x and y."""
    if not values.size:
        return values
    column, row = np.floor((values[:2] - values[:2].min(axis=1)[:, None]) / side).astype(np.intp)
    which = row * (column.max() + 1) + column
    count = np.bincount(which)
    full = count >= 0.5 * count.max()
    return np.stack([np.bincount(which, one)[full] / count[full] for one in values])


def regress(samples: Sequence[Sample]) -> tuple[float, float] | None:
    """The delay of the second camera behind the first and its standard uncertainty, in frames.
    Robust least squares (Huber at 2.5); every instant has a constant and slopes of its own. The uncertainty
    is from leaving out one part of the field after the other, at all instants: near patches depend on each
    other, instants may show the same beads, and a single place may determine the delay.
    """
    if len(samples) < 2:
        return None
    weights = [np.ones(len(s.miss)) for s in samples]
    for _ in range(8):
        fitted = _fit_delay(samples, weights)
        if fitted is None:
            return None
        delay, left = fitted
        scale = PER_MEDIAN * float(np.median(np.abs(np.concatenate(left)))) + 1e-9
        weights = [np.minimum(1.0, 2.5 * scale / np.maximum(np.abs(r), 1e-12)) for r in left]
    cells = [_cells(s) for s in samples]
    changes = []
    for cell in np.unique(np.concatenate(cells)):
        others = _fit_delay(samples, [w * (c != cell) for w, c in zip(weights, cells)])
        if others is None:
            return None
        changes.append(others[0] - delay)
    return delay, float(np.sqrt((len(changes) - 1) / len(changes) * np.sum(np.square(changes))))


def _fit_delay(samples: Sequence[Sample], weights: Sequence[Array]) -> tuple[float, list[Array]] | None:
    """The delay, in frames, and the remaining mismatch; None if nothing moves."""
    cleared = [_cleared(s, w) for s, w in zip(samples, weights)]
    power = sum(float((w * v * v).sum()) for (_, v), w in zip(cleared, weights))
    if power <= 0:
        return None
    delay = sum(float((w * v * y).sum()) for (y, v), w in zip(cleared, weights)) / power
    return delay, [y - delay * v for y, v in cleared]


def is_determined(samples: Sequence[Sample], delay: float, std: float) -> bool:
    """Whether the motion determines a delay, given its standard uncertainty, in frames."""
    moving = np.concatenate([_cleared(s, np.ones(len(s.miss)))[1] for s in samples])
    fast = float(np.sqrt(np.mean(moving**2))) >= MIN_VELOCITY
    return fast and std < MAX_STD_INTERVALS and abs(delay) < MAX_INTERVALS


def row_time_of(samples: Sequence[Sample]) -> tuple[float, float] | None:
    """Delay from row to row, equal in both cameras, in frames."""
    other = [
        replace(s, velocity=s.velocity * s.rows, low=np.column_stack([s.low, s.velocity]))
        for s in samples
        if s.rows is not None
    ]
    return regress(other)


def _cells(one: Sample) -> NDArray[np.intp]:
    """Number of the part of the field that each patch lies in."""
    column, row = np.clip((one.low[:, 1:3].T + 1) * (0.5 * _CELLS), 0, _CELLS - 1).astype(np.intp)
    return np.asarray(row * _CELLS + column)


def _cleared(one: Sample, weight: Array) -> tuple[Array, Array]:
    """Mismatch and velocity without the part that a constant and slopes explain."""
    root = np.sqrt(weight)[:, None]
    both = np.stack([one.miss, one.velocity], axis=-1)
    fit = np.linalg.lstsq(root * one.low, root * both, rcond=None)[0]
    rest = both - one.low @ fit
    return rest[:, 0], rest[:, 1]


def delays(
    geometry: "GridGeometry",
    record: "LearnedRecord",
    instants: Sequence[LazyInstant],
    rate: float,
    threads: int = 1,
) -> Synchrony:
    """Delay of each camera's frames relative to most cameras, and delay from row to row."""
    late: dict[Pair, tuple[float, float]] = {}
    row_times: list[tuple[float, float]] = []
    speeds: list[float] = []

    def samples_at(instant: LazyInstant) -> list[Sample | None]:
        flat = _prepared(instant.images(), geometry, dict(record.beads))
        displacement = instant.displacement()
        return [sample(geometry, pair, flat, displacement) for pair in geometry.pairs]

    with ThreadPoolExecutor(threads) as pool:
        found_at = list(pool.map(samples_at, instants))
    for pair, of_pair in zip(geometry.pairs, zip(*found_at)):
        samples = [s for s in of_pair if s is not None]
        speeds += [s.speed for s in samples]
        found = regress(samples)
        if found is None or not is_determined(samples, *found):
            continue
        late[pair] = found
        if (row_time := row_time_of(samples)) is not None:
            row_times.append(row_time)
    if len(late) < len(geometry.pairs):
        return Synchrony({})
    height = max(geometry.rig[name].size[1] for name in geometry.surface_cameras)
    surest = min(row_times, key=lambda one: one[1], default=None)
    readout = Delay(surest[0] / rate, surest[1] / rate) if surest else None
    return Synchrony(_of_cameras(late, rate), rate * float(np.median(speeds)), readout, height)


def _prepared(
    images: Mapping[str, NDArray[Any] | None], geometry: "GridGeometry", widths: Mapping[str, float]
) -> dict[str, Any]:
    """Images of an instant, ready for matching between cameras; those that cannot be used are left out."""
    from wavefield.measurement.images import prepare, ready, usable

    out = {}
    for name in geometry.surface_cameras:
        image = images.get(name)
        if image is not None and usable(image, geometry.rig[name].size):
            flat = ready(image, geometry.sights[name].binning, widths[name])
            out[name] = prepare(flat, name, geometry)
    return out


def _of_cameras(found: Mapping[Pair, tuple[float, float]], rate: float) -> dict[str, Delay]:
    """Delay of each camera relative to most, s, from those of pairs with the reference, in frames."""
    late = {next(iter(found))[0]: (0.0, 0.0)} | {name: one for (_, name), one in found.items()}
    # only differences are measured: the median of the cameras, or the reference of two, has no delay
    usual = next(iter(late))
    if len(late) > 2:
        usual = sorted(late, key=lambda name: late[name][0])[len(late) // 2]
    out = {}
    for name, (delay, std) in late.items():
        delay = delay - late[usual][0]
        std = 0.0 if name == usual else float(np.hypot(std, late[usual][1]))
        out[name] = Delay(delay / rate, float(np.hypot(std, BIAS * delay)) / rate)
    return out


def remarks_on_clocks(found: Synchrony) -> Iterator[Remark]:
    """Remarks on delays between cameras, and on a rolling shutter that all of them share."""
    yield from _on_delays(found.delays, found.speed)
    if found.row_time is None:
        return
    late, std = abs(found.row_time.seconds) * found.rows, found.row_time.std * found.rows
    off = 0.5 * late * found.speed
    if late < SIGNIFICANCE * std or std > MAX_READOUT_STD or off < CAMERA_LIMITS.delay_motion:
        return
    order = "after" if found.row_time.seconds > 0 else "before"
    yield Remark(
        "cameras",
        "rolling shutter",
        "remark",
        f"the last row of an image is read {1e3 * late:.2g} ms {order} the first (+- {1e3 * std:.2g} ms)",
        f"The water moves {off:.2f} px from the middle to the edge meanwhile: z and velocities are off there",
        "State `row_time` of every camera that has a rolling shutter, and of no other, from its data sheet "
        f"(about {abs(found.row_time.seconds):.2g} s if all have one alike), or use a global shutter",
        {"row_time": found.row_time.seconds, "std": found.row_time.std, "px": off},
    )


def _on_delays(found: Mapping[str, Delay], speed: float) -> Iterator[Remark]:
    for name, one in found.items():
        if abs(one.seconds) < max(SIGNIFICANCE * one.std, CAMERA_LIMITS.delay):
            continue
        off, word = abs(one.seconds) * speed, "later" if one.seconds > 0 else "earlier"
        yield Remark(
            name,
            "delayed",
            "remark" if off > CAMERA_LIMITS.delay_motion else "note",
            f"its frames are taken {1e3 * abs(one.seconds):.3f} ms {word} than the others' "
            f"(+- {1e3 * one.std:.3f} ms)",
            f"The water moves {off:.2f} px meanwhile: z is off by about as much",
            "Trigger all cameras by one signal and give them one exposure time",
            {"delay": one.seconds, "std": one.std, "px": off},
        )


def spell_delays(found: Mapping[str, Delay], interval: float = np.inf) -> str:
    """Text with the delays of all cameras; those with an uncertainty above half a frame interval (s) are
    omitted.
    """
    first = next((name for name, one in found.items() if one.std == 0), "")
    words = []
    for name, one in found.items():
        late, std = 1e3 * one.seconds, 1e3 * one.std
        if name == first or one.std >= MAX_STD_INTERVALS * interval:
            continue
        if abs(late) < 2.0 * std or abs(late) < 1e3 * CAMERA_LIMITS.delay:
            within = max(abs(late) + std, 1e3 * CAMERA_LIMITS.delay)
            words.append(f"{first} and {name} are synchronous within {within:.2g} ms")
        else:
            words.append(
                f"{name} is {abs(late):.3f} +- {std:.3f} ms {'later' if late > 0 else 'earlier'} than {first}"
            )
    return "; ".join(words) or "not determined: too little moves or matches"


# -- motion of the mounts, from eps_y at every step

MAX_STEPS = 600  # steps that are read, evenly over the record
MAX_NODES = 2000  # of each
MIN_NODES = 50  # of a step
MIN_STEPS_PER_SIDE = 3  # of a jump
PIECE = 64  # steps in which the motion of the mean level is separated from slow waves
MIN_FREEDOM = 3  # steps of a record more than slow waves can explain
SLOW_WAVES = 3e-3  # singular value, of the largest, down to which slow waves explain the mean level


@dataclass(frozen=True)
class CameraMotion:
    """Fit of a constant and slopes in x and y to the epipolar error eps_y, at several steps."""

    steps: NDArray[np.intp]  # (n,): Which steps were read
    low: Array  # (n, 3), px: eps_y at the middle of the field; its change to the right and to the upper edge
    std: Array  # (n, 3): Standard uncertainty, px


@dataclass(frozen=True)
class Knock:
    """A sudden turn of a camera, with its frame."""

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


def knock(cube: xr.Dataset, found: CameraMotion) -> Knock | None:
    """The largest jump of a record, dated to a frame; None if it does not jump."""
    at = jump(found.low)
    if at is None:
        return None
    before, after = (np.median(part, axis=0) for part in (found.low[:at], found.low[at:]))
    between = range(max(int(found.steps[at - 1]) - 1, 0), int(found.steps[at]) + 1)
    near = camera_motion(cube, list(between))
    along = (near.low - before) @ (after - before) / float((after - before) @ (after - before))
    # a step shows the mean of its two frames: the one in which the knock falls is half way
    whole = near.steps[along > 0.75]
    frame = int(whole[0]) if whole.size else int(found.steps[at])
    return Knock(frame, rms_over_field(after - before))


def shaking(found: CameraMotion, knocked: Knock | None) -> tuple[float, float]:
    """Rms shake of the cameras' pictures from step to step, before and after a knock, and its uncertainty."""
    cut = np.searchsorted(found.steps, knocked.frame) if knocked else 0
    parts = [part - part.mean(axis=0) for part in (found.low[:cut], found.low[cut:]) if len(part)]
    rest = np.concatenate(parts)
    freedom = len(rest) - len(parts)
    variance = (rest**2).sum(axis=0) / freedom - np.mean(found.std**2, axis=0)
    power = max(float(variance[0] + (variance[1] + variance[2]) / 3), 0.0)
    noise = float(np.mean(found.std[:, 0] ** 2)) + power
    return float(np.sqrt(power)), float(np.sqrt(noise / (2 * freedom)))


def remarks_on_mounts(cube: xr.Dataset) -> Iterator[Remark]:
    """Remarks on cameras that are knocked or shake."""
    found = camera_motion(cube)
    if len(found.steps) < 2 * MIN_STEPS_PER_SIDE:
        return
    one = knock(cube, found)
    if one is not None:
        frame = int(cube.frame[0]) + one.frame
        yield Remark(
            "rig",
            "moved",
            "grave" if one.size > 10 * CAMERA_LIMITS.motion else "remark",
            f"sight lines miss each other by {one.size:.2f} px more from frame {frame} on",
            f"A camera was knocked between frames {frame - 1} and {frame}; z is off by as much or more since",
            "Run the two parts by themselves (`frames: {first, last}`), the second with a rig corrected by "
            "`wavefield refine`; `check` of the second part names the camera",
            {"frame": frame, "px": one.size},
        )
    rms, std = shaking(found, one)
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
