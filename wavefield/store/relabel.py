"""Labels of a cube: changing them costs no measurement.

Name, clock (number of the first frame, frame rate), depth of the water and places of files are labels: the
values of a cube follow from its images alone, in metres and metres per frame. Velocities are stored at the
frame rate they were measured with, ``measured_frame_rate``; another rate is a ``scale_factor`` of theirs,
as CF has it.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from wavefield.atomic_write import writing
from wavefield.store.layout import PACKING
from wavefield.store.metadata import update_metadata
from wavefield.store.read import measured_rate, open_group
from wavefield.store.recipe import Recipe, differences
from wavefield.variables import CUBE_FIELDS, TABLE

RATES = tuple(name for name in CUBE_FIELDS if TABLE[name].units == "m s-1")
# attributes that the description of an experiment gives a cube
_OURS = ("experiment_file", "image_folder", "water_depth", "surface_tension_over_density", "description")


def relabel(path: Path, recipe: Recipe, attributes: Mapping[str, object]) -> list[str]:
    """Give a cube the labels of another description of the same images; returns what differed.
    After being cut off anywhere, the same call does all of it again.
    """
    group = open_group(path)
    before = str(group.attrs["recipe"])
    recipe = replace(recipe, software=json.loads(before)["software"])  # of those who measured
    changed = differences(before, recipe.to_json())
    old = {name: group.attrs.get(name) for name in _OURS}
    new = {name: attributes.get(name) for name in _OURS}
    changed += [
        f"{name}: {old[name]!r} there, {new[name]!r} here" for name in _OURS if old[name] != new[name]
    ]
    if changed:
        _write(path, recipe, new)
    return changed


def _write(path: Path, recipe: Recipe, labels: Mapping[str, object]) -> None:
    """Write labels: the values of frames and times first, all metadata last."""
    group = open_group(path, "r+")
    measured = measured_rate(group)
    factor = recipe.frame_rate / measured
    arrays: dict[str, dict[str, object]] = {}
    for name in RATES:
        scale = PACKING[name] * factor if group[name].dtype == np.int16 else factor
        arrays[name] = {"scale_factor": None if scale == 1.0 else scale}
    frames = recipe.frames[0] + np.arange(group["frame"].shape[0])
    with writing(path):
        group["frame"][:] = frames
        group["time"][:] = (frames[:-1] + 0.5) / recipe.frame_rate
    described = {
        "measured_frame_rate": measured,
        "title": f"water surface and its velocity, {recipe.experiment}",
        "experiment": recipe.experiment,
        "frame_rate": recipe.frame_rate,
        "recipe": recipe.to_json(),
        "recipe_hash": recipe.hash,
    }
    update_metadata(path, {**labels, **described}, arrays)
