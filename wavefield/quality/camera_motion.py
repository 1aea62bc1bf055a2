"""Find cameras that are delayed, vibrate or were knocked, from the epipolar errors (eps_y) of moving water.

eps_y is the displacement between the images of two cameras across their parallax. With a correct calibration,
water of any shape has eps_y = 0. If eps_y is constant or linear over the field, a camera has turned: eps_y
varies from step to step if a camera vibrates (tilt, roll), and jumps once if a camera was knocked. A step is
the interval between two consecutive frames. A patch is a square of `SIDE` x `SIDE` pixels on the water.

A camera that is delayed by tau sees every bead displaced by tau times its velocity. The component of this
displacement along the parallax looks like height. The component across the parallax is eps_y, so tau is the
slope of a regression of eps_y on the velocity across the parallax, over the patches of several frames. Each
frame has a constant and linear terms of its own, which absorb the motion of the mounts. A rolling shutter
reads rows one after the other: the delay then grows with the difference between the rows in which two cameras
see a patch.

If eps_y and velocity differed in resolution, tau would be too large, so both are averaged over the same
patches. The velocity is the mean of the steps before and after the frame, which is 5 % too low for 2 Hz waves
at 20 frames per second. `BIAS` includes this error in the uncertainty.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.measurement.velocity import MIN_NODES
from wavefield.quality.cameras import MIN_PATCHES, SIDE, Array, Pair, Read, rms_over_field, scaled
from wavefield.quality.remarks import CELLS, GRAVE_EPS_Y, MAX_EPS_Y, MAX_SAMPLES, SIGNIFICANCE
from wavefield.robust import robust_std
from wavefield.store.verdict import Remark, Weight

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry
    from wavefield.measurement.model import LearnedRecord
    from wavefield.rig import Camera

BIAS = 0.05  # relative error of a delay, because velocities are averaged over two steps (see above)
MIN_STEPS_PER_SIDE = 3  # steps before and after a jump
MIN_VELOCITY = 0.03  # px per frame, rms after the fit of linear terms: less is matching noise


@dataclass(frozen=True)
class Delay:
    """Measured time by which a camera is later than another, or an image row later than the row above."""

    seconds: float  # Delay, s; negative if earlier
    std: float  # Standard uncertainty, s


@dataclass(frozen=True)
class Sample:
    """Mean epipolar error and velocity in each of m patches of the water, for two cameras at one frame."""

    eps_y: Array  # (m,): Mean epipolar error, px on the water
    velocity: Array  # (m,): Velocity of the beads across the parallax, px per frame
    design: Array  # (m, 3): Columns of the linear fit: 1, x and y, both scaled to -1 to 1
    speed: float = 0.0  # Horizontal speed of the beads, mean over all patches, px per frame
    rows: Array | float = 0.0  # (m,): Row in the second image minus row in the first, from each mid-image


class Synchrony(NamedTuple):
    """Result of `delays`: delays between cameras and between image rows, and the speed of the beads."""

    # By camera: delay behind the median camera of three or more, or behind the reference camera of two;
    # empty if unknown
    delays: dict[str, Delay]
    speed: float = 0.0  # Median speed of the beads, px/s
    # Of an image row behind the row above, minus the `row_time` that the user gave; None if unknown
    row_time: Delay | None = None
    rows: int = 0  # Rows of the largest image


def sample(
    geometry: "GridGeometry", pair: Pair, flat: Mapping[str, Any], displacement: NDArray[np.floating]
) -> Sample | None:
    """Match the images of two cameras at one frame, and average epipolar error and velocity over patches.
    None if an image is missing or few patches match. ``flat`` holds filtered images by camera;
    ``displacement`` (3, ny, nx) is that of the water along x, y, z at the nodes, metres per frame, or NaN."""
    from wavefield.measurement.elevation import match_pair

    if not all(name in flat for name in pair):
        return None
    match = match_pair(flat[pair[0]], flat[pair[1]], pair, geometry)
    x, y = np.meshgrid(geometry.lattice.x, geometry.lattice.y)
    first, second = (geometry.rig[name] for name in pair)
    # where the sight line of the first camera meets the water
    x, y = (v + _sight_slope(first, axis, v) * match.height for axis, v in enumerate((x, y)))
    column, row = (
        np.rint((v - side[0]) / geometry.grid.step)
        for v, side in zip((x, y), (geometry.grid.x, geometry.grid.y))
    )
    ny, nx = displacement.shape[1:]
    good = match.matched & (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
    x, y, eps_y = x[good], y[good], match.eps_y[good]
    dx, dy, dz = displacement[:, row[good].astype(np.intp), column[good].astype(np.intp)]
    # displacement seen by the second camera, projected on z = 0
    dx, dy = dx - _sight_slope(second, 0, x) * dz, dy - _sight_slope(second, 1, y) * dz
    p, q = (match.parallax / np.hypot(*match.parallax))[:, good]
    values = np.stack([x, y, eps_y, q * dx - p * dy, np.hypot(dx, dy)])
    x, y, eps_y, velocity, speed = _patch_means(
        values[:, np.isfinite(values).all(axis=0)], SIDE * geometry.pixel
    )
    if x.size < MIN_PATCHES:
        return None
    eps_y, velocity, speed = (v / geometry.pixel for v in (eps_y, velocity, speed))
    row_delays = dict(geometry.settings.row_delays)  # of rolling shutters
    rows = [c.project(x, y, 0.0)[1] - 0.5 * (c.size[1] - 1) for c in (first, second)]  # from mid-image
    delay = row_delays.get(pair[1], 0.0) * rows[1] - row_delays.get(pair[0], 0.0) * rows[0]
    design = np.stack([np.ones(x.size), scaled(x), scaled(y)], axis=-1)
    return Sample(eps_y - delay * velocity, velocity, design, float(speed.mean()), rows[1] - rows[0])


def _sight_slope(camera: "Camera", axis: int, v: Array) -> Array:
    """Return the slope dx/dz (``axis`` 0) or dy/dz (``axis`` 1) of sight lines of a camera.
    ``v`` holds the coordinates, along this axis, of the points where the lines cross z = 0, metres."""
    return np.asarray((v - camera.centre[axis]) / -camera.centre[2])


def _patch_means(values: Array, side: float) -> Array:
    """Average quantities at interrogation blocks, ``values`` (quantity, block), to (quantity, patch).
    The first two quantities are x and y of the blocks; ``side`` is the side of a patch in the same unit.
    Patches with less than half as many blocks as the fullest patch are left out."""
    if not values.size:
        return values
    column, row = np.floor((values[:2] - values[:2].min(axis=1)[:, None]) / side).astype(np.intp)
    which = row * (column.max() + 1) + column
    count = np.bincount(which)
    full = count >= 0.5 * count.max()
    return np.stack([np.bincount(which, one)[full] / count[full] for one in values])


def regress(samples: Sequence[Sample]) -> tuple[float, float] | None:
    """Fit the delay of the second of two cameras behind the first, by a robust regression over all samples.
    ``samples`` has one `Sample` per frame. Returns the delay and the standard uncertainty of the delay, in
    frame intervals; None for fewer than two samples, or if the water hardly moves."""
    if len(samples) < 2:
        return None
    weights = [np.ones(len(s.eps_y)) for s in samples]
    moving = np.concatenate([_residuals(s, w)[1] for s, w in zip(samples, weights)])
    if not np.sqrt(np.mean(moving**2)) >= MIN_VELOCITY:
        return None
    for _ in range(8):
        delay, left = _fit_delay(samples, weights)
        limit = 2.5 * robust_std(np.concatenate(left)) + 1e-9
        weights = [np.minimum(1.0, limit / np.maximum(np.abs(r), 1e-12)) for r in left]
    # uncertainty: a jackknife over parts of the field, each left out at all frames, because neighbouring
    # patches are correlated, frames may show the same beads, and one part alone may determine the delay
    cells = [np.clip((s.design[:, 1:3] + 1) * (0.5 * CELLS), 0, CELLS - 1).astype(int) for s in samples]
    cells = [row * CELLS + column for column, row in (c.T for c in cells)]
    others = [
        _fit_delay(samples, [w * (c != cell) for w, c in zip(weights, cells)])[0]
        for cell in np.unique(np.concatenate(cells))
    ]
    factor = (len(others) - 1) / len(others)
    return delay, float(np.sqrt(factor * np.sum(np.square(np.subtract(others, delay)))))


def _fit_delay(samples: Sequence[Sample], weights: Sequence[Array]) -> tuple[float, list[Array]]:
    """Fit the delay between two cameras by least squares; ``weights`` has an array (m,) for each sample.
    Returns the delay, in frame intervals, and for each sample the residuals of eps_y (m,), px."""
    residuals = [_residuals(s, w) for s, w in zip(samples, weights)]
    power = sum(float((w * v * v).sum()) for (_, v), w in zip(residuals, weights))
    delay = sum(float((w * v * y).sum()) for (y, v), w in zip(residuals, weights)) / max(power, 1e-12)
    return delay, [y - delay * v for y, v in residuals]


def _residuals(one: Sample, weight: Array) -> tuple[Array, Array]:
    """Return eps_y (px) and velocity (px per frame) of the m patches, each minus its fit by `Sample.design`.
    The columns of this array (1, x, y) are fitted by least squares with the patch weights ``weight`` (m,)."""
    root = np.sqrt(weight)[:, None]
    both = np.stack([one.eps_y, one.velocity], axis=-1)
    fit = np.linalg.lstsq(root * one.design, root * both, rcond=None)[0]
    rest = both - one.design @ fit
    return rest[:, 0], rest[:, 1]


def delays(
    geometry: "GridGeometry",
    record: "LearnedRecord",
    frames: Sequence[int],
    read: Read,
    displacement: Callable[[int], NDArray[np.floating]],
    rate: float,
    threads: int = 1,
) -> Synchrony:
    """Measure the delays of cameras and of image rows at ``frames``; empty if the fit of any pair fails.
    ``read(camera, frame)`` returns an image or None, ``record`` has the bead widths, ``displacement(frame)``
    is that of the water at the nodes, (3, ny, nx), metres per frame, NaN where unknown. ``rate`` is in Hz."""
    from wavefield.measurement.images import prepare, ready, usable

    widths = dict(record.beads)
    pair_delays: dict[Pair, tuple[float, float]] = {}
    row_times: list[tuple[float, float]] = []
    speeds: list[float] = []

    def samples_at(frame: int) -> list[Sample | None]:
        flat = {}
        for name in geometry.surface_cameras:
            image = read(name, frame)
            if image is not None and usable(image, geometry.rig[name].size):
                even = ready(image, geometry.sights[name].binning, widths[name])
                flat[name] = prepare(even, name, geometry)
        moved = displacement(frame)
        return [sample(geometry, pair, flat, moved) for pair in geometry.pairs]

    if not geometry.pairs or not frames:
        return Synchrony({})
    with ThreadPoolExecutor(threads) as pool:
        found_at = list(pool.map(samples_at, frames))
    for pair, of_pair in zip(geometry.pairs, zip(*found_at)):
        samples = [s for s in of_pair if s is not None]
        speeds += [s.speed for s in samples]
        found = regress(samples)
        if found is None:
            return Synchrony({})
        pair_delays[pair] = found
        by_row = [  # the delay of a pair is now part of the linear terms
            replace(s, velocity=s.velocity * s.rows, design=np.column_stack([s.design, s.velocity]))
            for s in samples
        ]
        if (row_time := regress(by_row)) is not None:
            row_times.append(row_time)
    surest = min(row_times, key=lambda one: one[1], default=None)
    readout = Delay(surest[0] / rate, surest[1] / rate) if surest else None
    rows = max(geometry.rig[name].size[1] for name in geometry.surface_cameras)
    return Synchrony(_camera_delays(pair_delays, rate), rate * float(np.median(speeds)), readout, rows)


def _camera_delays(found: Mapping[Pair, tuple[float, float]], rate: float) -> dict[str, Delay]:
    """Convert the delays between cameras to a delay of each camera, s; ``rate`` is the frame rate, Hz.
    ``found`` holds, by pair (reference camera, other camera), the delay of the other camera and its standard
    uncertainty, in frame intervals."""
    delays = {next(iter(found))[0]: (0.0, 0.0)} | {name: one for (_, name), one in found.items()}
    # only differences are measured: zero is the median camera of three or more, the reference camera of two
    median = next(iter(delays))
    if len(delays) > 2:
        median = sorted(delays, key=lambda name: delays[name][0])[len(delays) // 2]
    out = {}
    for name, (delay, std) in delays.items():
        delay = delay - delays[median][0]
        std = 0.0 if name == median else float(np.hypot(std, delays[median][1]))
        out[name] = Delay(delay / rate, float(np.hypot(std, BIAS * delay)) / rate)
    return out


def remarks_on_clocks(found: Synchrony) -> Iterator[Remark]:
    """Yield remarks on late or early cameras, and on a rolling shutter that `row_time` does not correct."""
    for name, one in found.delays.items():
        off, word = abs(one.seconds) * found.speed, "later" if one.seconds > 0 else "earlier"
        if abs(one.seconds) > SIGNIFICANCE * one.std and off > MAX_EPS_Y:
            sentence = (
                f"its frames are taken {1e3 * abs(one.seconds):.3f} ms {word} than the others' "
                f"(+- {1e3 * one.std:.3f} ms)"
            )
            means = f"The water moves {off:.2f} px in that time: z is wrong by about as much"
            remedy = "Trigger all cameras by one signal, with the same exposure time"
            values = {"delay": one.seconds, "std": one.std, "px": off}
            yield Remark(name, "delayed", "remark", sentence, means, remedy, values)
    if found.row_time is None:
        return
    late, std = found.rows * abs(found.row_time.seconds), found.rows * found.row_time.std
    off = 0.5 * late * found.speed
    if late > SIGNIFICANCE * std and off > MAX_EPS_Y:
        yield Remark(
            "cameras",
            "rolling shutter",
            "remark",
            f"the first and the last row of an image are read {1e3 * late:.2g} +- {1e3 * std:.2g} ms apart",
            f"The water moves {off:.2f} px from mid-image to the edge: z and velocities are wrong there",
            "Give `row_time` of each camera with a rolling shutter, and of no other, from its data sheet "
            f"(about {found.row_time.seconds:.2g} s if all are equal), or use global shutters",
            {"row_time": found.row_time.seconds, "std": found.row_time.std, "px": off},
        )


def spell_delays(found: Mapping[str, Delay]) -> str:
    """Return a text on the delay of each camera, such as "cam2 is 3.100 +- 0.200 ms later than cam1".
    ``found`` is `Synchrony.delays`; the delays are relative to the camera whose uncertainty is zero."""
    first = next((name for name, one in found.items() if one.std == 0), "")
    words = []
    for name, one in found.items():
        delay, std = 1e3 * abs(one.seconds), 1e3 * one.std  # ms
        if name != first and delay <= 2 * std:
            words.append(f"{first} and {name} are synchronous within {delay + std:.2g} ms")
        elif name != first:
            order = "later" if one.seconds > 0 else "earlier"
            words.append(f"{name} is {delay:.3f} +- {std:.3f} ms {order} than {first}")
    return "; ".join(words) or "not determined: the water hardly moves, or too few patches match"


@dataclass(frozen=True)
class CameraMotion:
    """Linear fits in x and y to the epipolar error of each step. A camera that turns changes the fits."""

    steps: NDArray[np.intp]  # (n,): Steps with enough measured nodes
    coefficients: Array  # (n, 3), px: eps_y at mid-field; its change from there to the right and upper edge
    std: Array  # (n, 3): Standard uncertainty of the coefficients, px


def camera_motion(cube: xr.Dataset) -> CameraMotion:
    """Fit a constant and linear terms in x and y to the epipolar error ``eps_y`` of each step of a cube.
    A step is the interval between two frames. Steps with few measured nodes are left out."""
    count, ny, nx = cube.eps_y.shape
    every = slice(None, None, max(1, int(np.sqrt(ny * nx / MAX_SAMPLES))))
    x, y = np.meshgrid(*(np.linspace(-1, 1, n)[every] for n in (nx, ny)))
    design = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=-1)
    chunk = max(cube.eps_y.chunksizes.get("time", (64,))[0], 1)
    fits = {}
    for start in range(0, count, chunk):
        part = cube.eps_y.isel(time=slice(start, start + chunk), y=every, x=every).values
        for k, values in enumerate(part / float(cube.attrs["pixel_size"]), start):
            if (fit := _fit_linear(design, values.ravel())) is not None:
                fits[k] = fit
    coefficients, std = (np.array([fit[part] for fit in fits.values()]).reshape(-1, 3) for part in (0, 1))
    return CameraMotion(np.array(list(fits), int), coefficients, std)


def _fit_linear(design: Array, values: Array) -> tuple[Array, Array] | None:
    """Fit ``values`` (n,), without outliers and NaN, by a linear combination of columns of ``design`` (n, 3).
    Returns the coefficients (3,) and their standard uncertainties (3,); None if too few values are left."""
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


def find_jump(series: Array) -> int | None:
    """Return the index of the first row after the largest jump in ``series`` (n, 3), or None without one.
    A row holds the three coefficients, px, of the linear fit of eps_y at a step. A jump counts if its rms
    over the field reaches `MAX_EPS_Y` and twice the scatter of the rows about the means before and after."""
    n = len(series)
    if n < 2 * MIN_STEPS_PER_SIDE:
        return None
    total, squares = np.cumsum(series, axis=0), float((series**2).sum())
    cuts = np.arange(MIN_STEPS_PER_SIDE, n - MIN_STEPS_PER_SIDE + 1)
    before, after = total[cuts - 1] / cuts[:, None], (total[-1] - total[cuts - 1]) / (n - cuts)[:, None]
    left = squares - (before**2).sum(axis=1) * cuts - (after**2).sum(axis=1) * (n - cuts)
    best = int(np.argmin(left))
    scatter = float(np.sqrt(max(left[best], 0.0) / max(n - 2, 1)))
    if rms_over_field(after[best] - before[best]) < max(MAX_EPS_Y, 2 * scatter):
        return None
    return int(cuts[best])


def find_knock(found: CameraMotion) -> tuple[int, float] | None:
    """Find the largest jump of eps_y between steps, which shows that a camera was knocked; None if none.
    Returns the index of the first frame after the jump, and the rms of the jump over the field, px."""
    at = find_jump(found.coefficients)
    if at is None:
        return None
    before, after = (np.median(part, axis=0) for part in (found.coefficients[:at], found.coefficients[at:]))
    near, change = slice(at - 1, at + 2), after - before
    along = (found.coefficients[near] - before) @ change / float(change @ change)
    # eps_y of a step is the mean of its two frames: in the step of the knock it has made half of the change
    frame = int(found.steps[near][np.argmax(along > 0.75)])
    return frame, rms_over_field(change)


def vibration_rms(found: CameraMotion, knocked: int | None = None) -> tuple[float, float]:
    """Return the rms over the steps of eps_y about its mean, px, and the standard uncertainty of this rms.
    eps_y is the linear fit of each step; the variance of the noise of the fits is subtracted. If a camera was
    knocked, at the frame ``knocked``, the steps before and after have separate means."""
    cut = 0 if knocked is None else np.searchsorted(found.steps, knocked)
    halves = found.coefficients[:cut], found.coefficients[cut:]
    parts = [part - part.mean(axis=0) for part in halves if len(part)]
    rest = np.concatenate(parts)
    freedom = len(rest) - len(parts)
    variance = (rest**2).sum(axis=0) / freedom - np.mean(found.std**2, axis=0)
    power = max(float(variance[0] + (variance[1] + variance[2]) / 3), 0.0)
    noise = float(np.mean(found.std[:, 0] ** 2)) + power
    return float(np.sqrt(power)), float(np.sqrt(noise / (2 * freedom)))


def remarks_on_mounts(cube: xr.Dataset) -> Iterator[Remark]:
    """Yield remarks on a cube in which a camera was knocked during the record, or cameras vibrate."""
    found = camera_motion(cube)
    if len(found.steps) < 2 * MIN_STEPS_PER_SIDE:
        return
    knocked, size = find_knock(found) or (None, 0.0)
    if knocked is not None:
        frame = int(cube.frame[0]) + knocked
        sentence = f"the epipolar error grows by {size:.2f} px at frame {frame}"
        means = f"A camera was knocked between frames {frame - 1} and {frame}: z is wrong by as much or more "
        means += "from there on"
        remedy = "Run the two parts separately (`frames: {first, last}`), the second with a rig corrected by "
        remedy += "`wavefield refine`; `check` of the second part names the camera"
        weight: Weight = "grave" if size > GRAVE_EPS_Y else "remark"
        yield Remark("rig", "moved", weight, sentence, means, remedy, {"frame": frame, "px": size})
    rms, std = vibration_rms(found, knocked)
    if rms > max(MAX_EPS_Y, SIGNIFICANCE * std):
        sentence = f"the epipolar error varies by {rms:.3f} +- {std:.3f} px rms from step to step"
        means = "A camera tilts or rolls on its mount: z and velocities are wrong by about as much"
        remedy = "Stiffen the mounts and keep carriages, pumps and people away"
        yield Remark("cameras", "vibration", "remark", sentence, means, remedy, {"px": rms, "std": std})
