"""Read and check settings that people write by hand; errors name file, line and remedy.

Settings consist of sections. A section is a pydantic model (`ConfigSection`) or a frozen dataclass. `load`
reads one from a YAML file, `make` from plain data that was read already.
"""

import dataclasses
import difflib
import os
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from wavefield.errors import ExperimentError, WavefieldError
from wavefield.file_access import refuse_pipe

Key = str | int
T = TypeVar("T")

_MAX_MESSAGES = 4  # problems of a file
_MAX_NAME = 100  # characters
_BACKSLASH = r"in double quotes \ begins a special character"
_SLASH = "write / between folders, or single quotes"
_KNOWN = "; known keys here: "
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
# configuration of a dataclass that `make` checks: its ``__pydantic_config__``
CHECKED = ConfigDict(extra="forbid", allow_inf_nan=False)

_RESERVED_NAMES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # of devices, on Windows
_NOT_IN_NAMES = re.compile(r"[/\\:*?\"<>|{}\[\]\x00-\x1f]")
MAX_NAME_BYTES = 255  # of a file or folder, on Linux, macOS and Windows


def safe_name(name: str) -> str:
    """Return `name` unchanged; ValueError if it cannot be a file name on Linux, macOS or Windows."""
    odd = _NOT_IN_NAMES.search(name) or _RESERVED_NAMES.fullmatch(name)
    if odd or not name.strip() or name != name.strip() or name.strip(".") == "" or len(name) > _MAX_NAME:
        raise ValueError(f"{name[:40]!r} cannot be part of a file's name; use letters, digits, - and _")
    return name


def portable_path(path: str) -> str:
    r"""Return a path unchanged; ValueError if it cannot be used on Linux, macOS and Windows alike.
    Names of over 255 bytes, control characters and backslashes raise this error, except for backslashes on
    Windows or in a path that exists. A URL, with ://, is not checked."""
    if "://" in path:  # an address, which may contain a password
        return path
    if any(len(part.encode()) > MAX_NAME_BYTES for part in path.split("/")):
        raise ValueError(f"{path[:40]!r}... has a name of more than {MAX_NAME_BYTES} characters; shorten it")
    if any(ord(character) < 32 for character in path):
        raise ValueError(f"{_BACKSLASH}: {path[:60]!r}; {_SLASH}")
    if "\\" in path and os.sep == "/" and not Path(path).exists():
        raise ValueError(f"{path!r} has \\ between folders; write /, which is read on Windows as well")
    return path


Name = Annotated[str, AfterValidator(safe_name)]
PathText = Annotated[str, AfterValidator(portable_path)]


class ConfigSection(BaseModel):
    """Base class of the sections of a settings file; their values cannot be changed after reading.
    Unknown keys, infinity and NaN raise errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, allow_inf_nan=False)


def load(kind: type[T], path: Path, data: Mapping[str, object] | None = None) -> T:
    """Read a YAML file, check its values, and return them as an instance of `kind`, a section's class.
    `data` is the file's content if it was read already. ExperimentError, which names the line and the remedy,
    if the file cannot be read or a value is wrong."""
    return make(kind, read_yaml(path) if data is None else data, path=path)


def make(
    kind: type[T],
    data: Mapping[str, object],
    *,
    path: Path | None = None,
    location: Sequence[Key] = (),
    name: str = "",
    error: type[WavefieldError] = ExperimentError,
) -> T:
    """Check plain data, and return them as an instance of `kind`, a pydantic model or a dataclass.
    Raises `error`, which lists up to four problems, if the data are wrong. The other arguments serve the
    message: `path` is the file that contains the data, under the keys `location`; `name` is what the message
    calls data that are not from a file."""
    try:
        made = TypeAdapter(kind).validate_python(dict(data))
    except WavefieldError as found:  # a section's own sentence
        where = file_and_line(path, location) if path else name
        raise error(f"{where}: {found}" if where else str(found)) from None
    except ValidationError as found:
        node = _compose(path) if path else None
        wrong = found.errors()
        unknown = [p for p in wrong if p["type"] in _UNKNOWN]  # what is missing is there under a wrong name
        wrong = unknown or [p for p in wrong if not _is_other_form(p, wrong)]
    else:
        return made
    problems = dict.fromkeys(_sentence(problem, kind, path, node, location, name) for problem in wrong)
    raise error(_joined(list(problems)))


def _joined(messages: Sequence[tuple[str, str]]) -> str:
    """Return one message that lists up to four pairs (place in the file, description of a problem)."""
    by_place: dict[str, list[str]] = {}
    listed: set[str] = set()
    for where, words in messages[:_MAX_MESSAGES]:
        bare, _, keys = words.partition(_KNOWN)
        by_place.setdefault(where, []).append(bare if keys in listed else words)
        listed |= {keys} - {""}
    sentences = [(f"{where}: " if where else "") + "; ".join(words) for where, words in by_place.items()]
    if len(messages) > _MAX_MESSAGES:
        sentences.append(f"and {len(messages) - _MAX_MESSAGES} more: is it a file of this kind at all?")
    return "; ".join(sentences)


# -- YAML ----------------------------------------------------------------------------------------------------


class _Loader(yaml.SafeLoader):
    """A YAML loader that reads numbers as people write them.

    The texts 1:30, yes, no and dates stay text, and 010 is ten. Aliases (`*name`) raise an error, because a
    few lines with aliases can expand to billions of values.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            words = "aliases (*name) are not read: write the values"
            raise yaml.composer.ComposerError(problem=words, problem_mark=mark)
        return super().compose_node(parent, index)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        text = str(self.construct_scalar(node)).replace("_", "")
        return int(text, 16 if "x" in text else 10)


_Loader.yaml_implicit_resolvers = {
    first: [rule for rule in rules if rule[0].rpartition(":")[2] not in ("bool", "int", "float", "timestamp")]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile("(true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"[-+]?(0x[0-9a-fA-F_]+|[0-9][0-9_]*)$"), list("-+0123456789")
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"[-+]?([0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*|[0-9][0-9_]*(?=[eE]))([eE][-+]?[0-9]+)?$"
        r"|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the content of a YAML file, which must be a mapping.
    ExperimentError if it is not, if the file cannot be read, or if a key is repeated."""
    node = _compose(path)
    if not isinstance(node, yaml.MappingNode):
        raise ExperimentError(f"{path} is not a list of `key: value` lines; see the example in the README")
    for first, second in _twice(node):
        raise ExperimentError(
            f"{path}, line {second.start_mark.line + 1}: {second.value!r} is there twice "
            f"(first on line {first.start_mark.line + 1}); remove one"
        )
    try:
        data: dict[str, Any] = yaml.load(_text(path), Loader=_Loader)
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise _not_yaml(path, error) from None
    return data


def _text(path: Path) -> str:
    """Return the text of a UTF-8 file; ExperimentError if it cannot be read."""
    try:
        refuse_pipe(path, ExperimentError)
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ExperimentError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ExperimentError(f"{path} is a folder; name the YAML file in it") from None
    except UnicodeDecodeError:
        raise ExperimentError(
            f"{path} is not UTF-8 text, but perhaps UTF-16; save it as UTF-8 in your editor"
        ) from None
    except OSError as error:
        raise ExperimentError(f"{path} cannot be read: {error.strerror}") from None


def _compose(path: Path) -> yaml.Node | None:
    """Return the root of a file's tree of YAML nodes, which have line numbers; None if the file is empty.
    ExperimentError if it is not YAML."""
    text = _text(path)
    try:
        return yaml.compose(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise _not_yaml(path, error) from None
    except RecursionError:
        raise ExperimentError(f"{path} is nested too deeply; it is no file of settings") from None


def _not_yaml(path: Path, error: Exception) -> ExperimentError:
    """Return the error to raise for a file that PyYAML could not read; `error` is PyYAML's exception."""
    mark = getattr(error, "problem_mark", None)
    where = f", line {mark.line + 1}" if mark else ""
    problem = getattr(error, "problem", None) or "not YAML"
    if "escape" in problem:
        return ExperimentError(f"{path}{where}: {_BACKSLASH}; {_SLASH}")
    if "special characters" in str(error):
        return ExperimentError(
            f"{path}: it holds characters that are no text: is it UTF-16? save it as UTF-8"
        )
    return ExperimentError(f"{path}{where}: {problem}; check indentation, colons and brackets")


def _twice(node: yaml.Node) -> Iterator[tuple[yaml.Node, yaml.Node]]:
    """Yield (first, second) YAML node of each key that occurs twice in a mapping, at any depth."""
    seen: dict[str, yaml.Node] = {}
    for part in node.value if isinstance(node, yaml.CollectionNode) else ():
        key, value = part if isinstance(part, tuple) else (None, part)
        if key is not None and seen.setdefault(str(key.value), key) is not key:
            yield seen[str(key.value)], key
        yield from _twice(value)


# -- where a value is ----------------------------------------------------------------------------------


def file_and_line(path: Path, location: Sequence[Key]) -> str:
    """Return the text "FILE, line N" for a value; `location` are the keys and indices that lead to it.
    If none of them is in the file, the text is "FILE"."""
    line = _line(_compose(path), location)
    return f"{path}, line {line}" if line else str(path)


def _line(node: yaml.Node | None, location: Sequence[Key]) -> int | None:
    """Return the line number, from 1, of a value; `location` are the keys and indices from `node` to it.
    Keys that are not in the file are skipped; None if no key is in the file."""
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


# -- messages ---------------------------------------------------------------------------------------------


def _sentence(
    problem: ErrorDetails,
    kind: object,
    path: Path | None,
    node: yaml.Node | None,
    location: Sequence[Key],
    name: str,
) -> tuple[str, str]:
    """Return where a problem is ("FILE, line N") and its description, from an error of pydantic.
    `kind` is the type of the section that is wrong, `node` the root of the file's YAML nodes, and `location`
    the keys that lead from this root to the section. Without a file (`path`) the place is `name`."""
    inner = list(problem["loc"])
    line = _line(node, [*location, *inner])
    where = (f"{path}, line {line}" if line else str(path)) if path else name
    names, kinds, example = _follow(kind, inner)
    what = ".".join(str(step) for step in (*location, *names))
    message = _message(problem, kinds)
    words = f"{what}: {message}" if problem["type"] == "value_error" and what else f"{what} {message}".strip()
    if example:
        words += f" (for example {names[-1]}: {example})"
    return where, words


def _is_other_form(problem: ErrorDetails, wrong: Sequence[ErrorDetails]) -> bool:
    """Return whether an error of pydantic can be omitted because another one describes the same mistake
    better. Pydantic reports an error for each form that the value could have, such as a word or a mapping."""
    place = problem["loc"][:-1]
    others = [other for other in wrong if other is not problem and other["loc"][: len(place)] == place]
    if problem["type"] == "literal_error" and isinstance(problem["input"], Mapping):
        return bool(others)
    wrong_kind = problem["type"] in ("list_type", "dict_type")
    return wrong_kind and any(other["type"] == "value_error" for other in others)


def _message(problem: ErrorDetails, kinds: Sequence[object]) -> str:
    """Return the message for one error of pydantic, without the name of the wrong key.
    `kinds` are the types of section that could contain this key."""
    sort, message = problem["type"], str(problem["msg"])
    if sort in _UNKNOWN:
        known = list(dict.fromkeys(name for member in kinds for name in _fields(member)))
        close = difflib.get_close_matches(str(problem["loc"][-1]), known, n=1)
        remedy = f"; did you mean {close[0]!r}?" if close else f"{_KNOWN}{', '.join(known)}"
        return f"is not a known key{remedy}"
    if sort == "missing":
        return "is missing"
    if sort == "value_error":
        return message.removeprefix("Value error, ")
    value = problem.get("input")
    if value is None:
        return "is empty; fill it in"
    found = f", not {value!r}" if len(repr(value)) < 60 else ""
    if sort in ("float_parsing", "int_parsing"):
        return f"should be a number{found}"
    return message.replace("Input should", "should") + found


def _follow(kind: object, location: Sequence[Key]) -> tuple[list[Key], list[Any], str | None]:
    """Follow the location of a pydantic error from the outermost section, of type `kind`, inwards.
    Returns the keys of the location that are in the file, the types of section that could have the last of
    these keys, and an example of a value for this key (or None)."""
    names: list[Key] = []
    sections = annotations = _members(kind)
    example = None
    for step in location:
        fields = {key: found for member in annotations for key, found in _fields(member).items()}
        inside = [inner for member in annotations for inner in _inside(member)]
        if fields:
            sections = [member for member in annotations if _fields(member)]
        if step in fields:
            names.append(step)
            annotation, example = fields[step]
            annotations = _members(annotation)
        elif inside and not _is_branch(step, annotations):  # an item, or the key of a mapping
            names.append(step)
            annotations, example = [m for part in inside for m in _members(part)], None
        elif not _is_branch(step, annotations) and step == location[-1]:
            names.append(step)  # an unknown key
            example = None
    return names, sections, example


def _is_branch(step: Key, annotations: Sequence[object]) -> bool:
    """Return whether a part of the location of a pydantic error is the name of a type ("str") and not a key.
    Pydantic adds such names where several types (`annotations`) are allowed."""
    if not isinstance(step, str):
        return False
    classes = [getattr(member, "__name__", "") for member in annotations]
    return step in ("str", "float", "int", *classes) or step.startswith("constrained-") or "[" in step


def _fields(kind: object) -> dict[str, tuple[Any, str | None]]:
    """Return the fields of a section by name, each with its type and an example of its value (or None)."""
    if not isinstance(kind, type):
        return {}
    if issubclass(kind, BaseModel):
        return {
            name: (field.annotation, str(field.examples[0]) if field.examples else None)
            for name, field in kind.model_fields.items()
        }
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return {field.name: (hints[field.name], None) for field in dataclasses.fields(kind) if field.init}
    return {}


def _inside(annotation: object) -> Sequence[Any]:
    """Return the types of the items of a list, or of the values of a mapping; empty for other types."""
    origin = typing.get_origin(annotation)
    if isinstance(origin, type) and issubclass(origin, Mapping | list | tuple | set | frozenset):
        arguments = [a for a in typing.get_args(annotation) if a is not Ellipsis]
        return arguments[-1:] if issubclass(origin, Mapping) else arguments
    return ()


def _members(annotation: object) -> list[Any]:
    """Return the types that an annotation allows: the members of a union, else the type itself."""
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        return _members(typing.get_args(annotation)[0])
    if origin in (typing.Union, types.UnionType):
        return [inner for member in typing.get_args(annotation) for inner in _members(member)]
    return [annotation]
