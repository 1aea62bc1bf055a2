"""The moving pictures of the report: a stretch of the cube, packed for drawing in the browser."""

import base64
import html
import json
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps

from wavefield.figures.quality import KINDS, quality_kind
from wavefield.figures.style import POSITIVE, SIGNED, limit
from wavefield.variables import TABLE
from wavefield.waves.nonlinear.kinematics import kinematics

_MOST_NODES = 8_000  # per field: more is not seen on a screen
_MOST_BYTES = 5_500_000  # of packed fields: leaves room for the figures in 15 MB
_ARROWS = 24  # along the longer side
_BALANCE = ("z", "z_t", "u", "v", "w")
_DERIVED = ("vorticity", "divergence", "residual")
# variable: factor from its stored unit, shown unit, whether it has a sign
_SHOWN: dict[str, tuple[float, str, bool]] = {
    "w": (100.0, "cm/s", True),
    "z": (100.0, "cm", True),
    "z_t": (100.0, "cm/s", True),
    "u": (100.0, "cm/s", True),
    "v": (100.0, "cm/s", True),
    "vorticity": (1.0, "1/s", True),
    "divergence": (1.0, "1/s", True),
    "residual": (100.0, "cm/s", True),
    "eps_y": (1000.0, "mm", True),
    "eps_piv": (1.0, "px", False),
    "z_std": (1000.0, "mm", False),
    "u_std": (100.0, "cm/s", False),
    "v_std": (100.0, "cm/s", False),
    "w_std": (100.0, "cm/s", False),
}


def _code(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Values to bytes: 0 where missing, 1 to 255 from low to high."""
    scaled = np.clip(np.round(1 + 254 * (values - low) / (high - low)), 1, 255)
    return np.where(np.isfinite(values), scaled, 0).astype(np.uint8)


def _text(raw: bytes) -> str:
    return base64.b64encode(raw).decode()


def stretch(cube: xr.Dataset) -> xr.Dataset:
    """Consecutive steps in the middle of the record, thinned in space, that fit into the page.

    With cube (time, y, x).
    """
    thin = max(1, int(np.ceil(np.sqrt(cube.sizes["x"] * cube.sizes["y"] / _MOST_NODES))))
    nodes = -(-cube.sizes["x"] // thin) * -(-cube.sizes["y"] // thin)
    most = max(2, _MOST_BYTES // ((len(_SHOWN) + 1) * nodes))
    first = max(0, (cube.sizes["time"] - most) // 2)
    part = cube[[n for n in (*_SHOWN, "quality") if n in cube]].isel(time=slice(first, first + most))
    part = part.transpose("time", "y", "x").load()
    if set(_BALANCE) <= set(part):
        part = part.merge(kinematics(part[list(_BALANCE)])[list(_DERIVED)])
    return part.isel(x=slice(None, None, thin), y=slice(None, None, thin))


def _field(values: np.ndarray, name: str) -> tuple[np.ndarray, dict[str, Any]]:
    """A variable as bytes, and how they are to be read."""
    factor, unit, signed = _SHOWN[name]
    shown = factor * values.astype(float)
    half = limit(shown)
    low = -half if signed else 0.0
    row = {"name": name, "words": TABLE[name].long_name, "unit": unit, "low": low, "high": half}
    return _code(shown, low, half), row | {"colours": "signed" if signed else "positive"}


def pack(cube: xr.Dataset) -> dict[str, str]:
    """Data for the browser.

    With cube (time, y, x).
    """
    part = stretch(cube)
    out, fields = {}, []
    for name in (name for name in _SHOWN if name in part):
        code, row = _field(part[name].values, name)
        out[f"field-{name}"] = _text(code.tobytes())
        fields.append(row)
    if "quality" in part:
        kinds = quality_kind(part.quality.values)
        out["field-quality"] = _text(np.where(kinds < len(KINDS), kinds + 1, 0).astype(np.uint8).tobytes())
        fields.append(
            {"name": "quality", "words": TABLE["quality"].long_name, "unit": "", "colours": "kinds"}
            | {"low": 0.5, "high": len(KINDS) + 0.5}
        )
    every = max(1, round(max(part.sizes["x"], part.sizes["y"]) / _ARROWS))
    thin = slice(every // 2, None, every)
    arrows = 100 * part[["u", "v"]].isel(x=thin, y=thin).astype(float)
    fastest = limit(np.hypot(arrows.u.values, arrows.v.values), 98)
    top = 1.3 * fastest
    description = {
        "nx": part.sizes["x"],
        "ny": part.sizes["y"],
        "x": [float(part.x[0]), float(part.x[-1])],
        "y": [float(part.y[0]), float(part.y[-1])],
        "time": [round(float(t), 6) for t in part.time.values],
        "fields": fields,
        "kinds": [[words, colour] for _, words, colour in KINDS],
        "arrows": {
            "x": [float(v) for v in arrows.x.values],
            "y": [float(v) for v in arrows.y.values],
            "fastest": fastest,
            "length": 1.4 * every * float(np.mean(np.diff(part.x.values))),
        },
        "colours": {
            kind: [[round(255 * c) for c in colormaps[name](i / 255)[:3]] for i in range(256)]
            for kind, name in (("signed", SIGNED), ("positive", POSITIVE))
        },
    }
    out["field-description"] = json.dumps(description)
    out["field-u-arrows"] = _text(_code(arrows.u.values, -top, top).tobytes())
    out["field-v-arrows"] = _text(_code(arrows.v.values, -top, top).tobytes())
    return out


def markup(cube: xr.Dataset) -> str:
    """The player's place on the page."""
    there = [n for n in (*_SHOWN, "quality") if n in cube or n in _DERIVED]
    options = "".join(
        f'<option value="{name}">{html.escape(f"{name}: {TABLE[name].long_name}")}</option>' for name in there
    )
    return _MARKUP.replace("OPTIONS", options)


_MARKUP = """
<div class="player" id="player">
<div class="views">
<canvas id="map" width="760" height="600" role="img" tabindex="0"
 aria-label="Map of the chosen field with arrows of the horizontal velocity, at the slider's time"></canvas>
<canvas id="relief" width="760" height="600" role="img" tabindex="0"
 aria-label="The surface in 3D at the slider's time, coloured by the chosen one; arrow keys turn it"></canvas>
</div>
<p class="kinds" id="kinds" hidden></p>
<div class="controls">
<button type="button" id="play" aria-pressed="false">Play</button>
<label for="moment">Time</label>
<input type="range" id="moment" min="0" value="0" step="1">
<output id="clock" for="moment"></output>
<span class="choice"><label for="shown">Shown</label> <select id="shown">OPTIONS</select></span>
</div>
<p>Arrow keys move the slider; drag the surface, or focus it and use the arrow keys, to turn it.</p>
<noscript><p>The moving pictures need JavaScript; the still ones below do not.</p></noscript>
</div>
"""
