"""The surface over time in the report: consecutive steps of a cube, packed for drawing in the browser."""

import base64
import json
import zlib

import numpy as np
import xarray as xr
from matplotlib import colormaps

from wavefield.figures.display import SIGNED, limit
from wavefield.reports.html import Picture, Player

MAX_NODES = 8_000  # per field: a screen shows no more
MAX_BYTES = 1_500_000  # of the uncompressed fields; compression halves them at least
_ARROWS = 24  # along the longer side


def player(cube: xr.Dataset, still: Picture) -> Player:
    """The player of a cube (time, y, x), and the picture that stands for it where there are no scripts."""
    return Player(pack(cube), still)


def excerpt(cube: xr.Dataset) -> xr.Dataset:
    """Consecutive steps in the middle of the record, thinned in space, that fit into the page."""
    thin = max(1, int(np.ceil(np.sqrt(cube.sizes["x"] * cube.sizes["y"] / MAX_NODES))))
    nodes = -(-cube.sizes["x"] // thin) * -(-cube.sizes["y"] // thin)
    steps = max(2, MAX_BYTES // (2 * nodes))
    first = max(0, (cube.sizes["time"] - steps) // 2)
    part = cube[["z", "u", "v", "w"]].isel(time=slice(first, first + steps))
    thinned = part.isel(x=slice(None, None, thin), y=slice(None, None, thin))
    return thinned.transpose("time", "y", "x").load()


def _code(values: np.ndarray, half: float) -> str:
    """Values (time, y, x) as text: 0 where missing, 1 to 255 from -half to half.
    Differences along x and y, modulo 256, compressed, in base 64.
    """
    scaled = np.round(np.clip(128 + 127 * values / half, 1, 255))
    codes = np.where(np.isfinite(values), scaled, 0).astype(np.uint8)
    differences = np.diff(np.diff(codes, axis=2, prepend=np.uint8(0)), axis=1, prepend=np.uint8(0))
    return base64.b64encode(zlib.compress(differences.tobytes(), 9)).decode()


def pack(cube: xr.Dataset) -> dict[str, str]:
    """Data for the browser from a cube (time, y, x), by the name of the element that holds it."""
    part = excerpt(cube)
    every = max(1, round(max(part.sizes["x"], part.sizes["y"]) / _ARROWS))
    thin = slice(every // 2, None, every)
    arrows = 100 * part[["u", "v"]].isel(x=thin, y=thin).astype(float)
    fastest = limit(np.hypot(arrows.u.values, arrows.v.values), 98)
    fields = {name: 100 * part[name].values.astype(float) for name in "zw"}
    ends = {name: limit(values) for name, values in fields.items()}
    description = {
        "nx": part.sizes["x"],
        "ny": part.sizes["y"],
        "x": [float(part.x[0]), float(part.x[-1])],
        "y": [float(part.y[0]), float(part.y[-1])],
        "time": [round(float(t), 6) for t in part.time.values],
        "ends": ends,  # ends of the colour scales of z (cm) and w (cm/s)
        "arrows": {
            "x": arrows.x.values.tolist(),
            "y": arrows.y.values.tolist(),
            "fastest": fastest,
            "length": 1.4 * every * float(np.mean(np.diff(part.x.values))),
        },
        "colours": np.rint(255 * colormaps[SIGNED](np.linspace(0, 1, 256))[:, :3]).astype(int).tolist(),
    }
    out = {"field-description": json.dumps(description)}
    out |= {f"field-{name}": _code(values, ends[name]) for name, values in fields.items()}
    return out | {f"field-{name}": _code(arrows[name].values, 1.3 * fastest) for name in "uv"}
