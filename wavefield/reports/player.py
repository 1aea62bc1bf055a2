"""The moving pictures of the report: a stretch of the cube, packed for drawing in the browser."""

import base64
import json

import numpy as np
import xarray as xr
from matplotlib import colormaps

from wavefield.figures.style import SIGNED, limit

_MOST_NODES = 20_000  # per field: more is not seen on a screen
_MOST_BYTES = 4_500_000  # of packed fields: leaves room for the figures in 15 MB
_ARROWS = 24  # along the longer side


def _code(values: np.ndarray, half: float) -> np.ndarray:
    """Values to bytes: 0 where missing, 1 to 255 for -half to half."""
    scaled = np.clip(np.round(128 + 127 * values / half), 1, 255)
    return np.where(np.isfinite(values), scaled, 0).astype(np.uint8)


def _text(raw: bytes) -> str:
    return base64.b64encode(raw).decode()


def stretch(cube: xr.Dataset) -> xr.Dataset:
    """Consecutive steps in the middle of the record, thinned in space, that fit into the page.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube.

    Returns
    -------
    Dataset
        z, u, v, w of a part of it, loaded.
    """
    thin = max(1, int(np.ceil(np.sqrt(cube.sizes["x"] * cube.sizes["y"] / _MOST_NODES))))
    part = cube[["z", "u", "v", "w"]].isel(x=slice(None, None, thin), y=slice(None, None, thin))
    most = max(2, _MOST_BYTES // (2 * part.sizes["x"] * part.sizes["y"]))
    first = max(0, (part.sizes["time"] - most) // 2)
    return part.isel(time=slice(first, first + most)).transpose("time", "y", "x").load()


def pack(cube: xr.Dataset) -> dict[str, str]:
    """Data for the browser.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with z (m) and u, v, w (m s-1).

    Returns
    -------
    dict of str to str
        Name of an element of the page to its text: fields as base64, their description as JSON.
    """
    part = stretch(cube)
    z, w = 100 * part.z.values.astype(float), 100 * part.w.values.astype(float)
    half = {"z": limit(z), "w": limit(w)}
    every = max(1, round(max(part.sizes["x"], part.sizes["y"]) / _ARROWS))
    thin = slice(every // 2, None, every)
    arrows = part[["u", "v"]].isel(x=thin, y=thin)
    fastest = limit(100 * np.hypot(arrows.u.values.astype(float), arrows.v.values.astype(float)), 98)
    description = {
        "nx": part.sizes["x"],
        "ny": part.sizes["y"],
        "x": [float(part.x[0]), float(part.x[-1])],
        "y": [float(part.y[0]), float(part.y[-1])],
        "time": [round(float(t), 6) for t in part.time.values],
        "half": half,
        "arrows": {
            "x": [float(v) for v in arrows.x.values],
            "y": [float(v) for v in arrows.y.values],
            "fastest": fastest,
            "length": 1.4 * every * float(np.mean(np.diff(part.x.values))),
        },
        "colours": [[round(255 * c) for c in colormaps[SIGNED](i / 255)[:3]] for i in range(256)],
    }
    return {
        "field-description": json.dumps(description),
        "field-z": _text(_code(z, half["z"]).tobytes()),
        "field-w": _text(_code(w, half["w"]).tobytes()),
        "field-u-arrows": _text(_code(100 * arrows.u.values.astype(float), fastest * 1.3).tobytes()),
        "field-v-arrows": _text(_code(100 * arrows.v.values.astype(float), fastest * 1.3).tobytes()),
    }


MARKUP = """
<div class="player" id="player">
<div class="views">
<canvas id="map" width="760" height="600" role="img" tabindex="0"
 aria-label="Map of the chosen field with arrows of the horizontal velocity, at the slider's time"></canvas>
<canvas id="relief" width="760" height="600" role="img" tabindex="0"
 aria-label="The surface in 3D at the slider's time, coloured by w; arrow keys turn it"></canvas>
</div>
<div class="controls">
<button type="button" id="play" aria-pressed="false">Play</button>
<label for="moment">Time</label>
<input type="range" id="moment" min="0" value="0" step="1">
<output id="clock" for="moment"></output>
<label for="shown">Map shows</label>
<select id="shown">
<option value="w">vertical velocity w</option><option value="z">elevation z</option>
</select>
</div>
<p>Arrow keys move the slider; drag the surface, or focus it and use the arrow keys, to turn it.</p>
<noscript><p>The moving pictures need JavaScript; the still ones below do not.</p></noscript>
</div>
"""
