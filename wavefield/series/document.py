"""YAML files written by hand: errors that name the file, the line and the remedy."""

import difflib
import types
import typing
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from wavefield.errors import ExperimentError

Key = str | int


class Section(BaseModel):
    """A block of a YAML file: refuses keys that it does not know and suggests the one that was meant."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for key in data:
                if key not in cls.model_fields:
                    raise PydanticCustomError(
                        "unknown_key",
                        "is not a known key; {remedy}",
                        {"key": key, "remedy": _meant(key, cls)},
                    )
        return data


def _meant(key: Any, model: type[BaseModel]) -> str:
    close = difflib.get_close_matches(str(key), model.model_fields, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"known keys here: {', '.join(model.model_fields)}"


S = TypeVar("S", bound=Section)


def load_section(model: type[S], path: Path, data: dict[str, Any] | None = None) -> S:
    """Read and validate a YAML file.

    Parameters
    ----------
    model : subclass of Section
        What the file must hold.
    path : path
        The file.
    data : dict, optional
        Its content, if it was read (and perhaps changed) already.

    Returns
    -------
    instance of model

    Raises
    ------
    ExperimentError
        If the file is missing, is not YAML, or does not hold what it must; the message names the line.
    """
    node = _compose(path)
    if data is None:
        data = read_yaml(path)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = [_sentence(problem, path, node, model) for problem in error.errors()]
    raise ExperimentError("; ".join(dict.fromkeys(problems)))


def read_yaml(path: Path) -> dict[str, Any]:
    """Content of a YAML file that holds a mapping.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    dict

    Raises
    ------
    ExperimentError
        If the file is missing, is not YAML, has a key twice, or is not a mapping.
    """
    node = _compose(path)
    if not isinstance(node, yaml.MappingNode):
        raise ExperimentError(f"{path} is not a list of `key: value` lines; see the example in the README")
    for first, second in _twice(node):
        raise ExperimentError(
            f"{path}, line {second.start_mark.line + 1}: {second.value!r} is there twice "
            f"(first on line {first.start_mark.line + 1}); remove one"
        )
    return yaml.safe_load(path.read_text())


def _compose(path: Path) -> yaml.Node | None:
    try:
        return yaml.compose(path.read_text(), Loader=yaml.SafeLoader)
    except FileNotFoundError:
        raise ExperimentError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ExperimentError(f"{path} is a folder; name the YAML file in it") from None
    except UnicodeDecodeError:
        raise ExperimentError(f"{path} is not a text file") from None
    except OSError as error:
        raise ExperimentError(f"{path} cannot be read: {error.strerror}") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not YAML"
        raise ExperimentError(f"{path}{where}: {problem}; check indentation, colons and brackets") from None


def _twice(node: yaml.Node) -> Iterator[tuple[yaml.Node, yaml.Node]]:
    if isinstance(node, yaml.MappingNode):
        seen: dict[Any, yaml.Node] = {}
        for key, value in node.value:
            if key.value in seen:
                yield seen[key.value], key
            seen[key.value] = key
            yield from _twice(value)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            yield from _twice(value)


def _line(node: yaml.Node | None, location: Sequence[Key]) -> int | None:
    """Line (from 1) of the deepest part of a location that the file has."""
    line = None
    for step in location:
        found = None
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if key.value == str(step):
                    found, line = value, key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            found = node.value[step]
            line = found.start_mark.line + 1
        if found is None:  # a name that pydantic adds for a member of a union
            continue
        node = found
    return line


def place_of(path: Path, location: Sequence[Key]) -> str:
    """File and line of a value, for a message.

    Parameters
    ----------
    path : path
        YAML.
    location : sequence of str or int
        Keys that lead to it.

    Returns
    -------
    str
        Such as "experiment.yaml, line 3".
    """
    line = _line(_compose(path), location)
    return f"{path}, line {line}" if line else str(path)


def _sentence(problem: Any, path: Path, node: yaml.Node | None, model: type[BaseModel]) -> str:
    location = list(problem["loc"])
    context = problem.get("ctx", {})
    if "key" in context:
        location.append(context["key"])
    names = [str(step) for step in location if not _is_branch(step)]
    line = _line(node, location)
    where = f"{path}, line {line}" if line else str(path)
    what = ".".join(names)
    kind, message = problem["type"], problem["msg"]
    if kind == "missing":
        message = "is missing"
    elif kind == "value_error":
        message = message.removeprefix("Value error, ")
        return f"{where}: {what + ': ' if what else ''}{message}"
    elif kind != "unknown_key":
        value = problem.get("input")
        message = message.replace("Input should", "should") + (f", not {value!r}" if _short(value) else "")
    example = _example(model, names)
    return f"{where}: {what} {message}" + (f" (for example {names[-1]}: {example})" if example else "")


def _short(value: Any) -> bool:
    return value is not None and len(repr(value)) < 60


def _is_branch(step: Key) -> bool:
    # pydantic names the members of a union in locations: "str", "GridSection", "list[...]"
    return isinstance(step, str) and (
        step in ("str", "float", "int") or "[" in step or step.endswith("Section")
    )


def _example(model: Any, names: Sequence[str]) -> str | None:
    """Example of the field at a location, from the model."""
    example = None
    for name in names:
        members = [m for m in _members(model) if isinstance(m, type) and issubclass(m, BaseModel)]
        fields = {key: f for m in members for key, f in m.model_fields.items()}
        if name in fields:
            found = fields[name]
            example = found.examples[0] if found.examples else None
            model = found.annotation
        else:  # the key of a mapping such as cameras
            values = [typing.get_args(m)[-1] for m in _members(model) if typing.get_origin(m) is dict]
            model, example = (values[0], None) if values else (None, None)
    return example


def _members(annotation: Any) -> Sequence[Any]:
    if typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return typing.get_args(annotation)
    return (annotation,)
