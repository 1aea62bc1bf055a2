"""Intake catalogs, which open the frames, cubes and waves of many runs by name.

A run is an experiment of a catalog. A recipe is everything that determines the values of a cube: settings,
rig, grid, images, algorithm. A catalog ``tank.yaml`` has a folder ``tank`` next to it with one folder per
run::

    tank.yaml
    tank/coriolis-07/experiment.yaml        the experiment, or a link to it
    tank/coriolis-07/1a2b3c4d/cube.zarr     results, in a folder named after the hash of their recipe
    tank/coriolis-07/1a2b3c4d/waves.zarr
    tank/coriolis-07/latest                 link to the recipe that was run last

A changed recipe therefore does not replace an earlier cube. The entries of `intake.open_catalog` open these
files, with the parameters ``run`` and ``recipe``.
"""

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock
from ruamel.yaml import YAML
from ruamel.yaml.scalarstring import SingleQuotedScalarString

from wavefield.atomic_write import write_text, writing
from wavefield.config_files import read_yaml, safe_name
from wavefield.errors import ExperimentError, StoreError

if TYPE_CHECKING:  # slow to import, and most commands only list the runs of a catalog
    from wavefield.execution.workflow import Workflow
    from wavefield.pipeline.running import ProgressFunction
    from wavefield.rig import Rig
    from wavefield.series import Experiment
    from wavefield.store.ledger import Status

NEW_CATALOG = Path(__file__).with_name("new_catalog.yaml")  # without runs
_PARAMETERS = ("run", "recipe", "location")


def catalog_add(catalog: str | Path, experiment: str | Path, name: str | None = None) -> str:
    """Add an experiment to a catalog as a run; creates the catalog if there is none.

    Parameters
    ----------
    catalog, experiment : path
        Intake catalog, YAML, and experiment file.
    name : str, optional
        Name of the run, which is returned; by default that of the experiment.

    Raises
    ------
    ExperimentError
        If the experiment file is wrong, or the catalog has another run of that name.
    """
    from wavefield.series import Experiment

    catalog = Path(catalog).absolute()
    found = Experiment.load(experiment)
    run = name or found.name
    place = _folder(catalog, {"run": run}) / "experiment.yaml"
    with _editing(catalog) as data:
        _allow(catalog, data, "run", run)
        if place.exists() and Experiment.load(place).path.resolve() != found.path.resolve():
            raise ExperimentError(
                f"{catalog} already has another run {run!r}; give this one a different name"
            )
        if not place.exists():
            with writing(place):
                place.parent.mkdir(parents=True, exist_ok=True)
                place.unlink(missing_ok=True)  # a link to a file that is gone
                place.symlink_to(os.path.relpath(found.path, place.parent.resolve()))
        parameter = data["user_parameters"]["run"]
        parameter["default"] = parameter["options"][0]
        _add_cube(catalog, data, place.parent, found.resolve("cube.zarr"))
    return run


def _add_cube(catalog: Path, data: dict[str, Any], place: Path, cube: Path) -> None:
    """Link the folder of an existing cube into the folder ``place`` of a run, by the hash of its recipe.
    The hash is added to ``data``, the content of the catalog."""
    from wavefield.store.read import is_cube, open_group

    if not is_cube(cube):
        return
    short = str(open_group(cube).attrs["recipe_hash"])[:8]
    folder = place / short
    if not os.path.lexists(folder):
        folder.symlink_to(os.path.relpath(cube.parent, place), target_is_directory=True)
        _link_latest(folder)
    _allow(catalog, data, "recipe", short)


def _allow(catalog: Path, data: Mapping[str, Any], parameter: str, value: str) -> None:
    """Add a value to those that a parameter may have, in the content ``data`` of a catalog."""
    try:
        options: list[str] = data["user_parameters"][parameter]["options"]
    except (KeyError, TypeError):
        raise ExperimentError(
            f"{catalog} has no parameter `{parameter}` with options; let `wavefield catalog add` make a new "
            "catalog"
        ) from None
    if value not in options:
        options.append(SingleQuotedScalarString(value))  # YAML would read the hash 795126e3 as a number


def is_catalog(path: str | Path) -> bool:
    """Whether a YAML file is an intake catalog, with ``entries``, rather than an experiment."""
    return "entries" in read_yaml(Path(path))


def run_catalog(
    catalog: str | Path,
    entries: Sequence[str] = (),
    out: str | Path | None = None,
    *,
    rig: "str | Path | Rig | None" = None,
    workflow: "str | Path | Workflow | None" = None,
    progress: "ProgressFunction | None" = None,
    parameters: Mapping[str, str] | None = None,
) -> "list[Status]":
    """Process runs of a catalog, each into a folder named after its recipe.

    Parameters
    ----------
    catalog : path
        Intake catalog.
    entries : sequence of str
        Names of runs; all by default.
    out, rig, workflow, progress : optional
        As for `wavefield.run`; ``out`` only for a single run.
    parameters : mapping, optional
        ``location``: folder of the images, if they are not next to the experiment file.

    Returns
    -------
    list of Status
        One per run.

    Raises
    ------
    ExperimentError
        If a run or a parameter is unknown.
    """
    from wavefield.execution.cluster import open_cluster
    from wavefield.execution.lock import locked
    from wavefield.execution.run_log import jobs_folder
    from wavefield.pipeline.prepare import prepare
    from wavefield.pipeline.running import MEASURING, process

    path = Path(catalog).absolute()
    runs = runs_of(path, entries)
    if out is not None and len(runs) > 1:
        raise ExperimentError(f"one store cannot hold {len(runs)} runs; name the run, or leave out -o")
    done = []
    for number, run in enumerate(runs, 1):
        chosen = {"run": run, **(parameters or {})}
        prepared = prepare(find_experiment(path, chosen), rig, workflow)
        store = Path(out).absolute() if out is not None else _new_cube(path, run, prepared.recipe.hash[:8])
        told = _named(progress, f"{run} ({number} of {len(runs)})")
        with locked(store), open_cluster(prepared.workflow, jobs_folder(store), MEASURING) as mapped:
            done.append(process(prepared, store, mapped, told))
        if out is None:
            _link_latest(store.parent)
    return done


def runs_of(catalog: str | Path, entries: Sequence[str] = ()) -> list[str]:
    """Return the names of all runs of a catalog, or the given ``entries`` if the catalog has them."""
    path = Path(catalog).absolute()
    options = read_yaml(path).get("user_parameters", {}).get("run", {}).get("options", [])
    unknown = [name for name in entries if name not in options]
    if unknown:
        raise ExperimentError(f"{path} has no run {unknown[0]!r}; it has {', '.join(options) or 'none'}")
    runs = list(entries) or list(options)
    if not runs:
        raise ExperimentError(
            f"{path} has no runs; add one with `wavefield catalog add {path.name} EXPERIMENT`"
        )
    return runs


def find_experiment(catalog: str | Path, chosen: Mapping[str, str]) -> "Experiment":
    """Read the experiment of the run ``chosen["run"]``, with images in ``chosen["location"]`` if given."""
    from wavefield.series import Experiment

    place = _folder(catalog, chosen)
    return Experiment.load(place / "experiment.yaml", chosen.get("location") or None)


def cube_of(catalog: str | Path, chosen: Mapping[str, str]) -> Path:
    """Return the path of the cube of the run ``chosen["run"]``, which may not exist.
    ``chosen["recipe"]`` is the hash of a recipe; by default the recipe that was run last."""
    return _folder(catalog, chosen) / chosen.get("recipe", "latest") / "cube.zarr"


def _folder(catalog: str | Path, chosen: Mapping[str, str]) -> Path:
    """Return the folder of the run ``chosen["run"]`` in a catalog."""
    unknown = [name for name in chosen if name not in _PARAMETERS]
    if unknown:
        raise ExperimentError(f"{catalog} has no parameter {unknown[0]!r}; it has {', '.join(_PARAMETERS)}")
    try:
        return Path(catalog).absolute().with_suffix("") / safe_name(str(chosen["run"]))
    except ValueError as error:
        raise ExperimentError(f"{catalog}: run {error}") from None


def _named(progress: "ProgressFunction | None", run: str) -> "ProgressFunction | None":
    """Return a progress function that puts the name of the run before each sentence; None for None."""
    if progress is None:
        return None
    return lambda done, total, sentence: progress(done, total, f"{run}: {sentence}" if sentence else run)


def find_cube(catalog: str | Path, run: str | None = None) -> Path:
    """Return the path of the latest cube of a run; without ``run``, of the only run that has one."""
    path = Path(catalog).absolute()
    cubes = {name: cube_of(path, {"run": name}) for name in runs_of(path, () if run is None else [run])}
    existing = {name: cube for name, cube in cubes.items() if cube.exists()}
    if not existing:
        raise ExperimentError(
            f"{path} has no cube of {run or 'any run'} yet; make it with `wavefield run {path.name}"
            + (f" {run}`" if run else "`")
        )
    if len(existing) > 1:
        raise ExperimentError(f"{path} has the cubes of {', '.join(existing)}; name one of these runs")
    return next(iter(existing.values()))


def _new_cube(catalog: Path, run: str, recipe: str) -> Path:
    """Add the hash ``recipe`` to the catalog, and return the path for the cube of a run with it."""
    with _editing(catalog) as data:
        _allow(catalog, data, "recipe", recipe)
    return cube_of(catalog, {"run": run, "recipe": recipe})


def _link_latest(folder: Path) -> None:
    """Make the link ``latest``, next to the folder of a recipe, point to this folder."""
    temporary = folder.with_name(f".latest.{os.getpid()}")
    try:
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(folder.name, target_is_directory=True)
        latest = folder.with_name("latest")
        if latest.exists() and not latest.is_symlink():
            raise OSError(errno.EEXIST, "there is a file or folder of this name")
        temporary.replace(latest)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise StoreError(
            f"the link {folder.with_name('latest')} cannot be made ({error.strerror}); open the cube with "
            f"recipe={folder.name!r}"
        ) from None


@contextmanager
def _editing(catalog: Path) -> Iterator[dict[str, Any]]:
    """Context manager: yield the content of a catalog for changes, and write it back with its comments."""
    editor = YAML()
    editor.preserve_quotes, editor.width = True, 110
    folder = catalog.with_suffix("")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".lock"):
        before = ""
        if catalog.exists():
            read_yaml(catalog)  # refuses what is not a catalog, with its line
            before = catalog.read_text(encoding="utf-8")
        data = editor.load(before or NEW_CATALOG.read_text(encoding="utf-8").replace("STEM", catalog.stem))
        yield data
        text = StringIO()
        editor.dump(data, text)
        if text.getvalue() != before:
            write_text(catalog, text.getvalue(), replace=True)
