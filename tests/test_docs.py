"""What the documents promise is there: links, commands, tables, notebooks."""

import importlib
import importlib.util
import inspect
import re
import shlex
import tomllib
from enum import Enum
from pathlib import Path

import click
import pytest

import wavefield.figures
from wavefield.commands.cli import cli

ROOT = Path(__file__).resolve().parents[1]
BUILT = ("_build", "gallery", "commands", "api", "notebooks")  # folders that the site makes
PAGES = sorted(
    page
    for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    if not any(part in BUILT for part in page.parts)
)
ROOMS = [
    *("calibration", "pipeline", "figures", "matching", "measurement", "reports", "rig", "series", "tank"),
    "waves",
]


def commands_of(text: str) -> list[list[str]]:
    """Every `wavefield ...` line of the shell blocks of a page, as words."""
    blocks = re.findall(r"```(?:bash|sh|console)\n(.*?)```", text, re.S)
    lines = [line.split("  #")[0].strip() for block in blocks for line in block.splitlines()]
    parts = [part.strip() for line in lines for part in line.split("&&")]
    return [shlex.split(part) for part in parts if re.match(r"(\S*/)?wavefield\s", part)]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if not re.match(r"https?:|mailto:|#", target):
            assert (page.parent / target.split("#")[0]).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_of_the_pages_exist(page):
    for words in commands_of(page.read_text(encoding="utf-8")):
        command: click.Command = cli
        rest = [word for word in words[1:] if word not in {"-q", "-v", "--debug"}]
        while isinstance(command, click.Group) and rest and not rest[0].startswith("-"):
            if command.name == "rig" and rest[0] not in command.commands:
                rest.insert(0, "convert")  # which may be left out
            assert rest[0] in command.commands, f"{page.name}: {' '.join(words)}"
            command = command.commands[rest.pop(0)]
        known = {option for parameter in command.params for option in parameter.opts} | {"--help", "-h"}
        unknown = {word.split("=")[0] for word in rest if word.startswith("-")} - known
        assert not unknown, f"{page.name}: {' '.join(words)} uses {unknown}"


def test_python_blocks_of_the_pages_are_valid():
    for page in PAGES:
        for block in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
            compile(block, str(page), "exec")


@pytest.mark.parametrize("script", ["make_tables", "make_validation"])
def test_tables_of_the_pages_are_made_from_package_and_results(script):
    spec = importlib.util.spec_from_file_location(script, ROOT / "docs" / f"{script}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for page in module.PAGES:
        text = page.read_text(encoding="utf-8")
        assert module.filled(text) == text, f"run `python docs/{script}.py`"


def test_changelog_citation_recipe_and_package_agree_on_the_release():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    release = project["version"]
    assert re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)[0] == release
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {release}\n" in citation
    assert f"license: {project['license']}\n" in citation
    recipe = (ROOT / "packaging" / "recipe.yaml").read_text(encoding="utf-8")
    assert f'version: "{release}"\n' in recipe


def public_objects() -> dict[str, object]:
    """What the rooms show, by the full name of where it is made."""
    found = {}
    for room in (wavefield, *(importlib.import_module(f"wavefield.{name}") for name in ROOMS)):
        for name in room.__all__:
            thing = getattr(room, name)
            if inspect.isfunction(thing) or (inspect.isclass(thing) and not issubclass(thing, Enum)):
                found[f"{thing.__module__}.{thing.__qualname__}"] = thing
    return found


@pytest.mark.filterwarnings("ignore")  # docstrings of other projects' base classes are read as well
def test_public_docstrings_name_every_parameter_and_what_comes_back():
    validate = pytest.importorskip("numpydoc.validate", reason="needs numpydoc (group docs)").validate
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    checks = set(config["tool"]["numpydoc_validation"]["checks"])
    faults = []
    for path, thing in public_objects().items():
        documented = (
            {"PR01"} if hasattr(thing, "model_fields") else set()
        )  # each field has its own description
        wrong = [f"{code} {text}" for code, text in validate(path)["errors"] if code in checks - documented]
        faults += [f"{path}: {line}" for line in wrong]
    assert not faults, "\n".join(faults)


def test_experiment_files_of_the_pages_load(tmp_path):
    from wavefield.series import Experiment

    found = 0
    for page in PAGES:
        for block in re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
            if block.startswith("name:"):
                (tmp_path / "experiment.yaml").write_text(block)
                assert Experiment.load(tmp_path / "experiment.yaml").cameras, page.name
                found += 1
    assert found >= 3


def test_every_key_of_an_experiment_workflow_target_and_the_settings_is_documented():
    docs = ROOT / "docs"
    text = (docs / "experiment-file.md").read_text() + (docs / "workflows-and-catalogs.md").read_text()
    documented = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`\n]+)`", text))))
    from dataclasses import fields
    from typing import get_args

    from wavefield.calibration import Target
    from wavefield.execution.workflow import Workflow
    from wavefield.matching import MatchSettings
    from wavefield.measurement import Settings
    from wavefield.series import Experiment

    def keys(annotation):
        models = getattr(annotation, "model_fields", {})
        parts = [one.annotation for one in models.values()] + list(get_args(annotation))
        return set(models).union(*(keys(part) for part in parts))

    accepted = keys(Experiment) | keys(Workflow) | {"preset"}
    accepted |= {field.name for kind in (Target, Settings, MatchSettings) for field in fields(kind)}
    assert {"cylinder", "bottom", "row_time"} <= accepted
    assert accepted - documented == set()


def test_stored_results_of_an_earlier_measurement_say_so_on_their_page():
    from benchmarks.results import RESULTS, Result
    from wavefield.measurement.algorithm import ALGORITHM

    pages = "".join((ROOT / page).read_text(encoding="utf-8") for page in ("README.md", "docs/validation.md"))
    for path in sorted(RESULTS.glob("*.json")):
        result = Result.load(path)
        module = re.match(r"python -m benchmarks\.(\w+)", result.command)
        assert module, path.name
        assert (ROOT / "benchmarks" / f"{module[1]}.py").exists(), path.name
        assert f"<!-- result: {path.stem}" in pages, f"no page shows {path.name}"
        if result.algorithm not in (None, ALGORITHM):
            assert f"`{result.command}`, {result.origin}" in pages, "run `python docs/make_validation.py`"
            assert f"not measured again with ALGORITHM {ALGORITHM}" in result.origin
