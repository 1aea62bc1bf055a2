"""Points of still water matched in several cameras, by which a rig is checked and refined."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import CalibrationError
from wavefield.measurement import pair_surface
from wavefield.measurement.frame import ready, usable
from wavefield.measurement.geometry import GridGeometry

_STRIDE_BLOCKS = 5  # nearer ones share their window


def matched_pixels(
    read: Callable[[str, int], NDArray[Any] | None],
    frames: Sequence[int],
    geometry: GridGeometry,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Pixels (column, row) of the same points of the surface in each camera's images, (n, 2)."""
    rig = geometry.rig
    cells = np.s_[::_STRIDE_BLOCKS, ::_STRIDE_BLOCKS]
    x, y = (v[cells] for v in np.meshgrid(geometry.lattice.x, geometry.lattice.y))
    parts: dict[str, list[NDArray[np.float64]]] = {name: [] for name in geometry.surface_cameras}
    for done, index in enumerate(frames, 1):
        images = {name: read(name, index) for name in geometry.surface_cameras}
        if all(usable(image, rig[name].size) for name, image in images.items()):
            flat = {
                name: pair_surface.prepare(
                    ready(np.asarray(image), geometry.sights[name].binning), name, geometry
                )
                for name, image in images.items()
            }
            valid = np.zeros(x.shape, bool)
            found = {}
            for a, b in geometry.pairs:
                match = pair_surface.match_pair(flat[a], flat[b], (a, b), geometry)
                dx, dy = (np.where(match.matched, d, np.nan)[cells] for d in match.difference)
                found[b] = np.stack(rig[b].project(x + dx, y + dy, 0.0), axis=-1)
                valid |= match.matched[cells]
            found[geometry.reference] = np.stack(rig[geometry.reference].project(x, y, 0.0), axis=-1)
            for name, pixels in found.items():
                parts[name].append(pixels[valid])
        if progress:
            progress(done, len(frames))
    if not any(parts.values()):
        raise CalibrationError(
            f"none of the {len(frames)} frames tried is there, and of the rig's size, in all of "
            f"{', '.join(parts)}: nothing to match"
        )
    return {name: np.concatenate(pixels) for name, pixels in parts.items()}
