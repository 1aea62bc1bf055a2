"""Fields for the screen: palettes, arrows, relief, values in words. Arrays in, arrays out."""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from wavefield.figures.display import display
from wavefield.figures.style import limit

_HEAD = 0.32  # of an arrow's length
Field = NDArray[np.floating]


@cache
def palette(colour_map: str) -> list[str]:
    """256 colours of a matplotlib colour map."""
    return [to_hex(colour) for colour in colormaps[colour_map](np.linspace(0, 1, 256))]


def top_speed(u: Field, v: Field) -> float:
    """Speed of the longest arrows of a velocity field, m/s; 0 where nothing was measured."""
    speed = np.hypot(u, v)
    return limit(speed, 98) if np.isfinite(speed).any() else 0.0


def arrows(
    u: Field, v: Field, x: Field, y: Field, fastest: float, *, along: int = 24
) -> tuple[Field, Field, float]:
    """Arrows of the horizontal velocity at about `along` nodes along the longer side.

    With u, v (ny, nx); x, y (nx,), metres; returns xs, ys (7 n,): n arrows in one line, metres, each of six
    points and a NaN that separates it from the next; and the arrows' metres per m/s.
    """
    every = max(1, round(max(len(x), len(y)) / along))
    thin = slice(every // 2, None, every)
    gap = every * float(np.mean(np.diff(x)))
    metres = 1.2 * gap / fastest if fastest > 0 else 0.0
    px, py = np.meshgrid(x[thin], y[thin])
    dx, dy = metres * u[thin, thin], metres * v[thin, thin]
    drawn = np.hypot(dx, dy) > 0.04 * gap  # False where NaN
    px, py, dx, dy = (part[drawn] for part in (px, py, dx, dy))
    left = dx - 0.5 * dy, dy + 0.5 * dx  # direction of the two strokes of the head
    right = dx + 0.5 * dy, dy - 0.5 * dx
    tip_x, tip_y, gap_after = px + dx, py + dy, np.full_like(px, np.nan)
    xs = [px, tip_x, tip_x - _HEAD * left[0], tip_x, tip_x - _HEAD * right[0], tip_x, gap_after]
    ys = [py, tip_y, tip_y - _HEAD * left[1], tip_y, tip_y - _HEAD * right[1], tip_y, gap_after]
    return np.array(xs).T.ravel(), np.array(ys).T.ravel(), metres


def relief(field: Field, x: Field, y: Field, most: int = 80) -> tuple[Field, Field, Field]:
    """A field (ny, nx) and its axes, thinned to at most `most` nodes along the longer side."""
    every = max(1, -(-max(field.shape) // most))
    return field[::every, ::every], x[::every], y[::every]


def readings(values: Mapping[str, float], names: Sequence[str]) -> str:
    """Values at a node in words, with units."""
    words = []
    for name in names:
        shown = display(name)
        value = values[name] * shown.factor
        text = f"{value:.3g}".replace("-", "\u2212") if np.isfinite(value) else "none"
        words.append(f"{name} {text}" + (f" {shown.unit}" if shown.unit and np.isfinite(value) else ""))
    return ", ".join(words)
