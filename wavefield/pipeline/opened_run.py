"""Open a cube together with what it was made from and what was computed from it.

A cube holds the path of its experiment file relative to the store, so that a folder can be copied. It also
holds checksums of a few images (fingerprints), which show whether images have changed since.
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
    """Return [file names or their pattern, offset of frame numbers, file of time stamps] of a camera.
    It is a part of the cube's recipe. More than 20 names are replaced by their number and hash."""
    section = experiment.cameras[camera]
    images: Any = section.images
    if not isinstance(images, str) and len(images) > 20:  # a long list is identified by its hash
        digest = hashlib.sha256(json.dumps(images).encode()).hexdigest()[:16]
        images = f"list of {len(images)} files, {digest}"
    return [images, section.offset, section.times]


def labels(experiment: Experiment, store: Path) -> dict[str, Any]:
    """Return attributes of a cube that describe its experiment but do not change the measured values.
    Paths (experiment file; folder of the images, if named) are relative to the folder of ``store``, but a
    folder of images outside of the experiment's folder is absolute."""
    home, own = store.absolute().parent.resolve(), experiment.path.parent.resolve()
    out: dict[str, Any] = {"experiment_file": _relative(own / experiment.path.name, home)}
    if experiment.description:
        out["description"] = experiment.description
    if experiment.folder:
        folder = experiment.image_folder.resolve()
        out["image_folder"] = _relative(folder, home) if folder.is_relative_to(own) else str(folder)
    return out | experiment.water.attributes()


def _relative(path: Path, home: Path) -> str:
    """Return ``path`` relative to the folder ``home``, or ``path`` itself if they are on different drives."""
    try:
        return Path(os.path.relpath(path, home)).as_posix()
    except ValueError:  # on another drive
        return str(path)


def _named(store: Path, attributes: Mapping[str, object], name: str) -> Path:
    """Return the path in the attribute ``name`` of a cube; paths there are relative to the store's folder."""
    home = store.absolute().parent.resolve()
    return Path(os.path.normpath(home / str(attributes.get(name, ""))))


def load_experiment(store: Path, attributes: Mapping[str, object], given: Path | None = None) -> Experiment:
    """Read the experiment of a cube from the file ``given`` or, by default, from the file next to the cube.
    If that is missing or has other images, the file that the cube's ``attributes`` name is read instead.
    WavefieldError if none can be read."""
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
    """Raise StoreError if the first image of a camera differs from its checksum in the cube's ``attributes``.
    Images that cannot be read are not compared. ``store`` is the cube, for the message."""
    begun = json.loads(str(attributes.get("fingerprints", "{}")))
    first = {camera: {k: sums[k] for k in sorted(sums, key=int)[:1]} for camera, sums in begun.items()}
    try:
        frames = experiment.open_frames() if first else {}
    except (WavefieldError, OSError):  # the images have been removed
        return
    check_images(str(store), first, frames)


def fingerprints(series: Mapping[str, FrameSeries]) -> dict[str, dict[str, int]]:
    """Return checksums of the first, middle and last image of each camera, by camera, then by frame index.
    An example is {"left": {"0": checksum, "50": checksum, "99": checksum}}. Bad images are left out."""
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
    """Raise StoreError if images in `series` differ from their checksums `begun`, a result of `fingerprints`.
    `store` is the name of the cube in the message. Missing cameras and unreadable images are skipped."""
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
    """A cube with its inputs (experiment, rig, images) and its results (waves): see `open_run`.

    Attributes are read when first used. An absent attribute is None or empty, and `reason` explains why.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        The cube, lazy.
    store : path
        Store of the cube.
    experiment_path : path, optional
        Experiment file, by default the one next to the cube or the original one.
    """

    cube: xr.Dataset
    store: Path = Path()
    experiment_path: Path | None = None
    _reasons: dict[str, str] = field(default_factory=dict, init=False, repr=False)

    @property
    def waves_path(self) -> Path:
        """Store of the cube's waves, next to the cube, where `analyze` writes it; it may not exist."""
        return beside(self.store, "waves", ".zarr")

    def reason(self, name: str) -> str:
        """Return why an attribute of the run, such as "waves", is absent; an empty text if it is present."""
        getattr(self, name)
        return self._reasons.get(name, "")

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """The recipe of the cube, the record of all inputs: settings, rig, grid, images and algorithm.
        It is plain data, and empty if the cube holds no recipe."""
        return recipe_of(self.cube.attrs)

    @cached_property
    def rig(self) -> Rig | None:
        """The calibrated cameras with which the cube was measured; None if the recipe has no rig."""
        cameras = self.recipe.get("rig")
        return Rig({name: Camera.from_dict(one) for name, one in cameras.items()}) if cameras else None

    @cached_property
    def grid(self) -> Grid:
        """The grid points of the cube, from its recipe or else from its coordinates."""
        if grid := self.recipe.get("grid"):
            return Grid(**grid)
        x, y = self.cube.x.values, self.cube.y.values
        return Grid((x[0], x[-1]), (y[0], y[-1]), float((x[-1] - x[0]) / (x.size - 1)))

    @cached_property
    def experiment(self) -> Experiment | None:
        """The experiment of the cube; None if its file is missing, cannot be read or has other images."""
        return self._try(
            "experiment", lambda: load_experiment(self.store, self.cube.attrs, self.experiment_path), None
        )

    @cached_property
    def frames(self) -> dict[str, FrameSeries]:
        """Images of every camera, with masks for the measuring cameras; empty if images are missing."""
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
        """Elevations at the wave probes of the experiment (`wavefield.read_probes`).
        None if the experiment names no probes, or if the file of the probes does not exist."""
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
        """The waves that `wavefield.analyze` stored, lazy; None if absent or the cube has changed since.
        StoreError if the store has the waves of another cube."""
        if not self.waves_path.is_dir():
            self._reasons["waves"] = f"no waves yet: run `wavefield analyze {self.store}`"
            return None
        from wavefield.store.results import open_waves

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
        """Return one group of `waves`, such as "spectra", loaded into memory; None if it does not exist."""
        if self.waves is None or name not in self.waves.children:
            return None
        return self.waves[name].to_dataset().load()

    @cached_property
    def truth(self) -> xr.Dataset | None:
        """Exact elevation and velocity of a simulated experiment, lazy; None if not simulated or missing."""
        file = self.experiment_path or _named(self.store, self.cube.attrs, "experiment_file")
        path = (self.experiment.path if self.experiment else file).parent / "truth" / "truth.zarr"
        if not path.is_dir():
            self._reasons["truth"] = f"the experiment is not simulated, or its exact fields are not in {path}"
            return None
        import xarray as xr

        truth: xr.Dataset = xr.open_zarr(path, consolidated=False)
        return truth

    @cached_property
    def pair_statistics(self) -> xr.Dataset | None:
        """Errors of each camera pair (`wavefield.pipeline.assess.pair_statistics`); None if not stored."""
        from wavefield.store.results import read_pair_statistics

        found = read_pair_statistics(self.store)
        if found is None:
            self._reasons["pair_statistics"] = (
                "the cube has none, because its run has not ended, no sampled step has usable frames of all "
                "cameras, or it was measured by an earlier version or in a light sheet"
            )
        return found

    def _try(self, name: str, load: Callable[[], T], absent: T) -> T:
        """Return the result of ``load()``, or ``absent`` if that raises an error.
        The error's message becomes the reason why the attribute ``name`` is absent."""
        try:
            return load()
        except (WavefieldError, OSError) as error:
            self._reasons[name] = str(error)
            return absent


def open_run(store: str | Path, *, experiment: str | Path | None = None) -> Run:
    """Open a cube together with its inputs (experiment, rig, images) and its results (waves).

    Parameters
    ----------
    store : path
        Cube written by `run`, or a folder that contains one.
    experiment : path, optional
        Experiment file; by default the file next to the cube, or else the file that was run.

    Returns
    -------
    Run
        The measured fields are ``cube``. Attributes that are read when first used: ``recipe``, ``rig``,
        ``grid``, ``experiment``, ``frames`` (images), ``probes``, ``waves``, ``truth`` (exact fields of a
        simulation), ``pair_statistics``. Absent ones are None or empty: see ``run.reason("probes")``.

    Raises
    ------
    StoreError
        If the cube does not exist, is not a cube, or is damaged.

    Examples
    --------
    A new store for ten steps, none of which is measured yet.

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

    return Run(open_cube(store), store, Path(experiment) if experiment is not None else None)
