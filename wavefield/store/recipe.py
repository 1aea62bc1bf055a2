"""The recipe of a cube: everything that determines its values; a run continues a cube of the same recipe."""

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
    """Return the recipe (all inputs) from the attributes of a cube, as plain data; empty if there is none."""
    try:
        return dict(json.loads(attributes["recipe"]))
    except (KeyError, TypeError, ValueError):
        return {}


# entries that are not part of the hash: the learned record follows from the others, and no value depends on
# the name; the version of the algorithm counts, not that of the software
_LABELS = ("experiment", "record", "software")


@dataclass(frozen=True)
class Recipe:
    """Everything that a cube was made from (images, rig, grid, settings, versions), as plain data."""

    experiment: str  # Name of the experiment
    # By camera: images as the experiment file names them, offset of the frame numbers, file of time stamps
    images: Mapping[str, Any]
    frames: tuple[int, int]  # First and last frame number
    frame_rate: float  # Hz
    grid: Mapping[str, Any]  # Limits and step, m
    rig: Mapping[str, Any]  # Cameras by name (`Camera.to_dict`)
    settings: Mapping[str, Any]  # Settings of the measurement
    packing: str = "float32"  # Type of stored values: "float32" or "int16"
    # Masked areas (`masks.as_data`); empty without masks
    mask: Mapping[str, Any] = field(default_factory=dict)
    # Checksum of the delays of the frames relative to even times; empty if the times are even
    departures: Mapping[str, str] = field(default_factory=dict)
    # By camera: checksum of the background that is subtracted from its frames; empty without backgrounds
    background: Mapping[str, str] = field(default_factory=dict)
    algorithm: int = 0  # Version of the measurement, raised when its values change
    # What was learned from sample frames of the whole record: beads, spectra, noise
    record: Mapping[str, Any] = field(default_factory=dict)
    # Versions of wavefield and of the libraries that it uses
    software: Mapping[str, str] = field(default_factory=lambda: _software())

    def to_json(self) -> str:
        """Return the recipe as JSON text, for the attributes of a cube."""
        return json.dumps(asdict(self), sort_keys=True)

    @property
    def hash(self) -> str:
        """A hash (sixteen hexadecimal digits) of the entries on which the cube's values depend."""
        values = {name: value for name, value in asdict(self).items() if name not in _LABELS}
        text = json.dumps(values, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def _software() -> dict[str, str]:
    """Return the versions of wavefield, Python and the main libraries, by name."""
    packages = ("numpy", "scipy", "numba", "opencv-python-headless", "zarr")
    versions = {name: version(name) for name in packages}
    return {"wavefield": __version__, "python": platform.python_version()} | versions


def differences(old: str, new: str) -> list[str]:
    """Return a line, such as "grid.step: 0.01 there, 0.02 here", for each difference between two recipes.
    `old` ("there") and `new` ("here") are JSON text. Entries on which no value depends are not compared."""
    a, b = dict(_leaves(json.loads(old))), dict(_leaves(json.loads(new)))
    keys = [key for key in {**a, **b} if key.partition(".")[0] not in _LABELS and a.get(key) != b.get(key)]
    return [f"{key}: {a.get(key)!r} there, {b.get(key)!r} here" for key in keys]


def _leaves(data: object, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield the key, such as "grid.step" after `prefix`, and the value of every entry of nested mappings."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, data


def source_of(cube: Any) -> str:
    """Return the identity of a cube (Dataset or open group): a hash of its recipe and of its images.
    For a Dataset without a stored recipe, it is a hash of the axes and of the experiment's name."""
    if "recipe_hash" in cube.attrs:
        return identity_of(cube.attrs["recipe_hash"], cube.attrs.get("fingerprints"))
    axes = {name: cube[name].values.tolist() for name in ("time", "y", "x") if name in cube.coords}
    return identity_of(cube.attrs.get("experiment"), axes)


def state_of(cube: Any) -> str:
    """Return a hash of a cube (Dataset or open group) that changes whenever further steps are measured."""
    if "recipe_hash" not in cube.attrs or "frame_status" not in cube:
        return source_of(cube)
    ledger = np.asarray(cube["frame_status"][...], np.uint8).tobytes().hex()
    return identity_of(source_of(cube), cube.attrs.get("frame_rate"), ledger)


def check_recipe(path: Path, attributes: Mapping[str, Any], recipe: Recipe) -> None:
    """Raise StoreError, which names two differences, if the cube at `path` was made with another recipe."""
    if attributes["recipe_hash"] == recipe.hash:
        return
    found = differences(str(attributes["recipe"]), recipe.to_json())
    more = f" and {len(found) - 2} more" if len(found) > 2 else ""
    raise StoreError(
        f"{path} was made with another recipe ({'; '.join(found[:2])}{more}); write to another store with -o"
    )
