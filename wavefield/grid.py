"""The regular physical grid on which every quantity is wanted."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Grid:
    """Nodes of a regular grid on the plane of the water at rest.

    Parameters
    ----------
    x, y : tuple of float
        First and last node along each axis, metres.
    step : float
        Distance between nodes, metres; the same along both axes.

    Raises
    ------
    ValueError
        If the step is not positive or an axis holds fewer than two nodes.

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

    def _axis(self, ends: tuple[float, float]) -> np.ndarray:
        # one multiplication per node and rounding to the nanometre: 0.1 + 0.2 must print as 0.3
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
