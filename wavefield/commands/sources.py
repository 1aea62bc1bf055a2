"""Arguments and options that several commands have; an experiment can be given as a file, folder or cube."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

from wavefield.errors import ExperimentError, StoreError

Command = TypeVar("Command", bound=Callable[..., None])
PATH = click.Path(exists=True, path_type=Path)
CUBE = "CUBE|EXPERIMENT|FOLDER"
FILE = click.Path(dir_okay=False, path_type=Path)
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON, for scripts.")
RIG = click.option("--rig", type=PATH, help="Rig file, in place of the one that the experiment names.")
NEW_RIG = click.option("-o", "--output", required=True, type=FILE, help="Rig to write.")


def is_store(path: Path) -> bool:
    """Return whether a path is itself a Zarr store, rather than a folder that contains one."""
    return path.is_dir() and (path.suffix == ".zarr" or (path / "zarr.json").is_file())


def source_of_experiment(experiment: Path, output: Path) -> str:
    """Return a hash of the name of an experiment and of the path of its file relative to `output`.
    `output` stores the hash, so that a later command replaces `output` only for the same experiment."""
    from wavefield.atomic_write import identity_of
    from wavefield.series import Experiment

    loaded = Experiment.load(experiment)
    place = Path(os.path.relpath(loaded.path.resolve(), output.absolute().parent.resolve()))
    return identity_of(loaded.name, place.as_posix())


def experiment_file(source: Path) -> Path:
    """Return the experiment file of a folder or of a cube; the path of a file is returned unchanged.
    Raises ExperimentError if a folder holds no experiment file, or several."""
    if source.is_file():
        return source
    if is_store(source):
        from wavefield.pipeline.opened_run import load_experiment
        from wavefield.store.read import open_group

        return load_experiment(source, open_group(source).attrs).path
    found = _experiments(source)
    if len(found) == 1:
        return found[0]
    if found:
        raise ExperimentError(
            f"{source} holds {len(found)} experiment files: name one of "
            f"{', '.join(path.name for path in found)}"
        )
    raise ExperimentError(
        f"{source} holds no experiment file; `wavefield init {source}` proposes one from its images"
    )


# the arguments of commands on one experiment, or on one cube
EXPERIMENT = click.argument(
    "experiment", metavar="EXPERIMENT|FOLDER", type=PATH, callback=lambda _, __, path: experiment_file(path)
)
STORE = click.argument("store", metavar=CUBE, type=PATH, callback=lambda _, __, path: find_cube(path))


def frames_option(default: int, words: str, least: int = 1) -> Callable[[Command], Command]:
    """Return the click option `--frames`, a number of at least `least`, with the help text `words`."""
    count = click.IntRange(min=least)
    return click.option("--frames", default=default, show_default=True, type=count, help=words)


def find_cube(source: Path, run: str | None = None) -> Path:
    """Return the cube of an experiment file, a folder, or a run of a catalog; a cube is returned unchanged.
    `run` is the name of a run, allowed only with a catalog. Raises StoreError if there is no cube,
    ExperimentError if a catalog has none, or several and `run` is None."""
    if source.is_file():
        from wavefield.pipeline import catalog

        if catalog.is_catalog(source):
            return catalog.find_cube(source, run)
    if run is not None:
        raise StoreError(f"{source} is no catalog: leave out {run!r}")
    if is_store(source):
        return source
    if source.is_dir():
        from wavefield.store.read import cubes_in, find_store

        if cubes_in(source):
            return find_store(source)
        if not _experiments(source):
            raise StoreError(f"{source} is not a cube, and holds neither a cube nor an experiment file")
    from wavefield.series import Experiment

    experiment = experiment_file(source)
    cube = Experiment.load(experiment).resolve("cube.zarr")
    if not cube.exists():
        raise StoreError(
            f"{experiment} has no cube next to it ({cube}); make it with `wavefield run {experiment}`"
        )
    return cube


def _experiments(folder: Path) -> list[Path]:
    """Return the experiment files in a folder; if `experiment.yaml` is there, only that file."""
    usual = folder / "experiment.yaml"
    if usual.is_file():
        return [usual]
    files = sorted(path for path in folder.iterdir() if path.suffix in (".yaml", ".yml") and path.is_file())
    return [path for path in files if _names_cameras(path)]


def _names_cameras(path: Path) -> bool:
    """Return whether a YAML file is an experiment file, or refers to one with the key "experiment"."""
    from wavefield.config_files import read_yaml

    try:
        data = read_yaml(path)
    except ExperimentError:
        return False
    return {"name", "cameras"} <= set(data) or set(data) in ({"experiment"}, {"experiment", "folder"})
