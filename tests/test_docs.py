"""What the documents promise is there: links, commands, tables, notebooks."""

import importlib
import importlib.util
import inspect
import json
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
    "calibration",
    "pipeline",
    "figures",
    "matching",
    "measurement",
    "reports",
    "rig",
    "series",
    "tank",
    "waves",
]
NOTEBOOKS = sorted(ROOT.glob("notebooks/*.ipynb"))


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


def test_readme_prints_exactly_two_lines():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = re.search(r"^## Two lines.*?```bash\n(.*?)```", text, re.S | re.M)
    assert block
    lines = [line for line in block[1].splitlines() if line and not line.startswith("#")]
    assert len(lines) == 2
    assert lines[0].endswith("wavefield demo")
    assert "pytest" in lines[1]
    for line in lines:
        assert "python3 -m venv" in line


@pytest.mark.parametrize("script", ["make_tables", "make_validation"])
def test_tables_of_the_pages_are_made_from_package_and_results(script):
    spec = importlib.util.spec_from_file_location(script, ROOT / "docs" / f"{script}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for page in module.PAGES:
        text = page.read_text(encoding="utf-8")
        assert module.filled(text) == text, f"run `python docs/{script}.py`"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.name)
def test_notebooks_are_small_and_free_of_private_paths(path):
    text = path.read_text(encoding="utf-8")
    assert json.loads(text)["nbformat"] == 4
    assert len(text) < 1_000_000
    assert not re.search(r"/(home|root|Users|tmp|work)/", text)


def test_every_page_of_the_guide_is_on_the_site():
    text = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    trees = re.findall(r"```\{toctree\}\n:hidden:\n:caption: [^\n]+\n(.*?)```", text, re.S)
    listed = set(" ".join(trees).split())
    on_the_front = {"notebooks", "reference", "commands", "install", "first-experiment"}  # of index.md
    linked = {target.removesuffix(".md") for target in re.findall(r"\]\((\S+\.md)\)", text)} - on_the_front
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8") + (
        ROOT / "docs" / "notebooks.md"
    ).read_text()
    docs = ROOT / "docs"
    pages = {page.relative_to(docs).with_suffix("").as_posix() for page in docs.glob("**/*.md")}
    pages -= {"index", "by_task"}
    pages = {page for page in pages if page.split("/")[0] not in BUILT or "/" not in page}
    assert listed == linked
    assert not [page for page in pages - listed if not re.search(rf"^{page}$", index, re.M)]
    assert not [path.stem for path in NOTEBOOKS if f"notebooks/{path.stem}" not in index]


def test_figures_of_the_gallery_exist():
    for script in ROOT.glob("docs/examples/*.py"):
        for name in re.findall(r"figures\.(\w+)\(", script.read_text(encoding="utf-8")):
            assert hasattr(wavefield.figures, name), f"{script.name} draws {name}"


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


def test_theory_pages_are_short_have_a_figure_and_no_measured_results():
    pages = [page for page in sorted((ROOT / "docs" / "theory").glob("*.md")) if page.stem != "paper-errors"]
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in pages}
    assert 10 <= len(pages) <= 13
    assert sum(words.values()) <= 5000
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert "validation.md" in text, f"{page.name} links to no validation"
        assert not re.search(r"\bseeds? \d", text), f"{page.name}: results belong to validation.md"
        assert re.search(r"!\[[^]]+\]\(figures/[\w-]+\.(?:svg|png)\)", text), page.name


def test_places_that_contributing_names_exist():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for path in re.findall(r"`((?:[a-z_]+/)+(?:[a-z_]+\.(?:py|yaml))?)`", text):
        assert (ROOT / "wavefield" / path).exists() or (ROOT / path).exists(), f"CONTRIBUTING.md names {path}"


@pytest.fixture(scope="module")
def site_parts():
    for needed in ("latex2mathml", "sphinx_gallery"):
        pytest.importorskip(needed, reason="needs group docs")
    spec = importlib.util.spec_from_file_location("site_parts", ROOT / "docs" / "site_parts.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_command_has_a_page_with_its_options_and_an_example(site_parts):
    pages = {name: site_parts.command_page(name, command) for name, command in site_parts.commands()}
    assert {"calibrate", "run", "look", "rig convert", "catalog add"} <= set(pages)
    for name, command in site_parts.commands():
        for option in (o for p in command.params for o in p.opts if o.startswith("--")):
            assert option in pages[name] or option == "--help", f"{name}: {option}"
        assert isinstance(command, click.Group) or "wavefield " + name in pages[name].split("```")[-2], name


def test_every_public_name_belongs_to_a_task_of_the_reference(site_parts):
    tasks = site_parts.tasks()
    listed = [name for names in tasks.values() for name in names]
    assert sorted([*listed, "__version__"]) == sorted(wavefield.__all__)
    assert site_parts.OTHER not in tasks, f"add the module of {tasks.get(site_parts.OTHER)} to TASKS"


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
    assert {"polygon", "row_time"} <= accepted
    assert accepted - documented == set()


def test_stored_results_of_an_earlier_measurement_say_so_on_their_page():
    from benchmarks.results import RESULTS, Result
    from wavefield.measurement.step import ALGORITHM

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
