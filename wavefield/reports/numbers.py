"""Compute numbers that several sections of a report need, and write numbers as text."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield.figures.style import moment_title
from wavefield.pipeline import Run
from wavefield.variables import FrameStatus, Quality

MAX_VALUES = 8_000_000  # values per variable in distributions, which take a few seconds and 64 MB
_SNAPSHOT_STEPS = 10  # steps before and after the middle of the record, one of which is drawn
_FIELDS = ("z", "u", "v", "w", "eps_y", "eps_piv", "quality")


def rms_of(values: xr.DataArray | np.ndarray) -> float:
    """Return the rms of the finite values of an array of any shape; NaN if there are none."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def median_of(values: object) -> float:
    """Return the median of the finite values of an array of any shape; NaN if there are none."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return float(np.median(finite)) if finite.size else float("nan")


def number(value: float, unit: str = "", digits: int = 3) -> str:
    """Return a value with its unit as text, to `digits` significant digits; a dash if it is not finite."""
    if not np.isfinite(value):
        return "–"
    return f"{value:.{digits}g}{' ' + unit if unit else ''}"


def with_interval(group: xr.Dataset | None, name: str, factor: float = 1.0) -> str:
    """Return `name` ± `name`_std (standard uncertainty) in a group, times `factor`, as text: "5.03 ± 0.41".
    The text is empty if the group of the wave store or a variable is missing, or a value is not finite."""
    if group is None or not {name, f"{name}_std"} <= set(group):
        return ""
    value, std = factor * float(group[name]), factor * float(group[f"{name}_std"])
    return f"{number(value)} ± {number(std, digits=2)}" if np.isfinite([value, std]).all() else ""


def small(value: float, unit: str) -> str:
    """Return a length or an angle with its unit as text, such as "0.41 mm" or "below 0.001 mrad"."""
    return f"{value:.2g} {unit}" if abs(value) >= 1e-3 else f"below 0.001 {unit}"


def thinned(cube: xr.Dataset, *names: str) -> xr.Dataset:
    """Return variables of a cube, loaded, at every n-th step: about 8 million values of each at most."""
    size = cube.sizes["time"] * cube.sizes["y"] * cube.sizes["x"]
    return cube[list(names)].isel(time=slice(None, None, -(-size // MAX_VALUES))).load()


def snapshot(cube: xr.Dataset) -> xr.Dataset:
    """Return one step (y, x), loaded: of those within 10 steps of mid-record, the one with most finite w."""
    middle = cube.sizes["time"] // 2
    near = cube.isel(time=slice(max(0, middle - _SNAPSHOT_STEPS), middle + _SNAPSHOT_STEPS + 1))
    shares = np.isfinite(near.w).mean(("y", "x")).values
    distance = np.abs(np.arange(shares.size) - shares.size // 2)
    return near.isel(time=int(np.argmax(np.round(shares, 2) - 1e-4 * distance))).load()


def extremes_of(snap: xr.Dataset) -> str:
    """Return a sentence with the ranges of z and w in one step (y, x) of a cube."""
    z, w = 100 * snap.z, 100 * snap.w
    return (
        f"At {moment_title(snap)} z is between {float(z.min()):.2g} and {float(z.max()):.2g} cm and w "
        f"between {float(w.min()):.2g} and {float(w.max()):.2g} cm/s."
    )


def reason_of(run: Run, name: str) -> str:
    """Return why the part `name` of a run, such as "waves", is absent; empty if it is there."""
    return in_folder(run, run.reason(name))


def in_folder(run: Run, words: str) -> str:
    """Return the text `words`, with paths in the folder of the cube or experiment made relative to it."""
    experiment = run.experiment.path.parent if run.experiment is not None else run.store.parent
    for folder in (run.store.parent, run.store.absolute().parent, experiment, experiment.absolute()):
        if folder != Path():
            words = words.replace(f"{folder}/", "")
    return words


def in_light_sheet(run: Run) -> bool:
    """Return whether a run measured velocities in a light sheet; it then has no surface and no waves."""
    return run.recipe.get("settings", {}).get("sheet_thickness") is not None


@dataclass(frozen=True, eq=False)
class RunNumbers:
    """Numbers of a run for all sections of its report: coverage, status of its steps, and the main fields."""

    run: Run

    @cached_property
    def part(self) -> xr.Dataset:
        """Fields z, u, v, w, misfits and quality, (time, y, x), loaded; a large cube is thinned in time."""
        return thinned(self.run.cube, *_FIELDS)

    @cached_property
    def n_in_view(self) -> int:
        """Number of values, in one field of `part`, at nodes that the cameras see; at least 1."""
        quality = self.part.quality
        seen = (quality != 0) & ((quality & np.uint16(Quality.OUTSIDE | Quality.MASKED)) == 0)
        return max(int(seen.sum()), 1)

    @property
    def in_view(self) -> float:
        """Fraction of the values in one field of `part` that are at nodes that the cameras see."""
        return float(self.n_in_view / self.part.quality.size)

    @property
    def measured(self) -> float:
        """Fraction of the values in one field of `part` that were measured, not filled from neighbours."""
        return float(((self.part.quality & int(Quality.MEASURED)) != 0).mean())

    @property
    def step_status(self) -> str:
        """Number of steps with each status (done, failed, ...), as text."""
        status = self.run.cube.frame_status.values
        counts = {s.name.lower().replace("_", " "): int((status == s).sum()) for s in FrameStatus}
        return ", ".join(f"{n} {words}" for words, n in counts.items() if n)
