"""Averages over the phase of waves of known period, such as those of a wave maker."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves.inputs import a_cube, takes
from wavefield.waves.record import FIELDS, Record, find_record
from wavefield.waves.welch import Reader

Array = NDArray[Any]

MIN_PERIODS = 4  # chosen: fewer cannot be separated from other waves of nearly the same period
HARMONICS = 3  # of Stokes waves, the third has 3/8 (k a)^2 of the first: 3 % at k a = 0.3


@takes(a_cube)
def phase_average(cube: xr.Dataset, period: float, *, phases: int = 24) -> xr.Dataset:
    """Average a cube over the phase of waves of known period.

    Parameters
    ----------
    cube : Dataset
        z (m) and, where present, z_t, u, v, w (m/s) over (time, y, x). A cube on disk is read in pieces.
    period : float
        Period of the waves, s. Phase 0 is at time 0 of the cube.
    phases : int, optional
        Number of phases per period, 24 by default.

    Returns
    -------
    Dataset
        Each field averaged over (phase, y, x), in its own units; ``<field>_std``, its standard uncertainty;
        ``<field>_rest`` (y, x), the standard deviation in time of the part that does not repeat; ``phase``,
        rad; ``steps`` (phase), the sum of the weights of steps; ``harmonic_amplitude``, m, and
        ``harmonic_phase``, rad, (harmonic, y, x), of the first three harmonics of z, NaN for harmonics near
        or above the Nyquist frequency. Attribute ``period``, s.

    Raises
    ------
    CubeError
        If the cube has no z or fewer than four periods, or if periods or phases have too few steps.

    Notes
    -----
    Each step contributes to the two nearest phases, which damps harmonics; ``harmonic_amplitude`` is fitted
    and not damped. The uncertainty assumes that the non-repeating parts of steps are independent.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.phase_average(wf.open_cube("sea.zarr"), period=0.5, phases=8)
    >>> found.z.dims, found.harmonic_amplitude.dims
    (('phase', 'y', 'x'), ('harmonic', 'y', 'x'))
    """
    names = [name for name in FIELDS if name in cube]
    if "z" not in names:
        raise CubeError("the cube has no 'z': phase averages need it")
    fields = validate(cube, *names)
    record = find_record(fields)
    steps = np.concatenate([np.arange(a, b) for a, b in record.runs])
    time = fields["time"].values.astype(float)[steps]
    periods = time.size * record.dt / period if period > 0 else 0.0
    if not 2 * record.dt < period or periods < MIN_PERIODS:
        raise CubeError(
            f"the record holds {periods:.3g} periods of {period:g} s, of steps of {record.dt:g} s: four"
            " periods of more than two steps are needed"
        )
    angle = 2 * np.pi * time / period
    weights = phase_weights(angle, phases)
    if (weights > 0).sum(axis=0).min() < 2:
        raise CubeError(
            f"some of the {phases} phases have fewer than two steps of {record.dt:g} s: choose fewer phases"
        )
    # harmonics beyond the Nyquist frequency are aliases of others
    count = min(HARMONICS, int(0.95 * period / (2 * record.dt)))
    harmonics = [f(n * angle) for n in range(1, count + 1) for f in (np.cos, np.sin)]
    design = np.column_stack([np.ones(time.size), *harmonics])
    sums = _sums(Reader([fields[n] for n in names], record), names, weights, design)
    return _label(fields, record, names, weights, design, sums).assign_attrs(period=period)


def phase_weights(angle: Array, phases: int) -> Array:
    """Return weights (steps, phases) that split each step between the two phases next to its `angle`, rad."""
    place = angle / (2 * np.pi) * phases
    low = np.floor(place)
    out = np.zeros((angle.size, phases))
    rows = np.arange(angle.size)
    out[rows, low.astype(int) % phases] = 1 - (place - low)
    out[rows, (low.astype(int) + 1) % phases] += place - low
    return out


def _sums(read: Reader, names: list[str], weights: Array, design: Array) -> dict[str, Array]:
    """Return three sums over steps for each field, with nodes (y, x) as last axes. "mean <field>" has the
    weights `weights` (steps, phases), and "fit <field>" the weights `design` (steps, n). "square <field>" is
    the sum of squares, without weights."""
    sums: dict[str, Array] = {}
    first = 0
    for run in read.record.runs:
        for blocks in read.blocks(run):
            part = slice(first, first + blocks[0].shape[0])
            for name, block in zip(names, blocks):
                values = block.astype(float)
                for kind, factors in (("mean", weights[part]), ("fit", design[part])):
                    key = f"{kind} {name}"
                    sums[key] = sums.get(key, 0) + np.tensordot(factors, values, (0, 0))
                sums[f"square {name}"] = sums.get(f"square {name}", 0) + (values**2).sum(axis=0)
            first = part.stop
    return sums


def _label(
    fields: xr.Dataset,
    record: Record,
    names: list[str],
    weights: Array,
    design: Array,
    sums: dict[str, Array],
) -> xr.Dataset:
    total = weights.sum(axis=0)
    count, phases = weights.shape
    # effective number of steps in a weighted mean
    independent = (total**2 / (weights**2).sum(axis=0))[:, None, None]
    normal = np.linalg.inv(design.T @ design)
    dims = ("phase", "y", "x")
    out: dict[str, Any] = {"steps": ("phase", total)}
    for name in names:
        mean = sums[f"mean {name}"] / total[:, None, None]
        fit = np.tensordot(normal, sums[f"fit {name}"], 1)
        rest = (sums[f"square {name}"] - (fit * sums[f"fit {name}"]).sum(axis=0)) / (count - design.shape[1])
        rest = np.sqrt(np.maximum(rest, 0.0))
        out[name], out[f"{name}_rest"] = (dims, mean), (("y", "x"), rest)
        out[f"{name}_std"] = (dims, rest / np.sqrt(independent))
        if name == "z":
            amplitude = np.full((HARMONICS, *rest.shape), np.nan + 0j)
            amplitude[: len(fit) // 2] = fit[1::2] - 1j * fit[2::2]
            out["harmonic_amplitude"] = (("harmonic", "y", "x"), np.abs(amplitude))
            out["harmonic_phase"] = (("harmonic", "y", "x"), np.angle(amplitude))
    y, x = fields["y"].values[slice(*record.y)], fields["x"].values[slice(*record.x)]
    coords = {
        "phase": np.arange(phases) * 2 * np.pi / phases,
        "harmonic": np.arange(1, HARMONICS + 1),
        "y": y,
        "x": x,
    }
    return annotate(xr.Dataset(out, coords), "phase")
