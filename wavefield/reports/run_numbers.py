"""Numbers of a whole run: sizes of the fields, shares of nodes, states of steps; computed when first used."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr

from wavefield.pipeline import Run
from wavefield.reports.run_data import thinned
from wavefield.variables import FrameStatus, Quality

_FIELDS = ("z", "u", "v", "w", "eps_y", "eps_piv", "quality")


@dataclass(frozen=True, eq=False)
class RunNumbers:
    """What the first pages of a report state of a run."""

    run: Run

    @cached_property
    def part(self) -> xr.Dataset:
        """The fields (time, y, x), with fewer steps where they are large."""
        return thinned(self.run.cube, *_FIELDS)

    @cached_property
    def _measured(self) -> int:
        return int(((self.part.quality & int(Quality.MEASURED)) != 0).sum())

    @cached_property
    def n_in_view(self) -> int:
        """How many values are of nodes in view; at least 1."""
        quality = self.part.quality
        seen = (quality != 0) & ((quality & np.uint16(Quality.OUTSIDE | Quality.MASKED)) == 0)
        return max(int(seen.sum()), 1)

    @property
    def in_view(self) -> float:
        """Fraction of the grid's nodes that are in view."""
        return float(self.n_in_view / self.part.quality.size)

    @property
    def measured(self) -> float:
        """Fraction of the grid's nodes that were measured."""
        return float(self._measured / self.part.quality.size)

    @property
    def measured_in_view(self) -> float:
        """Fraction of the nodes in view that were measured."""
        return self._measured / self.n_in_view

    @cached_property
    def step_status(self) -> str:
        """How many steps have which status."""
        status = self.run.cube.frame_status.values
        counts = {s.name.lower().replace("_", " "): int((status == s).sum()) for s in FrameStatus}
        return ", ".join(f"{n} {words}" for words, n in counts.items() if n)
