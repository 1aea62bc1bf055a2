"""Waves that several cameras have in common: their spectrum from products of the cameras' displacements.

The power of one camera's displacement contains its noise, and waves that are weaker than it are lost in the
level of the noise. The noise of two cameras is independent: in products it averages out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from wavefield.matching import Modes, Prior
from wavefield.matching.learned_spectrum import SHORTEST_IN_COMMON
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.wavenumber_rings import RINGS, SECTOR_ANGLES, SHORTEST_WAVENUMBER
from wavefield.measurement.flow import FlowEstimate
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.sight import Sight
from wavefield.measurement.temporal_truncation import detected_rings
from wavefield.measurement.unresolved_waves import MIN_SINE, sine_between
from wavefield.water import dispersion

Float = NDArray[Any]
Array = NDArray[np.float64]

_PROBABILITY = 0.3  # that a ring has waves which no camera shows alone
_LARGEST_SIGNAL_TO_NOISE = 1.0  # of such waves
_SHORTEST_WAVE = 0.035  # metres: in fine images shorter ones are searched for only where blocks resolve them
_RIM = 3  # nodes at the rim of what both cameras measure, that have less weight
_MIN_NODES = 100
_SHORTEST_ON_NODES = 0.95 * np.pi  # rad per node
_LARGEST_PHASE = 4.0  # rad per step: the rise of waves that turn further does not show their height
_EXCESS_VARIANCE = 1.7  # of products on still water: both components of a camera have noise in common
_TINY = 1e-30


@dataclass(frozen=True)
class OpenField:
    """One camera's displacement in one step, under a prior that suppresses no wave."""

    prior: Prior
    modes: Modes
    found: FlowEstimate

    def at_nodes(self, sight: Sight, z: Float) -> Array:
        """The field with all modes at the same power where the camera sees the nodes, (2, ny, nx).
        They are on the surface z, (ny, nx); NaN where nothing was measured.
        """
        kx, ky = self.modes.kx, self.modes.ky
        whitening = self._power(kx, ky) * self._whitening(sight, kx, ky) / self.prior.spectrum(kx, ky)
        whitening[:, 0, 0] = 0.0
        field = self.modes.field((self.found.waves * whitening).astype(np.float32))
        lattice = sight.lattice
        x, y = sight.position(z)
        place = np.stack([(y - lattice.y0) / lattice.step, (x - lattice.x0) / lattice.step])
        out = np.array([map_coordinates(one, place, np.float64, mode="nearest") for one in field])
        last = np.array(lattice.shape)[:, None, None] - 2
        row, column = np.clip(np.rint(place).astype(np.intp), 1, last)
        inside = ((place >= 1) & (place <= last)).all(axis=0)
        out[:, ~(inside & self.found.found.valid[row, column])] = np.nan
        return out

    def response(self, sight: Sight, k: Array) -> NDArray[np.complex128]:
        """What `at_nodes` has of waves with wavenumbers k (2, ny, nx), rad/m, over their rise, (2, ...)."""
        jacobian = sight.at_middle()
        kx, ky = np.einsum("ji,jyx->iyx", np.linalg.inv(jacobian[:, :2]), k) * BLOCK
        along = k / np.maximum(np.hypot(*k), _TINY)
        moved = np.einsum("ik,kyx->iyx", jacobian[:, :2], along) + 1j * jacobian[:, 2, None, None]
        return np.asarray(moved * self._whitening(sight, kx, ky))

    def _whitening(self, sight: Sight, kx: Float, ky: Float) -> Array:
        """Factor on displacements, (1 or 2, ...), at kx, ky, rad per block; 0 of the shortest waves."""
        block = BLOCK / np.sqrt(abs(np.linalg.det(sight.at_middle()[:, :2])))
        shortest = np.clip(2.0 * np.pi * block / _SHORTEST_WAVE, SHORTEST_WAVENUMBER, SHORTEST_IN_COMMON)
        resolved = np.hypot(kx, ky) < shortest
        return np.asarray(resolved / np.sqrt(self._power(kx, ky)))

    def _power(self, kx: Float, ky: Float) -> Array:
        """Expected power of waves and noise."""
        information = max(float(self.found.information.mean()), _TINY)
        return np.asarray(
            self.prior.spectrum(kx, ky) + 1.0 / (self.prior.footprint(kx, ky) ** 2 * information)
        )


@dataclass(frozen=True)
class CommonWaves:
    """Expected spectrum of the rise per step by waves that cameras have in common.

    `density` (rings,), m^4, is the power of a cosine on nodes 1 m apart; NaN where it was not measured. `k`
    is in rad/m. A wave moves the water along its direction and, a quarter of a turn later, as far up.
    """

    k: Array
    density: Array

    def at(self, k: Float) -> Array:
        """Density at wavenumbers k, rad/m; NaN where it was not measured."""
        known = np.isfinite(self.density)
        return np.asarray(np.interp(k, self.k[known], self.density[known], np.nan, np.nan))

    def with_elevation(self, elevation: Prior, block: float, frame_rate: float) -> CommonWaves:
        """With the rise of waves that the elevation on blocks of this side, metres, shows by itself."""
        k = np.array(elevation.k) / block
        shown, _ = detected_rings(elevation)
        phase = dispersion(k) / frame_rate
        power = np.mean(elevation.power, axis=(0, 1)) * np.square(2.0 * np.sin(0.5 * phase) * block)
        rise = np.interp(self.k, k, shown * power * (phase < _LARGEST_PHASE), 0.0, 0.0)
        return replace(self, density=np.fmax(self.density, rise))

    def in_camera(self, sight: Sight, k: Array) -> Array:
        """Power of the cosines of a displacement, (2, directions, rings), px^2, at k, rad per block."""
        jacobian = sight.at_middle()
        across, up = jacobian[:, :2], jacobian[:, 2:]
        power = []
        for sign in (1.0, -1.0):  # a cosine represents both
            on_water = across.T @ np.stack([np.cos(SECTOR_ANGLES), sign * np.sin(SECTOR_ANGLES)])
            length = np.hypot(*on_water)
            moved = np.square(across @ (on_water / length)) + np.square(up)
            power.append(moved[:, :, None] * self.at(length[:, None] * k / BLOCK))
        return np.asarray(np.mean(power, axis=0) * abs(np.linalg.det(across)) / BLOCK**2)

    def of_elevation(self, block: float, k: Array, frame_rate: float) -> Array:
        """Power of the cosines of the elevation on blocks of this side, metres, (1, 1, rings), m^2.
        At k, rad per block; NaN of waves that turn too far in a step.
        """
        phase = dispersion(k / block) / frame_rate
        power = self.at(k / block) / np.square(2.0 * np.sin(0.5 * phase) * block)
        return np.where(phase < _LARGEST_PHASE, power, np.nan)[None, None]


def common_waves(
    steps: Sequence[tuple[Mapping[str, OpenField], Float]], geometry: GridGeometry
) -> CommonWaves | None:
    """Waves in the cameras' fields of some steps, with their surfaces z (ny, nx).
    None where no two cameras have enough nodes in common.
    """
    edges = np.linspace(0.0, np.pi / (BLOCK * geometry.pixel), RINGS + 1)
    each = [part for fields, z in steps for part in _products(fields, z, geometry, edges)]
    if not each:
        return None
    product, square, variance, count = np.sum(each, axis=0)
    sums = product, square, _EXCESS_VARIANCE * variance, count
    product, square, variance, count = (np.convolve(part, np.ones(3), mode="same") for part in sums)
    known = square > 0
    found, std, noise = (
        np.divide(part, square, out=np.full(RINGS, _TINY), where=known)
        for part in (product, np.sqrt(variance), np.sqrt(square * count))
    )
    noise = np.minimum.accumulate(np.where(known, noise, np.inf))  # shorter waves are not stronger
    density = expected_power(found, std, _LARGEST_SIGNAL_TO_NOISE * noise) * geometry.grid.step**2
    return CommonWaves(0.5 * (edges[1:] + edges[:-1]), np.where(known, density, np.nan))


def _products(fields: Mapping[str, OpenField], z: Float, geometry: GridGeometry, edges: Array) -> list[Array]:
    """Sums of every pair of cameras, (4, rings): of products times what waves of power 1 give, of the square
    of this, of the variance of the first by chance, and their number.
    """
    step, shape = geometry.grid.step, geometry.grid.shape
    kx, ky = (2.0 * np.pi * np.fft.fftfreq(n, step) for n in shape[::-1])
    k = np.stack(np.broadcast_arrays(kx, ky[:, None]))
    ring = np.digitize(np.hypot(*k), edges) - 1
    used = (ring < RINGS) & (np.hypot(*k) > 0) & (np.abs(k).max(axis=0) < _SHORTEST_ON_NODES / step)
    sights = {name: geometry.sights[name] for name in fields}
    moved = {name: field.at_nodes(sights[name], z) for name, field in fields.items()}
    response = {name: field.response(sights[name], k) for name, field in fields.items()}
    jacobians = {name: sight.at_middle()[..., None] for name, sight in sights.items()}
    out, pairs = [], list(combinations(fields, 2))
    apart = [(a, b) for a, b in pairs if sine_between(jacobians[a], jacobians[b]) > MIN_SINE]
    for a, b in apart or pairs:
        both = np.isfinite(moved[a][0] + moved[b][0])
        inner = cv2.erode(both.view(np.uint8), np.ones((3, 3)), iterations=_RIM, borderValue=0)
        if inner.sum() < _MIN_NODES:
            continue
        weight = cv2.GaussianBlur(inner.astype(np.float64), (0, 0), _RIM) * both
        total = np.square(weight).sum()
        p, q = (_transformed(moved[name], weight) / np.sqrt(total) for name in (a, b))
        expected = np.real(response[a][:, None] * np.conj(response[b]))
        by_chance = np.square(np.abs(p))[:, None] * np.square(np.abs(q))
        dependent = np.sum(weight**4) * weight.size / total**2  # neighbouring modes have as much in common
        parts = (
            expected * np.real(p[:, None] * np.conj(q)),
            np.square(expected),
            0.5 * dependent * np.square(expected) * by_chance,
            np.ones_like(expected),
        )
        sums = [np.bincount(ring[used], part.sum(axis=(0, 1))[used], minlength=RINGS) for part in parts]
        out.append(np.array(sums, np.float64))
    return out


def _transformed(field: Array, weight: Array) -> NDArray[np.complex128]:
    """Fourier transform of a field (2, ny, nx) less its mean, with weights."""
    field = np.where(weight > 0, field, 0.0)
    mean = (field * weight).sum(axis=(1, 2), keepdims=True) / weight.sum()
    return np.asarray(np.fft.fft2((field - mean) * weight))


def expected_power(found: Array, std: Array, largest: Array) -> Array:
    """Mean of the power that waves may have, from what was found of it and its standard deviation.
    Before, waves are there with some probability, and then any power up to the largest is as likely.
    """
    found = np.minimum(found, largest)
    t, top = found / std, (largest - found) / std
    within = np.maximum(ndtr(top) - ndtr(-t), _TINY)
    at_zero, at_top = (np.exp(-0.5 * np.square(value)) / np.sqrt(2.0 * np.pi) for value in (t, top))
    power = np.clip(found + std * (at_zero - at_top) / within, 0.0, largest)
    odds = _PROBABILITY / (1.0 - _PROBABILITY) * within / np.maximum(largest / std * at_zero, _TINY)
    return np.asarray(power * odds / (1.0 + odds))
