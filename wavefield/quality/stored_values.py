"""Checks on what a cube stores: the surface rises as its water moves, steps continue each other evenly.

None uses what the uncertainties were computed from, so that all can show where these are wrong.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from wavefield.quality.frame_jitter import FrameJitter, frame_jitter
from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.quality.step_continuity import MIN_STEPS, StepFactors, patch_means, step_factors
from wavefield.store.read import DISCONTINUOUS_STEPS
from wavefield.store.verdict import Remark
from wavefield.text import spell_ranges
from wavefield.variables import Quality
from wavefield.waves.nonlinear.kinematics import slopes

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

MIN_NODES = 50  # with fewer measured nodes a step is not checked
MARGIN_NODES = 3  # from the edge of the grid, where slopes are of lower order
MEDIAN_SQUARE = 0.455  # of a standard normal variable
VELOCITY = ("u", "v", "w")
JITTER_STEPS = 64  # read for the size of the errors by jitter
MAX_NOISE = 0.2  # of the mean square of velocities: with more, they do not predict each other
FRAME_REACH = 2  # steps to either side of a frame, or a gap, whose six frames contain it
MAX_LEFT_OUT = 0.5  # of the steps: what is more than one gap and leaves less is everywhere
CHANGING_NOISE = 0.25  # of the variance of z by noise: beads repeat the rest of it from frame to frame
ELEVATION_NOISE = 0.84  # root of the sum of squares of the weights of six frames in z


# variables whose kinematics are compared
COMPARED = ["z", "z_t", "u", "v", "w", "z_std", "u_std", "v_std", "w_std"]


def kinematic_misfit(fields: Mapping[str, Array], measured: Mask, step: float, rate: float) -> Array:
    """Robust rms of z_t - w + u z_x + v z_y over its standard uncertainty, per step (n,).
    Fields and mask (n, ny, nx), `step` in metres, frames per second; about 1 if uncertainties hold, NaN with
    few measured nodes. z_t is the difference of two frames, each with noise of its own.
    """
    z = np.asarray(fields["z"], np.float64)
    z_y, z_x = slopes(z, step, step)
    residual = fields["z_t"] - fields["w"] + fields["u"] * z_x + fields["v"] * z_y
    variance = (
        np.square(fields["w_std"])
        + np.square(fields["u_std"] * z_x)
        + np.square(fields["v_std"] * z_y)
        + 2.0 * CHANGING_NOISE * np.square(fields["z_std"] * rate)
    )
    inner = np.zeros_like(measured)
    inner[:, MARGIN_NODES:-MARGIN_NODES, MARGIN_NODES:-MARGIN_NODES] = True
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.square(residual) / variance
    usable = measured & inner & np.isfinite(ratio)
    return np.array([_robust_rms(one[ok]) for one, ok in zip(ratio, usable, strict=True)])


def _robust_rms(squares: Array) -> float:
    return float(np.sqrt(np.median(squares) / MEDIAN_SQUARE)) if squares.size >= MIN_NODES else np.nan


def step_factors_of(cube: xr.Dataset) -> StepFactors:
    """How the steps of a cube continue each other, read chunk by chunk; unknown where noise is large."""
    count, chunk = cube.sizes["time"], max(cube.w.chunksizes.get("time", (64,))[0], 1)
    means, noise, size = [], np.full(count, np.nan), np.full(count, np.nan)
    for start in range(0, count, chunk):
        part = cube[[*VELOCITY, "w_std", "quality"]].isel(time=slice(start, start + chunk)).load()
        velocity = np.stack([part[name].values for name in VELOCITY], axis=1)
        measured = (part.quality.values & int(Quality.MEASURED) != 0) & np.isfinite(velocity).all(axis=1)
        for k, (fields, std, there) in enumerate(zip(velocity, part.w_std.values, measured, strict=True)):
            means.append(patch_means(fields, there))
            if there.any():
                noise[start + k] = np.mean(np.square(std[there], dtype=float))
                size[start + k] = np.mean(np.square(fields[:, there], dtype=float))
    # the noise of steps beside a lost frame contains the contradiction: the least of five
    near = (sliding_window_view(np.pad(one, 2, constant_values=np.nan), 5) for one in (noise, size))
    least, largest = (of.reduce(one, axis=1) for of, one in zip((np.fmin, np.fmax), near))
    return step_factors(np.array(means)).without(np.flatnonzero(~(least < MAX_NOISE * largest)))


def steps_left_out(discontinuous: NDArray[np.intp], steps: int) -> NDArray[np.intp]:
    """Steps whose frames lie on both sides of a discontinuity; none if these are most of a record, which
    has more than one.
    """
    apart = np.abs(np.subtract.outer(np.arange(steps), discontinuous))
    out = np.flatnonzero(apart.min(axis=1, initial=steps) <= FRAME_REACH)
    return out if discontinuous.size == 1 or out.size <= MAX_LEFT_OUT * steps else out[:0]


def jitter_of(cube: xr.Dataset, factors: StepFactors) -> tuple[FrameJitter, float] | None:
    """Jitter of a cube's frame times, and the largest error by it over its standard uncertainty.
    Without steps around discontinuous ones, if others are left; None if no jitter shows.
    """
    found = factors.discontinuous(RECORD_LIMITS.discontinuity)
    even = factors.without(steps_left_out(found, cube.sizes["time"]))
    if np.isfinite(even.factor).sum() < MIN_STEPS:
        even = factors
    jitter = frame_jitter(even, int(cube.path_frames))
    if jitter is None:
        return None
    compared = np.flatnonzero(np.isfinite(even.factor))
    first = max(int(compared[compared.size // 2]) - JITTER_STEPS // 2, 0)
    part = cube[[*VELOCITY, "z_std", *(f"{name}_std" for name in VELOCITY), "quality"]]
    part = part.isel(time=slice(first, first + JITTER_STEPS)).load()
    velocity = np.stack([part[name].values for name in VELOCITY], axis=1).astype(np.float64)
    measured = (part.quality.values & int(Quality.MEASURED) != 0) & np.isfinite(velocity).all(axis=1)
    sizes = [float(np.sqrt(np.mean(np.square(one[measured])))) for one in np.moveaxis(velocity, 1, 0)]
    stds = [float(np.median(part[f"{name}_std"].values[measured])) for name in (*VELOCITY, "z")]
    late = ELEVATION_NOISE * jitter.intervals
    # that velocities are of another moment is a part of their relative error
    jitter = replace(jitter, velocity=float(np.hypot(jitter.velocity, late * _turn(velocity, measured))))
    errors = [jitter.velocity * size for size in sizes]
    errors.append(late / float(cube.attrs["frame_rate"]) * sizes[2])
    return jitter, max(error / std for error, std in zip(errors, stds) if std > 0)


def _turn(velocity: Array, measured: Mask) -> float:
    """By what fraction velocities (n, 3, ny, nx) change from step to step, rms."""
    both = (measured[1:] & measured[:-1])[:, None]
    change = np.where(both, np.diff(velocity, axis=0), 0.0)
    size = np.where(both, velocity[1:], 0.0)
    return float(np.linalg.norm(change)) / max(float(np.linalg.norm(size)), 1e-12)


def remark_on_stored_values(cube: xr.Dataset, sample: xr.Dataset) -> Iterator[Remark]:
    """Compare the stored fields of a cube with each other: kinematics at sampled steps, continuity at all."""
    first, measured = int(cube.frame[0]), sample.quality.values & int(Quality.MEASURED) != 0
    spacing = float(cube.x[1] - cube.x[0])
    fields, rate = {name: sample[name].values for name in COMPARED}, float(cube.attrs["frame_rate"])
    misfits = kinematic_misfit(fields, measured, spacing, rate)
    if np.isfinite(misfits).any():
        misfit = float(np.nanmedian(misfits))
        if misfit > RECORD_LIMITS.kinematic_misfit:
            yield Remark(
                "record",
                "kinematics",
                "grave" if misfit > RECORD_LIMITS.kinematic_misfit_grave else "remark",
                f"the surface does not rise as its water moves: z_t - w + u . grad z is {misfit:.1f} times"
                " its standard uncertainty",
                f"at most {RECORD_LIMITS.kinematic_misfit}",
                "check frame rate, synchronisation and seeding; waves may be too short for the images",
                {"kinematic_misfit": misfit},
            )
    factors = step_factors_of(cube)
    found = factors.discontinuous(RECORD_LIMITS.discontinuity)
    if found.size:
        without = steps_left_out(found, cube.sizes["time"])
        places = spell_ranges([first + int(k) for k in found], 3)
        which = (
            f"the step from frame {places} does not continue its neighbours"
            if found.size == 1
            else f"{found.size} of {cube.sizes['time']} steps do not continue their neighbours: those from"
            f" frames {places}"
        )
        done = f"; the {without.size} steps with frames on both sides are NaN in opened cubes"
        yield Remark(
            "record",
            "discontinuous steps",
            "remark",
            which + (done if without.size else ""),
            "none",
            "check whether frames were duplicated, lost or late in all cameras there",
            {"steps": int(found.size), DISCONTINUOUS_STEPS: without.tolist()},
        )
    shown = jitter_of(cube, factors)
    if shown and shown[1] > RECORD_LIMITS.jitter_noted:
        late = 1e3 * shown[0].intervals / rate
        yield Remark(
            "record",
            "jitter",
            "remark" if shown[1] > RECORD_LIMITS.jitter else "note",
            f"the times of the frames depart by {late:.2g} ms rms from those that they are measured at:"
            f" values are off by {shown[1]:.1f} of the standard uncertainties without it, which the stated"
            " ones contain",
            f"at most {RECORD_LIMITS.jitter} standard uncertainties",
            "state the cameras' time stamps (`times`), or trigger the cameras by a steadier clock",
            {
                "jitter_ms": late,
                "over_std": shown[1],
                "elevation_jitter": ELEVATION_NOISE * shown[0].intervals,
                "velocity_jitter": shown[0].velocity,
            },
        )
