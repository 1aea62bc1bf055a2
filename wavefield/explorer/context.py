"""What lies beside a cube: its rig, its experiment with the images, its waves, its probes."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import xarray as xr

from wavefield.errors import StoreError, WavefieldError
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.target_images import TargetImages
from wavefield.rig import Camera, Rig
from wavefield.series import Experiment, FrameSeries
from wavefield.series.masks import covered_series
from wavefield.store.wave_store import open_waves as open_wave_store

_REACH = 0.05  # m: how low the water is thought to go where a cylinder stands


@dataclass
class CubeContext:
    """Companions of a cube; what is not there is None or empty, with a sentence in `notes`."""

    rig: Rig | None = None  # Cameras of the run
    experiment: Experiment | None = None  # Its file
    frames: dict[str, FrameSeries] = field(default_factory=dict)  # The images, with what is masked in them
    waves: xr.DataTree | None = None  # The wave store
    waves_path: Path = Path()  # Where that is, or would be
    probes: xr.Dataset | None = None  # Wave probes
    targets: TargetImages | None = None  # The target images
    # What is missing, and why: keys "cameras", "waves", "probes"
    notes: dict[str, str] = field(default_factory=dict)

    def take(self, experiment: Experiment) -> None:
        """Find the images of an experiment, and what is masked in them; a note says what is not there."""
        self.experiment, self.targets = experiment, TargetImages(experiment)
        try:
            frames = experiment.open_frames()
            self.frames = frames
            if self.rig is not None:
                known = {name: one for name, one in frames.items() if name in self.rig.cameras}
                folder = experiment.path.parent
                self.frames = frames | covered_series(experiment.mask, known, self.rig, folder, _REACH)
        except WavefieldError as error:
            self.notes["cameras"] = str(error) if self.frames else f"no images: {error}"

    def group(self, name: str) -> xr.Dataset | None:
        """One group of the wave store, loaded; None if there is none."""
        if self.waves is None or name not in self.waves.children:
            return None
        return self.waves[name].to_dataset().load()


def waves_beside(cube: Path) -> Path:
    """Where `wavefield analyze` puts the waves of a cube.

    Examples
    --------
    >>> waves_beside(Path("cube.zarr")).name, waves_beside(Path("run7.zarr")).name
    ('waves.zarr', 'run7_waves.zarr')
    """
    stem = cube.name.removesuffix(".zarr")
    return cube.with_name((stem.replace("cube", "waves") if "cube" in stem else f"{stem}_waves") + ".zarr")


def find_context(record: CubeRecord, waves: str | Path | None = None) -> CubeContext:
    """Find what lies beside a cube."""
    out = CubeContext(waves_path=Path(waves) if waves is not None else waves_beside(record.path))
    open_waves(out)
    attributes = record.group.attrs
    recipe = json.loads(str(attributes.get("recipe", "{}")))
    if isinstance(recipe.get("rig"), Mapping):
        out.rig = Rig({name: Camera.from_dict(camera) for name, camera in recipe["rig"].items()})
    file = Path(str(attributes.get("experiment_file", "")))
    if not file.is_absolute():
        file = Path(os.path.normpath(record.path.parent / file))
    try:
        folder = attributes.get("image_folder")
        experiment = Experiment.load(file, str(folder) if folder else None)
    except (WavefieldError, OSError) as error:
        out.notes["cameras"] = f"no images: the experiment file cannot be read ({error})"
        return out
    out.take(experiment)
    if experiment.probes:
        try:
            out.probes = experiment.read_probes()
        except WavefieldError as error:
            out.notes["probes"] = str(error)
    return out


def open_waves(beside: CubeContext) -> bool:
    """Open the wave store, if it is there by now."""
    beside.notes.pop("waves", None)
    if not beside.waves_path.is_dir():
        beside.notes["waves"] = (
            "no waves yet: run `wavefield analyze` on this cube; they appear here by themselves"
        )
        return False
    try:
        beside.waves = open_wave_store(beside.waves_path)
    except StoreError as error:
        beside.notes["waves"] = str(error)
        return False
    return True
