"""Rate brightness, seeding, focus, cameras and measured steps for the status lights of `wavefield follow`."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from wavefield.quality.cameras import blur
from wavefield.robust import PER_MEDIAN
from wavefield.text import spell_time
from wavefield.variables import Quality

State = Literal["good", "unknown", "doubtful", "bad"]  # in rising order of severity
Limits = tuple[float, float]  # for doubtful, for bad
_CELL_PX = 16  # every cell of this size should contain a bead
_FULL_SCALES = (255, 1023, 4095, 16383, 65535)  # largest grey levels of 8, 10, 12, 14 and 16 bits

_BRIGHT = 5.5  # a bead exceeds the background by this many standard deviations of the noise
Image = NDArray[Any]
T = TypeVar("T")
# the order in which bad lights are named: causes before their consequences
_ORDER = ("arrival", "synchronisation", "brightness", "saturation", "seeding", "focus", "eps_y", "eps'",
          "range of z", "coverage")  # fmt: skip


# A quantity is doubtful beyond the first limit and bad beyond the second; if the second is smaller, "beyond"
# means below.
LIMITS: dict[str, Limits] = {
    "saturated": (0.01, 0.05),  # fraction of pixels
    "cells": (0.6, 0.3),  # fraction of cells with beads
    "bead_size": (2.5, np.inf),  # width of the beads' images (standard deviation of a Gaussian), px
    "silence": (2.0, 5.0),  # time without a new frame, minus `INTERVALS` frame intervals, s
    "delay": (0.5, 1.0),  # time by which frames come after those of the other cameras, s
    "eps_y": (0.5, 1.0),  # epipolar error, px
    "matched": (0.5, 0.2),  # fraction of the visible blocks that match
    "eps_piv": (0.3, 0.6),  # misfit of displacements, px
    "coverage": (0.6, 0.3),  # fraction of the grid's nodes that were measured
    "range_used": (0.8, 0.95),  # highest waves, as a fraction of the searched range of z
}
# the same for quantities divided by their medians over the first steps
RELATIVE: dict[str, Limits] = {
    "brightness": (0.5, 0.5),  # the larger of the ratios for beads and background; below it, a lamp is off
    "cells": (0.7, 0.4),
    "bead_size": (1.2, 1.4),
    "matched": (0.8, 0.6),
    "coverage": (0.9, 0.7),
}
ARRIVALS = ("arrival", "synchronisation")  # lights about the arrival of frames rather than their content
INTERVALS = 5  # frame intervals without a new frame that are still normal


@dataclass(frozen=True)
class StatusLight:
    """One status light on the page: the state of one property of a camera, a pair of cameras, or the rig."""

    name: str  # what is assessed, such as "focus"
    camera: str  # a camera or a pair "a-b"; empty for all together
    state: State  # "unknown" where something else must be fixed first
    words: str  # what was found


@dataclass(frozen=True)
class FrameFeatures:
    """Numbers measured in one frame, from which its brightness, saturation, seeding and focus are rated."""

    dark: float  # 0.1 % quantile of the grey levels
    background: float  # median of the grey levels
    peak: float  # 99.9 % quantile of the grey levels
    saturated: float  # fraction of pixels at the full scale
    cells: float  # fraction of cells of 16 px that contain a bead
    bead_size: float  # width of the beads' images (standard deviation of a Gaussian), px; NaN with few beads


def frame_features(image: Image) -> FrameFeatures:
    """Return grey levels, fractions of saturated and seeded area, and bead size of an image (row, column)."""
    sample = image[::3, ::3]
    dark, background, peak = (float(v) for v in np.percentile(sample, [0.1, 50.0, 99.9]))
    brightest = float(image.max())
    full_scale = next((full for full in _FULL_SCALES if brightest <= full), brightest)
    if image.dtype.kind == "f":
        full_scale = brightest or 1.0
    saturated = float(np.mean(sample >= full_scale)) if peak > 0.5 * full_scale else 0.0
    rows = image[::3].astype(np.float32)
    noise = PER_MEDIAN / np.sqrt(2.0) * float(np.median(np.abs(np.diff(rows, axis=1)))) + 0.5
    h, w = (n - n % _CELL_PX for n in image.shape)
    cells = image[:h, :w].reshape(h // _CELL_PX, _CELL_PX, w // _CELL_PX, _CELL_PX).max(axis=(1, 3))
    seeded = float(np.mean(cells.astype(np.float32) - background > _BRIGHT * noise))
    size = blur(image) if seeded > LIMITS["cells"][1] else np.nan
    return FrameFeatures(dark, background, peak, saturated, seeded, size)


@dataclass(frozen=True)
class StepSummary:
    """Misfit of displacements, coverage of the grid, and used part of the range of z, for one time step."""

    eps_piv: float  # rms difference of displacements between cameras, px
    coverage: float  # fraction of the grid's nodes that were measured, not filled
    range_used: float  # 99.5 % quantile of |z - middle of the searched range| over half that range


@dataclass(frozen=True)
class PairSummary:
    """How well simultaneous images of two cameras agree: epipolar error, fraction of matched blocks."""

    eps_y: float  # epipolar error, rms, px
    matched: float  # fraction of the visible blocks that match


def summarize_step(fields: Mapping[str, NDArray[Any]], z_range: tuple[float, float]) -> StepSummary:
    """Return displacement misfit, coverage, and the fraction of the range of z that is used, for one time
    step. `fields` holds z (m), eps_piv (the misfit, px) and quality, each (ny, nx). `z_range` is the lower
    and upper limit of the search for z, m. Misfit and fraction are NaN if all z are NaN."""
    z = np.asarray(fields["z"], float)
    valid = np.isfinite(z)
    if not valid.any():
        return StepSummary(np.nan, 0.0, np.nan)
    measured = valid & ((fields["quality"].astype(int) & int(Quality.FILLED)) == 0)
    misfit = np.asarray(fields["eps_piv"], float)[measured if measured.any() else valid]
    misfit = misfit[np.isfinite(misfit)]
    middle, half = 0.5 * (z_range[0] + z_range[1]), 0.5 * (z_range[1] - z_range[0])
    return StepSummary(
        eps_piv=float(np.sqrt(np.mean(misfit**2))) if misfit.size else np.nan,
        coverage=float(np.mean(measured)),
        range_used=float(np.percentile(np.abs(z[valid] - middle), 99.5) / half),
    )


@dataclass
class Baseline:
    """Keeps the first FrameFeatures, PairSummary and StepSummary instances of a recording as a reference.
    Later instances are compared with their medians."""

    n_steps: int = 4  # number of first steps that count
    _first: dict[tuple[type, str], list[object]] = field(default_factory=dict)

    def add(self, name: str, values: object) -> None:
        """Keep the numbers `values` of the camera or pair of cameras `name`, or of a step (`name` is "").
        Do nothing if `n_steps` instances of this class are kept for this name already."""
        first = self._first.setdefault((type(values), name), [])
        if len(first) < self.n_steps:
            first.append(values)

    def medians(self, kind: type[T], name: str = "") -> T | None:
        """Return an instance of the class `kind` with the medians of the numbers kept for `name`.
        `name` is a camera, a pair of cameras, or "" for steps. None until `n_steps` instances are kept."""
        first = self._first.get((kind, name), [])
        if len(first) < self.n_steps:
            return None
        medians = np.median([astuple(one) for one in first], axis=0)  # type: ignore[call-overload]
        return kind(*map(float, medians))


def frame_lights(camera: str, now: FrameFeatures, first: FrameFeatures | None) -> list[StatusLight]:
    """Return the lights "brightness", "saturation", "seeding" and "focus" of one camera.
    `now` describes its newest frame; `first` holds the medians of its first frames, None if not known yet."""
    words = f"beads at {now.peak:.0f}, background {now.background:.0f}"
    dark = False
    if first is not None:
        background = _ratio(now.background - first.dark, first.background - first.dark)
        beads = _ratio(now.peak - first.dark, first.peak - first.dark)
        dark = max(background, beads) < RELATIVE["brightness"][1]
        words += f"; {100 * min(beads, 9.99):.0f} % of the first frames"
    out = [
        StatusLight("brightness", camera, "bad" if dark else "good", words),
        StatusLight(
            "saturation", camera, _rate("saturated", now, first), f"{100 * now.saturated:.1f} % saturated"
        ),
    ]
    if dark:
        return out + [StatusLight(name, camera, "unknown", "too dark") for name in ("seeding", "focus")]
    seeding, focus = _rate("cells", now, first), _rate("bead_size", now, first)
    words = f"{100 * now.cells:.0f} % of the cells contain beads"
    out.append(StatusLight("seeding", camera, seeding, words))
    if seeding == "bad" or not np.isfinite(now.bead_size):
        return [*out, StatusLight("focus", camera, "unknown", "no beads to assess it")]
    return [*out, StatusLight("focus", camera, focus, f"beads of {now.bead_size:.2f} px")]


def pair_light(pair: str, now: PairSummary, first: PairSummary | None) -> StatusLight:
    """Return the light "eps_y" (epipolar error) of two cameras; it is bad if one of them may have moved.
    `pair` is their names, "a-b"; `now` describes their newest frames; `first` holds the medians of the first
    frames, None if not known yet."""
    state = _worst(_rate("eps_y", now, first), _rate("matched", now, first))
    missed = f"epipolar error {now.eps_y:.2f} px" if np.isfinite(now.eps_y) else "no blocks match"
    return StatusLight("eps_y", pair, state, f"{missed}; {100 * now.matched:.0f} % of the blocks match")


def arrival_lights(
    silent: Mapping[str, float], written: Mapping[str, float], newest: Mapping[str, int], frame_rate: float
) -> list[StatusLight]:
    """Return a light "arrival" for each camera, and a light "synchronisation" for each camera with frames.
    By camera: `silent` is the time, s, since its newest frame was found, `written` the time at which this
    frame was written, s since the epoch, and `newest` the frame's number. `frame_rate` is in Hz."""
    out = []
    for camera, since in silent.items():
        state = _state(since - INTERVALS / frame_rate, LIMITS["silence"])
        words = "frames arrive" if state == "good" else f"no new frame for {spell_time(since)}"
        out.append(StatusLight("arrival", camera, state, words if camera in newest else f"{words}, none yet"))
    for camera, when in written.items():
        delay, behind = max(written.values()) - when, max(newest.values()) - newest[camera]
        words = f"frame {newest[camera]}"
        if delay > LIMITS["delay"][0]:
            words += f", {delay:.1f} s after the others"
        if behind > 2:
            words += f", {behind} frames behind"
        out.append(StatusLight("synchronisation", camera, _state(delay, LIMITS["delay"]), words))
    return out


def step_lights(now: StepSummary, first: StepSummary | None) -> list[StatusLight]:
    """Return the lights "eps'" (misfit), "coverage" and "range of z" of a measured step.
    `now` describes this step; `first` holds the medians of the first steps, None if not known yet."""
    found = {
        "eps'": ("eps_piv", f"displacements differ by {now.eps_piv:.2f} px"),
        "coverage": ("coverage", f"{100 * now.coverage:.0f} % of the nodes measured"),
        "range of z": ("range_used", f"{100 * now.range_used:.0f} % of it used"),
    }
    return [StatusLight(name, "", _rate(field, now, first), words) for name, (field, words) in found.items()]


def red_lights(lights: Sequence[StatusLight]) -> list[StatusLight]:
    """Return the lights whose state is "bad", sorted so that causes, such as focus, precede consequences."""
    bad = [light for light in lights if light.state == "bad"]
    return sorted(bad, key=lambda light: _ORDER.index(light.name))


def _ratio(value: float, reference: float) -> float:
    """Return `value` over `reference`; 1 if the reference is zero."""
    return value / reference if abs(reference) > 1e-9 else 1.0


def _rate(name: str, now: T, first: T | None) -> State:
    """Return the state ("good", "doubtful" or "bad") of the number `name`, such as "matched", in `now`.
    `LIMITS` rates its value, and `RELATIVE` its ratio to the number in `first`; the worse state counts."""
    value = getattr(now, name)
    state = _state(value, LIMITS[name])
    if first is None or name not in RELATIVE:
        return state
    return _worst(state, _state(_ratio(value, getattr(first, name)), RELATIVE[name]))


def _state(value: float, limits: Limits) -> State:
    """Return "bad" for a value beyond the second of `limits`, "doubtful" beyond the first, else "good".
    If the second limit is the smaller one, beyond means below. NaN is "good"."""
    doubtful, bad = limits
    if bad < doubtful:
        value, doubtful, bad = -value, -doubtful, -bad
    return "bad" if value > bad else "doubtful" if value > doubtful else "good"


def _worst(*states: State) -> State:
    return max(states, key=get_args(State).index)
