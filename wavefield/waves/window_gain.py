"""The gain of the matching windows over k, measured on a simulated experiment whose truth is known."""

from itertools import pairwise
from typing import Any

import dask
import numpy as np
import xarray as xr

from wavefield.errors import CubeError
from wavefield.variables import CUBE_DIMS
from wavefield.waves import crosses, segments, spectra
from wavefield.waves.dispersion import dispersion
from wavefield.waves.record import Record, find_record

_NEAR = 0.12  # of omega: half the width of the band around the ridge
_LINES = 3  # but so many lines of the spectrum at least
_LEAST_COHERENCE = 0.3  # squared, with the truth: below it the gain is not known
_PAIRS = (("true z", "measured z"), ("true w", "measured w"))


def window_gain(
    measured: xr.Dataset,
    exact: xr.Dataset,
    *,
    depth: float | None = None,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Gain of what the cameras measure over what is there, for waves on the ridge.

    Parameters
    ----------
    measured : Dataset
        Cube measured from simulated images: z_t, w over (time, y, x), m/s.
    exact : Dataset
        Its truth at the same steps and nodes (``truth/truth.zarr``): z_t, m/s, and dz, m.
    depth : float, optional
        Depth of the water, m; the attribute ``water_depth`` of the cube, or deep, if not given.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``gain_z``, ``gain_w`` (k): amplitude gain of the elevation and of the displacement dz, 1 where
        nothing is lost; ``coherence_z``, ``coherence_w`` (k): squared coherence with the truth. A gain is NaN
        from where that falls below 0.3. Computed at once.

    Raises
    ------
    CubeError
        If a variable is missing, the truth is of other steps or nodes, or the record is too short.

    Notes
    -----
    H = Re <F_true* F_measured> / <|F_true|^2>, over angle and the band of the ridge. It holds for the
    cameras, the windows and the texture that were simulated; undo it with ``undo(E, gain ** 2, noise)``.
    """
    for dataset, needed, what in ((measured, ("z_t", "w"), "cube"), (exact, ("z_t", "dz"), "truth")):
        for name in needed:
            if name not in dataset:
                raise CubeError(f"the {what} has no {name!r}: the gain of the windows needs it")
    for name in CUBE_DIMS:
        same = measured.sizes[name] == exact.sizes[name]
        if not same or not np.allclose(measured[name].values, exact[name].values, rtol=0, atol=1e-6):
            raise CubeError(f"cube and truth differ in {name!r}: they must hold the same steps and nodes")
    record = find_record(measured[["z_t", "w"]]) if record is None else record
    segment = segments.segment_length(record, segment)
    depth = float(measured.attrs.get("water_depth") or np.inf) if depth is None else depth
    table = spectra.ring_table(record)
    names = ("true z", "measured z", "true w", "measured w")
    fields = [exact["z_t"], measured["z_t"], exact["dz"] / record.dt, measured["w"]]

    def make(blocks: list[np.ndarray], first: int) -> dict[str, np.ndarray]:
        return {name: segments.transform_space(block) for name, block in zip(names, blocks)}

    runs = segments.half_segments(fields, record, segment // 2, make)
    task = dask.delayed(crosses.combine, pure=False)
    parts = [task(a, b, names, _PAIRS, (), table, record.dt) for run in runs for a, b in pairwise(run)]
    (sums,) = dask.compute(segments.in_order(parts))

    omega = spectra.omega_axis(segment, record.dt)
    ridge = dispersion(table.k, depth)[:, None]
    near = np.abs(omega - ridge) < np.maximum(_NEAR * ridge, _LINES * omega[1])
    out: dict[str, Any] = {}
    for name, (true, mine) in zip(("z", "w"), _PAIRS):
        with np.errstate(divide="ignore", invalid="ignore"):
            power, own, cross = ((sums[key] * near).sum(axis=1) for key in (true, mine, f"{true}*{mine}"))
            gain = cross.real / power
            coherence = np.abs(cross) ** 2 / (power * own)
        lost = np.cumsum((coherence < _LEAST_COHERENCE) & (np.arange(table.k.size) > 1)) > 0
        text = {"z": "elevation", "w": "displacement dz"}[name]
        out[f"gain_{name}"] = (
            "k",
            np.where(lost, np.nan, gain),
            {"long_name": f"amplitude gain of the {text}", "units": "1"},
        )
        out[f"coherence_{name}"] = (
            "k",
            coherence,
            {"long_name": f"squared coherence of the {text} with the truth", "units": "1"},
        )
    return xr.Dataset(out, spectra.k_coords(table.k), attrs={"segment": segment, "water_depth": depth})
