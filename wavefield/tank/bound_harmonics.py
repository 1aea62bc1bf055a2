"""Second-order waves bound to pairs of free waves, in water of any depth, with surface tension.

From the kinematic and dynamic conditions expanded to second order at z = 0,

    phi2_z - z2_t                  = grad phi1 . grad z1 - z1 phi1_zz                       = F
    phi2_t + g z2 - gamma lap z2   = -|grad phi1|^2/2 - phi1_z^2/2 - z1 phi1_tz             = G

each pair (i, j) forces a wave of vector K = k_i +- k_j and frequency S = s_i +- s_j:

    z2 = (q G + i S F) / (q g' - S^2),   phi2 = (g' F - i S G) / (q g' - S^2),
    q = |K| tanh |K|h,   g' = g + gamma K^2.

The velocity of the surface water to second order is grad phi1 + z1 grad phi1_z + grad phi2 at z = 0;
beads that follow it drift as Stokes has it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavefield.water import GRAVITY

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MIN_DETUNING = 0.1  # share of q g': pairs closer to resonance are left to higher orders


@dataclass(frozen=True)
class BoundWaves:
    """Second-order waves, summed by wave vector."""

    kx: Array  # (m,): Wave vectors, rad/m
    ky: Array
    z: Complex  # (p,): Contributions of each pair at time zero, metres and m/s
    u: Complex
    v: Complex
    frequency: Array  # (p,): Frequency of each contribution relative to the water, rad/s
    target: NDArray[np.int64]  # (p,): Which wave vector each contribution belongs to

    def at(self, time: float, current: tuple[float, float]) -> dict[str, Complex]:
        """Coefficients of z, z_t, u, v at one time, each (m,)."""
        turn = np.exp(-1j * self.frequency * time)
        drift = self.kx * current[0] + self.ky * current[1]
        carried = np.exp(-1j * drift * time)

        def gather(values: Complex) -> Complex:
            real, imag = (np.bincount(self.target, part, self.kx.size) for part in (values.real, values.imag))
            return np.asarray((real + 1j * imag) * carried)

        z = gather(self.z * turn)
        return {
            "z": z,
            "z_t": gather(-1j * self.frequency * self.z * turn) - 1j * drift * z,
            "u": gather(self.u * turn),
            "v": gather(self.v * turn),
        }


def bound_waves(
    kx: Array, ky: Array, amplitude: Complex, sigma: Array, depth: float, surface_tension: float, number: int
) -> BoundWaves:
    """Waves bound to the steepest of the free waves, (n,), given in rad/m, m and rad/s."""
    steep = np.argsort(-np.hypot(kx, ky) * np.abs(amplitude), kind="stable")[:number]
    kx, ky, a, s = kx[steep], ky[steep], amplitude[steep], sigma[steep]
    k = np.hypot(kx, ky)
    b = a * s / (k * np.tanh(k * depth))  # potential: phi1 = Re sum -i b exp(i theta)
    dot = np.multiply.outer(kx, kx) + np.multiply.outer(ky, ky)
    parts = []
    for sign in (+1, -1):
        # i carries the potential, j the elevation; for differences the second factor is conjugate
        ai, bi = a[:, None], b[:, None]
        aj, bj = (a, b) if sign > 0 else (a.conj(), b.conj())
        ki2, si = (k * k)[:, None], s[:, None]
        f = 0.5j * bi * aj * (sign * dot + ki2)
        g = 0.5 * (-0.5 * dot * bi * bj + sign * 0.5 * si * s * ai * aj + si * si * ai * aj)
        sum_x, sum_y = kx[:, None] + sign * kx, ky[:, None] + sign * ky
        frequency = np.broadcast_to(si + sign * s, dot.shape)
        length = np.hypot(sum_x, sum_y)
        with np.errstate(invalid="ignore"):
            q = length * np.tanh(length * depth)
        stiffness = GRAVITY + surface_tension * length**2
        det = q * stiffness - frequency**2
        bound = (length > 1e-9) & (np.abs(det) > MIN_DETUNING * q * stiffness)
        det = np.where(bound, det, np.inf)
        z = (q * g + 1j * frequency * f) / det
        phi = (stiffness * f - 1j * frequency * g) / det
        lift = 0.5 * si * ai * aj  # z1 grad phi1_z
        u, v = kx[:, None] * lift + 1j * sum_x * phi, ky[:, None] * lift + 1j * sum_y * phi
        # K = 0 (a wave with itself) is no wave: the mean level stays, the mean drift remains
        used = bound | (length <= 1e-9)
        parts.append([part[used] for part in (sum_x, sum_y, z, u, v, frequency)])
    sum_x, sum_y, z, u, v, frequency = (np.concatenate(p) for p in zip(*parts, strict=True))
    quantum = 1e-9 * max(float(np.abs(k).max(initial=1.0)), 1.0)
    keys = np.stack([np.round(sum_x / quantum), np.round(sum_y / quantum)], axis=1)
    vectors, target = np.unique(keys, axis=0, return_inverse=True)
    return BoundWaves(
        vectors[:, 0] * quantum, vectors[:, 1] * quantum, z, u, v, frequency, target.reshape(-1)
    )
