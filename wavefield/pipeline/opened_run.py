"""Open a cube with what belongs to it: recipe, rig, experiment, images, probes, waves, truth.

The experiment's file is named relative to the store, so that a folder can be copied; some of its images are
compared with those that the cube was begun with.
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
from wavefield.errors import ExperimentError, StoreError, WavefieldError
from wavefield.grid import Grid
from wavefield.rig import Camera, Rig
from wavefield.sampling import from_first_to_last
from wavefield.series import Experiment, FrameSeries
from wavefield.series.masks import covered_series
from wavefield.store import beside
from wavefield.store.read import find_store
from wavefield.store.recipe import recipe_of, source_of, state_of

if TYPE_CHECKING:  # half a second to import, which a run needs at its end alone
    import xarray as xr

SAMPLE_FRAMES = 3  # frames of each camera: first, middle and last


def image_names(experiment: Experiment, camera: str) -> list[Any]:
    """Names, offset and time stamps of a camera's images, as the recipe stores them."""
    section = experiment.cameras[camera]
    images: Any = section.images
    if not isinstance(images, str) and len(images) > 20:  # a long list is identified by its hash
        digest = hashlib.sha256(json.dumps(images).encode()).hexdigest()[:16]
        images = f"list of {len(images)} files, {digest}"
    return [images, section.offset, section.times]


def labels(experiment: Experiment, store: Path) -> dict[str, Any]:
    """Attributes of a cube that describe its experiment; no value depends on them."""
    home, own = store.absolute().parent.resolve(), experiment.path.parent.resolve()
    out: dict[str, Any] = {"experiment_file": _relative(own / experiment.path.name, home)}
    if experiment.description:
        out["description"] = experiment.description
    if experiment.folder:
        folder = experiment.image_folder.resolve()
        out["image_folder"] = _relative(folder, home) if folder.is_relative_to(own) else str(folder)
    return out | experiment.water.attributes()


def _relative(path: Path, home: Path) -> str:
    try:
        return Path(os.path.relpath(path, home)).as_posix()
    except ValueError:  # on another drive
        return str(path)


def _named(store: Path, attributes: Mapping[str, object], name: str) -> Path:
    """Path that an attribute gives, relative to the folder of the store."""
    home = store.absolute().parent.resolve()
    return Path(os.path.normpath(home / str(attributes.get(name, ""))))


def experiment_path(store: Path, attributes: Mapping[str, object]) -> Path:
    """Where the experiment file of a cube is expected."""
    return _named(store, attributes, "experiment_file")


def load_experiment(store: Path, attributes: Mapping[str, object], given: Path | None = None) -> Experiment:
    """Read the experiment of a cube: the given file, else the one beside the cube, else the one it names."""
    named, folder = experiment_path(store, attributes), _named(store, attributes, "image_folder")
    images = folder if attributes.get("image_folder") and folder.is_dir() else None
    if given is not None:
        return Experiment.load(given, images)
    problem: WavefieldError | None = None
    for path in dict.fromkeys((store.absolute().parent.resolve() / named.name, named)):
        if path.is_file():
            try:
                experiment = Experiment.load(path, images)
                _check_fits(experiment, store, attributes)
                return experiment
            except WavefieldError as error:
                problem = error
    if problem is not None:
        raise problem
    return Experiment.load(named, images)


def _check_fits(experiment: Experiment, store: Path, attributes: Mapping[str, object]) -> None:
    """Refuse an experiment with other images: other names, or another first frame."""
    recipe = json.loads(str(attributes.get("recipe", "{}")))
    for camera, names in recipe.get("images", {}).items():
        if camera not in experiment.cameras or image_names(experiment, camera)[0] != names[0]:
            raise ExperimentError(
                f"{experiment.path} is not the experiment of {store}, whose images of {camera} are {names[0]}"
            )
    begun = json.loads(str(attributes.get("fingerprints", "{}")))
    first = {camera: {k: sums[k] for k in sorted(sums, key=int)[:1]} for camera, sums in begun.items()}
    try:
        frames = experiment.open_frames() if first else {}
    except (WavefieldError, OSError):  # images that are no longer there
        return
    check_images(str(store), first, frames)


def fingerprints(series: Mapping[str, FrameSeries]) -> dict[str, dict[str, int]]:
    """Checksums of the grey levels of some frames of each camera."""
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
    """Refuse images that differ from those that a cube was begun with."""
    for name, sums in begun.items():
        for index, requested in sums.items():
            frames = series.get(name)
            image = frames.read(int(index)).image if frames is not None else None
            if frames is not None and image is not None and _sum(image) != requested:
                raise StoreError(
                    f"{store} was begun with other images: {frames.place(int(index))} is not what it was; "
                    "write to another store with -o, or remove this one"
                )


T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Run:
    """A cube and what belongs to it, each read when it is first used.

    What is absent is None (or empty); `reason` gives the reason.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        The cube, lazy.
    store : path
        Its store.
    waves_path : path
        Where its waves are expected.
    experiment_path : path, optional
        Its experiment file; by default the file of that name beside the cube, or the one that it was made
        from, if its images are those of the cube.
    truth_path : path, optional
        The exact fields of a simulated experiment; by default beside the experiment file.
    """

    cube: xr.Dataset
    store: Path = Path()
    waves_path: Path = Path()
    experiment_path: Path | None = None
    truth_path: Path | None = None
    _reasons: dict[str, str] = field(default_factory=dict, init=False, repr=False)

    def reason(self, name: str) -> str:
        """Why something of the run is absent.

        Parameters
        ----------
        name : str
            Such as "experiment" or "waves".

        Returns
        -------
        str
            A sentence; empty where nothing is absent.
        """
        getattr(self, name)
        return self._reasons.get(name, "")

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """The recipe of the cube as plain data; empty if it has none."""
        found = recipe_of(self.cube.attrs)
        if not found:
            self._reasons["recipe"] = "the cube does not state how it was made"
        return found

    @cached_property
    def rig(self) -> Rig | None:
        """The cameras that measured."""
        cameras = self.recipe.get("rig")
        if not cameras:
            self._reasons["rig"] = "the cube's recipe has no rig"
            return None
        return Rig({name: Camera.from_dict(camera) for name, camera in cameras.items()})

    @cached_property
    def grid(self) -> Grid:
        """The nodes."""
        if grid := self.recipe.get("grid"):
            return Grid(**grid)
        x, y = self.cube.x.values, self.cube.y.values
        return Grid((x[0], x[-1]), (y[0], y[-1]), float((x[-1] - x[0]) / (x.size - 1)))

    @cached_property
    def experiment(self) -> Experiment | None:
        """The experiment, if its file is still there and can be read."""

        def load() -> Experiment | None:
            return load_experiment(self.store, self.cube.attrs, self.experiment_path)

        return self._try("experiment", load, None)

    @cached_property
    def frames(self) -> dict[str, FrameSeries]:
        """Images of every camera with their masks, if they are still there."""
        experiment, rig = self.experiment, self.rig
        if experiment is None:
            self._reasons["frames"] = f"the experiment file cannot be read: {self._reasons['experiment']}"
            return {}
        frames: dict[str, FrameSeries] = self._try("frames", experiment.open_frames, {})
        if not frames or rig is None:
            return frames
        measuring = {name: one for name, one in frames.items() if name in rig.cameras}
        folder = experiment.path.parent
        masked: dict[str, FrameSeries] = self._try(
            "masks", lambda: covered_series(experiment.mask, measuring, rig, folder), {}
        )
        return frames | masked

    @cached_property
    def probes(self) -> xr.Dataset | None:
        """The wave probes of the experiment, if it has any and their file is there.

        Raises
        ------
        ExperimentError
            If that file is wrong.
        """
        experiment = self.experiment
        if experiment is None or experiment.probes is None:
            self._reasons["probes"] = self._reasons.get("experiment", "the experiment names no probes")
            return None
        file = experiment.resolve(experiment.probes.file)
        if not file.is_file():
            self._reasons["probes"] = f"{file}, which {experiment.path} names: there is no such file"
            return None
        probes: xr.Dataset = experiment.read_probes()
        return probes

    @cached_property
    def waves(self) -> xr.DataTree | None:
        """The wave store next to the cube, lazy, if it belongs to the cube as it is.

        Raises
        ------
        StoreError
            If it is damaged, or of another cube.
        """
        if not self.waves_path.is_dir():
            self._reasons["waves"] = f"no waves yet: run `wavefield analyze {self.store}`"
            return None
        from wavefield.store.wave_store import open_waves

        waves = open_waves(self.waves_path)
        mark = read_mark(self.waves_path)
        if mark is None or mark.source != source_of(self.cube):
            raise StoreError(
                f"{self.waves_path} are the waves of another cube than {self.store}: move them, and run "
                f"`wavefield analyze {self.store}`"
            )
        if waves.attrs.get("cube") != state_of(self.cube):
            self._reasons["waves"] = (
                f"the cube has changed since its waves were computed: run `wavefield analyze {self.store}` "
                "again"
            )
            return None
        return waves

    def wave_group(self, name: str) -> xr.Dataset | None:
        """One group of the waves.

        Parameters
        ----------
        name : str
            Such as "spectra".

        Returns
        -------
        Dataset or None
            Loaded; None if there are no waves or they have no such group.
        """
        if self.waves is None or name not in self.waves.children:
            return None
        return self.waves[name].to_dataset().load()

    @cached_property
    def truth(self) -> xr.Dataset | None:
        """The exact fields of a simulated experiment, lazy."""
        file = self.experiment_path or experiment_path(self.store, self.cube.attrs)
        folder = (self.experiment.path if self.experiment else file).parent
        path = self.truth_path or folder / "truth" / "truth.zarr"
        if not path.is_dir():
            self._reasons["truth"] = "the experiment is not a simulated one, or its truth is not there"
            return None
        import xarray as xr

        truth: xr.Dataset = xr.open_zarr(path, consolidated=False)
        return truth

    @cached_property
    def pair_statistics(self) -> xr.Dataset | None:
        """Errors of every pair of cameras on its own: `wavefield.pipeline.assess`."""
        from wavefield.store.camera_pairs import read_pair_statistics

        found = read_pair_statistics(self.store)
        if found is None:
            self._reasons["pair_statistics"] = (
                "the cube has none: its run has not ended, no sampled step has usable frames of all cameras, "
                "or it was measured by an earlier version or in a light sheet"
            )
        return found

    def _try(self, name: str, load: Callable[[], T], absent: T) -> T:
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
    """Open a cube with everything that belongs to it.

    Parameters
    ----------
    store : path
        Cube written by `run`, or a folder that holds one.
    waves : path, optional
        Its waves; by default where `wavefield analyze` writes them, next to the cube.
    experiment : path, optional
        Its experiment file; by default the file of that name beside the cube, or the one that it was made
        from, if its images are those of the cube.
    truth : path, optional
        Exact fields of a simulated experiment; by default ``truth/truth.zarr`` next to the experiment file.

    Returns
    -------
    Run
        With ``cube``, ``recipe``, ``rig``, ``grid``, ``experiment``, ``frames``, ``probes``,
        ``waves``, ``truth`` and ``pair_statistics``, each read when it is first used; what is absent is None
        or empty, and ``run.reason("probes")`` gives the reason.

    Raises
    ------
    StoreError
        If the cube is not there, is not a cube, or is damaged.

    Examples
    --------
    The empty store that a run of ten steps begins with.

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
    from wavefield.store.cube import open_cube  # xarray, which a run does not need at its start

    cube = open_cube(store)
    return Run(
        cube,
        store,
        Path(waves) if waves is not None else beside(store, "waves", ".zarr"),
        Path(experiment) if experiment is not None else None,
        Path(truth) if truth is not None else None,
    )
