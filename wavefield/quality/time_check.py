"""Checks of stored fields against each other: does the surface rise as its water moves, step by step?

Two residuals of the kinematic condition dz/dt + u . grad z = w at the free surface. Within a step, dz/dt
comes from the two frames of the step, and the residual is compared with its standard uncertainty. Between
steps, dz/dt comes from the steps before and after: these are two frame intervals apart only if no frame was
lost, doubled or late, so that w over dz/dt + u . grad z jumps where time does. A step over a lost frame has
4/3 of the usual ratio and its neighbours 4/5 of it; a step onto a doubled frame has 0 and its neighbours 4/3.
Neither uses what the standard uncertainties were computed from.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import special  # scipy.stats takes half a second to import

from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.robust import PER_MEDIAN
from wavefield.store.verdict import Remark
from wavefield.text import spell_ranges
from wavefield.variables import FrameStatus, Quality

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

MIN_NODES = 50  # measured nodes of a step; with fewer it is not checked
MARGIN_NODES = 3  # from the edge of the grid, where slopes are less accurate
CHANGING_NOISE = 0.25  # of the variance of z by noise; the rest stays with the beads from frame to frame
COMPARED = ["z", "z_t", "u", "v", "w", "z_std", "u_std", "v_std", "w_std"]
PATH_REACH = 2  # steps: the six frames of a step reach so many steps to either side
MAX_LEFT_OUT = 0.5  # of the steps of a record with several discontinuities; more are not left out
PATCHES = 8  # along the shorter side of the field
# A wave that turns by p from frame to frame has the ratio p / sin p. Where most turn by more than a sixth of
# a turn, sound simulated seas scatter as much as a lost frame does, and nothing is judged.
MAX_RATIO = 1.2
CELLS = 3  # parts of the field along either side whose ratios are compared
SIGNIFICANCE = 4.0  # standard deviations
MIN_RATIO = 0.05  # smallest ratio that counts: log(0) of a doubled frame
JITTER_VARIANCE = 4.375  # variance of the difference of consecutive ratios over that of the frame times
VARYING_TURN = 0.5  # of (ratio - 1)^2: variance of ratios because the waves in view change; simulated seas
CHANCE = 1e-3  # that an even record shows as large a jitter


def kinematic_misfit(fields: Mapping[str, Array], measured: Mask, step: float, rate: float) -> Array:
    """Robust rms of z_t - w + u z_x + v z_y over its standard uncertainty, per step (n,).

    Fields and mask (n, ny, nx), ``step`` in metres, ``rate`` in Hz; about 1 if the uncertainties are right,
    NaN with few measured nodes. z_t is the difference of two frames, each with its own noise.
    """
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
    usable = measured & _inner(measured) & np.isfinite(ratio)
    return np.array(
        [PER_MEDIAN * np.median(r[ok]) if ok.sum() >= MIN_NODES else np.nan for r, ok in zip(ratio, usable)]
    )


def _inner(mask: Mask) -> Mask:
    out = np.zeros_like(mask)
    out[:, MARGIN_NODES:-MARGIN_NODES, MARGIN_NODES:-MARGIN_NODES] = True
    return out


@dataclass(frozen=True)
class RiseRatios:
    """w over the rise between the steps before and after, per step (n,), NaN where unknown."""

    ratio: Array
    variance: Array  # of the ratio, from the parts of the field

    def discontinuous(self) -> NDArray[np.intp]:
        """Steps whose ratio departs from that of both neighbours by more than the limit, significantly."""
        log = np.log(np.maximum(self.ratio, MIN_RATIO))
        relative = self.variance / np.square(np.maximum(self.ratio, MIN_RATIO))
        jump, std = np.full((2, log.size), np.nan)
        jump[1:-1] = log[1:-1] - 0.5 * (log[:-2] + log[2:])
        std[1:-1] = np.sqrt(relative[1:-1] + 0.25 * (relative[:-2] + relative[2:]))
        size = np.nan_to_num(np.abs(jump))
        found = size > np.maximum(RECORD_LIMITS.discontinuity, SIGNIFICANCE * np.nan_to_num(std))
        around = np.pad(size, PATH_REACH)
        largest = np.lib.stride_tricks.sliding_window_view(around, 2 * PATH_REACH + 1).max(axis=1)
        return np.flatnonzero(found & (size == largest))

    def jitter(self) -> float:
        """Standard deviation of the frame times in frame intervals; 0 if none is significant.

        Differences of consecutive ratios are taken, because how fast waves turn changes slowly.
        """
        known = np.isfinite(self.ratio)
        both = known[1:] & known[:-1]
        if both.sum() < 3:
            return 0.0
        median = float(np.median(self.ratio[known]))
        change = np.diff(self.ratio)[both] / median
        found = float(np.mean(np.square(change)))
        noise = 2.0 * float(np.median(self.variance[known])) / median**2
        # a third of the differences share their steps; the variance is from all parts of the field
        freedom = change.size * 2.0 / 3.0, change.size * (CELLS**2 - 1)
        by_chance = noise * float(special.fdtri(*freedom, 1.0 - CHANCE))
        if found <= max(by_chance, VARYING_TURN * (median - 1.0) ** 2):
            return 0.0
        return float(np.sqrt((found - noise) / JITTER_VARIANCE))


def rise_ratios(cube: xr.Dataset) -> RiseRatios:
    """Regression of w on (z(k+1) - z(k-1)) / 2 dt + u . grad z at every step, without the field means."""
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
    return RiseRatios(ratio, variance)


def _slope(values: Array, on: Array, usable: Mask) -> tuple[float, float]:
    """Slope of values on others (ny, nx), and its variance from the parts of the field.

    Both are means over patches, which leave the longer waves: these turn less from step to step.
    """
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
    """Sums over adjacent squares of nodes."""
    side = max(min(values.shape) // PATCHES, 1)
    ny, nx = (n // side for n in values.shape)
    return np.asarray(values[: ny * side, : nx * side].reshape(ny, side, nx, side).sum(axis=(1, 3)))


def steps_to_leave_out(discontinuous: NDArray[np.intp], steps: int) -> NDArray[np.intp]:
    """Steps whose six frames lie on both sides of a discontinuity; none if that is most of a record."""
    apart = np.abs(np.subtract.outer(np.arange(steps), discontinuous))
    out = np.flatnonzero(apart.min(axis=1, initial=steps) <= PATH_REACH)
    return out if discontinuous.size == 1 or out.size <= MAX_LEFT_OUT * steps else out[:0]


def remark_on_kinematics(sample: xr.Dataset) -> Iterator[Remark]:
    """Report steps whose surface does not rise as its water moves."""
    measured = sample.quality.values & int(Quality.MEASURED) != 0
    fields, rate = {name: sample[name].values for name in COMPARED}, float(sample.attrs["frame_rate"])
    misfits = kinematic_misfit(fields, measured, float(sample.x[1] - sample.x[0]), rate)
    misfit = float(np.nanmedian(misfits)) if np.isfinite(misfits).any() else 0.0
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


def remark_on_steps_left_out(cube: xr.Dataset) -> Iterator[Remark]:
    """Report the steps that the end of the run has cleared because time jumps there."""
    steps = np.flatnonzero(cube.frame_status.values == FrameStatus.DISCONTINUOUS)
    if steps.size:
        numbers = spell_ranges([int(cube.frame[0]) + int(k) for k in steps], 3)
        yield Remark(
            "record",
            "discontinuous steps",
            "remark",
            f"a frame was lost, doubled or late in all cameras: {steps.size} steps around it, from frames"
            f" {numbers}, are NaN",
            "none",
            "check the numbering of these frames, or state the cameras' time stamps (`times`)",
            {"steps": int(steps.size)},
        )


def remark_on_jitter(ratios: RiseRatios, sample: xr.Dataset) -> Iterator[Remark]:
    """Report jitter of the frame times that makes velocities wrong by more than their uncertainty."""
    jitter, rate = ratios.jitter(), float(sample.attrs["frame_rate"])
    measured = sample.quality.values & int(Quality.MEASURED) != 0
    if not jitter or not measured.any():
        return
    sizes = [float(np.sqrt(np.mean(np.square(sample[name].values[measured])))) for name in "uvw"]
    stds = [float(np.median(sample[f"{name}_std"].values[measured])) for name in "uvw"]
    # a step's displacement contains the errors of both frame times
    over = np.sqrt(2.0) * jitter * max(size / std for size, std in zip(sizes, stds))
    if over > RECORD_LIMITS.jitter:
        yield Remark(
            "record",
            "jitter",
            "remark",
            f"the frame times jitter by about {1e3 * jitter / rate:.2g} ms rms: velocities are off by"
            f" {over:.1f} of their standard uncertainties",
            f"at most {RECORD_LIMITS.jitter} standard uncertainties",
            "state the cameras' time stamps (`times`), or trigger the cameras by a steadier clock",
            {"jitter_ms": 1e3 * jitter / rate, "over_std": float(over)},
        )
