"""Polygons that were drawn, written into an experiment file; all else in it stays as it was typed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from wavefield.atomic_write import ANY_FILE, atomic
from wavefield.config_files import make, read_yaml
from wavefield.errors import ExperimentError
from wavefield.series.experiment import Experiment
from wavefield.series.masks import MaskSection, normalized

Point = tuple[float, float]


def add_polygons(experiment: Experiment, polygons: Mapping[str, Sequence[Point]]) -> None:
    """Write polygons into the experiment's file, beside the masks that it has.

    With polygons (float, float).
    """
    path = experiment.path
    for name, corners in polygons.items():
        make(MaskSection, {"polygon": [list(c) for c in corners]}, name=f"mask of {name}")
    written = read_yaml(path).get("mask") or {}
    data: dict[str, Any] = normalized(written, experiment.cameras)
    for name, corners in polygons.items():
        digits = 4 if name == "water" else 1
        corner = [[round(float(x), digits), round(float(y), digits)] for x, y in corners]
        data[name] = [*data.get(name, ()), {"polygon": corner}]
    block = yaml.safe_dump({"mask": data}, default_flow_style=None, sort_keys=False, width=140)
    text = path.read_text(encoding="utf-8")
    start, stop = _place(text)
    text = text[:start] + ("" if not start or text[start - 1] == "\n" else "\n") + block + text[stop:]
    with atomic(path, ANY_FILE) as draft:
        draft.write_text(text, encoding="utf-8")
        _still_an_experiment(draft, path)


def _still_an_experiment(draft: Path, path: Path) -> None:
    try:
        Experiment.load(draft)
    except ExperimentError as error:
        raise ExperimentError(str(error).replace(str(draft), str(path))) from None


def _place(text: str) -> tuple[int, int]:
    """Where the mask of an experiment file stands, from its key to the line after it; else the end, twice."""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(node, yaml.MappingNode)
    for key, value in node.value:
        if key.value == "mask":
            stop = text.find("\n", _last(value))
            return key.start_mark.index, len(text) if stop < 0 else stop + 1
    return len(text), len(text)


def _last(node: yaml.Node) -> int:
    """Where a node's own text ends: a block's mark lies behind the comments that follow it."""
    if isinstance(node, yaml.MappingNode) and not node.flow_style and node.value:
        return _last(node.value[-1][1])
    if isinstance(node, yaml.SequenceNode) and not node.flow_style and node.value:
        return _last(node.value[-1])
    return int(node.end_mark.index)
