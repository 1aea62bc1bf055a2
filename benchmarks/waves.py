"""Speed, memory and accuracy of the wave analysis: `python -m benchmarks.waves`.

    python -m benchmarks.waves                          the cube of the paper: 12,000 x 150 x 200
    python -m benchmarks.waves --steps 2560             the same at reduced length
    python -m benchmarks.waves --store cube.zarr --truth truth.zarr
                                                        a simulated experiment, measured from its images:
                                                        wavefield simulate spectra DIR,
                                                        wavefield run DIR/experiment.yaml -o cube.zarr,
                                                        truth in DIR/truth/truth.zarr

The cube is noise on a sea, float32, in a Zarr store with one step range per chunk. xrft is measured beside
where it can be imported. Times of single estimators are CPU times on one thread; the whole analysis is wall
time.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import dask
import numpy as np
import scipy.fft
import xarray as xr

import wavefield.waves as wv
from benchmarks.from_images import experiment, row, title
from benchmarks.options import parser_of
from wavefield.waves import rings

STEPS, NY, NX, SEGMENT = 12_000, 150, 200, 512
DT, STEP = 0.05, 0.01
FIELDS = ("z", "z_t", "u", "v", "w")


def write_cube(path: Path, steps: int) -> None:
    """A sea of a hundred waves with the paper's noise, piece by piece."""
    rng = np.random.default_rng(0)
    n = 100
    f = (rng.random(n) * (4.0**-4 - 1) + 1) ** -0.25
    k = wv.wavenumber(2 * np.pi * f, 0.7)
    angle = 2 * np.pi * rng.random(n)
    kx, ky, omega = k * np.cos(angle), k * np.sin(angle), wv.dispersion(k, 0.7)
    a = (0.015 * np.sqrt(2 / n) * np.exp(2j * np.pi * rng.random(n))).astype("c8")
    y, x = np.arange(NY) * STEP, np.arange(NX) * STEP
    ex, ey = np.exp(1j * np.outer(kx, x)).astype("c8"), np.exp(1j * np.outer(y, ky)).astype("c8")
    gains = {"z": 1.0, "z_t": -1j * omega, "u": kx * omega / k, "v": ky * omega / k, "w": -1j * omega}
    noise = {"z": 0.00057, "z_t": 0.016, "u": 0.005, "v": 0.005, "w": 0.0056}
    coords = {"time": (np.arange(steps) + 0.5) * DT, "y": y, "x": x}
    attrs = {"frame_rate": 1 / DT, "water_depth": 0.7}
    for first in range(0, steps, 64):
        t = coords["time"][first : first + 64]
        turned = a * np.exp(-1j * np.outer(t, omega))
        data = {}
        for name in FIELDS:
            sea = np.stack([((ey * (row_ * gains[name])) @ ex).real for row_ in turned]).astype("f4")
            sea += noise[name] * rng.standard_normal(sea.shape, dtype="f4")
            data[name] = (("time", "y", "x"), sea, {"units": "m" if name == "z" else "m s-1"})
        part = xr.Dataset(data, coords | {"time": t}, attrs)
        if first == 0:
            chunks = {name: {"chunks": (64, NY, NX)} for name in FIELDS}
            part.to_zarr(path, mode="w", consolidated=False, encoding=chunks)
        else:
            part.to_zarr(path, append_dim="time", consolidated=False)


def cpu(function, repeats: int = 2):
    """Least CPU time of a few runs, and the last result."""
    times, out = [], None
    for _ in range(repeats):
        start = time.process_time()
        out = function()
        times.append(time.process_time() - start)
    return min(times), out


def peer(stored) -> float | None:
    """CPU time of xrft over the same segments with half overlap, or None."""
    try:
        import xrft
    except ImportError:
        return None
    start = time.process_time()
    total, count, power = 0.0, 0, None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for first in range(0, stored.sizes["time"] - SEGMENT + 1, SEGMENT // 2):
            power = xrft.power_spectrum(
                stored.isel(time=slice(first, first + SEGMENT)).load(),
                dim=["time", "y", "x"],
                real_dim="x",  # quicker than time
                window="hann",
                window_correction=True,
                detrend="constant",
            )
            # values: its frequencies differ by rounding from one segment to the next
            total = total + power.values
            count += 1
    spent = time.process_time() - start
    cell = np.prod([float(power[name][1] - power[name][0]) for name in power.dims])
    share = float((total / count).sum() * cell / stored[:2000].var())
    row(f"xrft {xrft.__version__}: its total over the variance", "1", f"{share:.3f}")
    return spent


def speed(path: Path) -> None:
    """E(k, omega) of one variable against the bare transform, on one thread."""
    stored = xr.open_zarr(path, chunks=None, consolidated=False)
    steps = stored.sizes["time"]
    title(f"E(k, omega) of one variable, {steps} x {NY} x {NX} float32 from Zarr, one thread, CPU s")
    with dask.config.set(scheduler="synchronous"):
        wv.komega(stored.w.isel(time=slice(0, SEGMENT)).chunk(), segment=SEGMENT).compute()  # compile
        rings.rings.cache_clear()
        lazy = stored.w.chunk({"time": SEGMENT // 2})

        def bare(read_only: bool) -> None:
            for first in range(0, steps - SEGMENT + 1, SEGMENT):
                part = stored.w[first : first + SEGMENT].values
                if not read_only:
                    scipy.fft.rfftn(part)

        read, _ = cpu(lambda: bare(True))
        both, _ = cpu(lambda: bare(False))
        found, record = cpu(lambda: wv.find_record(stored.w))
        known, E = cpu(lambda: wv.komega(lazy, segment=SEGMENT, record=record).compute())
        whole, _ = cpu(lambda: wv.komega(lazy, segment=SEGMENT).compute())
    row("reading the variable once", "", f"{read:.2f}")
    row("bare rfftn of the segments without overlap, with reading", "", f"{both:.2f}")
    row("looking for gaps and edges (once per cube; reads it)", "", f"{found:.2f}")
    row("komega, gaps and edges known, with reading", "", f"{known:.2f}")
    row("  the same over bare rfftn twice (overlap), both with reading", "1.5", f"{known / both / 2:.2f}")
    row("  the same, reading taken off both", "1.5", f"{(known - read) / (both - read) / 2:.2f}")
    row("komega, gaps and edges searched, with all reading", "", f"{whole:.2f}")
    row("  the same over bare rfftn twice (overlap), with reading", "1.5", f"{whole / both / 2:.2f}")
    row("its total over the variance", "1", f"{float(wv.total(E.E) / stored.w[:2000].var()):.3f}")
    time_of_peer = peer(stored.w)
    if time_of_peer is None:
        row("xrft (not installed)", "", "-")
    else:
        row("xrft over the same segments, no angular integral, with reading", "", f"{time_of_peer:.2f}")
        row("komega, gaps and edges known, over xrft", "", f"{known / time_of_peer:.2f}")


def in_memory() -> None:
    """E(k, omega) of cubes in memory against the transforms of all their segments, which overlap by half."""
    title("E(k, omega) of noise in memory, gaps and edges known, over rfftn of all segments, one thread")
    for steps, ny, nx, segment in ((1024, 96, 128, 256), (1024, 96, 128, 512), (1536, 150, 200, 512)):
        values = np.random.default_rng(0).standard_normal((steps, ny, nx), dtype=np.float32)
        coords = {"time": (np.arange(steps) + 0.5) * DT, "y": np.arange(ny) * STEP, "x": np.arange(nx) * STEP}
        cube = xr.DataArray(values, coords, ("time", "y", "x"), name="w", attrs={"units": "m s-1"})
        firsts = range(0, steps - segment + 1, segment // 2)
        with dask.config.set(scheduler="synchronous"):
            _, record = cpu(lambda c=cube: wv.find_record(c), 3)
            spent, _ = cpu(lambda c=cube, n=segment, r=record: wv.komega(c, segment=n, record=r).compute(), 5)
            asked, _ = cpu(lambda c=cube, n=segment: wv.komega(c, segment=n).compute(), 5)
            bare, _ = cpu(lambda a=values, n=segment, f=firsts: [scipy.fft.rfftn(a[k : k + n]) for k in f], 5)
        row(f"{steps} x {ny} x {nx}, segments of {segment}", "1.5", f"{spent / bare:.2f}")
        row("  gaps and edges searched as well", "", f"{asked / bare:.2f}")


_WHOLE = """
import json, resource, sys, time
from dataclasses import replace
import dask
import wavefield
import wavefield.waves as wv
import numpy as np, xarray as xr
parts = {}
from wavefield.waves import products
def timed(product):
    def work(*inputs):
        begin = time.process_time()
        try:
            return product.compute(*inputs)
        finally:
            parts[product.name] = parts.get(product.name, 0.0) + time.process_time() - begin
    return replace(product, compute=work)
cube = xr.open_zarr(sys.argv[1], chunks=None, consolidated=False)
small = cube.isel(time=slice(0, 128), y=slice(0, 40), x=slice(0, 50)).load()
wv.analyze(small)  # compile
longest = ("dispersion_fit", "directional")
every = [timed(p) if p.name in longest else p for p in products.registered()]
products.registered = lambda: every
start, work = time.perf_counter(), time.process_time()
with dask.config.set(scheduler="threads", num_workers=2):
    out = wavefield.analyze(sys.argv[1], sys.argv[2])
print(json.dumps({
    "wall": time.perf_counter() - start,
    "cpu": time.process_time() - work,
    "parts": parts,
    "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
}))
"""


def whole(path: Path, steps: int) -> None:
    """The whole analysis in a process of its own."""
    title(f"The whole of analyze, five variables of {steps} x {NY} x {NX}, two threads")
    done = subprocess.run(
        [sys.executable, "-c", _WHOLE, str(path), str(path.with_name("waves.zarr"))],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        print(done.stderr)
        raise SystemExit(1)
    figures = json.loads(done.stdout.splitlines()[-1])
    share = steps / STEPS
    row("wall time, s", f"{60 * share:.0f}", f"{figures['wall']:.1f}")
    row("CPU time, s (wall on two free cores is about half)", "", f"{figures['cpu']:.1f}")
    for name, spent in figures["parts"].items():
        row(f"  of it {name}, s", "", f"{spent:.1f}")
    new = sum(spent for name, spent in figures["parts"].items() if name != "dispersion_fit")
    row(
        "CPU time over that without directional",
        "2",
        f"{figures['cpu'] / (figures['cpu'] - new):.2f}",
    )
    row("memory, GB", "2", f"{figures['memory']:.2f}")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--steps", type=int, default=STEPS, help="length of the record")
    parser.add_argument("--cube", type=Path, help="where the cube is kept between runs; by default it is not")
    parser.add_argument("--store", type=Path, help="a cube measured from a simulated experiment")
    parser.add_argument("--truth", type=Path, help="the exact fields of that experiment")
    parser.add_argument("--segment", type=int, help="steps of a segment, for --store")
    parser.add_argument("--gain", type=Path, help="a gain kept from another experiment, for --store")
    parser.add_argument("--picture", type=Path, help="PNG of coherence and spectra to write, for --store")
    given = parser.parse_args()
    if given.store:
        truth = given.truth or given.store.parent / "truth" / "truth.zarr"
        experiment(given.store, truth, given.segment, given.picture, given.gain)
        return
    in_memory()
    with tempfile.TemporaryDirectory() as folder:
        path = given.cube or Path(folder) / "cube.zarr"
        if not path.exists():
            write_cube(path, given.steps)
        steps = xr.open_zarr(path, chunks=None, consolidated=False).sizes["time"]
        speed(path)
        whole(path, steps)


if __name__ == "__main__":
    main()
