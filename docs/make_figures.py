"""Draw the figures of the theory pages into docs/theory/figures: `python docs/make_figures.py`.

The drawings follow the equations on the pages; nothing here is measured.
"""

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

FOLDER = Path(__file__).parent / "theory" / "figures"
G, DEPTH, TENSION = 9.81, 0.7, 7.4e-5  # m/s2, m, m3/s2: clean water in a tank
BLUE, ORANGE, GREEN, GREY = "#1f5f99", "#c8553d", "#3c8d5a", "#8a8f98"
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "wavefield",
    "svg.fonttype": "none",
}


def free_frequency(k: np.ndarray) -> np.ndarray:
    """Angular frequency of free waves, rad/s, from the wavenumber, rad/m."""
    return np.sqrt((G * k + TENSION * k**3) * np.tanh(k * DEPTH))


def cameras() -> Figure:
    """Sight lines of two cameras; a point above z = 0 is seen displaced by D h."""
    figure = Figure(figsize=(6, 2.8), layout="constrained")
    axes = figure.subplots()
    x = np.linspace(-1.6, 1.6, 300)
    water = 0.16 * np.cos(2.6 * x - 0.4)
    axes.fill_between(x, -0.6, water, color=BLUE, alpha=0.12, lw=0)
    axes.plot(x, water, color=BLUE)
    axes.axhline(0.0, color=GREY, lw=0.8, ls="--")
    point = np.array([0.2, 0.16 * np.cos(2.6 * 0.2 - 0.4)])
    for name, centre, side in (("camera a", (-1.3, 2.0), "right"), ("camera b", (1.3, 2.0), "left")):
        centre = np.array(centre)
        reach = centre[1] / (centre[1] - point[1])
        foot = centre + reach * (point - centre)
        axes.plot(*np.stack([centre, foot]).T, color=ORANGE, lw=1)
        axes.plot(*centre, "s", color="black", ms=9)
        axes.annotate(name, centre, (0, 9), textcoords="offset points", ha="center")
        axes.plot(*foot, "o", color=ORANGE, ms=4)
        label = "$\\mathbf{x}_a$" if name.endswith("a") else "$\\mathbf{x}_b$"
        axes.annotate(
            label, foot, (6 if side == "right" else -6, -14), textcoords="offset points", ha="center"
        )
    axes.plot(*point, "o", color="black", ms=5)
    axes.annotate("bead at height $h$", point, (12, 16), textcoords="offset points")
    axes.annotate("$z = 0$", (-1.6, 0.03), color=GREY)
    axes.set(xlim=(-1.75, 1.75), ylim=(-0.5, 2.4), aspect="equal")
    axes.axis("off")
    return figure


def matching() -> Figure:
    """Beads in two frames, the block, and the residual before and after the Gauss-Newton step."""
    rng = np.random.default_rng(4)
    places, light = rng.uniform(-4, 36, (70, 2)), rng.uniform(0.5, 1.0, 70)
    yy, xx = np.mgrid[:32, :32]

    def image(shift: tuple[float, float]) -> np.ndarray:
        out = np.zeros((32, 32))
        for (px, py), bright in zip(places, light):
            out += bright * np.exp(-((xx - px - shift[0]) ** 2 + (yy - py - shift[1]) ** 2) / 2.6)
        return out

    figure = Figure(figsize=(6.4, 1.9), layout="constrained")
    first, second = image((0, 0)), image((2.3, 1.2))
    near = image((0.25, -0.1))
    titles = ("frame $a$", "frame $b$", "$a - b$, no shift", "$a - b(x + u)$, first step")
    shown = (first, second, first - second, first - near)
    for axes, title, values in zip(figure.subplots(1, 4), titles, shown):
        symmetric = title.startswith("$a")
        axes.imshow(values, cmap="RdBu_r" if symmetric else "gray", vmin=-1 if symmetric else 0, vmax=1)
        axes.set_title(title, fontsize=9)
        axes.plot([10, 21, 21, 10, 10], [10, 10, 21, 21, 10], color=ORANGE, lw=1.2)
        axes.axis("off")
    return figure


def map_estimate() -> Figure:
    """The gain of the estimate, S / (S + N), for waves of every length."""
    figure = Figure(figsize=(6, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    k = np.geomspace(4, 400, 300)
    spectrum = k**-3.5 * np.exp(-((9 / k) ** 4)) * 9**3.5
    footprint = np.exp(-(k**2) * (0.005**2))
    noise = 2e-4 / footprint**2
    left.loglog(k, spectrum, color=BLUE, label="waves, $S$")
    left.loglog(k, noise, color=ORANGE, label="noise of the blocks, $N = 1/(F^2 A)$")
    left.set(xlabel="wavenumber k (rad/m)", ylabel="power (arbitrary)", ylim=(1e-6, 10))
    left.legend(fontsize=8)
    right.semilogx(k, spectrum / (spectrum + noise), color=GREEN, label="$G = S/(S + N)$")
    right.semilogx(k, footprint, color=GREY, ls="--", label="block average alone, $F$")
    right.set(xlabel="wavenumber k (rad/m)", ylabel="amplitude kept", ylim=(0, 1.05))
    right.legend(fontsize=8)
    return figure


def surface() -> Figure:
    """Apparent positions of a bead on z = 0: along D_b - D_a elevation, across it the epipolar error."""
    figure = Figure(figsize=(5.2, 2.4), layout="constrained")
    axes = figure.subplots()
    a, along = np.array([0.0, 0.0]), np.array([3.0, 0.6])
    across = np.array([-along[1], along[0]]) / np.hypot(*along)
    b = a - 0.8 * along + 0.45 * across
    axes.annotate("", a - 0.8 * along, a, arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 1.8})
    axes.annotate("", b, a - 0.8 * along, arrowprops={"arrowstyle": "->", "color": ORANGE, "lw": 1.8})
    axes.annotate("", b, a, arrowprops={"arrowstyle": "->", "color": "black", "lw": 1})
    axes.plot(*np.stack([a - along, a + 0.25 * along]).T, color=GREY, ls="--", lw=0.8)
    axes.annotate(
        "direction of $\\Delta\\mathbf{D}$", a + 0.1 * along, (0, -16), textcoords="offset points", color=GREY
    )
    axes.annotate(
        "$-z\\,\\Delta\\mathbf{D}$", a - 0.4 * along, (4, -14), textcoords="offset points", color=BLUE
    )
    axes.annotate(
        "$\\varepsilon_Y$",
        a - 0.8 * along + 0.22 * across,
        (-18, 0),
        textcoords="offset points",
        color=ORANGE,
    )
    axes.annotate(
        "$\\mathbf{d} = \\mathbf{x}_b - \\mathbf{x}_a$", 0.5 * (a + b), (-4, 10), textcoords="offset points"
    )
    for place, name in ((a, "$\\mathbf{x}_a$"), (b, "$\\mathbf{x}_b$")):
        axes.plot(*place, "o", color="black", ms=5)
        axes.annotate(name, place, (8, 4), textcoords="offset points")
    axes.set(xlim=(-3.4, 1.2), ylim=(-0.9, 0.7), aspect="equal")
    axes.axis("off")
    return figure


def velocity() -> Figure:
    """The share of a wave's velocity that chords and paths keep."""
    figure = Figure(figsize=(6, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    t = np.linspace(-2.6, 2.6, 200)
    path = lambda s: np.stack([0.8 * s, 0.8 * np.sin(1.3 * s + 0.9)])
    left.plot(*path(t), color=BLUE, lw=1)
    frames = np.arange(-2.5, 3.0)
    left.plot(*path(frames), "o", color="white", mec=BLUE, ms=5)
    left.plot(*path(np.array([-0.5, 0.5])), color=ORANGE, lw=1.5, label="chord over one step")
    left.plot(*path(np.array([0.0])), "o", color="black", ms=5)
    slope = (path(np.array([0.01])) - path(np.array([-0.01]))) / 0.02
    ends = path(np.array([0.0])) + slope * np.array([-1.0, 1.0])
    left.plot(*ends, color=GREEN, lw=1.5, label="velocity at the node, mid-time")
    left.legend(fontsize=8, loc="lower right")
    left.set(title="path of the water through six frames")
    left.title.set_fontsize(9)
    left.axis("off")
    p = np.linspace(1e-3, 3.0, 300)
    chord = np.sin(p / 2) / (p / 2)
    kept = {
        "chord": chord,
        "four frames, $K_4$": chord * (26 - 2 * np.cos(p)) / 24,
        "six, smooth, $K_6$": chord * (34 + 20 * np.cos(p) - 6 * np.cos(2 * p)) / 48,
        "six, exact, $K_7$": chord * (2134 - 232 * np.cos(p) + 18 * np.cos(2 * p)) / 1920,
    }
    for (name, values), colour in zip(kept.items(), (GREY, BLUE, ORANGE, GREEN)):
        right.plot(p, values, color=colour, label=name)
    right.set(xlabel=r"phase from frame to frame, $\omega\,dt$ (rad)", ylabel="velocity kept", ylim=(0, 1.05))
    right.legend(fontsize=8, loc="lower left")
    return figure


def spectra() -> Figure:
    """Overlapping Hann windows, and the 95 % interval of a spectrum against the number of segments."""
    figure = Figure(figsize=(6, 2.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    t = np.linspace(0, 40, 800)
    rng = np.random.default_rng(1)
    signal = sum(np.sin(w * t + p) for w, p in zip(rng.uniform(1.6, 2.6, 9), rng.uniform(0, 6, 9)))
    left.plot(t, 0.12 * signal - 0.6, color=GREY, lw=0.8)
    for number in range(4):
        inside = (t >= 8 * number) & (t <= 8 * number + 16)
        left.plot(t[inside], np.sin(np.pi * (t[inside] - 8 * number) / 16) ** 2, color=BLUE, lw=1.2)
    left.set(xlabel="time (s)", yticks=[])
    left.set_title("segments that overlap by half", fontsize=9)
    from scipy.stats import chi2

    segments = np.arange(1, 61)
    dof = 2 * segments / (1 + (1 - 1 / segments) / 18)
    right.fill_between(
        segments, dof / chi2.ppf(0.975, dof), dof / chi2.ppf(0.025, dof), color=BLUE, alpha=0.2, lw=0
    )
    right.axhline(1.0, color=BLUE)
    right.set(xlabel="segments K", ylabel="interval / estimate", yscale="log", ylim=(0.2, 20))
    right.set_title("95 % interval of one cell", fontsize=9)
    return figure


def kinematics() -> Figure:
    """Rise of the surface at a node against vertical velocity and the nonlinear term, for a steep wave."""
    figure = Figure(figsize=(6, 2.4), layout="constrained")
    axes = figure.subplots()
    k, a = 2 * np.pi / 0.5, 0.012
    omega = np.sqrt(G * k)
    t = np.linspace(0, 2.0, 500)
    z = a * np.cos(omega * t)
    steep = k * a
    rise = -a * omega * (np.sin(omega * t) + steep * np.sin(2 * omega * t))
    decay = np.exp(k * z)
    w = -a * omega * decay * np.sin(omega * t)
    axes.plot(t, rise, color=BLUE, label="rise of the surface, $z_t$")
    axes.plot(t, w, color=ORANGE, ls="--", label="vertical velocity of the water, $w$")
    axes.plot(t, rise - w, color=GREEN, label=r"nonlinear term, $-\mathbf{u}\cdot\nabla z$")
    axes.set(xlabel="time (s)", ylabel="m/s")
    axes.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def fused_elevation() -> Figure:
    """Noise of both elevations, and the weight of stereo in their best combination."""
    figure = Figure(figsize=(6, 2.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    f = np.geomspace(0.2, 8, 200)
    stereo = np.full_like(f, 1e-9)
    integrated = 4e-8 / (2 * np.pi * f) ** 2
    sea = 2e-5 * f**-5 * np.exp(-1.25 * (0.9 / f) ** 4)
    left.loglog(f, sea, color=GREY, label="waves")
    left.loglog(f, stereo, color=BLUE, label="noise of stereo z")
    left.loglog(f, integrated, color=ORANGE, label=r"noise of $\int w\,dt$")
    left.loglog(f, 1 / (1 / stereo + 1 / integrated), color=GREEN, lw=2, label="noise of both together")
    left.set(xlabel="frequency (Hz)", ylabel="power (m²/Hz)", ylim=(1e-11, 3e-2))
    left.legend(fontsize=8, loc="upper left")
    right.semilogx(f, 1 / stereo / (1 / stereo + 1 / integrated), color=BLUE)
    right.set(xlabel="frequency (Hz)", ylabel="weight of stereo", ylim=(0, 1.02))
    for axes in (left, right):
        axes.set_xticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"])
        axes.set_xticks([], minor=True)
    return figure


def dispersion() -> Figure:
    """The relation in still water and on currents along and against the waves."""
    figure = Figure(figsize=(6, 2.6), layout="constrained")
    axes = figure.subplots()
    k = np.linspace(0.5, 120, 400)
    rest = free_frequency(k)
    axes.plot(k, rest / (2 * np.pi), color=BLUE, label="still water, $\\sigma(k)$")
    for speed, colour in ((0.15, GREEN), (-0.15, ORANGE)):
        axes.plot(
            k, (rest + k * speed) / (2 * np.pi), color=colour, label=f"U = {speed:+.2f} m/s along the waves"
        )
    rng = np.random.default_rng(2)
    at = np.linspace(8, 110, 18)
    axes.plot(
        at + rng.normal(0, 1.5, 18),
        (free_frequency(at) + 0.15 * at) / (2 * np.pi),
        "o",
        ms=3.5,
        color="black",
        label="centroids of the energy",
    )
    axes.set(xlabel="wavenumber k (rad/m)", ylabel="frequency (Hz)")
    axes.legend(fontsize=8)
    return figure


def nonlinear_waves() -> Figure:
    """Free waves, and where the waves that they force lie."""
    figure = Figure(figsize=(6, 2.6), layout="constrained")
    axes = figure.subplots()
    k = np.linspace(0.5, 120, 400)
    axes.plot(k, free_frequency(k) / (2 * np.pi), color=BLUE, label="free waves")
    half = free_frequency(k / 2)
    axes.plot(k, 2 * half / (2 * np.pi), color=ORANGE, ls="--", label="second harmonic, $2\\sigma(k/2)$")
    k1, k2 = 20.0, 34.0
    f1, f2 = (float(free_frequency(np.array(q))) / (2 * np.pi) for q in (k1, k2))
    axes.plot([k1, k2], [f1, f2], "o", color="black", ms=5)
    axes.plot(
        [k1 + k2, k2 - k1],
        [f1 + f2, f2 - f1],
        "D",
        color=GREEN,
        ms=6,
        label="sum and difference of two waves",
    )
    axes.set(xlabel="wavenumber k (rad/m)", ylabel="frequency (Hz)", ylim=(0, 8))
    axes.legend(fontsize=8)
    return figure


def surface_statistics() -> Figure:
    """Exceedance of crests by Rayleigh and Tayfun, and the flatness of increments."""
    figure = Figure(figsize=(5.2, 2.6), layout="constrained")
    axes = figure.subplots()
    x = np.linspace(0, 5.2, 200)
    axes.semilogy(x, np.exp(-(x**2) / 2), color=GREY, label="Rayleigh, linear waves")
    for skewness, colour in ((0.15, BLUE), (0.3, ORANGE)):
        m = skewness / 3
        level = np.exp(-((np.sqrt(1 + 2 * m * x) - 1) ** 2) / (2 * m**2))
        axes.semilogy(x, level, color=colour, label=f"Tayfun, skewness {skewness:g}")
    axes.set(xlabel="crest height / standard deviation", ylabel="share of higher crests", ylim=(1e-5, 1.5))
    axes.legend(fontsize=8)
    return figure


def uncertainty() -> Figure:
    """Variance per decade of wavenumber that noise, prior and frames leave in the error of z."""
    figure = Figure(figsize=(5.2, 2.6), layout="constrained")
    axes = figure.subplots()
    k = np.geomspace(4, 400, 300)
    spectrum = k**-3.5 * np.exp(-((9 / k) ** 4)) * 9**3.5
    noise = 2e-4 / np.exp(-2 * k**2 * 0.005**2)
    gain = spectrum / (spectrum + noise)
    phase = free_frequency(k) / 20.0
    frames = (150 * np.cos(phase / 2) - 25 * np.cos(1.5 * phase) + 3 * np.cos(2.5 * phase)) / 128
    axes.loglog(k, k**2 * spectrum, color=BLUE, label="waves, $S$")
    axes.loglog(k, k**2 * gain**2 * noise, color=ORANGE, label="noise, $G^2 N$")
    axes.loglog(k, k**2 * (1 - gain) ** 2 * spectrum, color=GREEN, label="prior, $(1 - G)^2 S$")
    axes.loglog(k, k**2 * spectrum * (1 - frames) ** 2, color=GREY, label="frames, $S\\,|1 - K|^2$")
    axes.set(xlabel="wavenumber k (rad/m)", ylabel="variance per decade (arbitrary)")
    axes.set(xlim=(7, 400), ylim=(1e-4, 3e3))
    axes.legend(fontsize=8, loc="upper right")
    return figure


FIGURES: tuple[Callable[[], Figure], ...] = (
    cameras, matching, map_estimate, surface, velocity, spectra, kinematics, fused_elevation, dispersion,
    nonlinear_waves, surface_statistics, uncertainty,
)  # fmt: skip


def main() -> None:
    """Draw all figures."""
    FOLDER.mkdir(exist_ok=True)
    with mpl.rc_context(STYLE):
        for draw in FIGURES:
            path = FOLDER / f"{draw.__name__.replace('_', '-')}.svg"
            draw().savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main()
