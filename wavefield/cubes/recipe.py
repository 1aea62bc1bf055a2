"""The recipe of a cube: everything that its values follow from, as plain data with a hash."""

import hashlib
import json
import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import Any

from wavefield import __version__
from wavefield.grid import Grid
from wavefield.rig import Rig
from wavefield.series import Experiment, FrameSeries


@dataclass(frozen=True)
class Recipe:
    """What a cube was made from and how.

    Parameters
    ----------
    experiment : str
        Name of the experiment.
    images : mapping
        The images of every camera, as the experiment file names them.
    frames : tuple of int
        First and last frame number.
    frame_rate : float
        Hz.
    grid, rig, settings : mapping
        As plain data.
    packing : str
        "float32" or "int16".
    wavefield : str
        Version of this program.
    software : mapping
        Versions of what it rests on; not part of the hash.
    """

    experiment: str
    images: Mapping[str, Any]
    frames: tuple[int, int]
    frame_rate: float
    grid: Mapping[str, Any]
    rig: Mapping[str, Any]
    settings: Mapping[str, Any]
    packing: str = "float32"
    wavefield: str = __version__
    software: Mapping[str, str] = field(default_factory=lambda: _software())

    def to_json(self) -> str:
        """The recipe as text for a store's attributes.

        Returns
        -------
        str
        """
        return json.dumps(asdict(self), sort_keys=True)

    @property
    def hash(self) -> str:
        """Sixteen hexadecimal digits that change whenever values of the cube could."""
        data = asdict(self)
        del data["software"]
        text = json.dumps(data, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def make_recipe(
    experiment: Experiment,
    series: Mapping[str, FrameSeries],
    rig: Rig,
    grid: Grid,
    settings: Any,
    packing: str = "float32",
) -> Recipe:
    """Collect the recipe of a run.

    Parameters
    ----------
    experiment : Experiment
        The experiment.
    series : mapping of str to FrameSeries
        Its frames.
    rig : Rig
        The cameras.
    grid : Grid
        The nodes.
    settings : wavefield.measurement.Settings
        The choices.
    packing : {"float32", "int16"}
        How values are stored.

    Returns
    -------
    Recipe
    """
    one = next(iter(series.values()))
    return Recipe(
        experiment=experiment.name,
        images={name: _images(experiment, name) for name in series},
        frames=(one.first, one.first + len(one) - 1),
        frame_rate=experiment.frame_rate,
        grid=asdict(grid),
        rig={name: rig[name].to_dict() for name in series},
        settings=settings.to_dict(),
        packing=packing,
    )


def _images(experiment: Experiment, name: str) -> Any:
    section = experiment.cameras[name]
    images: Any = section.images
    if not isinstance(images, str) and len(images) > 20:  # a long list is told apart by its hash
        digest = hashlib.sha256(json.dumps(images).encode()).hexdigest()[:16]
        images = f"list of {len(images)} files, {digest}"
    return [images, section.offset, section.times]


def _software() -> dict[str, str]:
    packages = ("numpy", "scipy", "numba", "opencv-python-headless", "zarr")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


def differences(old: str, new: str) -> list[str]:
    """What tells two recipes apart.

    Parameters
    ----------
    old, new : str
        Recipes as JSON.

    Returns
    -------
    list of str
        Such as "settings.piv.window: 20 there, 24 here".
    """
    a, b = dict(_leaves(json.loads(old))), dict(_leaves(json.loads(new)))
    keys = [key for key in {**a, **b} if not key.startswith("software.") and a.get(key) != b.get(key)]
    return [f"{key}: {a.get(key)!r} there, {b.get(key)!r} here" for key in keys]


def _leaves(data: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, data
