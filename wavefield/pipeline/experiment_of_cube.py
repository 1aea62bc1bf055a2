"""The experiment of a cube. Its file is named relative to the store, so that a folder can be copied; some of
its images are compared with those that the cube was begun with.
"""

import hashlib
import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.errors import ExperimentError, StoreError, WavefieldError
from wavefield.sampling import from_first_to_last
from wavefield.series import Experiment, FrameSeries
from wavefield.series.readers import without_password

SAMPLE_FRAMES = 3  # frames of each camera: first, middle and last


def image_names(experiment: Experiment, camera: str) -> list[Any]:
    """Images of a camera as a recipe holds them: names, offset, file of time stamps."""
    section = experiment.cameras[camera]
    images: Any = section.images
    if not isinstance(images, str) and len(images) > 20:  # a long list is identified by its hash
        digest = hashlib.sha256(json.dumps(images).encode()).hexdigest()[:16]
        images = f"list of {len(images)} files, {digest}"
    if isinstance(images, str):
        images = without_password(images)
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
    """Read the experiment of a cube: the given one, or the one beside it or named in it if that fits."""
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
