"""A cube as the dataset that PIVPy works on."""

import numpy as np
import xarray as xr

from wavefield.variables import Quality


def to_pivpy(cube: xr.Dataset) -> xr.Dataset:
    """Arrange a cube as PIVPy's datasets are: dims (y, x, t), vectors u, v and their flag ``chc``.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        As from `open_cube`; lazy values stay so.

    Returns
    -------
    Dataset, (y, x, t)
        u, v, w (m s-1), z (m), and ``chc``: 1 where measured, 0 where filled, -1 where outside or rejected;
        ``delta_t`` (s) among the attributes.

    Raises
    ------
    KeyError
        If the dataset has no u, v and quality.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> field = ("time", "y", "x"), np.zeros((2, 3, 4), "float32")
    >>> quality = ("time", "y", "x"), np.ones((2, 3, 4), "uint8")
    >>> cube = xr.Dataset({"u": field, "v": field, "quality": quality}, {"time": [0.0, 0.1]})
    >>> sorted(to_pivpy(cube).sizes.items())
    [('t', 2), ('x', 4), ('y', 3)]
    """
    quality = cube["quality"]
    measured = (quality & np.uint8(Quality.MEASURED)) != 0
    filled = (quality & np.uint8(Quality.FILLED)) != 0
    chc = (measured.astype("int8") + (filled | measured).astype("int8") - np.int8(1)).astype("int8")
    chc.attrs = {"flag_values": [-1, 0, 1], "flag_meanings": "outside_or_rejected filled measured"}
    out = cube[[name for name in ("u", "v", "w", "z") if name in cube]].assign(chc=chc)
    out = out.rename({"time": "t"}).transpose("y", "x", "t")
    steps = np.diff(np.asarray(cube["time"], float))
    out.attrs = {
        "delta_t": float(np.median(steps)) if steps.size else float("nan"),
        "files": "",
        "variables": ["x", "y", *(str(name) for name in out.data_vars)],
        "units": ["m", "m", *(str(out[name].attrs.get("units", "1")) for name in out.data_vars)],
    }
    return out
