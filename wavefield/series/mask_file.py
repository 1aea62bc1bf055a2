"""Write drawn polygons into an experiment file without changing its other text."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import yaml

from wavefield.atomic_write import atomic
from wavefield.config_files import make, read_yaml
from wavefield.errors import ExperimentError
from wavefield.series.experiment import Experiment
from wavefield.series.masks import WATER, MaskSection, normalized

WATER_DIGITS, IMAGE_DIGITS = 4, 1  # of a corner's coordinates: 0.1 mm, 0.1 px


def add_polygons(experiment: Experiment, polygons: Mapping[str, Sequence[tuple[float, float]]]) -> None:
    """Write polygons, by camera (px) or on the water (m), into the experiment's file, after its masks."""
    path = experiment.path
    for name, corners in polygons.items():
        make(MaskSection, {"polygon": [list(c) for c in corners]}, name=f"mask of {name}")
    masks = cast(dict[str, Any], normalized(read_yaml(path).get("mask") or {}, experiment.cameras))
    for name, corners in polygons.items():
        digits = WATER_DIGITS if name == WATER else IMAGE_DIGITS
        rounded = [[round(float(x), digits), round(float(y), digits)] for x, y in corners]
        masks[name] = [*masks.get(name, ()), {"polygon": rounded}]
    block = yaml.safe_dump({"mask": masks}, default_flow_style=None, sort_keys=False, width=140)
    text = path.read_text(encoding="utf-8")
    start, stop = _place_of_masks(text)
    line_break = "" if not start or text[start - 1] == "\n" else "\n"
    with atomic(path, replace=True) as draft:
        draft.write_text(text[:start] + line_break + block + text[stop:], encoding="utf-8")
        try:
            Experiment.load(draft)
        except ExperimentError as error:
            raise ExperimentError(str(error).replace(str(draft), str(path))) from None


def _place_of_masks(text: str) -> tuple[int, int]:
    """Start and end of the masks in an experiment file; without any, the end of the text twice."""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(node, yaml.MappingNode)
    for key, value in node.value:
        if key.value == "mask":
            stop = text.find("\n", _end(value))
            return key.start_mark.index, len(text) if stop < 0 else stop + 1
    return len(text), len(text)


def _end(node: yaml.Node) -> int:
    """End of a node's own text: the mark of a block is after the comments that follow it."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(node, yaml.MappingNode) else last)
    return int(node.end_mark.index)
