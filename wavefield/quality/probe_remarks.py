"""Compare probes with the cube, and state what to write into the experiment file where they differ."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from wavefield.errors import ExperimentError
from wavefield.series import Experiment
from wavefield.store.verdict import Remark

if TYPE_CHECKING:
    from wavefield.waves.probes.probe_fit import ProbeFit

MAX_STEPS = 1500  # of a long record, in its middle
MAX_NODES = 2000  # of each


def remark_on_probe_file(experiment: Experiment, span: tuple[float, float]) -> Iterator[Remark]:
    """Report probes that cannot be read, or that were recorded at other times than the frames (s)."""
    try:
        probes = experiment.read_probes()
    except ExperimentError as error:
        yield Remark("probes", "unreadable", "remark", str(error), "", "correct the file, or `probes:`")
        return
    if probes is None:
        return
    first, last = float(probes["time"][0]), float(probes["time"][-1])
    if first > span[1] or last < span[0]:
        yield Remark(
            "probes",
            "no overlap",
            "remark",
            f"they were recorded from {first:g} to {last:g} s, the frames from {span[0]:g} to {span[1]:g} s",
            "some time in common",
            "state the difference of the clocks as `clock` in `probes:`",
            {"first": first, "last": last},
        )


def compare_probes(experiment: Experiment, cube: xr.Dataset) -> "tuple[list[ProbeFit], float]":
    """How the probes of an experiment fit the elevation of its cube, and the interval of its steps, s.
    Of a long record the middle is compared, thinned in space.
    """
    from wavefield.waves.probes.probe_fit import fit_probes  # imports all of the analysis

    every = slice(None, None, max(1, int(np.sqrt(cube.z[0].size / MAX_NODES))))
    first = max(0, (len(cube.z) - MAX_STEPS) // 2)
    z = cube.z.isel(time=slice(first, first + MAX_STEPS), y=every, x=every).load()
    dt = float(z["time"][1] - z["time"][0]) if len(z) > 1 else 1.0
    return fit_probes(z, experiment.read_probes()), dt


def remark_on_fits(fits: "Iterable[ProbeFit]", dt: float) -> Iterator[Remark]:
    """Report what does not fit of each probe."""
    for fit in fits:
        values = {"correlation": fit.peak_correlation, "best": fit.best, "lag": fit.lag, "gain": fit.gain}
        for kind, sentence, remedy in fit.problems(dt):
            yield Remark(
                f"probe {fit.name}", kind, "remark", sentence, "as the elevation there", remedy, values
            )


def remark_on_probes(experiment: Experiment, cube: xr.Dataset, span: tuple[float, float]) -> Iterator[Remark]:
    """Report what is wrong with the probes of an experiment, or between them and its cube."""
    of_file = list(remark_on_probe_file(experiment, span))
    yield from of_file
    if experiment.probes and not of_file:
        yield from remark_on_fits(*compare_probes(experiment, cube))
