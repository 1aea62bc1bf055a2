"""The moving pictures of the report: consecutive steps of a cube, packed for drawing in the browser."""

import base64
import json
import zlib

import numpy as np
import xarray as xr
from matplotlib import colormaps

from wavefield.figures.display import BALANCE, DERIVED, POSITIVE, SIGNED, display, limit
from wavefield.figures.quality_kinds import KINDS, quality_kind
from wavefield.reports.html_page import Picture, Player
from wavefield.variables import TABLE
from wavefield.waves.nonlinear.kinematics import kinematic_fields

MAX_NODES = 8_000  # per field: a screen shows no more
MAX_BYTES = 5_500_000  # of the fields before they are compressed, to a third or less
_ARROWS = 24  # along the longer side
_VARIABLES = ("w", "z", "z_t", "u", "v", *DERIVED, "eps_y", "eps_piv", "z_std", "u_std", "v_std", "w_std")
# steps of 255 levels, of fields that are mostly noise
_COARSE = {"residual": 8, "eps_y": 8, "eps_piv": 8, "vorticity": 2, "divergence": 2}


def player(cube: xr.Dataset, still: Picture) -> Player:
    """The player of a cube (time, y, x), and what stands for it where there are no scripts."""
    data = pack(cube)
    names = [row["name"] for row in json.loads(data["field-description"])["fields"]]
    return Player([(name, TABLE[name].long_name) for name in names], data, still)


def excerpt(cube: xr.Dataset) -> xr.Dataset:
    """Consecutive steps in the middle of the record, thinned in space, that fit into the page."""
    thin = max(1, int(np.ceil(np.sqrt(cube.sizes["x"] * cube.sizes["y"] / MAX_NODES))))
    nodes = -(-cube.sizes["x"] // thin) * -(-cube.sizes["y"] // thin)
    steps = max(2, MAX_BYTES // ((len(_VARIABLES) + 1) * nodes))
    first = max(0, (cube.sizes["time"] - steps) // 2)
    part = cube[[n for n in (*_VARIABLES, "quality") if n in cube]].isel(time=slice(first, first + steps))
    part = part.transpose("time", "y", "x").load()
    if set(BALANCE) <= set(part):
        part = part.merge(kinematic_fields(part[list(BALANCE)])[list(DERIVED)])
    return part.isel(x=slice(None, None, thin), y=slice(None, None, thin))


def _code(values: np.ndarray, low: float, high: float, step: int = 1) -> str:
    """Values (time, y, x) as text: 0 where missing, 1 to 255 from low to high, in steps about the middle."""
    scaled = np.clip(1 + 254 * (values - low) / (high - low), 1, 255)
    coded = np.clip(128 + step * np.round((scaled - 128) / step), 1, 255)
    return _text(np.where(np.isfinite(values), coded, 0))


def _text(codes: np.ndarray) -> str:
    """Bytes (time, y, x) as text: differences along x and y, modulo 256, compressed, in base 64."""
    values = codes.astype(np.uint8)
    differences = np.diff(np.diff(values, axis=2, prepend=np.uint8(0)), axis=1, prepend=np.uint8(0))
    return base64.b64encode(zlib.compress(differences.tobytes(), 9)).decode()


def pack(cube: xr.Dataset) -> dict[str, str]:
    """Data for the browser from a cube (time, y, x), by the name of the element that holds it."""
    part = excerpt(cube)
    out, fields = {}, []
    for name in (name for name in _VARIABLES if name in part):
        shown = display(name)
        values = shown.factor * part[name].values.astype(float)
        high = limit(values)
        low = -high if shown.signed else 0.0
        out[f"field-{name}"] = _code(values, low, high, _COARSE.get(name, 1))
        row = {"name": name, "words": shown.long_name, "unit": shown.unit, "low": low, "high": high}
        fields.append(row | {"colours": "signed" if shown.signed else "positive"})
    if "quality" in part:
        kinds = quality_kind(part.quality.values)
        out["field-quality"] = _text(np.where(kinds < len(KINDS), kinds + 1, 0))
        row = {"name": "quality", "words": TABLE["quality"].long_name, "unit": "", "colours": "kinds"}
        fields.append(row | {"low": 0.5, "high": len(KINDS) + 0.5})
    every = max(1, round(max(part.sizes["x"], part.sizes["y"]) / _ARROWS))
    thin = slice(every // 2, None, every)
    arrows = 100 * part[["u", "v"]].isel(x=thin, y=thin).astype(float)
    fastest = limit(np.hypot(arrows.u.values, arrows.v.values), 98)
    out["field-description"] = json.dumps(
        {
            "nx": part.sizes["x"],
            "ny": part.sizes["y"],
            "x": [float(part.x[0]), float(part.x[-1])],
            "y": [float(part.y[0]), float(part.y[-1])],
            "time": [round(float(t), 6) for t in part.time.values],
            "fields": fields,
            "kinds": [[words, colour] for _, words, colour in KINDS],
            "arrows": {
                "nx": arrows.sizes["x"],
                "ny": arrows.sizes["y"],
                "x": arrows.x.values.tolist(),
                "y": arrows.y.values.tolist(),
                "fastest": fastest,
                "length": 1.4 * every * float(np.mean(np.diff(part.x.values))),
            },
            "colours": {
                kind: np.rint(255 * colormaps[name](np.linspace(0, 1, 256))[:, :3]).astype(int).tolist()
                for kind, name in (("signed", SIGNED), ("positive", POSITIVE))
            },
        }
    )
    top = 1.3 * fastest
    for name in ("u", "v"):
        out[f"field-{name}-arrows"] = _code(arrows[name].values, -top, top)
    return out
