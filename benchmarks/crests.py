"""B = u / c at crests of a measured cube beside that of exact fields: for `bound` and `waves`."""

import numpy as np
import xarray as xr

import wavefield as wf
from wavefield.grid import largest_rectangle

FIELDS = ["z", "z_t", "u", "v", "w"]
STEPS = 80  # of the middle of a record
EDGE = 3  # nodes


def inside(cube: xr.Dataset) -> xr.Dataset:
    """The middle of a record on the largest rectangle that is measured throughout, without its edge."""
    first = max((cube.sizes["time"] - STEPS) // 2, 0)
    some = cube[FIELDS].isel(time=slice(first, first + STEPS)).load()
    (a, b), (c, d) = largest_rectangle(some["z"].notnull().all("time").values)
    part = some.isel(y=slice(a + EDGE, b - EDGE), x=slice(c + EDGE, d - EDGE))
    return part.assign_attrs(cube.attrs)


def print_table(cube: xr.Dataset, truth: xr.Dataset) -> None:
    """Print the difference of B from images and B of the exact fields, by the same estimator.

    Compared are nodes where both have a crest and the exact B is below 1.
    """
    measured = inside(cube)
    exact = truth[FIELDS].sel(time=measured.time, method="nearest")
    exact = exact.interp(y=measured.y, x=measured.x, assume_sorted=True).load()
    exact = exact.assign_coords(time=measured.time).assign_attrs(cube.attrs)
    for name in FIELDS:
        exact[name].attrs["units"] = measured[name].attrs["units"]
    ours, theirs = (wf.breaking(fields)["B"].values for fields in (measured, exact))
    z = exact["z"].values
    print("\n| B at crests | nodes | within .03 | within .05 | half within | rms | B |\n" + "|---" * 7 + "|")
    for words, higher in (("all", -np.inf), ("beyond two standard deviations", 2 * z.std())):
        both = np.isfinite(ours) & (theirs < 1) & (z > higher)
        off = np.abs(ours - theirs)[both]
        low, high = np.percentile(theirs[both], [5, 95])
        cells = [f"{off.size}", *(f"{np.mean(off < limit):.3f}" for limit in (0.03, 0.05))]
        cells += [f"{np.median(off):.4f}", f"{np.sqrt(np.mean(off**2)):.3f}", f"{low:.2f} to {high:.2f}"]
        print(f"| {words} | {' | '.join(cells)} |", flush=True)
