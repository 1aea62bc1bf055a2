"""Lights: what a set of frames says of lamps, lenses, beads and cameras. Arrays and numbers in, words out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wavefield.explorer.features import Features
from wavefield.variables import Quality

State = Literal["good", "doubtful", "bad", "unknown"]

_DIM = 0.5  # of the light at the start: less is a lamp switched off
_FEW_BEADS = (0.7, 0.4)  # of the cells with beads at the start: doubtful, bad
_SPARSE = (0.6, 0.3)  # cells with beads, as a fraction: doubtful, bad whatever there was at the start
_BLURRED = (1.2, 1.4)  # times the bead size at the start
_LARGE_BEADS = 2.5  # px, standard deviation: doubtful at any time
_SATURATED = (0.01, 0.05)  # of the pixels
_LATE = (0.5, 1.0)  # s behind the other cameras
_RISE = (1.6, 2.2)  # times the mismatch at the start
_EPS = (0.5, 1.0)  # px: mismatch of sight lines, whatever there was at the start
_EPS_PIV = (0.3, 0.6)  # px
_COVERAGE = (0.9, 0.7)  # of what was measured at the start
_RANGE = (0.8, 0.95)  # of the range of z that is searched
_TILT = (3e-3, 1e-2)  # rad: slope of the plane through the water, beyond what waves make uncertain
_ENOUGH = 20  # steps


@dataclass(frozen=True)
class StatusLight:
    """One light."""

    name: str  # What is judged, such as "focus"
    camera: str  # Which camera; empty for all together
    state: State  # "good", "doubtful", "bad", or "unknown" where something else must be mended first
    words: str  # What was found


@dataclass(frozen=True)
class Quantities:
    """What one measured step says of the rig and the water."""

    eps_piv: float  # Misfit of the cameras' displacements, rms, px
    coverage: float  # Fraction of the nodes with a value
    range_used: float  # Largest elevation as a fraction of what is searched
    slope_x: float  # Plane through the water: slopes, and elevation at the origin, m
    slope_y: float
    height: float


def quantities(
    fields: Mapping[str, NDArray[Any]],
    x: NDArray[Any],
    y: NDArray[Any],
    z_range: tuple[float, float],
) -> Quantities:
    """Sum up a step.

    With fields (ny, nx); x, y (ny, nx); z_range (float, float).
    """
    z, quality = fields["z"], fields["quality"].astype(int)
    there = np.isfinite(z)
    if not there.any():
        nan = float("nan")
        return Quantities(nan, 0.0, nan, nan, nan, nan)
    measured = there & ((quality & int(Quality.FILLED)) == 0)
    chosen = measured if measured.any() else there
    middle, half = 0.5 * (z_range[0] + z_range[1]), 0.5 * (z_range[1] - z_range[0])
    plane, *_ = np.linalg.lstsq(
        np.stack([x[there], y[there], np.ones(there.sum())], axis=1), z[there].astype(float), rcond=None
    )
    return Quantities(
        eps_piv=_rms(fields["eps_piv"][chosen]),
        coverage=float(np.mean(measured)),
        range_used=float(np.percentile(np.abs(z[there] - middle), 99.5) / half),
        slope_x=float(plane[0]),
        slope_y=float(plane[1]),
        height=float(plane[2]),
    )


def _rms(values: NDArray[Any]) -> float:
    finite = values[np.isfinite(values)].astype(float)
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


@dataclass(frozen=True)
class PairMisfit:
    """How two cameras agree on the same instant, before anything is rejected."""

    eps_y: float  # Mismatch of sight lines, rms, in pixels on the water
    agreed: float  # Fraction of the blocks seen by both that count


def pair_light(pair: str, now: PairMisfit, start: PairMisfit | None) -> StatusLight:
    """Whether a camera was knocked: sight lines of a pair miss each other, or nothing is found again."""
    state = _worse(_over(now.eps_y, _EPS), _under(now.agreed, (0.5, 0.2)))
    if start is not None:
        state = _worse(state, _over(_fraction(now.eps_y, max(start.eps_y, 0.15)), _RISE))
        state = _worse(state, _under(_fraction(now.agreed, start.agreed), (0.8, 0.6)))
    missed = f"sight lines miss by {now.eps_y:.2f} px" if np.isfinite(now.eps_y) else "nothing is found again"
    return StatusLight("eps_y", pair, state, f"{missed}; {100 * now.agreed:.0f} % agree")


@dataclass
class Start:
    """How things were when the watch began: the median of the first sets."""

    sets: int = 4  # How many sets make the start
    _frames: dict[str, list[Features]] = field(default_factory=dict)
    _steps: list[Quantities] = field(default_factory=list)
    _pairs: dict[str, list[PairMisfit]] = field(default_factory=dict)

    def take(
        self, frames: Mapping[str, Features], pairs: Mapping[str, PairMisfit], step: Quantities | None
    ) -> None:
        """Take in a set, as long as it is one of the first."""
        for pair, agreement in pairs.items():
            before = self._pairs.setdefault(pair, [])
            if len(before) < self.sets:
                before.append(agreement)
        for camera, found in frames.items():
            kept = self._frames.setdefault(camera, [])
            if len(kept) < self.sets:
                kept.append(found)
        if step is not None and len(self._steps) < self.sets:
            self._steps.append(step)

    def of(self, camera: str) -> Features | None:
        """A camera's frames at the start; None until there are enough."""
        kept = self._frames.get(camera, [])
        return _median(kept, Features) if len(kept) >= self.sets else None

    def of_pair(self, pair: str) -> PairMisfit | None:
        """A pair of cameras at the start; None until there are enough."""
        kept = self._pairs.get(pair, [])
        return _median(kept, PairMisfit) if len(kept) >= self.sets else None

    @property
    def step(self) -> Quantities | None:
        """The measured steps at the start; None until there are enough."""
        return _median(self._steps, Quantities) if len(self._steps) >= self.sets else None


def _median(kept: Sequence[Any], kind: type) -> Any:
    names = vars(kept[0])
    with np.errstate(all="ignore"):
        return kind(**{name: float(np.median([getattr(one, name) for one in kept])) for name in names})


def frame_lights(camera: str, now: Features, start: Features | None) -> list[StatusLight]:
    """Brightness, saturation, seeding and focus of one camera."""
    dark = False
    beads = 1.0
    if start is not None:
        light = _fraction(now.background - start.dark, start.background - start.dark)
        beads = _fraction(now.peak - start.dark, start.peak - start.dark)
        dark = light < _DIM and beads < _DIM
    out = [
        StatusLight("brightness", camera, "bad" if dark else "good", _brightness(now, beads, start)),
        StatusLight(
            "saturation", camera, _over(now.saturated, _SATURATED), f"{100 * now.saturated:.1f} % saturated"
        ),
    ]
    if dark:
        return [
            *out,
            StatusLight("seeding", camera, "unknown", "too dark"),
            StatusLight("focus", camera, "unknown", "too dark"),
        ]
    seeding = _under(now.cells, _SPARSE)
    if start is not None:
        seeding = _worse(seeding, _under(_fraction(now.cells, start.cells), _FEW_BEADS))
    out.append(StatusLight("seeding", camera, seeding, f"{100 * now.cells:.0f} % of the cells hold beads"))
    if seeding == "bad" or not np.isfinite(now.size):
        return [*out, StatusLight("focus", camera, "unknown", "no beads to judge by")]
    focus: State = "doubtful" if now.size > _LARGE_BEADS else "good"
    if start is not None and np.isfinite(start.size):
        focus = _worse(focus, _over(now.size / start.size, _BLURRED))
    return [*out, StatusLight("focus", camera, focus, f"beads of {now.size:.2f} px")]


def _brightness(now: Features, beads: float, start: Features | None) -> str:
    words = f"beads at {now.peak:.0f}, background {now.background:.0f}"
    return words if start is None else f"{words}; {100 * min(beads, 9.99):.0f} % of the start"


def arrival_lights(last: Mapping[str, float], newest: Mapping[str, int], now: float) -> list[StatusLight]:
    """Whether every camera still sends frames, and all the same ones."""
    out = []
    latest = max(last.values(), default=now)
    most = max(newest.values(), default=0)
    for camera, when in last.items():
        behind = latest - when
        words = f"frame {newest[camera]}" + (
            f", {behind:.1f} s after the others" if behind > _LATE[0] else ""
        )
        if most - newest[camera] > 2:
            words += f", {most - newest[camera]} frames behind"
        out.append(StatusLight("synchronisation", camera, _over(behind, _LATE), words))
    return out


def step_lights(now: Quantities | None, start: Quantities | None) -> list[StatusLight]:
    """What a measured step says of the rig and the water."""
    if now is None:
        return []
    coverage: State = _under(now.coverage, (0.6, 0.3))
    if start is not None:
        coverage = _worse(coverage, _under(_fraction(now.coverage, start.coverage), _COVERAGE))
    return [
        StatusLight(
            "eps'", "", _over(now.eps_piv, _EPS_PIV), f"displacements disagree by {now.eps_piv:.2f} px"
        ),
        StatusLight("coverage", "", coverage, f"{100 * now.coverage:.0f} % of the nodes measured"),
        StatusLight(
            "range of z", "", _over(now.range_used, _RANGE), f"{100 * now.range_used:.0f} % of it used"
        ),
    ]


def tilt_light(steps: Sequence[Quantities]) -> StatusLight:
    """Whether z = 0 lies on the water at rest: the plane through it, averaged over waves."""
    planes = np.array([[one.slope_x, one.slope_y, one.height] for one in steps if np.isfinite(one.height)])
    if len(planes) < _ENOUGH:
        return StatusLight("tilt", "", "unknown", f"after {_ENOUGH} steps")
    mean, doubt = planes.mean(axis=0), planes.std(axis=0) / np.sqrt(len(planes) / 4)  # waves last some steps
    tilt = float(np.hypot(mean[0], mean[1]))
    state = _over(tilt - 2 * float(np.hypot(doubt[0], doubt[1])), _TILT)
    return StatusLight(
        "tilt", "", state, f"{1e3 * tilt:.1f} mrad, mean z {1e3 * mean[2]:+.1f} mm, {len(planes)} steps"
    )


# what is named first where several lights are bad: causes before their consequences
_ORDER = ("synchronisation", "brightness", "saturation", "seeding", "focus", "eps_y", "eps'", "range of z",
          "coverage", "tilt")  # fmt: skip


def verdict(lights: Sequence[StatusLight]) -> StatusLight | None:
    """The light to look at first."""
    bad = [light for light in lights if light.state == "bad"]
    return min(bad, key=lambda light: _ORDER.index(light.name)) if bad else None


def _fraction(value: float, reference: float) -> float:
    return value / reference if abs(reference) > 1e-9 else 1.0


def _over(value: float, limits: tuple[float, float]) -> State:
    return "bad" if value > limits[1] else "doubtful" if value > limits[0] else "good"


def _under(value: float, limits: tuple[float, float]) -> State:
    return "bad" if value < limits[1] else "doubtful" if value < limits[0] else "good"


def _worse(a: State, b: State) -> State:
    rank: dict[State, int] = {"good": 0, "unknown": 1, "doubtful": 2, "bad": 3}
    return a if rank[a] >= rank[b] else b
