"""Cameras that are late, shake or were knocked, from the epipolar errors (eps_y) of moving water.

Water causes no eps_y, whatever its shape: eps_y is the part of a displacement between two images that lies
across their parallax. The part of it that is constant or linear over the field belongs to the mounts. It
varies from step to step if a camera shakes (tilt, roll), and jumps once if a camera was knocked.

A camera that is late by tau sees every bead tau times its velocity further on. Along the parallax this looks
like height. Across it, eps_y is tau times the velocity across the sight lines, so that one regression of
eps_y on that velocity, over patches of some instants, gives tau. Each instant has a constant and slopes of
its own, which take up the motion of the mounts. The rows of a rolling shutter are read one after the other:
the delay then grows with the difference between the rows in which two cameras see a place.

Both sides of the regression must have one resolution, or tau is too large: they are means over one patch.
The velocity is the mean of the steps before and after the frame, which is 5 % low for 2 Hz waves at 20 frames
per second; `BIAS` adds so much to the uncertainty.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.quality.cameras import MIN_PATCHES, SIDE, Array, Pair, rms_over_field, scaled
from wavefield.quality.remarks import CELLS, GRAVE_MISS, MAX_MISS, MAX_NODES, MIN_NODES, SIGNIFICANCE
from wavefield.robust import robust_std
from wavefield.store.verdict import Remark

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, LearnedRecord
    from wavefield.rig import Camera

BIAS = 0.05  # of a delay, because water turns between the steps whose velocity is taken
MIN_VELOCITY = 0.03  # px per frame, rms without constant and slopes: less is noise of the matching
MAX_STD = 0.5  # frame intervals: a delay of larger uncertainty is not determined

Images = Mapping[str, NDArray[Any] | None]  # of one instant, by camera


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


class Synchrony(NamedTuple):
    """Whether the cameras, and the rows of their images, are read at the same moment."""

    delays: dict[str, Delay]  # Of each camera's frames behind those of most
    speed: float = 0.0  # Of the beads, px/s
    row_time: Delay | None = None  # Of each row behind the one above it, beyond what is stated
    rows: int = 0  # Of the highest image


def sample(
    geometry: "GridGeometry", pair: Pair, flat: Mapping[str, Any], displacement: NDArray[np.floating]
) -> Sample | None:
    """Mean eps_y and velocity in patches of two cameras at an instant; None with too few patches.

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
    """Means over square patches of values (n, blocks) that begin with x and y; half-empty patches leave."""
    if not values.size:
        return values
    column, row = np.floor((values[:2] - values[:2].min(axis=1)[:, None]) / side).astype(np.intp)
    which = row * (column.max() + 1) + column
    count = np.bincount(which)
    full = count >= 0.5 * count.max()
    return np.stack([np.bincount(which, one)[full] / count[full] for one in values])


def regress(samples: Sequence[Sample]) -> tuple[float, float] | None:
    """Delay of the second camera behind the first and its standard uncertainty, in frames.

    Robust least squares (Huber at 2.5 standard deviations); None with fewer than two instants, or if too
    little moves. The uncertainty is a jackknife over parts of the field, at all instants: near patches depend
    on each other, instants may show the same beads, and a single place may determine the delay.
    """
    if len(samples) < 2:
        return None
    weights = [np.ones(len(s.miss)) for s in samples]
    moving = np.concatenate([_cleared(s, w)[1] for s, w in zip(samples, weights)])
    if not np.sqrt(np.mean(moving**2)) >= MIN_VELOCITY:
        return None
    for _ in range(8):
        delay, left = _fit_delay(samples, weights)
        limit = 2.5 * robust_std(np.concatenate(left)) + 1e-9
        weights = [np.minimum(1.0, limit / np.maximum(np.abs(r), 1e-12)) for r in left]
    cells = [_cells(s) for s in samples]
    others = [
        _fit_delay(samples, [w * (c != cell) for w, c in zip(weights, cells)])[0]
        for cell in np.unique(np.concatenate(cells))
    ]
    share = (len(others) - 1) / len(others)
    return delay, float(np.sqrt(share * np.sum(np.square(np.subtract(others, delay)))))


def _fit_delay(samples: Sequence[Sample], weights: Sequence[Array]) -> tuple[float, list[Array]]:
    """The delay, in frames, and the remaining mismatch."""
    cleared = [_cleared(s, w) for s, w in zip(samples, weights)]
    power = sum(float((w * v * v).sum()) for (_, v), w in zip(cleared, weights))
    delay = sum(float((w * v * y).sum()) for (y, v), w in zip(cleared, weights)) / max(power, 1e-12)
    return delay, [y - delay * v for y, v in cleared]


def _cleared(one: Sample, weight: Array) -> tuple[Array, Array]:
    """Residuals of mismatch and velocity after a fit of a constant and slopes."""
    root = np.sqrt(weight)[:, None]
    both = np.stack([one.miss, one.velocity], axis=-1)
    fit = np.linalg.lstsq(root * one.low, root * both, rcond=None)[0]
    rest = both - one.low @ fit
    return rest[:, 0], rest[:, 1]


def row_time_of(samples: Sequence[Sample]) -> tuple[float, float] | None:
    """Delay from row to row, equal in both cameras, and its standard uncertainty, in frames."""
    return regress(
        [
            replace(s, velocity=s.velocity * s.rows, low=np.column_stack([s.low, s.velocity]))
            for s in samples
            if s.rows is not None
        ]
    )


def _cells(one: Sample) -> NDArray[np.intp]:
    """Number of the part of the field that each patch lies in."""
    column, row = np.clip((one.low[:, 1:3].T + 1) * (0.5 * CELLS), 0, CELLS - 1).astype(np.intp)
    return np.asarray(row * CELLS + column)


def delays(
    geometry: "GridGeometry",
    record: "LearnedRecord",
    frames: Sequence[int],
    images: Callable[[int], Images],
    displacement: Callable[[int], NDArray[np.floating]],
    rate: float,
    threads: int = 1,
) -> Synchrony:
    """Delay of each camera's frames relative to most cameras, and delay from row to row.

    ``images`` gives those of a frame; ``displacement`` how the nodes move there, (3, ny, nx), metres per
    frame, NaN where it is not measured.
    """
    late: dict[Pair, tuple[float, float]] = {}
    row_times: list[tuple[float, float]] = []
    speeds: list[float] = []

    def samples_at(frame: int) -> list[Sample | None]:
        flat = _prepared(images(frame), geometry, dict(record.beads))
        moved = displacement(frame)
        return [sample(geometry, pair, flat, moved) for pair in geometry.pairs]

    with ThreadPoolExecutor(threads) as pool:
        found_at = list(pool.map(samples_at, frames))
    for pair, of_pair in zip(geometry.pairs, zip(*found_at)):
        samples = [s for s in of_pair if s is not None]
        speeds += [s.speed for s in samples]
        found = regress(samples)
        if found is None or found[1] > MAX_STD:
            return Synchrony({})
        late[pair] = found
        if (row_time := row_time_of(samples)) is not None:
            row_times.append(row_time)
    if not late:
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
    for name, one in found.delays.items():
        off, word = abs(one.seconds) * found.speed, "later" if one.seconds > 0 else "earlier"
        if abs(one.seconds) > SIGNIFICANCE * one.std and off > MAX_MISS:
            yield Remark(
                name,
                "delayed",
                "remark",
                f"its frames are taken {1e3 * abs(one.seconds):.3f} ms {word} than the others' "
                f"(+- {1e3 * one.std:.3f} ms)",
                f"The water moves {off:.2f} px meanwhile: z is off by about as much",
                "Trigger all cameras by one signal and give them one exposure time",
                {"delay": one.seconds, "std": one.std, "px": off},
            )
    if found.row_time is None:
        return
    late, std = abs(found.row_time.seconds) * found.rows, found.row_time.std * found.rows
    off = 0.5 * late * found.speed
    if late < SIGNIFICANCE * std or off < MAX_MISS:
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


def spell_delays(found: Mapping[str, Delay]) -> str:
    """Delays of the cameras as text."""
    first = next((name for name, one in found.items() if one.std == 0), "")
    words = [
        f"{name} is {1e3 * abs(one.seconds):.3f} +- {1e3 * one.std:.3f} ms "
        f"{'later' if one.seconds > 0 else 'earlier'} than {first}"
        for name, one in found.items()
        if name != first
    ]
    return "; ".join(words) or "not determined: too little moves or matches"


# -- motion of the mounts, from eps_y at every step

MIN_STEPS_PER_SIDE = 3  # of a jump


@dataclass(frozen=True)
class CameraMotion:
    """Constant and slopes in x and y fitted to the epipolar error eps_y of each step."""

    steps: NDArray[np.intp]  # (n,): Those with enough measured nodes
    low: Array  # (n, 3), px: eps_y at the middle of the field; its change to the right and to the upper edge
    std: Array  # (n, 3): Standard uncertainty, px


@dataclass(frozen=True)
class Knock:
    """A sudden turn of a camera."""

    frame: int  # First frame (index in the record) after it
    size: float  # Change of eps_y, rms over the field, px


def camera_motion(cube: xr.Dataset) -> CameraMotion:
    """Fit the low-order part of eps_y at every step of a cube."""
    count, ny, nx = cube.eps_y.shape
    every = slice(None, None, max(1, int(np.sqrt(ny * nx / MAX_NODES))))
    x, y = np.meshgrid(*(np.linspace(-1, 1, n)[every] for n in (nx, ny)))
    design = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=-1)
    chunk = max(cube.eps_y.chunksizes.get("time", (64,))[0], 1)
    fits = {}
    for start in range(0, count, chunk):
        part = cube.eps_y.isel(time=slice(start, start + chunk), y=every, x=every).values
        for k, values in enumerate(part / float(cube.attrs["pixel_size"]), start):
            if (fit := _fit_low_order(design, values.ravel())) is not None:
                fits[k] = fit
    low, std = (np.array([fit[part] for fit in fits.values()]).reshape(-1, 3) for part in (0, 1))
    return CameraMotion(np.array(list(fits), int), low, std)


def _fit_low_order(design: Array, values: Array) -> tuple[Array, Array] | None:
    """Coefficients, fitted without outliers, and their standard uncertainties; None with too few values."""
    near = np.isfinite(values)
    if near.sum() >= MIN_NODES:
        departure = values - np.median(values[near])
        near &= np.abs(departure) < 4 * robust_std(departure[near]) + 1.0
    if near.sum() < MIN_NODES:
        return None
    A, b = design[near], values[near].astype(float)
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
    if rms_over_field(after[best] - before[best]) < max(MAX_MISS, 2 * scatter):
        return None
    return int(cuts[best])


def knock(found: CameraMotion) -> Knock | None:
    """The largest jump of a record, dated to a frame; None if it does not jump."""
    at = jump(found.low)
    if at is None:
        return None
    before, after = (np.median(part, axis=0) for part in (found.low[:at], found.low[at:]))
    near = slice(at - 1, at + 2)
    along = (found.low[near] - before) @ (after - before) / float((after - before) @ (after - before))
    # a step shows the mean of its two frames: the one in which the knock falls is half way
    frame = int(found.steps[near][np.argmax(along > 0.75)])
    return Knock(frame, rms_over_field(after - before))


def shaking(found: CameraMotion, knocked: Knock | None) -> tuple[float, float]:
    """Rms over field and steps by which eps_y varies, before and after a knock, and its uncertainty, px."""
    cut = np.searchsorted(found.steps, knocked.frame) if knocked else 0
    parts = [part - part.mean(axis=0) for part in (found.low[:cut], found.low[cut:]) if len(part)]
    rest = np.concatenate(parts)
    freedom = len(rest) - len(parts)
    variance = (rest**2).sum(axis=0) / freedom - np.mean(found.std**2, axis=0)
    power = max(float(variance[0] + (variance[1] + variance[2]) / 3), 0.0)
    noise = float(np.mean(found.std[:, 0] ** 2)) + power
    return float(np.sqrt(power)), float(np.sqrt(noise / (2 * freedom)))


def remarks_on_mounts(cube: xr.Dataset) -> Iterator[Remark]:
    """Remarks on cameras that were knocked within the record, or that shake."""
    found = camera_motion(cube)
    if len(found.steps) < 2 * MIN_STEPS_PER_SIDE:
        return
    one = knock(found)
    if one is not None:
        frame = int(cube.frame[0]) + one.frame
        yield Remark(
            "rig",
            "moved",
            "grave" if one.size > GRAVE_MISS else "remark",
            f"sight lines miss each other by {one.size:.2f} px more from frame {frame} on",
            f"A camera was knocked between frames {frame - 1} and {frame}; z is off by as much or more since",
            "Run the two parts by themselves (`frames: {first, last}`), the second with a rig corrected by "
            "`wavefield refine`; `check` of the second part names the camera",
            {"frame": frame, "px": one.size},
        )
    rms, std = shaking(found, one)
    if rms > max(MAX_MISS, SIGNIFICANCE * std):
        yield Remark(
            "cameras",
            "vibration",
            "remark",
            f"from step to step their sight lines miss each other by {rms:.3f} +- {std:.3f} px, rms",
            "The cameras tilt or roll on their mounts: z and velocities are off by about as much",
            "Stiffen the mounts and keep carriages, pumps and people away; `settings: {vibration: correct}` "
            "turns the images back",
            {"px": rms, "std": std},
        )
