"""The terms of the standard uncertainties of one step, by name."""

from pathlib import Path

import xarray as xr

from wavefield.errors import WavefieldError
from wavefield.execution.process import one_thread
from wavefield.pipeline.chunk import make_chunk, measure_chunk
from wavefield.pipeline.learning import learn_record
from wavefield.pipeline.prepare import prepare
from wavefield.rig import Rig
from wavefield.series import Experiment


def uncertainty_terms(
    experiment: str | Path | Experiment,
    step: int | None = None,
    rig: str | Path | Rig | None = None,
) -> xr.Dataset:
    """Terms of the standard uncertainties of one step; their squares add up to those of z_std, u_std, ...

    Parameters
    ----------
    experiment : path or Experiment
        As for `run`.
    step : int, optional
        Step of the record, from 0; by default the one in the middle.
    rig : path or Rig, optional
        As for `run`.

    Returns
    -------
    Dataset, (term, y, x)
        z in m, u, v, w in m/s; ``term``: noise (through the estimator, times chi^2), prior (waves that the
        prior removes), frames (waves that turn too fast for the frames), ripples (shorter than a block) and
        setup (epipolar error, height of beads, light sheet). NaN where nothing was measured.

    Raises
    ------
    WavefieldError
        If there is no such step, or no frames from which the record's spectra can be learned.

    Examples
    --------
    >>> import tempfile
    >>> from wavefield.tank import Scene, simulate
    >>> scene = Scene.load("demo").with_(rig={"crop": 0.15}, frames=6, sea={"shortest": 0.15})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     terms = uncertainty_terms(simulate(scene, folder), rig=scene.build_rig())
    >>> terms.term.values.tolist()
    ['noise', 'prior', 'frames', 'ripples', 'setup']
    >>> rms = (terms.z**2).mean(("y", "x")) ** 0.5
    >>> bool(rms.sel(term="noise") > rms.sel(term="frames"))
    True
    """
    from wavefield.measurement.error_budget import TERMS

    prepared = prepare(experiment, rig)
    step = prepared.steps // 2 if step is None else step
    if not 0 <= step < prepared.steps:
        raise WavefieldError(f"step {step}: the record has steps 0 to {prepared.steps - 1}")
    rate, geometry = prepared.experiment.frame_rate, prepared.geometry
    prepared = prepared.with_prior(learn_record(prepared.series, prepared.steps, geometry, rate))
    if prepared.model is None:
        raise WavefieldError(f"{prepared.experiment.path}: none of the sample frames can be measured")
    chunk = make_chunk(prepared.series, step, step + 1, prepared.departures)
    with one_thread():
        found = measure_chunk(chunk, geometry, rate, prepared.model, terms=True)
    terms = found.fields["uncertainty_terms"][0]
    scale = {"z": 1.0, "u": rate, "v": rate, "w": rate}
    units = {name: {"units": "m" if name == "z" else "m s-1"} for name in scale}
    return xr.Dataset(
        {n: (("term", "y", "x"), terms[:, i] * k, units[n]) for i, (n, k) in enumerate(scale.items())},
        {"term": list(TERMS), "y": prepared.grid.y_nodes, "x": prepared.grid.x_nodes},
        {"step": step},
    )
