"""Random linear seas of a generator that shares no code with the package, for judging its estimators.

A sea is a sum of a few hundred free waves at random wave vectors, with random amplitudes, on a uniform
current, in water of any depth, with surface tension. Frequencies in the settings are those in still water.
"""

from dataclasses import dataclass

import numpy as np
import xarray as xr

GRAVITY, TENSION = 9.81, 7.28e-5  # m/s2, m3/s2
DIMS, UNITS = ("time", "y", "x"), {"z": "m"}


def still_frequency(k, depth):
    """Angular frequency of free waves in still water, rad/s."""
    return np.sqrt((GRAVITY * k + TENSION * k**3) * np.tanh(k * depth))


@dataclass(frozen=True)
class Sea:
    """Settings of a random sea."""

    current: tuple = (0.0, 0.0)  # of the water along x and y, m/s
    depth: float = np.inf  # m
    lowest: float = 1.2  # ends of the spectrum, Hz
    highest: float = 6.0
    slope: float = 5.0  # the spectrum of elevation falls as f^-slope
    directions: tuple = ((0.0, 0.0, 1.0),)  # parts (heading, s, weight), each cos(theta / 2)^2s wide
    height: float = 0.008  # standard deviation of elevation, m
    noise: float = 0.0  # standard deviation of displacements between frames and of elevation, m
    shape: tuple = (640, 60, 80)  # steps, nodes along y and x
    dt: float = 0.05  # s
    dx: float = 0.02  # m
    waves: int = 500
    seed: int = 0

    def components(self):
        """Wave vectors kx, ky and complex amplitudes of elevation, each (waves,)."""
        rng = np.random.default_rng(self.seed)
        # evenly over frequency, so that the weak end has as many waves as the peak
        share = (np.arange(self.waves) + rng.random(self.waves)) / self.waves
        f = self.lowest + (self.highest - self.lowest) * share
        table = np.linspace(0.05, 700, 70000)
        k = np.interp(2 * np.pi * f, still_frequency(table, self.depth), table)
        weights = np.array([part[2] for part in self.directions])
        chosen = rng.choice(len(weights), self.waves, p=weights / weights.sum())
        angle = np.empty(self.waves)
        for i, part in enumerate(chosen):
            heading, s, _ = self.directions[part]
            while True:
                turn = rng.uniform(-np.pi, np.pi)
                if rng.random() <= np.cos(turn / 2) ** (2 * s):
                    break
            angle[i] = heading + turn
        size = f ** (-self.slope / 2) * (
            rng.standard_normal(self.waves) + 1j * rng.standard_normal(self.waves)
        )
        size *= self.height / np.sqrt((np.abs(size) ** 2).sum() / 2)
        return k * np.cos(angle), k * np.sin(angle), size

    def cube(self, names=("z", "w")):
        """Fields at the nodes, (time, y, x), m and m/s.

        Velocities are displacements of the water between frames over dt at mid-time. ``z_t`` is the change
        at a fixed place; ``z`` is at mid-time.
        """
        kx, ky, a = self.components()
        k = np.hypot(kx, ky)
        sigma = still_frequency(k, self.depth)
        omega = sigma + kx * self.current[0] + ky * self.current[1]
        mean = {"u": self.current[0], "v": self.current[1]}

        over_a_step, place_over_a_step = (np.sinc(o * self.dt / (2 * np.pi)) for o in (sigma, omega))
        along = sigma / (k * np.tanh(k * self.depth)) * over_a_step
        gains = {"z": np.ones(k.size), "u": kx * along, "v": ky * along}
        gains |= {"z_t": -1j * omega * place_over_a_step, "w": -1j * sigma * over_a_step}
        t, y, x = (np.arange(n) * step for n, step in zip(self.shape, (self.dt, self.dx, self.dx)))
        ex = np.exp(1j * np.outer(kx, x)).astype("c8")
        ey = np.exp(1j * np.outer(y, ky)).astype("c8")
        turned = (a * np.exp(-1j * np.outer(t, omega))).astype("c8")
        rng = np.random.default_rng([self.seed, 1])
        out = {}
        for name in names:
            rows = (turned * gains[name].astype("c8"))[:, None, :] * ey
            field = (rows.reshape(-1, k.size) @ ex).real.reshape(self.shape) + np.float32(mean.get(name, 0))
            level = self.noise if name == "z" else self.noise / self.dt
            out[name] = (DIMS, field + level * self._noise(rng), {"units": UNITS.get(name, "m s-1")})
        return xr.Dataset(out, {"time": t, "y": y, "x": x})

    def _noise(self, rng):
        if not self.noise:
            return np.float32(0)
        steps, ny, nx = self.shape
        raw = rng.standard_normal((steps, ny + 1, nx + 1), dtype="f4")  # the same over two nodes on average
        return sum(raw[:, i : i + ny, j : j + nx] for i in range(2) for j in range(2)) / np.float32(2)


@dataclass(frozen=True)
class LatticeSea:
    """Settings of a Gaussian sea without end: random amplitudes on a fine lattice of wave vectors.

    Free waves with linear kinematics on a uniform current; fields at the nodes of a small window. The
    lattice is fine enough that waves do not come round again within about 30 s."""

    current: tuple = (0.0, 0.0)
    depth: float = 0.7
    lowest: float = 1.2  # ends of the spectrum in still water, Hz
    highest: float = 3.0
    slope: float = 5.0
    directions: tuple = ((0.0, 0.0, 1.0),)
    height: float = 0.008  # standard deviation of elevation in the mean of draws, m
    side: int = 420  # nodes along a side of the basin
    shape: tuple = (640, 28, 34)  # of the window
    dt: float = 0.05
    dx: float = 0.07
    noise: float = 0.0
    gap: int = 0  # steps that are missing in the middle

    def _size(self):
        """Wave vectors, frequencies in still water and amplitudes' standard deviations, (ky, kx)."""
        line = 2 * np.pi * np.fft.fftfreq(self.side, self.dx)
        kx, ky = line[None, :], line[:, None]
        k = np.maximum(np.hypot(kx, ky), 1e-6)
        free = still_frequency(k, self.depth)
        group = np.gradient(still_frequency(t := np.linspace(1e-3, 200, 20001), self.depth), t)
        f, angle = free / (2 * np.pi), np.arctan2(ky, kx)
        spread = sum(
            weight * np.abs(np.cos((angle - heading) / 2)) ** (2 * s) * _spread_norm(s)
            for heading, s, weight in self.directions
        )
        variance = f**-self.slope * np.interp(k, t, group) / k * spread
        variance = np.where((f > self.lowest) & (f < self.highest), variance, 0.0)
        return kx, ky, k, free, np.sqrt(variance * self.height**2 / variance.sum())

    def cube(self, seed, names=("z", "z_t", "u", "v", "w")):
        """Fields of the moment at the nodes, (time, y, x), m and m/s."""
        from scipy import fft

        kx, ky, k, free, size = self._size()
        rng = np.random.default_rng(seed)
        lines = size * (rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape))
        lines = (lines * self.side**2).astype("c8")
        omega = free + kx * self.current[0] + ky * self.current[1]
        along = free / k / np.tanh(k * self.depth)
        gains = {"z": 1.0, "z_t": -1j * omega, "u": kx * along, "v": ky * along, "w": -1j * free}
        rows = np.flatnonzero((size > 0).any(axis=1))
        gains = {name: np.broadcast_to(gains[name], size.shape)[rows].astype("c8") for name in names}
        turn, lines = np.exp(-1j * omega * self.dt).astype("c8")[rows], lines[rows]
        steps, ny, nx = self.shape
        out = {name: np.empty(self.shape, "f4") for name in names}
        part = np.zeros((self.side, nx), "c8")
        for step in range(steps):
            for name in names:
                part[rows] = fft.ifft(lines * gains[name], axis=1)[:, :nx]
                out[name][step] = fft.ifft(part, axis=0).real[:ny]
            lines = lines * turn
        for name in names if self.noise else ():
            level = np.float32(self.noise / (1 if name == "z" else self.dt))
            out[name] += level * rng.standard_normal(self.shape, dtype="f4")
        middle = slice(steps // 2, steps // 2 + self.gap)
        for name in names:
            out[name][middle] = np.nan
        mean = {"u": self.current[0], "v": self.current[1]}
        t, y, x = (np.arange(n) * step for n, step in zip(self.shape, (self.dt, self.dx, self.dx)))
        data = {
            name: (DIMS, values + np.float32(mean.get(name, 0)), {"units": UNITS.get(name, "m s-1")})
            for name, values in out.items()
        }
        attrs = {"water_depth": self.depth, "frame_rate": 1 / self.dt, "velocity": "instantaneous"}
        return xr.Dataset(data, {"time": t, "y": y, "x": x}, attrs)


def _spread_norm(s):
    angle = np.linspace(-np.pi, np.pi, 2000, endpoint=False)
    return 1 / (np.cos(angle / 2) ** (2 * s)).mean()


def random_lattice_sea(seed):
    """A Gaussian sea drawn at random, and the families that it belongs to."""
    rng = np.random.default_rng([seed, 77])
    speed, towards, heading = rng.uniform(0, 0.3), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    s = float(rng.choice([0.0, 2.0, 5.0, 10.0, 20.0, 50.0]))
    bimodal, current, noisy, gap = rng.random(4) < (0.25, 0.6, 0.5, 0.25)
    directions = ((heading, s, 1.0),)
    if bimodal:
        s = max(s, 5.0)
        directions = ((heading, s, 0.6), (heading + rng.uniform(1, np.pi), 10.0, 0.4))
    depth = float(rng.choice([0.05, 0.1, 0.7, 5.0]))
    sea = LatticeSea(
        current=(speed * np.cos(towards), speed * np.sin(towards)) if current else (0.0, 0.0),
        depth=depth,
        lowest=rng.uniform(1.1, 1.4),
        highest=rng.uniform(2.4, 3.0),
        slope=rng.uniform(3, 6),
        directions=directions,
        height=rng.uniform(0.004, 0.01),
        side=270,
        shape=(int(rng.integers(320, 480)), int(rng.integers(22, 32)), int(rng.integers(26, 38))),
        dx=rng.uniform(0.06, 0.07),
        dt=float(rng.choice([0.04, 0.05])),
        noise=rng.uniform(5e-5, 3e-4) if noisy else 0.0,
        gap=3 if gap else 0,
    )
    families = {
        "current": current,
        "bimodal": bimodal,
        "narrow": s >= 20 and not bimodal,
        "isotropic": s == 0,
        "shallow": depth <= 0.1,
        "noise": noisy,
        "gap": gap,
    }
    return sea, [name for name, there in families.items() if there] or ["plain"]
