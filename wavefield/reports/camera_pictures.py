"""What each camera showed over the record, and how well each pair of them agreed."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, panels, plain_axes
from wavefield.store.verdict import Numbers

_MARKERS = "os^Dv*"


def _draw(axes: Axes, time: Sequence[float], curves: Mapping[str, Sequence[float]], label: str) -> None:
    """Draw one number of every camera or pair over time, from zero."""
    for k, (name, values) in enumerate(curves.items()):
        style = LINES[1 + k % (len(LINES) - 1)]
        axes.plot(time, values, marker=_MARKERS[k % len(_MARKERS)], markersize=4, label=name, **style)
    most = max((float(np.nanmax(v)) for v in curves.values() if np.isfinite(v).any()), default=1.0)
    axes.set(xlabel="time (s)", ylabel=label, ylim=(0.0, 1.12 * most or 1.0))
    plain_axes(axes, loc="best", fontsize=8.5)


def camera_history(time: Sequence[float], cameras: Numbers, pairs: Numbers) -> Figure:
    """Sharpness, brightness and free view of every camera, agreement of every pair, over the record."""
    figure, axes = panels(3, 2 if pairs else 1, width=3.8, height=2.7)
    _draw(axes[0, 0], time, {n: c["blur"] for n, c in cameras.items()}, "width of the finest details (px)")
    levels = {n: c["brightness"] for n, c in cameras.items()}
    _draw(axes[0, 1], time, levels, "mean brightness (grey levels)")
    free = {n: [100 * v for v in c["coverage"]] for n, c in cameras.items()}
    _draw(axes[0, 2], time, free, "view not covered (%)")
    if pairs:
        agreed = {n: [100 * v for v in p["agreement"]] for n, p in pairs.items()}
        _draw(axes[1, 0], time, agreed, "patches found in both (%)")
        _draw(axes[1, 1], time, {n: p["eps_y"] for n, p in pairs.items()}, "sight lines miss by (px)")
        axes[1, 2].set_axis_off()
    return figure
