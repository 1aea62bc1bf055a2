"""Fill the tables of the reference pages from the package itself: `python docs/make_tables.py`."""

import ast
import dataclasses
import inspect
import re
import tomllib
import types
from enum import Enum
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from wavefield.series.masks import MaskSection
from wavefield.variables import CUBE_DIMS, GROUPS, TABLE, FrameStatus, Quality, Variable, rows_of

ROOT = Path(__file__).parents[1]
PAGES = (
    ROOT / "CONTRIBUTING.md",
    ROOT / "packaging" / "recipe.yaml",
    *(
        ROOT / "docs" / f"{name}.md"
        for name in ("experiment-file", "cube", "waves", "workflows-and-catalogs")
    ),
)

INTERVAL = re.compile("^(low|high|dof)(_|$)")  # names of variables that the page explains once

QUALITY = {
    Quality.MEASURED: "measured by matching",
    Quality.FILLED: "interpolated from its neighbours",
    Quality.OUTSIDE: "outside the cameras' view",
    Quality.REJECTED_CORRELATION: "low correlation between images",
    Quality.REJECTED_EPS: "large epipolar error",
    Quality.REJECTED_NEIGHBOURS: "outlier among its neighbours",
    Quality.REJECTED_RANGE: "outside the search range, or waves far higher than the learned spectrum",
    Quality.TWO_FRAME_MEAN: "z or the velocity comes from fewer than four frames",
    Quality.FEWER_CAMERAS: "one or more cameras left out",
    Quality.MASKED: "masked, or hidden behind a mask",
    Quality.WITHOUT_1: "first camera in `cameras` left out; the next four bits: second to fifth camera",
    Quality.WITHOUT_6: "sixth or a later camera left out",
}
STATUS = {
    FrameStatus.NOT_STARTED: "not yet measured",
    FrameStatus.DONE: "measured",
    FrameStatus.DONE_WITH_FAULTS: "measured, but a camera's frame is missing or few nodes are valid",
    FrameStatus.FAILED: "could not be measured; NaN",
    FrameStatus.DISCONTINUOUS: "at or near a lost, repeated or late frame; NaN",
}


def rows_to_table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    first, *lines = ("|" + "|".join(line) + "|" for line in (head, *rows))
    return "\n".join([first, "|---" * len(head) + "|", *lines])


def _line(rows: list[Variable], name: str = "", usual: tuple[str, ...] = ()) -> tuple[str, str, str]:
    """Name with dimensions (left out if usual), units, and meaning of variables that share a line."""
    names = f"`{name}`" if name else ", ".join(f"`{row.name}`" for row in rows)
    shapes = dict.fromkeys(", ".join(row.dims) for row in rows if row.dims != usual)
    dims = f" ({'; '.join(shapes)})" if any(shapes) else ""
    texts = [row.long_name.split() for row in rows]
    shared = [column[0] for column in takewhile(lambda column: len(set(column)) == 1, zip(*texts))]
    words = " ".join(shared) or ", ".join(dict.fromkeys(row.long_name for row in rows))
    if len(rows) > 1:
        words = re.sub("( of| from| with| along)?( the)?:?$", "", words)
    notes = [row.meaning for row in rows if row.meaning][:1]
    units = {row.units for row in rows}
    unit = units.pop() if len(units) == 1 else ""
    return names + dims, "" if unit == "1" else unit, "; ".join(text for text in (words, *notes) if text)


def cube() -> str:
    """Variables of a cube."""
    lines = (
        *(
            ("z",),
            ("z_t",),
            ("u", "v", "w"),
            ("eps_y",),
            ("eps_piv",),
            ("z_std",),
            ("u_std", "v_std", "w_std"),
        ),
        *(("quality",), ("path_frames",), ("z_level_std",), ("frame_status",), ("frame_fault",)),
        tuple(f"gain/gain_{name}" for name in "zuvw"),
    )
    rows = [_line([TABLE[name] for name in names], usual=CUBE_DIMS) for names in lines]
    lines = [(name, meaning + (unit and f" ({unit})")) for name, unit, meaning in rows]
    return rows_to_table(("variable", "meaning (units)"), lines)


def flags(meanings: dict, name: str) -> str:
    """Values of an enumeration."""

    def value(member: Enum) -> str:
        return str(int(member.value))

    return rows_to_table(
        (name, "name", "meaning"), [(value(m), f"`{m.name.lower()}`", t) for m, t in meanings.items()]
    )


def waves() -> str:
    """Groups of a wave store, with the variables that need more than their long names."""
    parts = []
    for group, words in GROUPS.items():
        families: dict[str, list[Variable]] = {}
        for row in rows_of(group):
            families.setdefault(row.family or row.name, []).append(row)
        lines = []
        for name, rows in families.items():
            if INTERVAL.search(name) or "standard uncertainty" in rows[0].long_name:
                continue  # the page explains them once
            if any(row.meaning for row in rows) or (group == "spectra" and not name.startswith("valid")):
                variable, unit, meaning = _line(rows, name)
                lines.append((variable, meaning + (unit and f" ({unit})")))
        table = rows_to_table(("variable", "meaning (units)"), lines) + "\n" if lines else ""
        parts.append(f"## `/{group}`\n\n{words}\n\n{table}")
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
    return {str: "text", int: "integer", float: "number", bool: "true or false"}.get(annotation, "text")


def _default(value: object) -> str:
    if isinstance(value, BaseModel) or value in (None, "", {}, [], ()):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


Row = tuple[str, str, str]
PER_CAMERA = "text or one text per name"


def _value(kind: str, needed: bool, default: object) -> str:
    """Choices and default of a key: "needed", "`0.5`". Other types follow from its meaning."""
    shown = "needed" if needed else _default(default)
    choices = "also one per camera" if kind == PER_CAMERA else kind if kind[0] in "`{" else ""
    return ", ".join(part for part in (choices, shown) if part)


def keys(model: type[BaseModel], prefix: str = "", shown: str = "") -> list[Row]:
    """Rows (key, value, meaning) of every key of a section and of those within it.

    Keys with the same value and meaning share a row. No example is given of a key that an example `shown`
    already contains, nor of a number.
    """
    rows: list[Row] = []
    for name, field in model.model_fields.items():
        per_name = get_origin(field.annotation) is dict or any(
            get_origin(part) is dict for part in get_args(field.annotation)
        )
        key = f"{prefix}{name}"
        example = field.examples[0].strip(chr(34)) if field.examples else ""
        inner = [section for section in _models(field.annotation) if section is not MaskSection]
        if (
            len(inner) == 1 and len(inner[0].model_fields) == 1
        ):  # a section of one key is described by that key
            words = inner[0].__doc__.strip().splitlines()[0].rstrip(".")
            [(first, value, more)] = keys(inner[0], f"{key}.")
            rows.append((first, value, "; ".join(text for text in (words, more) if text)))
            continue
        first = inner[0].__doc__.strip().splitlines()[0].rstrip(".") if inner else ""
        plain = name in shown or re.fullmatch(r"[\d.]+", example) or example == field.default
        texts = (field.description or first, "" if plain or not example else f"`{example}`")
        meaning = "; ".join(text for text in texts if text).replace("|", "or")
        default = None if field.is_required() else field.get_default(call_default_factory=True)
        row = (f"`{key}`", _value(_type(field.annotation), field.is_required(), default), meaning)
        if rows and rows[-1][1:] == row[1:]:
            rows[-1] = (f"{rows[-1][0]}, {row[0]}", *row[1:])
        elif not inner or "`" in row[1]:  # the keys of a section say what it is
            rows.append(row)
        for section in inner:
            rows += keys(section, f"{key}.NAME." if per_name else f"{key}.", shown + example)
    return rows


def settings(kind: type, *presets: object) -> list[Row]:
    """Rows of the fields of a settings class, with their meanings from its docstring.

    Defaults are those of the class, or of the presets, one after the other.
    """
    text = inspect.getdoc(kind).split("Parameters\n----------\n")[1].split("\n\n")[0]
    meanings: dict[str, tuple[str, str]] = {}
    for entry in re.split(r"\n(?=\w)", text):
        names, _, rest = entry.partition(" : ")
        declared, *words = rest.splitlines()
        for name in names.split(", "):
            declared = re.sub(", optional| or None", "", declared)
            meanings[name] = declared, " ".join(word.strip() for word in words)
    rows: list[Row] = []
    for field in dataclasses.fields(kind):
        if field.name in ("stereo", "piv"):
            continue
        declared, meaning = meanings[field.name]
        value = _value(declared, field.default is dataclasses.MISSING, field.default)
        if presets:
            defaults = (_default(getattr(one, field.name)) for one in presets)
            value = " and ".join(dict.fromkeys(defaults))
        rows.append((f"`{field.name}`", value, meaning))
    return rows


def key_table(rows: list[Row]) -> str:
    """A table of keys, with choices and default in brackets."""
    lines = [(f"{key} ({value})" if value else key, meaning) for key, value, meaning in rows]
    return rows_to_table(("key", "meaning"), lines)


def settings_table() -> str:
    """Settings of the measurement."""
    from wavefield.measurement import Settings

    return key_table(settings(Settings))


def matching_table() -> str:
    """Settings of both matchings, with both defaults."""
    from wavefield.matching import MatchSettings
    from wavefield.measurement import Settings

    return key_table(settings(MatchSettings, Settings().stereo, Settings().piv))


def experiment() -> str:
    """Keys of an experiment file."""
    from wavefield.series.experiment import Experiment

    page = (ROOT / "docs" / "experiment-file.md").read_text(encoding="utf-8")
    return key_table(keys(Experiment, shown=page.partition("## Keys")[0]))


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
    return rows_to_table(("floor", "room", "content"), rows)


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
    "matching": matching_table,
    "workflow": workflow,
    "target": target,
    "cube": cube,
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
