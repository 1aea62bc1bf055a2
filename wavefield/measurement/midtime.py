"""Elevation and rate of rise half-way between two frames, from the four frames around."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.elevation import Surface

Float = NDArray[Any]
Mask = NDArray[np.bool_]
Surfaces = Sequence[Surface | None]

F = np.float32


def at_mid_time(surfaces: Surfaces) -> tuple[Float, Float, Float]:
    """Elevation, its standard uncertainty and its rise per step.

    Parameters
    ----------
    surfaces : sequence of four Surface or None
        Of the frame before, of the two frames of the step, which must be there, and of the frame after.

    Returns
    -------
    z, std, rise : ndarray of float32, (ny, nx)
        Metres.

    Notes
    -----
    z = (9 (z_0 + z_1) - z_-1 - z_2) / 16 and z_t dt = (27 (z_1 - z_0) - z_2 + z_-1) / 24, which is
    (26 r - r_before - r_after) / 24 for the rises r from frame to frame: the same mean as of displacements,
    so that z_t changes with w. Where a neighbour is missing a parabola serves, (3 z_0 + 6 z_1 - z_2) / 8 and
    z_1 - z_0; where both are, the mean.

    The same beads in the same places err the same way in all frames, so their errors do not average out.
    """
    before, first, second, after = surfaces
    assert first is not None
    assert second is not None
    std = F(0.5) * (first.std + second.std)
    rise = second.z - first.z
    if before is not None and after is not None:
        z = (F(9) * (first.z + second.z) - before.z - after.z) / F(16)
        return z, std, (F(27) * rise - (after.z - before.z)) / F(24)
    if after is not None:
        return (F(3) * first.z + F(6) * second.z - after.z) / F(8), std, rise
    if before is not None:
        return (F(3) * second.z + F(6) * first.z - before.z) / F(8), std, rise
    return F(0.5) * (first.z + second.z), std, rise


def squared_phase(surfaces: Surfaces, dz: Float, inside: Mask) -> float:
    """Mean (omega dt)^2 of the waves in view, from the highest differences in time that there are.

    Parameters
    ----------
    surfaces : sequence of four Surface or None
        As for `at_mid_time`.
    dz : ndarray, (ny, nx)
        Displacement of the water upwards in the step, metres.
    inside : ndarray of bool, (ny, nx)
        Nodes that count.

    Returns
    -------
    float
        From two frames it can only be guessed, from how far the water rises in a step and how high it stands.
    """
    before, first, second, after = surfaces
    assert first is not None
    assert second is not None
    if not inside.any():
        return 0.0
    rise = (second.z - first.z)[inside]
    if before is not None and after is not None:
        third = (after.z - before.z)[inside] - F(3) * rise
        return float(np.sqrt(np.mean(third**2) / max(np.mean(rise**2), 1e-30)))
    z = 0.5 * (first.z + second.z)[inside]
    if before is not None or after is not None:
        three = [one.z[inside] for one in surfaces if one is not None]
        bend = three[0] - 2 * three[1] + three[2]
        return float(np.sqrt(np.mean(bend**2) / max(np.var(z), 1e-30)))
    return float(np.nanmean(dz[inside] ** 2) / max(np.mean(z**2), 1e-30))


def left_out_of_z(surfaces: Surfaces, z: Float, squared: float, inside: Mask) -> Float:
    """What the finite time step leaves out of z at mid-time.

    Parameters
    ----------
    surfaces : sequence of four Surface or None
        As for `at_mid_time`.
    z : ndarray, (ny, nx)
        Elevation at mid-time, metres.
    squared : float
        `squared_phase`.
    inside : ndarray of bool, (ny, nx)
        Nodes that count.

    Returns
    -------
    ndarray, (ny, nx)
        Metres. Of a wave of phase p = omega dt per step two frames leave out p^2/8, a parabola p^3/16, four
        frames 3/16 p^2 of what they add to the mean of two.
    """
    before, first, second, after = surfaces
    assert first is not None
    assert second is not None
    if before is not None and after is not None:
        correction = z - F(0.5) * (first.z + second.z)
        return np.asarray(0.1875 * squared * typical(correction, inside))
    if before is not None or after is not None:
        return np.asarray(0.0625 * squared**1.5 * typical(z, inside))
    return np.asarray(0.125 * squared * typical(z, inside))


def left_out_of_displacement(squared: float, chord: Mask) -> Float:
    """Fraction of a displacement that the finite time step leaves out.

    Parameters
    ----------
    squared : float
        `squared_phase`.
    chord : ndarray of bool, (ny, nx)
        Where a path has fewer than four places.

    Returns
    -------
    ndarray, (ny, nx)
        3/640 p^4 from four frames; p^2/24 from two, and a third as much again because the chord lies beside
        the path.
    """
    return np.where(chord, squared / 18.0, squared**2 * (3.0 / 640.0))


def typical(field: Float, inside: Mask) -> Float:
    """Half what is here, half what is elsewhere: errors do not vanish where a field passes through zero.

    Parameters
    ----------
    field : ndarray, (ny, nx)
        Any field.
    inside : ndarray of bool, (ny, nx)
        Nodes that count.

    Returns
    -------
    ndarray, (ny, nx)
    """
    elsewhere = np.nanmean(np.square(field[inside])) if inside.any() else 0.0
    return np.sqrt(0.5 * (np.square(field) + elsewhere))
