"""Fields for the screen: palettes, arrows, streamlines, relief, values in words. Arrays in, arrays out."""

from functools import cache

import numpy as np
from bokeh import palettes
from numpy.typing import NDArray

from wavefield.figures.display import limit

_ARROWS, _STREAMS, _RELIEF = 24, 22, 80  # arrows, seeds of streamlines, nodes along the longer side
_HEAD = 0.32  # of an arrow's length
_STREAM_STEP = 0.35  # of a streamline between two of its points, nodes
_STREAM_POINTS = 90  # of a streamline to either side of its seed, at most
_STREAM_GAP = 2.0  # between streamlines, of the lattice of their seeds
_PALETTES = {
    "RdBu_r": palettes.RdBu11, "cividis": palettes.Cividis256, "viridis": palettes.Viridis256,
    "inferno": palettes.Inferno256, "turbo": palettes.Turbo256, "gray": palettes.Greys256,
}  # fmt: skip
Field = NDArray[np.floating]


@cache
def palette(colour_map: str) -> list[str]:
    """256 colours of a matplotlib colour map, one of `place.COLOUR_MAPS`."""
    return list(palettes.interp_palette(_PALETTES[colour_map], 256))


def colour_limits(values: Field, signed: bool, log: bool) -> tuple[float, float]:
    """Ends of a colour scale that fits values, without the largest half percent; two digits."""
    high = float(f"{limit(values):.2g}")
    if log:
        positive = np.abs(values[np.isfinite(values) & (values != 0)])
        low = float(np.percentile(positive, 1)) if positive.size else 0.0
        return float(f"{max(low, 1e-4 * high):.1g}"), high
    return (-high if signed else 0.0), high


def top_speed(u: Field, v: Field) -> float:
    """Speed of the longest arrows of a velocity field, m/s; 0 where nothing was measured."""
    speed = np.hypot(u, v)
    return limit(speed, 98) if np.isfinite(speed).any() else 0.0


def arrows(u: Field, v: Field, x: Field, y: Field, fastest: float) -> tuple[Field, Field, float]:
    """Arrows xs, ys (7 n,), metres, of u, v (ny, nx), m/s, some 24 along the longer side; metres per m/s.
    Each of n arrows has six points and a NaN that separates it from the next.
    """
    every = max(1, round(max(len(x), len(y)) / _ARROWS))
    thin = slice(every // 2, None, every)
    gap = every * float(np.mean(np.diff(x)))
    metres = 1.2 * gap / fastest if fastest > 0 else 0.0
    px, py = np.meshgrid(x[thin], y[thin])
    dx, dy = metres * u[thin, thin], metres * v[thin, thin]
    drawn = np.hypot(dx, dy) > 0.04 * gap  # False where NaN
    return (*_with_heads(*(part[drawn] for part in (px, py, dx, dy))), metres)


def _with_heads(px: Field, py: Field, dx: Field, dy: Field) -> tuple[Field, Field]:
    """Arrows (n,) from points, metres, as one line (7 n,) with gaps."""
    left = dx - 0.5 * dy, dy + 0.5 * dx  # direction of the two strokes of the head
    right = dx + 0.5 * dy, dy - 0.5 * dx
    tip_x, tip_y, gap_after = px + dx, py + dy, np.full_like(px, np.nan)
    xs = [px, tip_x, tip_x - _HEAD * left[0], tip_x, tip_x - _HEAD * right[0], tip_x, gap_after]
    ys = [py, tip_y, tip_y - _HEAD * left[1], tip_y, tip_y - _HEAD * right[1], tip_y, gap_after]
    return np.array(xs).T.ravel(), np.array(ys).T.ravel()


def streamlines(u: Field, v: Field, x: Field, y: Field) -> tuple[Field, Field]:
    """Streamlines of the horizontal velocity u, v (ny, nx) as one line xs, ys (m,), metres, with gaps.
    The longest come first, and end where they enter a cell that another has passed.
    """
    gap = max(len(x), len(y)) / _STREAMS
    seeds = np.meshgrid(np.arange(gap / 2, len(x) - 1, gap), np.arange(gap / 2, len(y) - 1, gap))
    seed = np.array([part.ravel() for part in seeds])
    back, forth = _traced(u, v, seed, -1.0), _traced(u, v, seed, 1.0)
    lines = np.concatenate([back[:, :, :0:-1], forth], axis=2)  # (2, n, points), in nodes
    cells = np.nan_to_num(lines // (_STREAM_GAP * gap / 2), nan=-1.0).astype(np.int32)
    taken: set[tuple[int, int]] = set()
    xs: list[Field] = [np.empty(0)]
    ys: list[Field] = [np.empty(0)]
    gap_after = np.array([np.nan])
    scale = np.array([[float(np.mean(np.diff(x)))], [float(np.mean(np.diff(y)))]])
    for k in np.argsort(-np.isfinite(lines[0]).sum(axis=1), kind="stable"):
        part = _free_part(cells[:, k], taken)
        if part.stop - part.start < 8:
            continue
        taken.update(zip(*cells[:, k, part].tolist()))
        line = np.array([[x[0]], [y[0]]]) + scale * lines[:, k, part]
        middle = line.shape[1] // 2
        step = (line[:, middle] - line[:, middle - 1]) / _STREAM_STEP * 0.4 * gap / 0.32
        head = _with_heads(*(np.array([value]) for value in (*(line[:, middle] - step), *step)))
        xs += [line[0], gap_after, head[0][1:]]
        ys += [line[1], gap_after, head[1][1:]]
    return np.concatenate(xs), np.concatenate(ys)


def _traced(u: Field, v: Field, seed: Field, sign: float) -> Field:
    """Points (2, n, points) of lines along or against a velocity from seeds (2, n), in nodes; then NaN."""
    at, out = seed.astype(float), [seed.astype(float)]
    for _ in range(_STREAM_POINTS):
        halfway = at + 0.5 * sign * _STREAM_STEP * _direction(u, v, at)
        at = at + sign * _STREAM_STEP * _direction(u, v, halfway)
        out.append(at)
    return np.stack(out, axis=2)


def _direction(u: Field, v: Field, at: Field) -> Field:
    """Direction of a velocity (ny, nx) between nodes at points (2, n), bilinear; NaN beyond and in gaps."""
    rows, columns = u.shape
    inside = (at[0] >= 0) & (at[0] <= columns - 1) & (at[1] >= 0) & (at[1] <= rows - 1)
    i, j = (np.clip(np.nan_to_num(p), 0, n - 2).astype(int) for p, n in ((at[0], columns), (at[1], rows)))
    a, b = at[0] - i, at[1] - j
    found = np.array([
        (1 - b) * ((1 - a) * w[j, i] + a * w[j, i + 1]) + b * ((1 - a) * w[j + 1, i] + a * w[j + 1, i + 1])
        for w in (u, v)
    ])  # fmt: skip
    speed = np.hypot(found[0], found[1])
    return np.where(inside & (speed > 0), found / np.where(speed > 0, speed, 1.0), np.nan)


def _free_part(cells: NDArray[np.int32], taken: set[tuple[int, int]]) -> slice:
    """The stretch of a line about its seed, of cells (2, points), that is defined and not taken."""
    free = [cell[0] >= 0 and cell not in taken for cell in zip(*cells.tolist())]
    middle = len(free) // 2
    if not free[middle]:
        return slice(middle, middle)
    start, stop = middle, middle + 1
    while start > 0 and free[start - 1]:
        start -= 1
    while stop < len(free) and free[stop]:
        stop += 1
    return slice(start, stop)


def relief(field: Field, x: Field, y: Field) -> tuple[Field, Field, Field]:
    """A field (ny, nx) and its axes, thinned to at most 80 nodes along the longer side."""
    every = max(1, -(-max(field.shape) // _RELIEF))
    return field[::every, ::every], x[::every], y[::every]
