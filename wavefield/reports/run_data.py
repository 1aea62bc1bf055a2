"""Parts of a run as the pages show them: variables thinned in time, one snapshot, dates."""

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield.figures.style import moment_title
from wavefield.pipeline import Run

MAX_VALUES = 8_000_000  # per variable, for distributions: a few seconds and 64 MB
_SNAPSHOT_STEPS = 10  # on either side of the middle of the record


def thinned(cube: xr.Dataset, *names: str) -> xr.Dataset:
    """Variables of a cube, loaded, with fewer steps where they are large."""
    size = cube.sizes["time"] * cube.sizes["y"] * cube.sizes["x"]
    return cube[list(names)].isel(time=slice(None, None, -(-size // MAX_VALUES))).load()


def snapshot(cube: xr.Dataset) -> xr.Dataset:
    """The step near the middle of the record with the most measured nodes, (y, x), loaded."""
    middle = cube.sizes["time"] // 2
    near = cube.isel(time=slice(max(0, middle - _SNAPSHOT_STEPS), middle + _SNAPSHOT_STEPS + 1))
    shares = np.isfinite(near.w).mean(("y", "x")).values
    distance = np.abs(np.arange(shares.size) - shares.size // 2)
    return near.isel(time=int(np.argmax(np.round(shares, 2) - 1e-4 * distance))).load()


def extremes_of(snap: xr.Dataset) -> str:
    """Ranges of z and w of a snapshot (y, x), as a sentence."""
    z, w = 100 * snap.z, 100 * snap.w
    return (
        f"At {moment_title(snap)} z is between {float(z.min()):.2g} and {float(z.max()):.2g} cm and w "
        f"between {float(w.min()):.2g} and {float(w.max()):.2g} cm/s."
    )


def reason_of(run: Run, name: str) -> str:
    """Why something of a run is absent, without the folders of this machine; empty where nothing is."""
    return in_folder(run, run.reason(name))


def in_folder(run: Run, words: str) -> str:
    """Words with paths relative to the folders of the cube and of its experiment."""
    experiment = run.experiment.path.parent if run.experiment is not None else run.store.parent
    for folder in (run.store.parent, run.store.absolute().parent, experiment, experiment.absolute()):
        if folder != Path():
            words = words.replace(f"{folder}/", "")
    return words


def in_light_sheet(run: Run) -> bool:
    """Whether velocities in a light sheet were measured: there are no surface and no waves then."""
    return run.recipe.get("settings", {}).get("sheet_thickness") is not None


def dates_of(run: Run) -> list[str]:
    """When the images were written and the steps measured, as far as the files' dates show."""
    ends = (entry for one in run.frames.values() for entry in (one.entries[0], one.entries[-1]) if entry)
    images = [Path(entry.path) for entry in ends]
    spans = {"images written": images, "measured": run.store.glob("frame_status/c/*")}
    return [f"{what} {dates}" for what, files in spans.items() if (dates := _span(files))]


def _span(files: Iterable[Path]) -> str:
    """From when to when files were written, to the minute; empty if there are none."""
    times = sorted(file.stat().st_mtime for file in files if file.exists())
    if not times:
        return ""
    first, last = (datetime.fromtimestamp(t).astimezone() for t in (times[0], times[-1]))
    words = f"{first:%Y-%m-%d %H:%M}"
    if f"{last:%Y-%m-%d %H:%M}" != words:
        words += f" to {last:%H:%M}" if last.date() == first.date() else f" to {last:%Y-%m-%d %H:%M}"
    return f"{words} {last:%Z}".strip()
