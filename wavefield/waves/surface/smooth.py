"""Fields smoothed over time by the free waves that fit a few steps best."""

from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter

from wavefield.errors import CubeError
from wavefield.one_thread import one_thread
from wavefield.variables import CUBE_DIMS, FrameStatus, Quality, annotate, validate
from wavefield.water import water_of
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.wave_record import check_axes
from wavefield.waves.nonlinear.kinematics import slopes
from wavefield.waves.surface.free_waves import Learned, PlaneWaves, Posterior, learn

Array = NDArray[Any]

NAMES = ("z", "u", "v", "w")
INPUTS = (*NAMES, *(f"{name}_std" for name in NAMES), "quality")
HALF_WINDOW = 0.1  # s
MIN_HALF_WINDOW_STEPS, MAX_HALF_WINDOW_STEPS = 2, 10  # on either side
MIN_STEP_RATE = 8.0  # steps per second: waves of 10 cm turn by half a period in a step
SAMPLED_WINDOWS, LEARNED_WINDOWS = 8, 4  # windows of a record that are read; that are learned from
MIN_RELATIVE_COVERAGE = 0.95  # of the nodes of the fullest of them
MIN_MEASURED_SHARE = 0.25  # of a rectangle's: measured in all steps of those windows
TILE_NODES = 60  # a side, at most, of a rectangle that is fitted as one
OVERLAP_NODES = 16  # that it shares with the next
MISFIT_RADIUS = 3.0  # nodes: standard deviation of the weights with which misfits are averaged
COMMON_ERROR_SHARE = 0.12  # of the noise's variance: errors that all steps of a window share
MIN_GRID_NODES = 8  # nodes a side
JUMP_OF_TIME = -1.0  # in place of the quality of a step where time jumps
VARIANCE_SPACING = 5  # nodes between those at which the variance of the fit is computed


def beyond_jumps(quality: Array) -> Array:
    """Steps of a window, quality (times, ny, nx), that a discontinuous step separates from the middle one."""
    jump = (quality == JUMP_OF_TIME).any(axis=(1, 2))
    middle = jump.size // 2
    before = np.logical_or.accumulate(jump[middle::-1])[::-1]
    return np.concatenate([before, np.logical_or.accumulate(jump[middle + 1 :])])


class _Smoother:
    """What is common to all steps of a record."""

    def __init__(
        self, shape: tuple[int, int], step: float, dt: float, water: tuple[float, float], steps: int
    ) -> None:
        most = min(MAX_HALF_WINDOW_STEPS, (steps - 1) // 2)
        self.steps = int(np.clip(round(HALF_WINDOW / dt), MIN_HALF_WINDOW_STEPS, most))
        counts = [max(-(-(n - OVERLAP_NODES) // (TILE_NODES - OVERLAP_NODES)), 1) for n in shape]
        ny, nx = (-(-(n + (count - 1) * OVERLAP_NODES) // count) for n, count in zip(shape, counts))
        self.tile = ny, nx
        starts = [
            np.round(np.linspace(0, n - size, count)).astype(int)
            for n, size, count in zip(shape, self.tile, counts)
        ]
        self.tiles = [
            (slice(a, a + self.tile[0]), slice(b, b + self.tile[1])) for a in starts[0] for b in starts[1]
        ]
        ramps = [np.minimum(np.arange(n) + 1.0, n - np.arange(n)).clip(max=OVERLAP_NODES) for n in self.tile]
        self.taper = ramps[0][:, None] * ramps[1]
        self.step, times = step, dt * np.arange(-self.steps, self.steps + 1, dtype=np.float64)
        self.waves = PlaneWaves(self.tile, step, times, np.zeros(2), *water)
        self.learned: Learned
        self.mask = np.zeros(shape, bool)
        self._fits: dict[int, tuple[Posterior, Array]] = {}

    def parts(self, window: Array) -> tuple[Array, Array, Array]:
        """z, u, v, rise (4, times, ny, nx), 0 where not measured; stated variances; measured nodes."""
        z, u, v, w = window[:4].astype(float)
        z_y, z_x = slopes(z, self.step, self.step)
        fields = np.stack([z, u, v, w - u * z_x - v * z_y])
        variance = np.square(window[4:8].astype(float))
        there = (
            np.isfinite(fields).all(axis=0) & np.isfinite(variance).all(axis=0) & (variance > 0).all(axis=0)
        )
        there &= (np.nan_to_num(window[8]).astype(int) & Quality.MEASURED) > 0
        return np.where(there, fields, 0.0), np.where(there, variance, 1.0), there

    def study(self, windows: list[Array]) -> None:
        """Learn from the fullest of sample windows (9, times, ny, nx), at nodes that all of them measured."""
        parts = [self.parts(window) for window in windows]
        shares = np.array([there.mean() for _, _, there in parts])
        order = np.argsort(-shares, kind="stable")[:LEARNED_WINDOWS]
        parts = [parts[i] for i in order if shares[i] >= MIN_RELATIVE_COVERAGE * shares.max()]
        measured = np.mean([there.mean(axis=0) for _, _, there in parts], axis=0)
        self.mask = measured > 0.5
        at = max(self.tiles, key=lambda tile: np.sum(measured[tile] == 1.0))
        mask, part = measured[at] == 1.0, (slice(None), slice(None), *at)
        if mask.sum() < MIN_MEASURED_SHARE * mask.size:
            raise CubeError(
                f"only {100 * mask.mean():.0f} % of the nodes are measured in all steps of a window:"
                f" smooth needs {100 * MIN_MEASURED_SHARE:.0f} %"
            )
        variance = np.median(
            np.concatenate([one[part][:, :, mask] for _, one, _ in parts], axis=1), axis=(1, 2)
        )
        self.learned = learn(
            self.waves, mask, [np.where(mask, one[part], 0.0) for one, _, _ in parts], variance
        )
        self.waves.respond(self.learned.current)

    def fit_of(self, number: int) -> tuple[Posterior, Array]:
        """Factor of a tile, and the covariance (ny, nx, 6, 6) of its fields and slopes at mid-time."""
        if number not in self._fits:
            waves, mask = self.waves, self.mask[self.tiles[number]]
            normal = waves.normal(waves.products(mask), self.learned.noise)
            posterior = Posterior(normal, self.learned.prior[waves.group])
            ny, nx = self.tile
            y, x = (np.unique(np.append(np.arange(0, n, VARIANCE_SPACING), n - 1)) for n in (ny, nx))
            nodes = (y[:, None] * nx + x).ravel()
            covariance = posterior.covariance(waves.rows(nodes, self.steps)).reshape(y.size, x.size, 6, 6)
            at = np.stack(np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij"), axis=-1)
            self._fits[number] = posterior, RegularGridInterpolator((y, x), covariance)(at)
        return self._fits[number]

    def smoothed(self, window: Array) -> Array:
        """z, u, v, w and their standard uncertainties (8, ny, nx) at the middle of a window."""
        own = window[:8, self.steps]
        total, weights = np.zeros(own.shape), np.zeros(own.shape[1:])
        fields, variance, there = self.parts(window)
        there[beyond_jumps(window[8])] = False
        for number, at in enumerate(self.tiles):
            if self.mask[at].any():
                part = (slice(None), slice(None), *at)
                values = self._tile(number, fields[part], variance[part], there[part[1:]], own[:4, *at])
                total[:, *at] += self.taper * values
                weights[at] += self.taper
        usable = there[self.steps] & self.mask & (weights > 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            total /= weights
        total[4:] = np.minimum(np.sqrt(total[4:]), own[4:])
        return np.where(usable, total, own).astype(np.float32)

    def _tile(self, number: int, fields: Array, variance: Array, there: Array, own: Array) -> Array:
        """Values and variances (8, ny, nx) of a tile at the middle."""
        waves, learned, middle = self.waves, self.learned, self.steps
        posterior, covariance = self.fit_of(number)
        mask = self.mask[self.tiles[number]]
        there = there & mask
        weight = there / learned.noise[:, None, None, None]
        if there[:, mask].all():
            unknowns = posterior.solve(waves.transposed(weight * fields))
        else:
            unknowns = posterior.solve_partial(waves, fields, weight)
        fit = waves.fields(unknowns)
        expected = (np.minimum(learned.misfit, 1.0) * (1.0 - learned.taken))[:, None, None, None]
        ratio = there * (fields - fit) ** 2 / (variance * expected)
        near = np.maximum(gaussian_filter(there.sum(axis=0) * 1.0, MISFIT_RADIUS), 1e-9)
        mean = gaussian_filter(ratio.sum(axis=1), (0.0, MISFIT_RADIUS, MISFIT_RADIUS)) / near
        fewer = (
            gaussian_filter(waves.times.size * mask * 1.0, MISFIT_RADIUS) / near
        )  # steps and nodes than the factor has
        excess = np.maximum(mean - 1.0, 0.0)
        kept = excess / (1.0 + excess)  # of what the waves leave
        z, u, v, rise = fit[:, middle]
        z_x, z_y = waves.slopes(unknowns, middle)
        of_w = np.stack([np.ones_like(u), u, v], axis=-1)
        posterior_variance = np.stack(
            [
                *(covariance[..., i, i] for i in range(3)),
                np.einsum("yxr,yxrs,yxs->yx", of_w, covariance[..., 3:, 3:], of_w),
            ]
        )
        best = np.stack([z, u, v, rise + u * z_x + v * z_y])
        noise = np.minimum(learned.misfit, 1.0)[:, None, None]
        left = fewer * posterior_variance / learned.variance[:, None, None] + noise * (
            excess + COMMON_ERROR_SHARE
        )
        total = variance[:, middle] * ((1.0 - kept) ** 2 * left + kept**2)
        return np.concatenate([best + kept * (np.nan_to_num(own) - best), total])


@takes(a_cube)
def smooth(cube: xr.Dataset, *, depth: float | None = None) -> xr.Dataset:
    """Smooth a cube over time by the free waves that fit the steps around each one best.

    Never applied by itself: spectra and other estimates take the noise of steps as independent, and are made
    of the cube itself.

    Parameters
    ----------
    cube : Dataset
        z, u, v, w over (time, y, x), m and m/s, with their standard uncertainties ``z_std``, ``u_std``,
        ``v_std``, ``w_std``; ``quality`` and ``frame_status`` where present. Up to eight windows of it are
        read at once to learn the spectrum, the noise and the current; lazy input gives a lazy result.
    depth : float, optional
        Depth of the water, m; that of the cube, or deep, if not given.

    Returns
    -------
    Dataset
        The same names over the same nodes and times: z, u, v, w, smoothed, their standard uncertainties, and
        the cube's ``quality``. Values at nodes that are not flagged as measured, and steps without a full
        window of measured neighbours in the learned region, are the cube's own. Attribute ``smoothed``.

    Raises
    ------
    CubeError
        If a variable is missing, the record has fewer than five steps or fewer than eight a second, or too
        few nodes are measured.

    Notes
    -----
    Windows hold the steps within 0.1 s, two on either side at least, none beyond a discontinuous step: time
    jumps there. Unknowns are the amplitudes a of free
    waves of all directions, of eddies (a stream function that the current carries) and constants,

        z = sum a e, u = sum (k / |k|) (sigma / tanh |k| h) a e, w - u . grad z = sum -i omega a e,

    e = exp(i (k . x - omega t)), omega = sigma + k . U, sigma by the dispersion relation. They are the most
    probable ones, given the cube's noise and a spectrum by rings of |k| that is learned with the current U,
    in rectangles of at most 60 nodes a side that overlap. Where what waves leave of a field exceeds its noise
    by the factor 1 + q, averaged over the window and 3 nodes, the share q / (1 + q) of the measured value is
    kept: with waves that first-order theory does not follow, steep ones above all, the result is the measured
    field, and so is its standard uncertainty. Of errors that all steps share, and that are alike free waves,
    12 % of the noise's variance are assumed. Waves shorter than 4.4 nodes are not followed.

    Examples
    --------
    A wave of 0.4 m on deep water, and noise.

    >>> import wavefield as wf
    >>> t, y, x = np.arange(9) * 0.05, np.arange(20) * 0.02, np.arange(24) * 0.02
    >>> k = 2 * np.pi / 0.4
    >>> omega = float(wf.water.dispersion(k))
    >>> phase = k * x - omega * t[:, None, None] + 0 * y[:, None]
    >>> exact = {"z": 2e-3 * np.cos(phase), "u": 2e-3 * omega * np.cos(phase), "v": 0 * phase}
    >>> exact["w"] = 2e-3 * np.sin(phase) * (omega - k * exact["u"])
    >>> noise, std = np.random.default_rng(1), {"z": 1e-4, "u": 2e-3, "v": 2e-3, "w": 2e-3}
    >>> fields = {n: f + std[n] * noise.standard_normal(f.shape) for n, f in exact.items()}
    >>> fields |= {f"{n}_std": np.full(phase.shape, s) for n, s in std.items()}
    >>> dims = ("time", "y", "x")
    >>> cube = xr.Dataset({n: (dims, f) for n, f in fields.items()}, {"time": t, "y": y, "x": x})
    >>> found = smooth(cube)
    >>> bool(np.std(found.u - exact["u"]) < 0.5 * np.std(cube.u - exact["u"]))
    True
    """
    missing = [name for name in INPUTS[:8] if name not in cube]
    if missing:
        raise CubeError(f"the cube has no {missing[0]!r}: smooth needs z, u, v, w and their uncertainties")
    fields = validate(cube, *INPUTS[:8]).transpose(*CUBE_DIMS)
    dt, dy, dx = check_axes(fields)
    steps, shape = fields.sizes["time"], (fields.sizes["y"], fields.sizes["x"])
    if steps < 2 * MIN_HALF_WINDOW_STEPS + 1 or not dt <= 1.0 / MIN_STEP_RATE:
        raise CubeError(
            f"the record has {steps} steps of {dt:g} s:"
            f" smooth needs {2 * MIN_HALF_WINDOW_STEPS + 1} steps, {MIN_STEP_RATE:g} of them a second"
        )
    if min(shape) < MIN_GRID_NODES or not np.isclose(dx, dy, rtol=0.01):
        raise CubeError(
            f"the grid has {shape[1]} x {shape[0]} nodes: smooth needs {MIN_GRID_NODES} of equal distances"
        )
    quality = cube["quality"].transpose(*CUBE_DIMS) if "quality" in cube else xr.ones_like(fields["z"])
    used = quality
    if "frame_status" in cube:
        used = quality.where(cube["frame_status"] != FrameStatus.DISCONTINUOUS, JUMP_OF_TIME)
    arrays = [*(fields[name] for name in INPUTS[:8]), used]
    smoother = _Smoother(shape, dx, dt, water_of(cube.attrs, depth), steps)
    reach = smoother.steps
    middles = sorted(
        {reach + (2 * i + 1) * (steps - 2 * reach) // (2 * SAMPLED_WINDOWS) for i in range(SAMPLED_WINDOWS)}
    )
    parts = [slice(one - reach, one + reach + 1) for one in middles]
    with one_thread():
        smoother.study([np.stack([a[part].values.astype(np.float32) for a in arrays]) for part in parts])

    def work(block: Array) -> Array:
        windows = [block[:, i : i + 2 * reach + 1] for i in range(block.shape[1] - 2 * reach)]
        with one_thread():
            return np.stack([smoother.smoothed(window) for window in windows], axis=1)

    ends = {0: 0, 1: reach, 2: 0, 3: 0}
    if any(a.chunks for a in arrays):
        lazy = da.stack([a.astype(np.float32).data for a in arrays]).rechunk({0: -1, 2: -1, 3: -1})
        lazy = da.overlap.overlap(lazy, ends, {1: np.nan})
        chunks = ((8,), tuple(n - 2 * reach for n in lazy.chunks[1]), *lazy.chunks[2:])
        out = lazy.map_blocks(work, dtype=np.float32, chunks=chunks, meta=np.empty((0,) * 4, np.float32))
    else:
        whole = np.stack([a.values.astype(np.float32) for a in arrays])
        out = work(np.pad(whole, [(n, n) for n in ends.values()], constant_values=np.nan))
    found = fields.assign({name: (CUBE_DIMS, out[i]) for i, name in enumerate(INPUTS[:8])})
    if "quality" in cube:
        found["quality"] = quality
    current = ", ".join(f"{part:.4f}" for part in smoother.learned.current)
    how = f"by free waves over {2 * reach + 1} steps, on a current of {current} m/s"
    return annotate(found).assign_attrs({**cube.attrs, "smoothed": how})
