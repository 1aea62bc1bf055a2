"""Each pair of cameras by itself: what the paper's accuracy section compares."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import xarray as xr

from wavefield.measurement import Plan, Settings, measure
from wavefield.report.sources import Sources
from wavefield.variables import CUBE_DIMS, annotate

_STEPS = 3
_FIELDS = ("z", "u", "v", "w", "eps_y", "eps_piv")


def measure_pairs(sources: Sources, middle: int) -> xr.Dataset | None:
    """Measure a few steps with every pair of cameras on its own, and with all of them.

    Parameters
    ----------
    sources : Sources
        With the rig and the experiment, whose images must still be there.
    middle : int
        Step around which to measure.

    Returns
    -------
    Dataset, (pair, time, y, x) or None
        z, eps_y (m), u, v, w (m s-1), eps_piv (px); the pair "all" is the run's own choice. None if there are
        no images, or fewer than two cameras, or fewer than three frames.
    """
    if not sources.frames or sources.rig is None or len(sources.rig) < 2:
        return None
    rig, grid, rate = sources.rig, sources.grid, float(sources.cube.attrs["frame_rate"])
    settings = Settings.from_dict(sources.recipe.get("settings", {}))
    series = sources.frames
    steps = len(next(iter(series.values()))) - 1
    first = int(np.clip(middle - _STEPS // 2, 0, max(steps - _STEPS, 0)))
    count = min(_STEPS, steps)
    numbers = range(first - 1, first + count + 2)
    frames = {
        name: [series[name].read(n).image if 0 <= n <= steps else None for n in numbers] for name in rig
    }
    # the reference of the run comes first in a pair, so that pairs share its lattice where they can
    names = list(dict.fromkeys([*(pair[0] for pair in settings.pairs), *rig]))
    chosen = {"all": settings} | {
        f"{a}-{b}": replace(settings, pairs=((a, b),), velocity_cameras=(a, b))
        for a, b in combinations(names, 2)
    }
    if len(chosen) == 2:  # one pair is all there is
        del chosen["all"]
    parts = []
    for choice in chosen.values():
        found = measure(frames, Plan(rig, grid, choice), rate)
        parts.append({name: found[name] for name in _FIELDS})
    return annotate(
        xr.Dataset(
            {name: (("pair", *CUBE_DIMS), np.stack([part[name] for part in parts])) for name in _FIELDS},
            {
                "pair": list(chosen),
                "time": sources.cube.time.values[0] + (first + np.arange(count)) / rate,
                "y": sources.cube.y.values,
                "x": sources.cube.x.values,
            },
            {"frame_rate": rate},
        )
    )
