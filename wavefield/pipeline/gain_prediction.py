"""The gain of a cube's measurement, predicted from its recipe."""

import xarray as xr

from wavefield.errors import CubeError
from wavefield.measurement import GridGeometry, LearnedRecord, Settings
from wavefield.measurement.response import tabulated
from wavefield.pipeline.opened_run import Run
from wavefield.waves.estimation.window_gain import PREDICTED, label


def predicted_gain(cube: xr.Dataset) -> xr.Dataset:
    """Predict the gain of the measurement from what a cube's run learned of its record.

    Parameters
    ----------
    cube : Dataset
        A cube with its recipe among its attributes, as `wavefield run` writes it.

    Returns
    -------
    Dataset
        As `wavefield.waves.estimation.window_gain` gives it, without coherences.

    Raises
    ------
    CubeError
        If the cube does not state how it was made.

    Notes
    -----
    By linear theory: `wavefield.measurement.response.gains`.

    Examples
    --------
    >>> import wavefield as wf
    >>> gain = wf.predicted_gain(wf.open_cube("cube.zarr"))  # doctest: +SKIP
    >>> waves = wf.analyze("cube.zarr", gain=gain)  # doctest: +SKIP

    A cube from elsewhere does not state how it was made:

    >>> predicted_gain(xr.Dataset())
    Traceback (most recent call last):
        ...
    wavefield.errors.CubeError: the cube does not state how it was made ...
    """
    run = Run(cube)
    try:
        if run.rig is None:
            raise KeyError("rig")
        settings = Settings.from_dict(run.recipe["settings"])
        record = LearnedRecord.from_dict(run.recipe["record"])
    except (KeyError, TypeError, ValueError) as error:
        raise CubeError(
            f"the cube does not state how it was made ({error}): measure the gain of its windows, window_gain"
        ) from None
    table = tabulated(GridGeometry(run.rig, run.grid, settings), record)
    return label({name: table[f"gain_{name}"] for name in "zuvw"}, table["k"], PREDICTED)
