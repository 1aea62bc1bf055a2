"""Fill the tables of the reference pages from the package itself: `python docs/make_tables.py`."""

import ast
import dataclasses
import importlib
import inspect
import re
import tomllib
import types
from enum import Enum
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from wavefield.variables import CUBE_FIELDS, GROUPS, TABLE, FrameStatus, Quality, Variable, rows_of

ROOT = Path(__file__).parents[1]
PAGES = (
    ROOT / "CONTRIBUTING.md",
    ROOT / "packaging" / "recipe.yaml",
    *(
        ROOT / "docs" / f"{name}.md"
        for name in ("experiment-file", "images", "cube", "waves", "workflows-and-catalogs")
    ),
)

INTERVAL = re.compile("^(low|high|dof)_")  # names of variables that the page explains once

QUALITY = {
    Quality.MEASURED: "found by matching on its own",
    Quality.FILLED: "interpolated from its neighbours",
    Quality.OUTSIDE: "outside the field seen by the cameras",
    Quality.REJECTED_CORRELATION: "the images do not look alike there",
    Quality.REJECTED_EPS: "sight lines miss one another",
    Quality.REJECTED_NEIGHBOURS: "far from its neighbours",
    Quality.REJECTED_RANGE: "beyond the range that was searched, or waves far above the sampled ones",
    Quality.TWO_FRAME_MEAN: "z at mid-time, or a camera's path there, from fewer than four frames",
    Quality.FEWER_CAMERAS: "a camera's frame is missing, or contradicts the others there: they did the work",
    Quality.MASKED: "covered: not water, or hidden from the cameras by what is not",
    Quality.WITHOUT_1: "of fewer cameras: without the first of the cube's `cameras`",
    Quality.WITHOUT_2: "without the second",
    Quality.WITHOUT_3: "without the third",
    Quality.WITHOUT_4: "without the fourth",
    Quality.WITHOUT_5: "without the fifth",
    Quality.WITHOUT_6: "without the sixth, or one behind it",
}
STATUS = {
    FrameStatus.NOT_STARTED: "not yet measured",
    FrameStatus.DONE: "measured",
    FrameStatus.DONE_WITH_FAULTS: "measured, without a frame or with too few nodes",
    FrameStatus.FAILED: "could not be measured; NaN",
    FrameStatus.DISCONTINUOUS: "over a lost, doubled or late frame, or beside it; NaN",
}


def rows_to_table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cube() -> str:
    """Variables of a cube."""
    importlib.import_module("wavefield.store.layout")  # registers the ledger's variables
    names = (
        "time",
        "y",
        "x",
        *CUBE_FIELDS,
        "path_frames",
        "z_level_std",
        "frame_status",
        "frame",
        "camera",
        "frame_fault",
        "camera_shift",
        "gain/direction",
        "k",
        *(f"gain/gain_{name}" for name in "zuvw"),
    )
    rows = []
    for v in (TABLE[name] for name in names):
        meaning = v.long_name + (f"; {v.meaning}" if v.meaning else "")
        rows.append((f"`{v.name}`", ", ".join(v.dims), v.units, v.dtype, meaning))
    return rows_to_table(("variable", "dims", "units", "type", "meaning"), rows)


def frames() -> str:
    """Variables of the frames of an experiment."""
    rows = [
        (
            f"`{v.name}`",
            ", ".join(v.dims),
            v.units,
            "as the file" if v.name == "image" else v.dtype,
            v.long_name,
        )
        for v in rows_of("frames")
    ]
    return rows_to_table(("variable", "dims", "units", "type", "meaning"), rows)


def pairs() -> str:
    """Variables of the group of camera pairs."""
    importlib.import_module("wavefield.store.camera_pairs")  # registers them
    rows = [
        (
            f"`{v.name}`",
            ", ".join(v.dims),
            v.units or "as the error's",
            v.dtype,
            v.long_name + (f"; {v.meaning}" if v.meaning else ""),
        )
        for v in rows_of("pair_statistics")
    ]
    return rows_to_table(("variable", "dims", "units", "type", "meaning"), rows)


def flags(meanings: dict, name: str) -> str:
    """Values of an enumeration."""

    def value(member: Enum) -> str:
        return str(int(member.value))

    return rows_to_table(
        (name, "name", "meaning"), [(value(m), f"`{m.name.lower()}`", t) for m, t in meanings.items()]
    )


def _line(name: str, rows: list[Variable]) -> tuple[str, ...]:
    # what the variables of a family have in common
    texts = [row.long_name.split() for row in rows]
    shared = [column[0] for column in takewhile(lambda column: len(set(column)) == 1, zip(*texts))]
    words = " ".join(shared).removesuffix(" of").removesuffix(" from").removesuffix(" with").rstrip(":")
    notes = [row.meaning for row in rows if row.meaning][:1]
    units = {row.units or "-" for row in rows}
    dims = ", ".join(rows[0].dims) or "-"
    return f"`{name}`", dims, units.pop() if len(units) == 1 else "as the field's", "; ".join([words, *notes])


def waves() -> str:
    """Groups of a wave store."""
    parts = []
    for group, words in GROUPS.items():
        families: dict[str, list[Variable]] = {}
        for row in rows_of(group):
            families.setdefault(row.family or row.name, []).append(row)
        lines = [
            _line(name, rows)
            for name, rows in families.items()
            if not INTERVAL.search(name) and "standard uncertainty" not in rows[0].long_name
        ]
        table = rows_to_table(("variable", "dims", "units", "meaning"), lines)
        parts.append(f"## `/{group}`\n\n{words}\n\n{table}\n")
    return "\n".join(parts)


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The sections that a value may be: models within an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _type(annotation: Any) -> str:
    """An annotation in words."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type(parts[0])
    if origin is Literal:
        return " or ".join(f"`{part}`" for part in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type(part) for part in parts if part is not type(None)))
    if origin is dict:
        return f"one {_type(parts[1])} per name" if parts[1] is not Any else "mapping"
    if origin in (list, tuple):
        return "list"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "section"
    return {str: "text", int: "whole number", float: "number", bool: "true or false"}.get(annotation, "text")


def _default(value: object) -> str:
    if isinstance(value, BaseModel) or value in (None, "", {}, [], ()):
        return "-"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def keys(model: type[BaseModel], prefix: str = "") -> list[tuple[str, str, str, str]]:
    """Rows (key, type, default, meaning) of every key of a section and of those within it."""
    rows = []
    for name, field in model.model_fields.items():
        per_name = get_origin(field.annotation) is dict or any(
            get_origin(part) is dict for part in get_args(field.annotation)
        )
        key = f"{prefix}{name}"
        example = f"e.g. `{field.examples[0].strip(chr(34))}`" if field.examples else ""
        inner = _models(field.annotation)
        first = inner[0].__doc__.strip().splitlines()[0].rstrip(".") if inner else ""
        meaning = "; ".join(text for text in (field.description or first, example) if text)
        default = "needed" if field.is_required() else _default(field.get_default(call_default_factory=True))
        rows.append((f"`{key}`", _type(field.annotation), default, meaning.replace("|", "or")))
        for section in inner:
            rows += keys(section, f"{key}.NAME." if per_name else f"{key}.")
    return rows


def settings(kind: type, prefix: str = "") -> list[tuple[str, str, str, str]]:
    """Rows of the fields of a settings class, with their meanings from its docstring."""
    text = inspect.getdoc(kind).split("Parameters\n----------\n")[1].split("\n\n")[0]
    meanings: dict[str, str] = {}
    for entry in re.split(r"\n(?=\w)", text):
        names, _, rest = entry.partition(" : ")
        declared, *words = rest.splitlines()
        for name in names.split(", "):
            meanings[name] = f"{declared}\0{' '.join(word.strip() for word in words)}"
    rows = []
    for field in dataclasses.fields(kind):
        if field.name in ("stereo", "piv"):
            continue
        declared, meaning = meanings[field.name].split("\0")
        needed = field.default is dataclasses.MISSING
        default = "needed" if needed else _default(field.default)
        rows.append((f"`{prefix}{field.name}`", declared, default, meaning))
    return rows


def key_table(rows: list[tuple[str, str, str, str]]) -> str:
    """A table of keys."""
    return rows_to_table(("key", "type", "default", "meaning"), rows)


def settings_table() -> str:
    """Settings of the measurement, and of each of its two matchings with both defaults."""
    from wavefield.matching import MatchSettings
    from wavefield.measurement import Settings

    both = Settings()
    rows = settings(Settings)
    for key, kind, _, meaning in settings(MatchSettings):
        name = key.strip("`")
        defaults = (_default(getattr(one, name)) for one in (both.stereo, both.piv))
        default = " / ".join(dict.fromkeys(defaults))
        rows.append((f"`stereo.{name}`, `piv.{name}`", kind, default, meaning))
    return key_table(rows)


def experiment() -> str:
    """Keys of an experiment file."""
    from wavefield.series.experiment import Experiment

    return key_table(keys(Experiment))


def workflow() -> str:
    """Keys of a workflow file."""
    from wavefield.execution.workflow import Workflow

    return key_table(keys(Workflow))


def target() -> str:
    """Keys of a calibration target."""
    from wavefield.calibration import Target

    return key_table(settings(Target))


def rooms() -> str:
    """Floors of the package with what each room holds, from the import contract and the rooms' docstrings."""
    package = ROOT / "wavefield"
    contract = (ROOT / ".importlinter").read_text(encoding="utf-8")
    layers = re.search(r"layers =\n((?:    .*\n)+)", contract)[1].split("\n")
    floors = [re.findall(r"\w+", line) for line in layers if line.strip() and "__main__" not in line]
    rows = []
    for number, names in zip(range(len(floors), 0, -1), floors):
        small = []
        for name in names:
            path = package / name / "__init__.py"
            if path.exists():
                first = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).splitlines()[0]
                rows.append((str(number), f"`{name}/`", first))
            else:
                small.append(f"`{name}.py`")
        if small:
            rows.append((str(number), "single files", ", ".join(small)))
    return rows_to_table(("floor", "room", "holds"), rows)


def dependencies() -> str:
    """Dependencies of the package by their names on conda-forge."""
    other = {"opencv-python-headless": "py-opencv", "dask": "dask-core", "matplotlib": "matplotlib-base"}
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    needs = [re.match(r"([\w-]+)[^>]*(>=.+)", need).groups() for need in config["project"]["dependencies"]]
    return "\n".join(f"    - {other.get(name, name)} {bound}" for name, bound in needs)


TABLES = {
    "dependencies": dependencies,
    "rooms": rooms,
    "experiment": experiment,
    "settings": settings_table,
    "workflow": workflow,
    "target": target,
    "frames": frames,
    "cube": cube,
    "pairs": pairs,
    "quality": lambda: flags(QUALITY, "bit"),
    "status": lambda: flags(STATUS, "value"),
    "waves": waves,
}


def filled(page: str) -> str:
    """The page with every table made anew."""
    for name, make in TABLES.items():
        pattern = re.compile(rf"(<!-- table: {name} -->\n).*?((?: *# )?<!-- end -->)", re.S)
        page = pattern.sub(lambda place, make=make: f"{place[1]}{make()}\n{place[2]}", page)
    return page


if __name__ == "__main__":
    for path in PAGES:
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")
