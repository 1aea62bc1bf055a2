"""The probes of an experiment before a run: their file, their times, and z where there is a cube."""

from pathlib import Path

import numpy as np

from wavefield.errors import WavefieldError
from wavefield.pipeline.experiment_of_cube import load_experiment
from wavefield.quality.remarks import compare_probes, remark_on_fits, remark_on_probe_file
from wavefield.series import Experiment
from wavefield.store.read import open_cube, open_group
from wavefield.store.verdict import Remark


def check_probes(experiment: Experiment, span: tuple[float, float]) -> tuple[list[Remark], str]:
    """Remarks on the probes, and a line on them; ``span`` is the time of the first and last frame, s."""
    remarks = list(remark_on_probe_file(experiment, span))
    if experiment.probes is None or any(not one.values for one in remarks):  # they cannot be read
        return remarks, ""
    probes = experiment.read_probes()
    clock = probes["time"].values
    sentence = (
        f"{', '.join(map(str, probes['probe'].values))}, from {clock[0]:g} to {clock[-1]:g} s; frames from "
        f"{span[0]:g} to {span[1]:g} s"
    )
    if not np.isfinite(probes["probe_x"].values).all():
        sentence += "; state where they are (`places: {name: [x, y]}` in `probes:`) to compare them with z"
    cube = _own_cube(experiment)
    if cube is not None and not remarks:
        fits, dt = compare_probes(experiment, open_cube(cube))
        remarks += remark_on_fits(fits, dt)
        if fits:
            correlations = ", ".join(f"{fit.name} {fit.best:.2f}" for fit in fits)
            sentence += f"; correlation with z of {cube.name}: {correlations}"
    return remarks, sentence


def _own_cube(experiment: Experiment) -> Path | None:
    """The cube next to an experiment, if it is of this experiment."""
    cube = experiment.resolve("cube.zarr")
    if not cube.is_dir():
        return None
    try:
        own = load_experiment(cube, open_group(cube).attrs)
    except WavefieldError:
        return None
    return cube if own.path.samefile(experiment.path) else None
