"""Compare probes with the cube, and state what to write into the experiment file where they differ."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield.errors import ExperimentError
from wavefield.series import Experiment
from wavefield.store.preview import read_steps
from wavefield.store.read import open_group
from wavefield.store.verdict import Remark

MAX_STEPS = 1500  # of a long record, in its middle
MAX_NODES = 2000  # of each
STEPS_PER_READ = 64  # steps read at once


def remark_on_probes(experiment: Experiment, store: Path) -> Iterator[Remark]:
    """Compare the probes of an experiment with its cube."""
    try:
        probes = experiment.read_probes()
    except ExperimentError as error:
        yield Remark("probes", "unreadable", "remark", str(error), "", "correct the file, or `probes:`")
        return
    if probes is None:
        return
    from wavefield.waves.probes.probe_fit import fit_probes  # imports all of the analysis

    z = _elevation(store)
    dt = float(z["time"][1] - z["time"][0]) if z.sizes["time"] > 1 else 1.0
    for fit in fit_probes(z, probes):
        values = {"correlation": fit.peak_correlation, "best": fit.best, "lag": fit.lag, "gain": fit.gain}
        for kind, sentence, remedy in fit.problems(dt):
            yield Remark(
                f"probe {fit.name}", kind, "remark", sentence, "as the elevation there", remedy, values
            )


def _elevation(store: Path) -> xr.DataArray:
    """z of the middle of the record, thinned in space."""
    group = open_group(store)
    count, ny, nx = group["z"].shape
    every = max(1, int(np.sqrt(ny * nx / MAX_NODES)))
    first = max(0, (count - MAX_STEPS) // 2)
    last = min(count, first + MAX_STEPS)
    pieces = [
        read_steps(group, "z", k, min(k + STEPS_PER_READ, last))[:, ::every, ::every]
        for k in range(first, last, STEPS_PER_READ)
    ]
    coords = {
        "time": np.asarray(group["time"][first:last]),
        "y": np.asarray(group["y"][::every]),
        "x": np.asarray(group["x"][::every]),
    }
    return xr.DataArray(np.concatenate(pieces), coords, ("time", "y", "x"))
