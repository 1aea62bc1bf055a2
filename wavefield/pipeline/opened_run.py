"""Open a cube with its recipe, rig, experiment, images, probes, waves and truth.

The cube names its experiment file relative to the store, so that a folder can be copied. Checksums of a few
images (fingerprints) show whether these are still the images of the cube.
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from wavefield.atomic_write import read_mark
from wavefield.errors import StoreError, WavefieldError
from wavefield.grid import Grid
from wavefield.rig import Camera, Rig
from wavefield.sampling import from_first_to_last
from wavefield.series import Experiment, FrameSeries
from wavefield.series.masks import covered_series
from wavefield.store import beside
from wavefield.store.read import find_store
from wavefield.store.recipe import recipe_of, source_of, state_of

if TYPE_CHECKING:  # takes half a second to import, and a run needs it only at its end
    import xarray as xr

SAMPLE_FRAMES = 3  # frames of each camera with a checksum: first, middle and last


def image_names(experiment: Experiment, camera: str) -> list[Any]:
    """Return the file names, offset and time stamps of a camera's images, as the recipe holds them.
    A list of more than 20 names is replaced by its length and hash."""
    section = experiment.cameras[camera]
    images: Any = section.images
    if not isinstance(images, str) and len(images) > 20:  # a long list is identified by its hash
        digest = hashlib.sha256(json.dumps(images).encode()).hexdigest()[:16]
        images = f"list of {len(images)} files, {digest}"
    return [images, section.offset, section.times]


def labels(experiment: Experiment, store: Path) -> dict[str, Any]:
    """Return the attributes of a cube that describe its experiment, with paths relative to the store.
    The measured values do not depend on them."""
    home, own = store.absolute().parent.resolve(), experiment.path.parent.resolve()
    out: dict[str, Any] = {"experiment_file": _relative(own / experiment.path.name, home)}
    if experiment.description:
        out["description"] = experiment.description
    if experiment.folder:
        folder = experiment.image_folder.resolve()
        out["image_folder"] = _relative(folder, home) if folder.is_relative_to(own) else str(folder)
    return out | experiment.water.attributes()


def _relative(path: Path, home: Path) -> str:
    """Return a path relative to a folder, or as it is if they are on different drives."""
    try:
        return Path(os.path.relpath(path, home)).as_posix()
    except ValueError:  # on another drive
        return str(path)


def _named(store: Path, attributes: Mapping[str, object], name: str) -> Path:
    """Return the path in the attribute ``name`` of a cube, which is relative to the folder of the store."""
    home = store.absolute().parent.resolve()
    return Path(os.path.normpath(home / str(attributes.get(name, ""))))


def load_experiment(store: Path, attributes: Mapping[str, object], given: Path | None = None) -> Experiment:
    """Read the experiment of a cube: the file ``given``, or else one whose images are those of the cube.
    This is the file next to the cube or, if that is missing or does not fit, the file that ``attributes``
    state."""
    named, folder = (_named(store, attributes, name) for name in ("experiment_file", "image_folder"))
    images = folder if attributes.get("image_folder") and folder.is_dir() else None
    if given is not None:
        return Experiment.load(given, images)
    problem: WavefieldError | None = None
    for path in dict.fromkeys((store.absolute().parent.resolve() / named.name, named)):
        if path.is_file():
            try:
                experiment = Experiment.load(path, images)
                _check_first_images(experiment, store, attributes)
                return experiment
            except WavefieldError as error:
                problem = error
    if problem is not None:
        raise problem
    return Experiment.load(named, images)


def _check_first_images(experiment: Experiment, store: Path, attributes: Mapping[str, object]) -> None:
    """Raise StoreError if the first images of an experiment are there and are not those of a cube."""
    begun = json.loads(str(attributes.get("fingerprints", "{}")))
    first = {camera: {k: sums[k] for k in sorted(sums, key=int)[:1]} for camera, sums in begun.items()}
    try:
        frames = experiment.open_frames() if first else {}
    except (WavefieldError, OSError):  # the images have been removed
        return
    check_images(str(store), first, frames)


def fingerprints(series: Mapping[str, FrameSeries]) -> dict[str, dict[str, int]]:
    """Return checksums of the first, middle and last image of each camera, by camera and index of frame."""
    out: dict[str, dict[str, int]] = {}
    for name, frames in series.items():
        read = {str(k): frames.read(k).image for k in from_first_to_last(len(frames), SAMPLE_FRAMES)}
        out[name] = {k: _sum(image) for k, image in read.items() if image is not None}
    return out


def _sum(image: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(image).tobytes())


def check_images(
    store: str, begun: Mapping[str, Mapping[str, int]], series: Mapping[str, FrameSeries]
) -> None:
    """Raise StoreError if images differ from those with the checksums `begun` of `fingerprints`.
    `store` names the cube in the message. Missing cameras and unreadable images are skipped."""
    for name, sums in begun.items():
        for index, expected in sums.items() if name in series else ():
            image = series[name].read(int(index)).image
            if image is not None and _sum(image) != expected:
                raise StoreError(
                    f"{store} was begun with other images: {series[name].place(int(index))} has changed; "
                    "write to another store with -o, or remove this one"
                )


T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Run:
    """A cube with its recipe, rig, experiment, images, probes, waves and truth, each read when first used.

    Anything that is absent is None or empty, and `reason` explains why.
    """

    cube: xr.Dataset  # (time, y, x): The cube, lazy
    store: Path = Path()  # Store of the cube
    waves_path: Path = Path()  # Store of its waves, which may not exist
    experiment_path: Path | None = None  # Experiment file, if not the one next to the cube or the original
    truth_path: Path | None = None  # Exact fields of a simulation, if not next to the experiment file
    _reasons: dict[str, str] = field(default_factory=dict, init=False, repr=False)

    def reason(self, name: str) -> str:
        """Return why a part of the run, such as "waves", is absent; empty if it is there."""
        getattr(self, name)
        return self._reasons.get(name, "")

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """The recipe of the cube as plain data: settings, rig, grid, images, algorithm; empty without one."""
        return recipe_of(self.cube.attrs)

    @cached_property
    def rig(self) -> Rig | None:
        """The cameras that were used; None if the recipe has no rig."""
        cameras = self.recipe.get("rig")
        return Rig({name: Camera.from_dict(one) for name, one in cameras.items()}) if cameras else None

    @cached_property
    def grid(self) -> Grid:
        """The nodes of the cube, from its recipe or else from its coordinates."""
        if grid := self.recipe.get("grid"):
            return Grid(**grid)
        x, y = self.cube.x.values, self.cube.y.values
        return Grid((x[0], x[-1]), (y[0], y[-1]), float((x[-1] - x[0]) / (x.size - 1)))

    @cached_property
    def experiment(self) -> Experiment | None:
        """The experiment; None if its file is missing or cannot be read."""
        return self._try(
            "experiment", lambda: load_experiment(self.store, self.cube.attrs, self.experiment_path), None
        )

    @cached_property
    def frames(self) -> dict[str, FrameSeries]:
        """Images of every camera with their masks; empty if they are missing."""
        experiment, rig = self.experiment, self.rig
        if experiment is None:
            self._reasons["frames"] = f"the experiment file cannot be read: {self._reasons['experiment']}"
            return {}
        none: dict[str, FrameSeries] = {}
        frames = self._try("frames", experiment.open_frames, none)
        if not frames or rig is None:
            return frames
        measuring = {name: one for name, one in frames.items() if name in rig.cameras}
        masks, folder = experiment.mask, experiment.path.parent
        return frames | self._try("masks", lambda: covered_series(masks, measuring, rig, folder), none)

    @cached_property
    def probes(self) -> xr.Dataset | None:
        """Elevations at the wave probes of the experiment; None without probes or without their file."""
        experiment = self.experiment
        if experiment is None or experiment.probes is None:
            self._reasons["probes"] = self._reasons.get("experiment", "the experiment names no probes")
            return None
        file = experiment.resolve(experiment.probes.file)
        if not file.is_file():
            self._reasons["probes"] = f"{experiment.path} names {file}, which does not exist"
            return None
        probes: xr.Dataset = experiment.read_probes()
        return probes

    @cached_property
    def waves(self) -> xr.DataTree | None:
        """The wave store, lazy; None if it does not exist, or if the cube has changed since."""
        if not self.waves_path.is_dir():
            self._reasons["waves"] = f"no waves yet: run `wavefield analyze {self.store}`"
            return None
        from wavefield.store.wave_store import open_waves

        waves = open_waves(self.waves_path)
        mark = read_mark(self.waves_path)
        if mark is None or mark.source != source_of(self.cube):
            raise StoreError(
                f"{self.waves_path} has the waves of another cube than {self.store}: move it, and run "
                f"`wavefield analyze {self.store}`"
            )
        if waves.attrs.get("cube") == state_of(self.cube):
            return waves
        again = f"run `wavefield analyze {self.store}` again"
        self._reasons["waves"] = f"the cube has changed since its waves were computed: {again}"
        return None

    def wave_group(self, name: str) -> xr.Dataset | None:
        """Return one group of the wave store, such as "spectra", loaded; None if there is none."""
        if self.waves is None or name not in self.waves.children:
            return None
        return self.waves[name].to_dataset().load()

    @cached_property
    def truth(self) -> xr.Dataset | None:
        """Exact fields of a simulated experiment, lazy; None if there are none."""
        file = self.experiment_path or _named(self.store, self.cube.attrs, "experiment_file")
        folder = (self.experiment.path if self.experiment else file).parent
        path = self.truth_path or folder / "truth" / "truth.zarr"
        if not path.is_dir():
            self._reasons["truth"] = f"the experiment is not simulated, or its exact fields are not in {path}"
            return None
        import xarray as xr

        truth: xr.Dataset = xr.open_zarr(path, consolidated=False)
        return truth

    @cached_property
    def pair_statistics(self) -> xr.Dataset | None:
        """Errors of each pair of cameras (`wavefield.pipeline.assess.pair_statistics`); None without them."""
        from wavefield.store.camera_pairs import read_pair_statistics

        found = read_pair_statistics(self.store)
        if found is None:
            self._reasons["pair_statistics"] = (
                "the cube has none, because its run has not ended, no sampled step has usable frames of all "
                "cameras, or it was measured by an earlier version or in a light sheet"
            )
        return found

    def _try(self, name: str, load: Callable[[], T], absent: T) -> T:
        """Return the result of ``load``, or ``absent`` if it raises an error, which becomes the reason."""
        try:
            return load()
        except (WavefieldError, OSError) as error:
            self._reasons[name] = str(error)
            return absent


def open_run(
    store: str | Path,
    *,
    waves: str | Path | None = None,
    experiment: str | Path | None = None,
    truth: str | Path | None = None,
) -> Run:
    """Open a cube with its recipe, rig, experiment, images, probes, waves and truth.

    Parameters
    ----------
    store : path
        Cube written by `run`, or a folder that contains one.
    waves, experiment, truth : path, optional
        Store of its waves, experiment file, and exact fields of a simulation, if they are elsewhere than next
        to the cube, where the experiment file was, and in ``truth/truth.zarr`` next to that file.

    Returns
    -------
    Run
        Its attributes ``cube``, ``recipe``, ``rig``, ``grid``, ``experiment``, ``frames``, ``probes``,
        ``waves``, ``truth`` and ``pair_statistics`` are read when first used. Absent parts are None or empty;
        ``run.reason("probes")`` explains why.

    Raises
    ------
    StoreError
        If the cube does not exist, is not a cube, or is damaged.

    Examples
    --------
    The store of a run of ten steps, before any step is measured.

    >>> import tempfile
    >>> import numpy as np
    >>> from wavefield.store.layout import StoreLayout, create_store
    >>> from wavefield.store.recipe import Recipe
    >>> recipe = Recipe("basin", {}, (0, 10), 20.0, {}, {}, {})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store, layout = Path(folder) / "cube.zarr", StoreLayout(10, 4, ("left", "right"), 0)
    ...     create_store(store, recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, layout, {})
    ...     run = open_run(store)
    ...     run.waves, run.reason("waves").replace(folder, "")
    (None, 'no waves yet: run `wavefield analyze /cube.zarr`')
    >>> run.grid.shape, run.recipe["experiment"]
    ((3, 4), 'basin')
    """
    store = find_store(store)
    from wavefield.store.cube import open_cube  # imports xarray, which a run needs only at its end

    cube = open_cube(store)
    return Run(
        cube,
        store,
        Path(waves) if waves is not None else beside(store, "waves", ".zarr"),
        Path(experiment) if experiment is not None else None,
        Path(truth) if truth is not None else None,
    )
