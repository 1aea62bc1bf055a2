"""Velocity of the surface water between two instants, from each camera's own displacement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.matching import Reason
from wavefield.measurement.plan import Plan, Sight
from wavefield.measurement.regrid import coefficients, fill, levelled, read_anchored
from wavefield.measurement.surface import why_rejected
from wavefield.rig.stereo import solve_displacement
from wavefield.variables import Quality

Float = NDArray[Any]

_STD_FLOOR = 0.010  # px: what interpolation leaves and neighbouring blocks share


@dataclass(frozen=True)
class Motion:
    """Displacement of the surface water during one step, anchored at the nodes at mid-time.

    Parameters
    ----------
    d, d_std : ndarray, (3, ny, nx)
        (dx, dy, dz) and its standard uncertainty, metres; NaN where fewer than two cameras see the node.
    eps_piv : ndarray, (ny, nx)
        Misfit of the cameras' displacements, px.
    quality : ndarray of uint8, (ny, nx)
        Bits of `Quality`: why a camera's displacement was rejected; `FILLED` where not enough of them were
        measured.
    """

    d: NDArray
    d_std: NDArray
    eps_piv: NDArray
    quality: NDArray[np.uint8]


def displacement_at(
    found: matching.Displacement, sight: Sight, X: NDArray, Y: NDArray
) -> tuple[Float, Float, NDArray[np.uint8]]:
    """One camera's displacement of the patches whose paths have their mid-points at given pixels.

    Parameters
    ----------
    found : Displacement
        From the first frame to the second.
    sight : Sight
        The camera.
    X, Y : ndarray, shape S
        Mid-points, px of the (binned) image; NaN where not seen.

    Returns
    -------
    d, std : ndarray of float32, (2,) + S
        Displacement along X and Y and its standard uncertainty, px of the (binned) image.
    rejected : ndarray of uint8, S
        Bits of `Quality`; 0 where measured.
    """
    valid = found.valid
    fields = np.stack([found.u, found.v], axis=-1)
    if not valid.all():
        # what left the image is no hole in it
        wanted = (found.reason & np.uint8(Reason.EDGE | Reason.MASKED)) == 0
        fields = fill(fields, valid, wanted, sight.energy)
    std = levelled(np.stack(_block_std(found)), valid).reshape(2, -1)
    d, block = read_anchored(coefficients(fields, sight.response), sight.lattice, X, Y)
    rejected = why_rejected(found.reason.ravel()[block])
    return d, np.hypot(np.take(std, block, axis=1), np.float32(_STD_FLOOR)), rejected


def _block_std(found: matching.Displacement) -> tuple[Float, Float]:
    """Standard uncertainty of the blocks' u and v, px."""
    gain = min(1.0, found.gain * found.settings.relaxation)
    u, v = (
        matching.std_from_influence(influence, found.settings, field=field, gain=gain, restored=True)
        for influence, field in ((found.influence_u, found.u), (found.influence_v, found.v))
    )
    return u, v


def velocity(
    first: Mapping[str, matching.Prepared], second: Mapping[str, matching.Prepared], z: NDArray, plan: Plan
) -> Motion | None:
    """Displacement of the surface water at the nodes.

    Parameters
    ----------
    first, second : mapping of str to Prepared
        Those of the cameras that have a usable frame at the first and at the second instant.
    z : ndarray, (ny, nx)
        Elevation at mid-time, metres.
    plan : Plan
        Everything computed beforehand.

    Returns
    -------
    Motion or None
        None if fewer than two cameras have both frames.

    Notes
    -----
    d = argmin sum w (J d - dX)^2, J the 2N x 3 Jacobian at the node's position on the surface at mid-time, dX
    the displacements read at X - dX/2, w from their uncertainty. eps' = |J d - dX| / sqrt(2N).
    """
    names = [n for n in first if n in second]
    if len(names) < 2:
        return None
    count = len(names)
    shape = z.shape
    jacobian = np.empty((2 * count, 3, *shape), np.float64)
    moved = np.empty((2 * count, *shape), np.float64)
    std = np.empty((2 * count, *shape), np.float64)
    trusted = np.zeros((count, *shape), bool)
    rejected = np.zeros(shape, np.uint8)
    for n, name in enumerate(names):
        sight = plan.sights[name]
        at = sight.at(z)
        X, Y = at[0], at[1]
        inside = sight.sees(X, Y)
        X, Y = np.where(inside, X, np.float32(np.nan)), np.where(inside, Y, np.float32(np.nan))
        d, d_std, why = displacement_at(
            matching.match(first[name], second[name], plan.settings.piv), sight, X, Y
        )
        rows = slice(2 * n, 2 * n + 2)
        jacobian[rows] = at[2:].reshape(2, 3, *shape)
        moved[rows] = d
        # a filled displacement must not outvote a measured one
        std[rows] = np.where(why == 0, d_std, np.float32(30.0) * d_std)
        trusted[n] = inside & (why == 0)
        rejected |= np.where(inside, why, np.uint8(0))
    d, eps, d_std = solve_displacement(
        np.moveaxis(jacobian, (0, 1), (-2, -1)), np.moveaxis(moved, 0, -1), np.moveaxis(std, 0, -1)
    )
    enough = trusted.sum(axis=0) >= 2
    quality = np.where(enough, np.uint8(0), rejected | np.uint8(Quality.FILLED))
    return Motion(np.moveaxis(d, -1, 0), np.moveaxis(d_std, -1, 0), eps, quality.astype(np.uint8))
