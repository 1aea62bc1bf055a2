"""The regular grid of nodes on which every quantity is measured."""

from dataclasses import dataclass

import numpy as np

MOST_NODES = 20_000_000  # one node per pixel of a camera of 20 Mpx; more is a wrong unit


@dataclass(frozen=True)
class Grid:
    """Nodes of a regular grid on the plane of the water at rest, z = 0.

    Parameters
    ----------
    x, y : tuple of float
        Lower and upper limit along each axis, metres. The first node is at the lower limit.
    step : float
        Distance between nodes, metres; the same along both axes.

    Raises
    ------
    ValueError
        If the step is not positive, an axis has fewer than two nodes, or the grid has more than 20 million.

    Examples
    --------
    >>> grid = Grid(x=(-1.0, 1.0), y=(-0.75, 0.75), step=0.01)
    >>> grid.shape
    (151, 201)
    """

    x: tuple[float, float]
    y: tuple[float, float]
    step: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", (float(self.x[0]), float(self.x[1])))
        object.__setattr__(self, "y", (float(self.y[0]), float(self.y[1])))
        object.__setattr__(self, "step", float(self.step))
        if not self.step > 0:
            raise ValueError(f"grid step must be positive, got {self.step} m")
        for name, (lo, hi) in (("x", self.x), ("y", self.y)):
            if not hi - lo >= self.step:
                raise ValueError(f"grid {name} runs from {lo} to {hi} m: less than one step of {self.step} m")
        nodes = np.prod([(hi - lo) / self.step + 1 for lo, hi in (self.x, self.y)])
        if not nodes <= MOST_NODES:
            raise ValueError(
                f"a grid of {nodes:.3g} nodes cannot be measured (at most {MOST_NODES:.0e}); are its limits "
                "and its step in metres?"
            )

    def _axis(self, ends: tuple[float, float]) -> np.ndarray:
        """Return node positions along an axis, (n,), metres; `ends` are its lower and upper limit."""
        # rounded to the nanometre, so that 0.1 + 0.2 is 0.3
        n = int(np.floor((ends[1] - ends[0]) / self.step + 1e-6)) + 1
        return np.round(ends[0] + self.step * np.arange(n), 9)

    @property
    def x_nodes(self) -> np.ndarray:
        """Positions of the nodes along x, (nx,), metres."""
        return self._axis(self.x)

    @property
    def y_nodes(self) -> np.ndarray:
        """Positions of the nodes along y, (ny,), metres."""
        return self._axis(self.y)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of nodes (ny, nx)."""
        return self.y_nodes.size, self.x_nodes.size


def largest_rectangle(mask: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the largest rectangle of a mask (ny, nx) in which all nodes are True.
    It is given by (first, stop) of its rows and (first, stop) of its columns; stop is excluded."""
    ny, nx = mask.shape
    height = np.zeros(nx, int)
    best, where = 0, ((0, 0), (0, 0))
    for i in range(ny):
        height = np.where(mask[i], height + 1, 0)
        stack: list[tuple[int, int]] = []  # (column where it starts, height)
        for j in range(nx + 1):
            h = int(height[j]) if j < nx else 0
            start = j
            while stack and stack[-1][1] >= h:
                start, top = stack.pop()
                if top * (j - start) > best:
                    best, where = top * (j - start), ((i + 1 - top, i + 1), (start, j))
            stack.append((start, h))
    return where
