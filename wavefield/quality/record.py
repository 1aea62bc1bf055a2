"""Find faults of a record: missing or bad frames, wrong frame rates, lost or doubled frames.

A step is the interval between two consecutive frames. The cube holds z, u, v and w of each step at mid-step.
Two tests use the kinematic boundary condition dz/dt + u . grad z = w:

- Within a step, dz/dt is the difference between the two frames. The residual of the condition is compared
  with the standard uncertainty of the residual.
- Between steps, dz/dt is the central difference of z between the steps before and after. The ratio of w to
  dz/dt + u . grad z is the same at all steps if the frame times are even. It jumps where a frame was lost,
  doubled or late in all cameras: a step over a lost frame has 4/3 of the usual ratio, and the steps before
  and after it have 4/5; a step from a frame to its double has 0, and the steps before and after it have 4/3.
  Random jitter of the frame times is not found.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.measurement.velocity import MIN_NODES
from wavefield.quality.remarks import CELLS, MAX_LOST, SIGNIFICANCE
from wavefield.robust import PER_MEDIAN
from wavefield.series import Experiment, FrameSeries
from wavefield.series.clocks import is_alike, stated_by_recordings
from wavefield.series.frames import is_interlaced
from wavefield.store.verdict import Remark, Weight
from wavefield.text import spell_ranges
from wavefield.variables import AROUND, FrameFault, FrameStatus, Quality

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

SAMPLED_STEPS = 12  # `check` reads the frames of so many steps, and all of a record shorter than twice that
FAULTS = {
    FrameFault.UNREADABLE: ("cannot be read", "Copy them again from the recording"),
    FrameFault.BLANK: ("are blank (all pixels equal)", "Was the lens covered, or the light off?"),
    FrameFault.WRONG_SIZE: (
        "have another size or type than the others",
        "Put the frames of one setting of the camera into one record",
    ),
    FrameFault.REPEATED: (
        "equal the frame before them in every pixel",
        "Copy the recording again, or leave these frames out (`frames`)",
    ),
}
CHANGING_NOISE = 0.25  # fraction of z_std^2 that is new in each frame; the rest moves with the beads
COMPARED = ["z", "z_t", "u", "v", "w", "z_std", "u_std", "v_std", "w_std"]
PATCHES = 8  # along the shorter side of the field
# A wave whose phase advances by p per frame interval has the ratio p / sin p. Above 1.2 (p is a sixth of a
# period) the ratios of sound simulated seas scatter as much as a lost frame changes them: nothing is judged.
MAX_RATIO = 1.2
DISCONTINUITY = 0.3  # difference of a ratio from the mean of its neighbours; a lost frame gives 0.5
MAX_MISFIT = 1.6  # rms of the residual in standard uncertainties; sound seas have 0.1 to 1.2


@dataclass(frozen=True)
class FrameInspection:
    """Result of `inspect_frames`: the frames of one camera that were read, and their faults."""

    read: tuple[int, ...]  # Indices of the frames that were read
    faults: Mapping[int, tuple[FrameFault, str]]  # By index of the bad frames: kind of fault and message


def sample_frames(series: Mapping[str, FrameSeries]) -> tuple[int, ...]:
    """Return the indices of the frames to inspect: all frames of a short record; of a long record the first,
    the last and those of 12 random steps. ``series`` holds the frames of each camera."""
    complete = complete_steps(series)
    if len(complete) < 2 * SAMPLED_STEPS:
        return tuple(range(len(complete) + 1))
    # random, because evenly spaced frames would be all good or all bad if every second frame is bad
    drawn = np.random.default_rng(0).permutation(np.flatnonzero(complete))[:SAMPLED_STEPS]
    return tuple(sorted({0, len(complete), *drawn.tolist(), *(drawn + 1).tolist()}))


def inspect_frames(series: FrameSeries, indices: Iterable[int]) -> FrameInspection:
    """Read the frames ``indices`` of a camera, and find those that are bad or equal the frame before them.
    Missing frames are skipped. Two frames are compared only if both indices are in ``indices``."""
    faults: dict[int, tuple[FrameFault, str]] = {}
    read: list[int] = []
    last: Any = None
    for index in indices:
        if series.entries[index] is None:
            continue
        image, fault, message = series.read(index)
        follows = bool(read) and read[-1] == index - 1
        if follows and image is not None and last is not None and np.array_equal(image, last):
            fault, message = FrameFault.REPEATED, series.place(index)
        if fault:
            faults[index] = fault, message
        read.append(index)
        last = image
    return FrameInspection(tuple(read), faults)


def complete_steps(series: Mapping[str, FrameSeries]) -> Mask:
    """Return a mask of the steps (n,), True if every camera has files of both frames of the step."""
    present = np.all([[entry is not None for entry in one.entries] for one in series.values()], axis=0)
    return np.asarray(present[:-1] & present[1:])


def remark_on_frames(
    series: Mapping[str, FrameSeries], inspections: Mapping[str, FrameInspection]
) -> Iterator[Remark]:
    """Yield remarks on cameras with many bad or repeated frames, or with any frame of another size.
    The arguments hold, by camera, its frames and the result of `inspect_frames`."""
    for name, found in inspections.items():
        for fault, (words, remedy) in FAULTS.items():
            bad = [index for index, (other, _) in found.faults.items() if other == fault]
            repeated = fault == FrameFault.REPEATED
            count = sum(index - 1 in found.read for index in found.read) if repeated else len(found.read)
            # a camera gives frames of one size: a single frame of another size is reported
            if len(bad) <= (0 if fault == FrameFault.WRONG_SIZE else max(1, MAX_LOST * count)):
                continue
            numbers = spell_ranges([series[name].first + index for index in bad], 3)
            yield Remark(
                name,
                "bad frames",
                "grave" if len(bad) > 0.5 * count else "remark",
                f"{len(bad)} of {count} frames read {words}: frames {numbers} ({found.faults[bad[0]][1]})",
                "Their steps are measured without this camera, or not at all",
                remedy,
                {"bad": len(bad), "frames": count},
            )


def remark_on_recordings(experiment: Experiment, series: Mapping[str, FrameSeries]) -> Iterator[Remark]:
    """Yield remarks on missing frames, uneven frame times, interlaced images and wrong frame rates.
    ``series`` holds the frames of each camera."""
    measuring = {name: series[name] for name in experiment.measuring_cameras if name in series}
    yield from _missing(measuring)
    yield from _rates(experiment, series)
    for one in series.values():
        yield from _uneven(one)
        if is_interlaced(one):
            sentence = "its images are interlaced: odd and even rows were exposed half a frame interval apart"
            means = "Moving beads look like combs, which do not match"
            remedy = "Save each field as a separate image with half the rows, or record progressive frames"
            yield Remark(one.camera, "frame times", "grave", sentence, means, remedy)


def _missing(series: Mapping[str, FrameSeries]) -> Iterator[Remark]:
    """Yield remarks on cameras that lack many frames, and on a record in which few steps are complete.
    A step is complete if both of its frames exist in every camera."""
    for name, one in series.items():
        missing = one.missing
        if len(missing) <= MAX_LOST * len(one):
            continue
        sentence = f"{len(missing)} of {len(one)} frames are missing: {spell_ranges(missing.tolist(), 3)}"
        means = "Their steps are measured without this camera, or not at all"
        remedy = "Copy them, or give the range of frames that is complete (`frames`)"
        weight: Weight = "grave" if len(missing) > 0.5 * len(one) else "remark"
        numbers = {"missing": len(missing), "frames": len(one)}
        yield Remark(name, "missing frames", weight, sentence, means, remedy, numbers)
    if not series:
        return
    complete = complete_steps(series)
    fraction = float(complete.mean())
    if fraction < 0.5:
        sentence = f"only {100 * fraction:.0f} % of {len(complete)} steps have both frames of every camera"
        means = "The other steps are measured with fewer cameras, or not at all"
        remedy = "Copy the missing frames, and number frames of one moment alike in all cameras (`offset`)"
        values = {"share": fraction, "steps": len(complete)}
        yield Remark("record", "missing frames", "grave", sentence, means, remedy, values)


def _rates(experiment: Experiment, series: Mapping[str, FrameSeries]) -> Iterator[Remark]:
    """Yield remarks on rotated videos, and on recordings whose frame rate differs from the experiment's.
    Also yields a note if the experiment's rate is the playback rate of a video, which may differ from the
    rate of the camera."""
    file, rate = experiment.path.name, experiment.frame_rate
    named = {name: one.images for name, one in experiment.cameras.items() if one.times is None}
    stated = stated_by_recordings(named, experiment.image_folder)
    for name, degrees in ((name, one.rotation) for name, one in stated.items() if one.rotation):
        sentence = f"its video states a rotation of {degrees} degrees, which is not applied"
        means = "Frames stay as the sensor recorded them"
        remedy = "Take target images in the same orientation"
        yield Remark(name, "mirrored", "note", sentence, means, remedy)
    rates = {name: one.rate for name, one in stated.items() if one.rate}
    for name, recorded in rates.items():
        if stated[name].is_video:
            continue
        stamped = name in series and series[name].times is not None  # compared with the rate already
        if not stamped and not is_alike(recorded, rate):
            sentence = f"its recording gives {recorded:g} Hz, but {file} gives {rate:g} Hz"
            means = "Velocities are proportional to the frame rate"
            remedy = "Leave frame_rate out to take the recording's rate; keep it if frames were removed since"
            values = {"recorded_hz": recorded, "stated_hz": rate}
            yield Remark(name, "frame rate", "remark", sentence, means, remedy, values)
    alike = [name for name, one in rates.items() if stated[name].is_video and is_alike(one, rate)]
    if alike:
        sentence = f"{rate:g} Hz is the playback rate of its video"
        means = "Velocities are wrong if the camera recorded at another rate (high-speed, time lapse)"
        remedy = "In that case, give the camera's own rate as frame_rate"
        yield Remark(alike[0], "frame rate", "note", sentence, means, remedy, values={"playback_hz": rate})


def _uneven(series: FrameSeries) -> Iterator[Remark]:
    """Yield a remark if time stamps of a camera are not whole frame intervals apart."""
    if series.times is None:
        return
    there = np.flatnonzero(np.isfinite(series.times))
    places, intervals = np.diff(there), np.diff(series.times[there])
    if not len(places):
        return
    usual = float(np.median(intervals / places))
    uneven = np.abs(intervals - places * usual) > 0.5 * usual
    if uneven.any():
        numbers = series.first + there[:-1][uneven]
        sentence = (
            f"{uneven.sum()} intervals between its images are not whole frame intervals, after frame "
            f"{spell_ranges(numbers.tolist(), 3)}"
        )
        means = "Velocities there assume the nominal interval and are wrong"
        remedy = "Use an even part of the record (`frames`), or save each part as a separate recording"
        values = {"uneven": int(uneven.sum()), "first": int(numbers[0])}
        yield Remark(series.camera, "frame times", "remark", sentence, means, remedy, values)


def kinematic_misfit(fields: Mapping[str, Array], measured: Mask, step: float, rate: float) -> Array:
    """Return the robust rms over the nodes of z_t - w + u z_x + v z_y at each step, (n,), NaN with few nodes.
    It is divided by the standard uncertainty of this sum. ``fields`` holds the variables `COMPARED`, each
    (n, ny, nx) like the mask ``measured``. ``step`` is the node spacing, m; ``rate`` the frame rate, Hz."""
    z = np.asarray(fields["z"], np.float64)
    z_y, z_x = (np.gradient(z, step, axis=axis) for axis in (1, 2))
    residual = fields["z_t"] - fields["w"] + fields["u"] * z_x + fields["v"] * z_y
    variance = (
        np.square(fields["w_std"])
        + np.square(fields["u_std"] * z_x)
        + np.square(fields["v_std"] * z_y)
        + 2.0 * CHANGING_NOISE * np.square(fields["z_std"] * rate)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(residual) / np.sqrt(variance)
    usable = measured & np.isfinite(ratio)
    return np.array(
        [PER_MEDIAN * np.median(r[ok]) if ok.sum() >= MIN_NODES else np.nan for r, ok in zip(ratio, usable)]
    )


def rise_ratios(cube: xr.Dataset) -> tuple[Array, Array]:
    """Return, by step k, the ratio of w to (z(k+1) - z(k-1)) / (2 dt) + u . grad z, and the ratio's variance.
    dt is the frame interval. A ratio is the slope of a regression over the field. All ratios are NaN if their
    median is not between 0 and `MAX_RATIO`, because the waves are then too fast for this test."""
    steps, rate = cube.sizes["time"], float(cube.attrs["frame_rate"])
    spacing = float(cube.x[1] - cube.x[0])
    ratio, variance = np.full((2, steps), np.nan)
    chunk = max(cube.w.chunksizes.get("time", (64,))[0], 1)
    for start in range(0, steps, chunk):
        first, last = max(start - 1, 0), min(start + chunk + 1, steps)
        part = cube[["z", "u", "v", "w", "quality"]].isel(time=slice(first, last)).load()
        z, u, v, w = (part[name].values.astype(np.float64) for name in "zuvw")
        z_y, z_x = (np.gradient(z, spacing, axis=axis) for axis in (1, 2))
        measured = (part.quality.values & int(Quality.MEASURED) != 0) & np.isfinite(z + u + v + w)
        for k in range(1, last - first - 1):
            rise = 0.5 * rate * (z[k + 1] - z[k - 1]) + u[k] * z_x[k] + v[k] * z_y[k]
            usable = measured[k - 1 : k + 2].all(axis=0) & np.isfinite(rise)
            if usable.sum() >= MIN_NODES:
                ratio[first + k], variance[first + k] = _slope(w[k], rise, usable)
    known = ratio[np.isfinite(ratio)]
    if known.size and not 0.0 < np.median(known) < MAX_RATIO:
        ratio[:] = np.nan
    return ratio, variance


def discontinuous_steps(ratio: Array, variance: Array) -> NDArray[np.intp]:
    """Return the steps at which ``ratio`` (n,) jumps; both arguments are results of `rise_ratios`.
    At such a step it differs significantly from the mean of the two neighbouring steps, by more than at any
    other step up to `AROUND` steps away."""
    usual = np.nanmedian(ratio) if np.isfinite(ratio).any() else np.nan
    jump, std = np.full((2, ratio.size), np.nan)
    jump[1:-1] = ratio[1:-1] - 0.5 * (ratio[:-2] + ratio[2:])
    std[1:-1] = np.sqrt(variance[1:-1] + 0.25 * (variance[:-2] + variance[2:]))
    size, std = np.nan_to_num(np.abs(jump) / usual), np.nan_to_num(std / usual)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(size, AROUND), 2 * AROUND + 1)
    found = (size > np.maximum(DISCONTINUITY, SIGNIFICANCE * std)) & (size == around.max(axis=1))
    return np.flatnonzero(found)


def _slope(values: Array, on: Array, usable: Mask) -> tuple[float, float]:
    """Return the slope of a regression of ``values`` on ``on``, both (ny, nx), and the variance of the slope.
    Only nodes where ``usable`` is True count. The variance comes from the scatter between parts of the field;
    slope and variance are NaN if too few parts have values."""
    # averages over patches keep the longer waves, whose phase changes less from step to step
    count = _patches(usable.astype(float))
    full = count > 0.5 * count.max()
    values, on = (_patches(np.where(usable, one, 0.0)) / np.maximum(count, 1.0) for one in (values, on))
    values, on = (np.where(full, one - one[full].mean(), 0.0) for one in (values, on))
    product, square = (
        np.array([part.sum() for row in np.array_split(one, CELLS) for part in np.array_split(row, CELLS, 1)])
        for one in (values * on, np.square(on))
    )
    cells = int((square > 0).sum())
    if cells < CELLS + 1:
        return np.nan, np.nan
    slope = float(product.sum() / square.sum())
    rest = (product - slope * square) / square.sum()
    return slope, cells / (cells - 1) * float(np.sum(np.square(rest)))


def _patches(values: Array) -> Array:
    """Return the sums of a field (ny, nx) over square patches, `PATCHES` of them along the shorter side."""
    side = max(min(values.shape) // PATCHES, 1)
    ny, nx = (n // side for n in values.shape)
    return np.asarray(values[: ny * side, : nx * side].reshape(ny, side, nx, side).sum(axis=(1, 3)))


def steps_to_leave_out(discontinuous: NDArray[np.intp], steps: int) -> NDArray[np.intp]:
    """Return the steps whose values use frames from both sides of a jump in time.
    A jump is a lost, doubled or late frame: ``discontinuous`` holds the steps with jumps, of ``steps`` steps.
    The result is empty if several jumps would leave out more than half of the record."""
    apart = np.abs(np.subtract.outer(np.arange(steps), discontinuous))
    out = np.flatnonzero(apart.min(axis=1, initial=steps) <= AROUND)
    return out if discontinuous.size == 1 or out.size <= 0.5 * steps else out[:0]


def remark_on_kinematics(sample: xr.Dataset) -> Iterator[Remark]:
    """Yield a remark if elevation and velocity violate the kinematic boundary condition.
    ``sample`` holds some steps of the cube: the variables `COMPARED` and ``quality``."""
    measured = sample.quality.values & int(Quality.MEASURED) != 0
    fields, rate = {name: sample[name].values for name in COMPARED}, float(sample.attrs["frame_rate"])
    misfits = kinematic_misfit(fields, measured, float(sample.x[1] - sample.x[0]), rate)
    misfit = float(np.nanmedian(misfits)) if np.isfinite(misfits).any() else 0.0
    if misfit > MAX_MISFIT:
        sentence = (
            f"z_t - w + u . grad z is {misfit:.1f} times its standard uncertainty (at most"
            f" {MAX_MISFIT} in sound records)"
        )
        means = "Elevation and velocity violate the kinematic boundary condition: one of them is wrong"
        remedy = "Check frame rate, synchronisation and seeding; waves may be too short for the images"
        weight: Weight = "grave" if misfit > 2 * MAX_MISFIT else "remark"
        yield Remark("record", "kinematics", weight, sentence, means, remedy, {"kinematic_misfit": misfit})


def remark_on_cleared_steps(cube: xr.Dataset) -> Iterator[Remark]:
    """Yield a remark on steps of a cube that were set to NaN because a frame was lost, doubled or late."""
    steps = np.flatnonzero(cube.frame_status.values == FrameStatus.DISCONTINUOUS)
    if steps.size:
        numbers = spell_ranges([int(cube.frame[0]) + int(k) for k in steps], 3)
        sentence = f"{steps.size} steps, from frames {numbers}, include a jump in time"
        means = "A frame was lost, doubled or late in all cameras; these steps are NaN"
        remedy = "Check the numbering of these frames, or give the cameras' time stamps (`times`)"
        yield Remark("record", "frame times", "remark", sentence, means, remedy, {"steps": int(steps.size)})
