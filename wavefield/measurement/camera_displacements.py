"""Each camera's displacement at the nodes, read along the path of the water in its images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled
from wavefield.measurement.flow import CameraFlow, Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.paths import five, read_path
from wavefield.measurement.rolling_shutter import middle_row, row_delay
from wavefield.measurement.sight import Sight
from wavefield.measurement.time_weights import noise_of_displacements, noise_weights
from wavefield.measurement.uneven_paths import displacement_weights, read_uneven_path
from wavefield.variables import Quality

Float = NDArray[np.floating]


@dataclass(frozen=True)
class CameraDisplacements:
    """Displacements of each of N cameras at the nodes."""

    jacobian: Float  # (2N, 3, ny, nx): px per metre
    moved: Float  # (2N, ny, nx): per step at mid-time, px; NaN where the camera does not see the node
    noise: Float  # (2N, ny, nx): variance by noise, and by what the prior removes or adds, px^2
    missing: Float
    rejected: NDArray[np.uint16]  # (N, ny, nx): why not measured: bits of `Quality`; `OUTSIDE` where not seen
    frames: NDArray[np.uint8]  # (ny, nx): places of the paths: 2, 4 or 6, the fewest of all cameras'
    chord: (
        Float  # (2N, ny, nx): displacement over the step, and the mean of the places in its two frames less
    )
    bend: Float  # that at mid-time, px
    axes: (
        Float  # (N, 3): viewing direction of each camera over its distance from the middle of the field, 1/m
    )

    def without(self, n: int) -> CameraDisplacements:
        """The same without one camera."""
        rows, cameras = [2 * n, 2 * n + 1], n
        of_rows = ("jacobian", "moved", "noise", "missing", "chord", "bend")
        parts = {name: np.delete(getattr(self, name), rows, axis=0) for name in of_rows}
        parts |= {name: np.delete(getattr(self, name), cameras, axis=0) for name in ("rejected", "axes")}
        return replace(self, **parts)


def displacements_at_nodes(
    names: Sequence[str],
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    times: Float | None = None,
    every: int = 1,
) -> CameraDisplacements:
    """Displacements of the named cameras at every n-th node along x and y on the surface z, metres.
    z is at all nodes. Uneven times of the six frames are in intervals from mid-time.
    """
    z = z[::every, ::every]
    count, shape = len(names), z.shape
    jacobian = np.empty((2 * count, 3, *shape), np.float32)
    moved, chord, bend, noise, missing = np.empty((5, 2 * count, *shape), np.float32)
    rejected = np.empty((count, *shape), np.uint16)
    frames = np.full(shape, 6, np.uint8)
    axes = np.empty((count, 3))
    middle = np.array([np.mean(geometry.x), np.mean(geometry.y), 0.0])
    for n, name in enumerate(names):
        sight = geometry.sights[name]
        at = sight.at(z, every)
        visible = sight.sees(at[0], at[1])
        X, Y = np.where(visible, at[:2], np.float32(np.nan))
        path = [None if f is None else f.get(name) for f in steps]
        rows = slice(2 * n, 2 * n + 2)
        jacobian[rows] = at[2:].reshape(2, 3, *shape)
        delay = row_delay(name, geometry)
        when = times if times is not None or not delay else np.arange(6) - 2.5
        late: Float | float = delay * (Y - middle_row(sight)) if delay else 0.0
        found, block, noise[rows], missing[rows] = _along_path(path, sight, X, Y, path_frames, when, -late)
        if delay:  # what moves down is seen later in the next frame
            found[:2] /= 1.0 + delay * found[1]
        moved[rows], chord[rows], bend[rows] = found[:2], found[2:4], found[4:]
        axes[n] = sight.camera.R[2] / (sight.camera.R[2] @ middle + sight.camera.T[2])
        here = path[len(path) // 2]
        assert here is not None
        rejected[n] = np.where(visible, here.rejected.ravel()[block[2]], np.uint16(Quality.OUTSIDE))
        frames = np.where(visible, np.minimum(frames, _places_read(block)), frames)
    return CameraDisplacements(jacobian, moved, noise, missing, rejected, frames, chord, bend, axes)


def _along_path(
    path: Sequence[CameraFlow | None],
    sight: Sight,
    X: Float,
    Y: Float,
    frames: int,
    times: Float | None,
    at_time: Float | float = 0.0,
) -> tuple[Float, NDArray[np.int64], Float, Float]:
    """Path of one camera at given pixels (`read_path`), blocks read, variances by noise and by the prior."""
    here = path[len(path) // 2]
    assert here is not None
    splines = [None if f is None else f.spline for f in path]
    valid = [None if f is None else f.valid for f in path]
    if times is None:
        d, block = read_path(splines, valid, sight.lattice, X, Y, frames)
    else:
        at_time = np.nan_to_num(at_time)
        d, block = read_uneven_path(splines, valid, sight.lattice, X, Y, times, at_time, frames)
    noises = [None if f is None else f.noise.reshape(len(f.noise), -1) for f in five(path)]
    if times is not None:
        weights = noise_of_displacements(displacement_weights(times, block, at_time, frames)[1])
        parts = (
            w * np.take(one, np.maximum(at, 0), axis=1)
            for w, one, at in zip(weights, noises, block)
            if one is not None
        )
        noise = sum(parts)
    else:
        noise = np.empty((len(here.noise), block[0].size), np.float32)
        own, near, _ = (*noise_weights(4), 0.0)
        weights = np.array([[1.0, 0.0, 0.0], [own, near, 0.0], noise_weights(max(frames, 6))], np.float32)
        some = [noises[2] if one is None else one for one in noises]
        _noise_along(tuple(map(np.ascontiguousarray, some)), block.reshape(5, -1), weights, noise)
        noise = noise.reshape(-1, *block.shape[1:])
    return d, block, noise, np.take(here.missing.reshape(len(here.missing), -1), block[2], axis=1)


@compiled(error_model="numpy")
def _noise_along(noises: tuple[Float, ...], block: NDArray[np.int64], weights: Float, out: Float) -> None:
    """Fill out (c, n) with the noise (c, blocks) of five steps at the blocks read (5, n), -1 where none was.
    The weights (3, 3) of the step, its neighbours and theirs are for paths of two, four and six places.
    """
    bb, b, c, a, aa = noises
    for k in range(block.shape[1]):
        near = block[1, k] >= 0 and block[3, k] >= 0
        far = near and block[0, k] >= 0 and block[4, k] >= 0
        w = weights[int(near) + int(far)]
        for i in range(len(out)):
            total = w[0] * c[i, block[2, k]]
            if near:
                total += w[1] * (b[i, block[1, k]] + a[i, block[3, k]])
            if far:
                total += w[2] * (bb[i, block[0, k]] + aa[i, block[4, k]])
            out[i, k] = total


def _places_read(block: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Number of places of paths, from the blocks read for them: 2, 4 or 6."""
    near, far = (block[[2 - n, 2 + n]] >= 0 for n in (1, 2))
    return np.asarray(2 + 2 * near.all(axis=0) + 2 * far.all(axis=0), np.uint8)
