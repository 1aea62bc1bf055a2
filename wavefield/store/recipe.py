"""The recipe of a cube: all inputs that determine its values, as plain data with a hash."""

import hashlib
import json
import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from wavefield import __version__
from wavefield.atomic_write import identity_of
from wavefield.errors import StoreError


def recipe_of(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """The recipe in the attributes of a cube, as plain data; empty if there is none."""
    try:
        return dict(json.loads(attributes["recipe"]))
    except (KeyError, TypeError, ValueError):
        return {}


# entries that no value depends on: the name, what was learned (it follows from the rest), versions
_LABELS = ("experiment", "record", "software")


@dataclass(frozen=True)
class Recipe:
    """What a cube was made from and how."""

    experiment: str  # Name of the experiment
    # Of every camera the images as the experiment file names them, its offset, its file of time stamps
    images: Mapping[str, Any]
    frames: tuple[int, int]  # First and last frame number
    frame_rate: float  # Hz
    grid: Mapping[str, Any]  # As plain data
    rig: Mapping[str, Any]
    settings: Mapping[str, Any]
    packing: str = "float32"  # "float32" or "int16"
    # What does not count as water, as plain data; empty if all does
    mask: Mapping[str, Any] = field(default_factory=dict)
    # Checksum of the departures of the frames from even times; empty where these are even
    departures: Mapping[str, str] = field(default_factory=dict)
    # Checksum of the image that is subtracted from the frames of each camera; empty without any
    background: Mapping[str, str] = field(default_factory=dict)
    algorithm: int = 0  # Version of the measurement, raised when its values change
    # What was learned from sample frames of the whole record: beads, spectra, noise
    record: Mapping[str, Any] = field(default_factory=dict)
    # Versions of this program and of what it rests on
    software: Mapping[str, str] = field(default_factory=lambda: _software())

    def to_json(self) -> str:
        """The recipe as text for a store's attributes."""
        return json.dumps(asdict(self), sort_keys=True)

    @property
    def hash(self) -> str:
        """Sixteen hexadecimal digits that change whenever values of the cube could."""
        values = {name: value for name, value in asdict(self).items() if name not in _LABELS}
        text = json.dumps(values, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def _software() -> dict[str, str]:
    packages = ("numpy", "scipy", "numba", "opencv-python-headless", "zarr")
    versions = {name: version(name) for name in packages}
    return {"wavefield": __version__, "python": platform.python_version()} | versions


def differences(old: str, new: str) -> list[str]:
    """Entries, other than labels, in which two recipes differ."""
    a, b = dict(_leaves(json.loads(old))), dict(_leaves(json.loads(new)))
    keys = [key for key in {**a, **b} if key.partition(".")[0] not in _LABELS and a.get(key) != b.get(key)]
    return [f"{key}: {a.get(key)!r} there, {b.get(key)!r} here" for key in keys]


def _leaves(data: object, prefix: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, data


def _hash_of(recipe: str) -> str:
    """Hash of a recipe that is given as text; empty for one of another version of this program."""
    try:
        return Recipe(**json.loads(recipe)).hash
    except (TypeError, ValueError):
        return ""


def source_of(cube: Any) -> str:
    """Identity of a cube, a Dataset or an open store, by its recipe and its images: what is made from it
    carries this as its source. A Dataset that no run wrote is identified by its axes and name.
    """
    if "recipe_hash" in cube.attrs:
        return identity_of(cube.attrs["recipe_hash"], cube.attrs.get("fingerprints"))
    axes = {name: cube[name].values.tolist() for name in ("time", "y", "x") if name in cube.coords}
    return identity_of(cube.attrs.get("experiment"), axes)


def state_of(cube: Any) -> str:
    """Identity of a cube and of the steps that it holds by now; as `source_of` where no run wrote it."""
    if "recipe_hash" not in cube.attrs or "frame_status" not in cube:
        return source_of(cube)
    ledger = np.asarray(cube["frame_status"][...], np.uint8).tobytes().hex()
    return identity_of(source_of(cube), cube.attrs.get("frame_rate"), ledger)


def check_recipe(path: Path, attributes: Mapping[str, Any], recipe: Recipe) -> None:
    """Refuse to go on with a store that was made with another recipe."""
    there = str(attributes["recipe"])
    if _hash_of(there) == recipe.hash:
        return
    found = differences(there, recipe.to_json())
    more = f" and {len(found) - 2} more" if len(found) > 2 else ""
    raise StoreError(
        f"{path} was made with another recipe ({'; '.join(found[:2])}{more}); write to another store with -o"
    )
