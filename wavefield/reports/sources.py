"""What a report is made from: the cube, and whatever else lies beside it."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from wavefield.errors import StoreError, WavefieldError
from wavefield.grid import Grid
from wavefield.rig import Camera, Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.store.wave_store import open_waves
from wavefield.variables import CUBE_FIELDS

_MOST_VALUES = 8_000_000  # per variable, for distributions: a few seconds and 64 MB


@dataclass
class Sources:
    """Everything that a report may show; what is not there is None, with the reason among the notes.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        The cube, lazy.
    waves : DataTree, optional
        The wave store.
    rig : Rig, optional
        The cameras of the run.
    experiment : Experiment, optional
        The experiment file, if it is still where it was.
    frames : dict of camera to FrameSeries
        The images, if they are still where they were.
    truth : Dataset, optional
        The exact fields of a simulated experiment, on the steps and nodes of the cube.
    bad_frames : tuple of str
        Frames that were missing or bad, in words.
    notes : list of str
        What is missing, and why.
    dates : dict of str to str
        When images were written and steps were measured, by what was done, as far as files tell.
    """

    cube: xr.Dataset
    waves: xr.DataTree | None = None
    rig: Rig | None = None
    experiment: Experiment | None = None
    frames: dict[str, FrameSeries] = field(default_factory=dict)
    truth: xr.Dataset | None = None
    bad_frames: tuple[str, ...] = ()
    notes: list[str] = field(default_factory=list)
    dates: dict[str, str] = field(default_factory=dict)

    @property
    def recipe(self) -> dict[str, Any]:
        """The recipe of the cube; empty if it has none."""
        text = self.cube.attrs.get("recipe", "")
        try:
            return dict(json.loads(text)) if isinstance(text, str) else dict(text)
        except (ValueError, TypeError):
            return {}

    @property
    def grid(self) -> Grid:
        """The grid of the cube."""
        return grid_of(self.cube)

    @property
    def calibration_folder(self) -> Path | None:
        """Folder that `wavefield calibrate` left beside the rig file; None if there is none."""
        if self.experiment is None or isinstance(self.experiment.rig, dict):
            return None
        rig = self.experiment.resolve(self.experiment.rig or "rig.yaml")
        folder = rig.with_name(f"{rig.stem}_report")
        return folder if (folder / "numbers.yaml").is_file() else None

    def group(self, name: str) -> xr.Dataset | None:
        """Give one group of the wave store.

        Parameters
        ----------
        name : str
            Such as "spectra".

        Returns
        -------
        Dataset or None
            None if there is no wave store or it has no such group.
        """
        if self.waves is None or name not in self.waves.children:
            return None
        return self.waves[name].to_dataset().load()

    @property
    def waves_notes(self) -> str:
        """What the analysis has to say to its reader, a sentence per line."""
        return "" if self.waves is None else str(self.waves.attrs.get("notes", ""))

    def thinned(self, *names: str) -> xr.Dataset:
        """Load variables of the cube, thinned in time if they are large.

        Parameters
        ----------
        *names : str
            Variables.

        Returns
        -------
        Dataset
        """
        size = self.cube.sizes["time"] * self.cube.sizes["y"] * self.cube.sizes["x"]
        return self.cube[list(names)].isel(time=slice(None, None, -(-size // _MOST_VALUES))).load()

    def snapshot(self) -> xr.Dataset:
        """Pick the step nearest the middle of the record with the most measured nodes.

        Returns
        -------
        Dataset, (y, x)
        """
        count = self.cube.sizes["time"]
        near = slice(max(0, count // 2 - 10), count // 2 + 11)
        shares = np.isfinite(self.cube.w.isel(time=near)).mean(("y", "x")).values
        distance = np.abs(np.arange(shares.size) - shares.size // 2)
        best = int(np.argmax(np.round(shares, 2) - 1e-4 * distance))
        return self.cube.isel(time=near).isel(time=best).load()


def gather(
    store: str | Path,
    waves: str | Path | None = None,
    experiment: str | Path | None = None,
    truth: str | Path | None = None,
) -> Sources:
    """Find what a report of a cube can be made from.

    Parameters
    ----------
    store : path
        The cube.
    waves : path, optional
        Its wave store; without one the report has no spectra.
    experiment : path, optional
        Its experiment file; by default the one it was made from, if it is still there.
    truth : path, optional
        Exact fields of a simulated experiment; by default ``truth/truth.zarr`` beside the experiment file.

    Returns
    -------
    Sources

    Raises
    ------
    StoreError
        If the cube cannot be read.
    """
    from wavefield.pipeline import open_cube, status

    cube = open_cube(store)
    cube = cube[[name for name in (*CUBE_FIELDS, "z_level_std", "frame_status") if name in cube]]
    kept = {*cube.dims, "path_frames"}
    cube = cube.drop_vars([name for name in cube.coords if name not in kept])
    out = Sources(cube, bad_frames=tuple(str(bad) for bad in status(store).bad_frames))
    if not len(cube.time) or not (cube.frame_status.values > 0).any():
        raise StoreError(f"{store} has no measured step yet; run `wavefield run` first")
    if waves is not None and Path(waves).is_dir():
        out.waves = open_waves(waves)
        rate = float(cube.attrs.get("frame_rate", np.nan))
        if abs(float(out.waves.attrs.get("frame_rate", rate)) / rate - 1) > 1e-3:
            out.waves = None
            out.notes.append(
                "spectra and coherence (the cube has another frame rate since: run "
                f"`wavefield analyze {store}` again)"
            )
    else:
        out.notes.append(f"spectra and coherence (run `wavefield analyze {store}` first)")
    out.dates = span_of("measured", Path(store).glob("frame_status/c/*"))
    rig = out.recipe.get("rig")
    if isinstance(rig, Mapping):
        out.rig = Rig({name: Camera.from_dict(camera) for name, camera in rig.items()})
    file = Path(experiment or str(cube.attrs.get("experiment_file", "")))
    try:
        out.experiment = Experiment.load(file, cube.attrs.get("image_folder"))
    except (WavefieldError, OSError) as error:
        out.notes.append(f"pictures of the cameras' frames (the experiment file cannot be read: {error})")
        return out
    try:
        out.frames = out.experiment.open_frames()
    except WavefieldError as error:
        out.notes.append(f"pictures of the cameras' frames, and each pair of cameras on its own ({error})")
    entries = (entry for one in out.frames.values() for entry in (one.entries[0], one.entries[-1]) if entry)
    out.dates = span_of("images written", (Path(entry.path) for entry in entries)) | out.dates
    exact = Path(truth) if truth else out.experiment.path.parent / "truth" / "truth.zarr"
    if exact.is_dir():
        out.truth = xr.open_zarr(exact, consolidated=False)
    return out


def span_of(what: str, files: Iterable[Path]) -> dict[str, str]:
    """From when to when files were written, to the minute."""
    times = sorted(file.stat().st_mtime for file in files if file.exists())
    if not times:
        return {}
    first, last = (datetime.fromtimestamp(t).astimezone() for t in (times[0], times[-1]))
    words = f"{first:%Y-%m-%d %H:%M}"
    if f"{last:%Y-%m-%d %H:%M}" != words:
        words += f" to {last:%H:%M}" if last.date() == first.date() else f" to {last:%Y-%m-%d %H:%M}"
    return {what: f"{words} {last:%Z}".strip()}


def grid_of(cube: xr.Dataset) -> Grid:
    """Grid of a cube.

    With cube (time, y, x).
    """
    x, y = cube.x.values, cube.y.values
    return Grid((x[0], x[-1]), (y[0], y[-1]), float(np.mean(np.diff(x))))
