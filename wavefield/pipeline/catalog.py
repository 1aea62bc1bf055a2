"""Intake catalogs, which open the images, cubes and waves of many experiments by name.

An experiment in a catalog is called a run. The recipe of a cube is the record of all inputs that determine
its values: settings, rig, grid, images, algorithm. A catalog ``tank.yaml`` has a folder ``tank`` next to it
with one folder per run::

    tank.yaml
    tank/coriolis-07/experiment.yaml        the experiment, or a link to it
    tank/coriolis-07/1a2b3c4d/cube.zarr     results, in a folder named after the hash of their recipe
    tank/coriolis-07/1a2b3c4d/waves.zarr
    tank/coriolis-07/latest                 link to the recipe that was run last

A run with changed inputs therefore does not replace an earlier cube. The entries of a catalog that
`intake.open_catalog` returns open these files; their parameters ``run`` and ``recipe`` select the folder.
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
    """Add an experiment file to a catalog as a run, and return the name of the run.
    A catalog that does not exist is created. ``name`` is by default that of the experiment. A ``cube.zarr``
    next to the experiment file is added, too. ExperimentError if the catalog has another run of that name."""
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
    """Make a link to the folder that holds ``cube`` in ``place``, the folder of a run, if the cube exists.
    The name of the link is the hash of the cube's recipe (record of inputs). It is also added, in place,
    to the values of the parameter ``recipe`` in ``data``, the content of the catalog."""
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
    """Add ``value`` to the allowed values of a parameter of a catalog, in place in the content ``data``.
    ExperimentError, with the file name ``catalog``, if the catalog has no such parameter."""
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
    """Return whether a YAML file has the key ``entries``: it is an intake catalog, not an experiment."""
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
    """Process experiments of a catalog into cubes, one after the other, as `wavefield.run` does.

    Each cube is written to a folder of the catalog that is named after the hash of the cube's recipe (the
    record of all inputs). A later run with other inputs therefore does not replace it.

    Parameters
    ----------
    catalog : path
        Intake catalog, a YAML file.
    entries : sequence of str
        Names of the runs (experiments) to process; by default all.
    out, rig, workflow, progress : optional
        As for `wavefield.run`. ``out`` is only allowed for a single run.
    parameters : mapping, optional
        The only key is ``location``: folder of the images, if they are not next to the experiment file.

    Returns
    -------
    list of Status
        Numbers of steps done, failed and left, for each run in the order of processing.

    Raises
    ------
    ExperimentError
        If a run or a parameter is unknown, or as for `wavefield.run`.
    RigError, StoreError, RunStopped
        As for `wavefield.run`.
    """
    from wavefield.execution.cluster import open_cluster
    from wavefield.execution.run_files import jobs_folder, locked
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
        if out is None:
            recipe = prepared.recipe.hash[:8]
            with _editing(path) as data:
                _allow(path, data, "recipe", recipe)
            store = cube_of(path, {"run": run, "recipe": recipe})
        else:
            store = Path(out).absolute()
        told = _named(progress, f"{run} ({number} of {len(runs)})")
        with locked(store), open_cluster(prepared.workflow, jobs_folder(store), MEASURING) as mapped:
            done.append(process(prepared, store, mapped, told))
        if out is None:
            _link_latest(store.parent)
    return done


def runs_of(catalog: str | Path, entries: Sequence[str] = ()) -> list[str]:
    """Return ``entries`` if all are names of runs of a catalog; by default the names of all runs.
    ExperimentError if a name is unknown, or the catalog has no runs."""
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
    """Read the experiment of the run ``chosen["run"]`` of a catalog.
    ``chosen["location"]`` is the folder of the images; by default it follows from the experiment file."""
    from wavefield.series import Experiment

    place = _folder(catalog, chosen)
    return Experiment.load(place / "experiment.yaml", chosen.get("location") or None)


def cube_of(catalog: str | Path, chosen: Mapping[str, str]) -> Path:
    """Return the path of a cube of the run ``chosen["run"]`` of a catalog; the cube need not exist.
    ``chosen["recipe"]`` is the hash (8 digits) of its recipe, the record of inputs; by default the latest."""
    return _folder(catalog, chosen) / chosen.get("recipe", "latest") / "cube.zarr"


def _folder(catalog: str | Path, chosen: Mapping[str, str]) -> Path:
    """Return the folder of the run ``chosen["run"]`` of a catalog.
    ExperimentError if ``chosen`` has keys that are not parameters of a catalog."""
    unknown = [name for name in chosen if name not in _PARAMETERS]
    if unknown:
        raise ExperimentError(f"{catalog} has no parameter {unknown[0]!r}; it has {', '.join(_PARAMETERS)}")
    try:
        return Path(catalog).absolute().with_suffix("") / safe_name(str(chosen["run"]))
    except ValueError as error:
        raise ExperimentError(f"{catalog}: run {error}") from None


def _named(progress: "ProgressFunction | None", run: str) -> "ProgressFunction | None":
    """Return a function that calls ``progress`` and puts the name of the run in front of each sentence.
    None if ``progress`` is None."""
    if progress is None:
        return None
    return lambda done, total, sentence: progress(done, total, f"{run}: {sentence}" if sentence else run)


def find_cube(catalog: str | Path, run: str | None = None) -> Path:
    """Return the path of the latest cube of a run; by default of the only run that has a cube.
    ExperimentError if there is no cube, or if no run is given and several have one."""
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


def _link_latest(folder: Path) -> None:
    """Make the link ``latest``, next to the folder of a cube, point to this folder."""
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
    """Context manager: yield the content of a catalog, which the block may change, and write it back.
    The file keeps its comments, and is locked meanwhile. A catalog that does not exist is created."""
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
