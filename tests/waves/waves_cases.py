"""Exact seas for the tests of the estimators: free waves that obey the kinematic condition."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from wavefield.water import water_of
from wavefield.waves.cross import label
from wavefield.waves.current import current_used
from wavefield.waves.dispersion_fit import dispersion_group
from wavefield.waves.elevation import NAMES, PAIRS, PLANES, fused_group
from wavefield.waves.gains import read_gain
from wavefield.waves.spectra import density, plane_density
from wavefield.waves.sums import Requested, segment_sums
from wavefield.waves.welch import Welch

G, GAMMA = 9.81, 7.28e-5


def relation(k, depth=np.inf, gamma=GAMMA):
    return np.sqrt((G * k + gamma * k**3) * np.tanh(k * depth))


@dataclass
class Waves:
    """z = Re sum a exp(i (kx x + ky y - omega t)); w is defined by z_t + u . grad z."""

    kx: np.ndarray
    ky: np.ndarray
    a: np.ndarray  # complex
    depth: float = 0.7
    current: tuple = (0.0, 0.0)

    @property
    def k(self):
        return np.hypot(self.kx, self.ky)

    @property
    def sigma(self):
        return relation(self.k, self.depth)

    @property
    def omega(self):
        return self.sigma + self.kx * self.current[0] + self.ky * self.current[1]

    def on_grid(self, t, y, x, *names):
        """Fields on a grid, each (time, y, x): z, z_t, z_x, z_y, u, v."""
        ex = np.exp(1j * np.outer(x, self.kx))
        ey = np.exp(1j * np.outer(y, self.ky))
        s = self.sigma / np.tanh(self.k * self.depth) / self.k
        gains = {
            "z": 1.0,
            "z_t": -1j * self.omega,
            "z_x": 1j * self.kx,
            "z_y": 1j * self.ky,
            "u": self.kx * s,
            "v": self.ky * s,
        }
        out = {name: np.empty((len(t), len(y), len(x))) for name in names}
        for i, now in enumerate(t):
            turned = self.a * np.exp(-1j * self.omega * now)
            for name in names:
                out[name][i] = ((ey * (turned * gains[name])) @ ex.T).real
        return out

    def at(self, x, y, t):
        """z, u, v at points, each of the points' shape."""
        shape = np.shape(x)
        phase = np.exp(
            1j * (np.outer(np.ravel(x), self.kx) + np.outer(np.ravel(y), self.ky) - self.omega * t)
        )
        s = self.sigma / np.tanh(self.k * self.depth) / self.k
        return tuple((phase @ (self.a * g)).real.reshape(shape) for g in (1.0, self.kx * s, self.ky * s))

    def move(self, x, y, start, end, steps=4):
        """Follow surface water from start to end (Runge-Kutta)."""
        h, t = (end - start) / steps, start
        for _ in range(steps):
            _, u1, v1 = self.at(x, y, t)
            _, u2, v2 = self.at(x + h / 2 * u1, y + h / 2 * v1, t + h / 2)
            _, u3, v3 = self.at(x + h / 2 * u2, y + h / 2 * v2, t + h / 2)
            _, u4, v4 = self.at(x + h * u3, y + h * v3, t + h)
            x = x + h / 6 * (u1 + 2 * u2 + 2 * u3 + u4)
            y = y + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
            t = t + h
        return x, y


def random_waves(seed=0, n=200, lowest=1.0, highest=4.0, sigma=0.015, depth=0.7, power=5, **more):
    """Isotropic sea with E(f) ~ f^-power between two frequencies (Hz)."""
    rng = np.random.default_rng(seed)
    share = rng.random(n)
    p = 1 - power
    f = (lowest**p + share * (highest**p - lowest**p)) ** (1 / p)
    k = np.interp(2 * np.pi * f, relation(table := np.linspace(0.1, 400, 40000), depth), table)
    angle = 2 * np.pi * rng.random(n)
    a = sigma * np.sqrt(2 / n) * np.exp(2j * np.pi * rng.random(n))
    return Waves(k * np.cos(angle), k * np.sin(angle), a, depth, **more)


def axes(steps, ny, nx, dt=0.05, dx=0.01):
    return np.arange(steps) * dt + dt / 2, np.arange(ny) * dx, np.arange(nx) * dx


def linear_cube(waves, steps, ny, nx, dt=0.05, dx=0.01, noise_z=0.0, noise_dz=0.0, seed=9, dtype="f4"):
    """A cube as measured from frames: z, u and v at mid-time, z_t and w over a step, linear kinematics.
    Noise is independent between steps (z, dz) and frames (z_t), correlated over 4 cm in space."""
    from scipy.ndimage import uniform_filter

    rng = np.random.default_rng(seed)
    t, y, x = axes(steps, ny, nx, dt, dx)

    def noise(rms, count):
        if not rms:
            return 0.0
        box = max(round(0.04 / dx), 1)
        raw = rng.standard_normal((count, ny + 2 * box, nx + 2 * box), dtype="f4")
        raw = uniform_filter(raw, (0, box, box))[:, box:-box, box:-box] * box
        return rms * raw

    fields = waves.on_grid(t, y, x, "z", "u", "v")
    fields["z"] += noise(noise_z, steps)
    frames = waves.on_grid(np.arange(steps + 1) * dt, y, x, "z")["z"]
    fields["w"] = (np.diff(frames, axis=0) + noise(noise_dz, steps)) / dt
    fields["z_t"] = np.diff(frames + noise(noise_z, steps + 1), axis=0) / dt
    return cube(fields, t, y, x, dtype, water_depth=waves.depth, frame_rate=1 / dt)


def cube(fields, t, y, x, dtype="f4", **attrs):
    units = {"z": "m"}
    data = {
        name: (("time", "y", "x"), np.asarray(values, dtype), {"units": units.get(name, "m s-1")})
        for name, values in fields.items()
    }
    return xr.Dataset(data, {"time": t, "y": y, "x": x}, attrs)


class PeriodicSea:
    """Random sea on a periodic square, seen through a smaller window: quick for long records."""

    dx, depth = 0.02, 0.7

    def __init__(self, seed=5, n=128, current=(0.0, 0.0), box=0.04):
        dx, depth = self.dx, self.depth
        rng = np.random.default_rng(seed)
        kx = 2 * np.pi * np.fft.fftfreq(n, dx)[None, :]
        ky = 2 * np.pi * np.fft.fftfreq(n, dx)[:, None]
        k = np.hypot(kx, ky)
        free = relation(k, depth)
        self.n, self.flows = n, any(current)
        self.free, self.omega = free, free + current[0] * kx + current[1] * ky
        f = free / (2 * np.pi)
        group = (relation(k + 1e-3, depth) - free) / 1e-3
        with np.errstate(divide="ignore", invalid="ignore"):
            density = 1 / (1 + f**6) * np.exp(-((0.85 / np.maximum(f, 1e-3)) ** 12)) * group / k
        density = np.where((f > 0.75) & (f < 7.4), density, 0.0)
        density[0, 0] = 0
        a = np.sqrt(density) * (rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))
        self.a = a * 0.015 / np.sqrt((np.abs(a) ** 2).sum() / 2)
        self.box = np.sinc(kx * box / (2 * np.pi)) * np.sinc(ky * box / (2 * np.pi)) if box else 1.0

    def z(self, first, steps, dt, ny, nx, gain=1.0):
        """Elevation from time ``first`` on, (steps, ny, nx), each wave times ``gain``."""
        from scipy.fft import ifft

        lines = self.a * self.box * gain * np.exp(-1j * self.omega * first)
        turn = np.exp(-1j * self.omega * dt)
        out = np.empty((steps, ny, nx))
        for frame in out:
            frame[:] = ifft(ifft(lines, axis=1)[:, :nx], axis=0).real[:ny] * self.n**2
            lines *= turn
        return out

    def cube(self, steps, ny, nx, dt=0.05, noise_z=0.0, noise_dz=0.0, seed=1):
        """z, z_t, w as measured from frames with noise; and the exact frame-time elevation."""
        rng = np.random.default_rng(seed)

        def noise(rms):
            raw = rng.standard_normal((ny + 4, nx + 4))[1:-2, 1:-2]
            raw = raw[1:] + raw[:-1]
            return rms / 2 * (raw[:, 1:] + raw[:, :-1])

        exact = self.z(0.0, steps + 1, dt, ny, nx)
        noisy = exact + np.array([noise(noise_z) for _ in range(steps + 1)])
        w = np.diff(exact, axis=0) / dt
        if self.flows:  # particles rise as the water that carries them sees the waves
            w = self.z(dt / 2, steps, dt, ny, nx, -2j * np.sin(self.free * dt / 2) / dt)
        w = w + np.array([noise(noise_dz) / dt for _ in range(steps)])
        z = self.z(dt / 2, steps, dt, ny, nx) + np.array([noise(noise_z) for _ in range(steps)])
        t, y, x = axes(steps, ny, nx, dt, self.dx)
        fields = {"z": z, "z_t": np.diff(noisy, axis=0) / dt, "w": w, "exact": exact[:-1]}
        return cube(fields, t, y, x, water_depth=self.depth, frame_rate=1 / dt)


def seen(lines, true, n, step):
    """Density on each line from a wave of variance 1 at each true k or omega, through a Hann window."""
    from wavefield.waves.welch import hann

    turned = np.exp(-1j * np.subtract.outer(lines, true)[..., None] * step * np.arange(n))
    return np.abs(turned @ hann(n)) ** 2 / (hann(n) ** 2).sum() * step / (2 * np.pi)


class GaussianSea:
    """Gaussian waves of known spectrum around the ridge, D(theta) ~ cos(theta / 2)^(2 spread); quick.

    Every (k, omega) is drawn anew, so a record holds as many independent waves as a sea without end.
    """

    dt = 0.05

    def __init__(
        self, n=100, steps=576, dx=0.04, spread=0, heading=0.0, band=(1.4, 3.3), current=(0.0, 0.0), width=0.6
    ):
        self.n, self.steps, self.dx = n, steps, dx
        lowest, highest = band
        self.k = 2 * np.pi * np.fft.fftfreq(n, dx)
        self.omega = 2 * np.pi * np.arange(steps // 2 + 1) / (steps * self.dt)
        kx, ky = self.k, self.k[:, None]
        ridge = relation(np.hypot(kx, ky), 0.7)
        seen_at = ridge + kx * current[0] + ky * current[1]
        density = np.exp(-0.5 * ((self.omega[:, None, None] - seen_at) / width) ** 2)
        density *= ((ridge > 2 * np.pi * lowest) & (ridge < 2 * np.pi * highest)) / np.maximum(ridge, 1) ** 5
        density *= np.cos((np.arctan2(ky, kx) - heading) / 2) ** (2 * spread)
        self.variance = density * 1e-4 / density.sum()  # of each wave (omega, ky, kx)

    def draw(self, seed):
        """One sea, (steps, n, n)."""
        from scipy import fft

        rng = np.random.default_rng(seed)
        half = self.steps // 2
        lines = np.zeros((self.steps, self.n, self.n), "c8")
        lines[-np.arange(half + 1)] = np.sqrt(2 * self.variance)  # exp(i (k . x - omega t))
        raw = rng.standard_normal((2, half + 1, self.n, self.n), dtype="f4")
        lines[-np.arange(half + 1)] *= (raw[0] + 1j * raw[1]) / np.float32(np.sqrt(2))
        return fft.ifftn(lines, overwrite_x=True).real * np.float32(lines.size)

    def field(self, seed, units="m s-1"):
        """One sea, labelled."""
        t, y, x = axes(self.steps, self.n, self.n, self.dt, self.dx)
        values = self.draw(seed).astype("f4")
        return xr.DataArray(values, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": units})

    def expected_map(self, ny, nx, segment):
        """Mean of E(ky, kx, omega) as a rectangle and a segment see it."""
        from wavefield.waves import rings

        ky, kx = (np.sort(rings.wavenumbers(n, self.dx)) for n in (ny, nx))
        omega = 2 * np.pi * np.arange(segment // 2 + 1) / (segment * self.dt)
        on_omega = seen(omega, self.omega, segment, self.dt)
        on_y, on_x = seen(ky, self.k, ny, self.dx), seen(kx, self.k, nx, self.dx)
        E = np.einsum("tw,wab,ya,xb->tyx", on_omega, self.variance, on_y, on_x, optimize=True)
        return xr.DataArray(E, {"omega": omega, "ky": ky, "kx": kx}, ("omega", "ky", "kx"))


def second_order_sea(seed, n, lowest, highest, sigma, spread):
    """Free waves ~ f^-6 on the lattice of a basin with all the waves that pairs of them force.

    On a lattice the sums of two waves meet others: the forced waves are few enough to be quick.
    """
    from wavefield.tank.sea import Sea

    rng = np.random.default_rng(seed)
    depth, step = 0.7, 2 * np.pi / 10.0  # of a basin of 10 m
    table = np.linspace(0.1, 200, 20000)
    top = int(np.interp(2 * np.pi * highest, relation(table, depth), table) / step) + 1
    line = np.arange(-top, top + 1) * step
    kx, ky = (part.ravel() for part in np.meshgrid(line, line))
    k = np.maximum(np.hypot(kx, ky), 1e-9)
    f = relation(k, depth) / (2 * np.pi)
    group = (relation(k + 1e-4, depth) - relation(k, depth)) / 1e-4
    with np.errstate(divide="ignore", over="ignore"):
        p = f**-6 * np.exp(-1.25 * (1.15 / f) ** 4) * group / k
        p = np.where((f > lowest) & (f < highest), p * np.cos(np.arctan2(ky, kx) / 2) ** (2 * spread), 0.0)
    pick = rng.choice(k.size, n, replace=False, p=p / p.sum())
    a = sigma * np.sqrt(2 / n) * np.exp(2j * np.pi * rng.random(n))
    return Sea(kx[pick], ky[pick], a, depth, bound=n)


def fused_spectra(cube, *, gain=None, depth=None, current=None, segment=None, record=None):
    """Return the elevation spectra of `wavefield.analyze`, without its other products."""
    water = water_of(cube.attrs, depth)
    gain = None if gain is None else read_gain(gain)
    welch = Welch.of(cube, segment, record)
    sums = segment_sums(cube, Requested(NAMES, PAIRS, ("w", *PLANES)), welch)
    w = plane_density(xr.Variable(("omega", "ky", "kx"), density(sums["map w"], welch)), "", "1", welch)["E"]
    used = current_used(xr.Dataset() if current else dispersion_group(w, welch.table.k, *water), current)
    return fused_group(label(sums, NAMES, PAIRS, welch), sums, welch, w, used, gain, *water)
