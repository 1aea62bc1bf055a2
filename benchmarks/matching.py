"""Accuracy and speed of matching: `python -m benchmarks.matching` prints asked and reached.

The cases of other programs and the real images are read from the folder that WAVEFIELD_SHARED names, or
../shared; without it these parts are skipped. OpenPIV and pivtools are measured beside it where they can be
imported. `--only` chooses parts, `--pictures DIR` saves the fields of the real images.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2
import numba as nb
import numpy as np
from scipy.ndimage import map_coordinates

from benchmarks import particle_images as images
from benchmarks.options import parser_of
from wavefield.images import read_image
from wavefield.matching import (
    Displacement,
    MatchSettings,
    PreparedImage,
    kernels,
    match,
    prepare,
)

cv2.setNumThreads(1)
SHARED = Path(os.environ.get("WAVEFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared"))
MISSED: list[str] = []

# few particles, hardly brighter than the noise
WEAK_PARTICLES = MatchSettings.piv(window=64.0, search_window=40.0, min_correlation=0.15)


def row(
    what: str, asked: float | None, reached: float, unit: str = "px", at_least: bool = False, note: str = ""
) -> None:
    """One line of the table; what is asked is a largest value unless `at_least`."""
    good = asked is None or (reached >= asked if at_least else reached <= asked)
    limit = "" if asked is None else f"{'>=' if at_least else '<='} {asked:g}"
    if not good:
        MISSED.append(what)
    print(
        f"  {what:58s} {limit:>10s} {reached:10.4g} {unit:6s} {'' if good else 'MISSED'} {note}", flush=True
    )


def title(text: str) -> None:
    print(f"\n{text}\n  {'':58s} {'asked':>10s} {'reached':>10s}", flush=True)


class Scores:
    """Errors of a displacement against the truth, away from the border."""

    def __init__(self, d: Displacement, truth, margin: float = 48, exclude: np.ndarray | None = None) -> None:
        x, y = np.meshgrid(d.x, d.y)
        u, v = truth(x, y)
        last = images.N - 1 - margin
        inside = (x >= margin) & (x <= last) & (y >= margin) & (y <= last) & (x + u <= last)
        if exclude is not None:
            inside &= ~exclude[y.astype(int), x.astype(int)]
        self.u, self.v = (d.u - u)[inside], (d.v - v)[inside]
        size = np.hypot(self.u, self.v)
        self.outliers = int(np.sum(~(size < 1)))
        self.total = size.size
        self.rms = float(np.sqrt(np.mean(size[size < 1] ** 2) / 2))
        self.valid = d.valid[inside]
        bad = size[self.valid]
        self.valid_outliers = int(np.sum(~(bad < 1)))


def sample(field: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """A lattice field (ny, nx) at places in blocks, by cubic splines."""
    return map_coordinates(field, [row, column], mode="nearest")


def at_midpoint(d: Displacement) -> Displacement:
    """The displacement whose path has its middle at the lattice: d_mid(x) = d(x - d_mid(x) / 2)."""
    spacing = d.x[1] - d.x[0]
    column, row = np.meshgrid(np.arange(len(d.x)), np.arange(len(d.y)))
    u, v = d.u, d.v
    for _ in range(6):
        at = column - u / (2 * spacing), row - v / (2 * spacing)
        u, v = sample(d.u, *at), sample(d.v, *at)
    return replace(d, u=u, v=v)


def peer_cases() -> dict[str, dict]:
    folder = SHARED / "peers" / "cases"
    return {p.name[0]: dict(np.load(p)) for p in sorted(folder.glob("*.npz"))} if folder.is_dir() else {}


def middle_truth(case: dict) -> Callable:
    shift, amplitude, wavelength = case["shift"], float(case["amp"]), float(case["lam"])
    if float(np.ptp(case["u_mid"])) < 1e-6:
        return lambda x, y: (np.full_like(x, shift[0]), np.full_like(x, shift[1]))
    k = 2 * np.pi / wavelength
    return lambda x, y: (amplitude * np.sin(k * y), amplitude * np.sin(k * x))


def peers() -> None:
    cases = peer_cases()
    if not cases:
        print("\nThe cases of other programs are not here: set WAVEFIELD_SHARED to their folder.")
        return
    title("Cases of other programs: rms at nodes 64 px from the border (anchored at mid-path)")
    for (name, case), limit in zip(cases.items(), (0.003, 0.006, 0.028, 0.033)):
        d = at_midpoint(match(case["A"], case["B"], MatchSettings.piv()))
        s = Scores(d, middle_truth(case), margin=64)
        note = f"{s.outliers} outliers of {s.total}"
        # figures are asked to three decimals
        row(f"piv, case {name}", limit + 0.0005, s.rms, note=note)
        row(f"piv, case {name}: outliers", 0, s.outliers, "")
    other_programs(cases)


def other_programs(cases: dict[str, dict]) -> None:
    try:
        sys.path.insert(0, str(SHARED / "peers"))
        import run_openpiv
    except ImportError:
        print("  OpenPIV is not installed: its rows are skipped.")
    else:
        for name in (
            "64-32-32 75% (3 pass, cubic, no s2n)",
            "64-32-32-32 75% (4 pass, quintic, linear norm corr)",
        ):
            for letter, case in cases.items():
                a, b = case["A"].astype(np.int32), case["B"].astype(np.int32)
                start = time.process_time()
                x, y, u, v, _ = run_openpiv.run(a, b, run_openpiv.CFG[name])
                _peer_row(f"OpenPIV {name[:32]}, case {letter}", case, x - 0.5, y - 0.5, u, v, start)
    try:
        correlator = _pivtools()
    except ImportError as missing:
        print(f"  pivtools is not installed ({missing}): its rows are skipped.")
        return
    for letter, case in cases.items():
        start = time.process_time()
        x, y, u, v = correlator(case["A"], case["B"])
        _peer_row(f"pivtools 4 passes 75 %, gauss6, Lanczos, case {letter}", case, x, y, u, v, start)


def _peer_row(what: str, case: dict, x, y, u, v, start: float) -> None:
    took = time.process_time() - start
    ut, vt = middle_truth(case)(x, y)
    inside = (x >= 64) & (x <= images.N - 65) & (y >= 64) & (y <= images.N - 65)
    error = np.hypot(u - ut, v - vt)[inside]
    good = error < 1
    note = f"{int(np.sum(~good))} outliers of {error.size}, {took * 1e3:.0f} ms"
    row(what, None, float(np.sqrt(np.mean(error[good] ** 2) / 2)), note=note)


def _pivtools() -> Callable:
    """pivtools' instantaneous correlator with its best setting for these cases: images in, vectors out."""
    import logging
    import tempfile

    import pivtools_core.config as config
    import yaml
    from pivtools_cli.cli import create_default_config
    from pivtools_cli.piv.piv_backend.cpu_instantaneous import InstantaneousCorrelatorCPU

    logging.disable(logging.CRITICAL)
    before, folder = Path.cwd(), tempfile.mkdtemp()
    os.chdir(folder)  # it reads and writes config.yaml in the current folder
    try:
        create_default_config(Path("config.yaml"))
        text = yaml.safe_load(Path("config.yaml").read_text())
        piv = text["instantaneous_piv"]
        sizes, overlaps = (64, 32, 32, 32), [50, 50, 75, 75]
        piv.update(window_size=[[n, n] for n in sizes], overlap=overlaps, runs=[4], peak_finder="gauss6")
        piv["image_warp_interpolation"] = "lanczos"
        text["processing"]["omp_threads"] = 1
        Path("config.yaml").write_text(yaml.safe_dump(text))
        settings = config.Config()
        settings._detected_image_shape = (images.N, images.N)
        correlator = InstantaneousCorrelatorCPU(settings)
    finally:
        os.chdir(before)

    def run(a: np.ndarray, b: np.ndarray):
        found = correlator.correlate_batch(np.stack([a, b])[None].astype(np.float32), settings)
        last = (found[0] if isinstance(found, list | tuple) else found).passes[-1]
        x, y = np.meshgrid(np.asarray(last.win_ctrs_x, float), np.asarray(last.win_ctrs_y, float))
        return x, y, np.asarray(last.ux_mat, float), np.asarray(last.uy_mat, float)

    return run


def speed() -> None:
    title("Time of a pair of 1024 x 1024, one image prepared per pair, CPU time relative to DIS MEDIUM")
    cases = peer_cases()
    a, b = (cases["b"]["A"], cases["b"]["B"]) if cases else images.particles(images.cellular(4.0))
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)

    def series(settings: MatchSettings) -> Callable[[], None]:
        state = {"previous": prepare(a, settings), "count": 0}

        def step() -> None:
            state["count"] += 1
            new = prepare(b if state["count"] % 2 else a, settings)
            match(state["previous"], new, settings)
            state["previous"] = new

        return step

    runs = {
        "DIS": lambda: dis.calc(a, b, None),
        "piv": series(MatchSettings.piv()),
    }
    runs["stereo"] = series(MatchSettings.stereo())
    took: dict[str, list[float]] = {name: [] for name in runs}
    for name in runs:
        runs[name]()
    for _ in range(15):  # interleaved, so that all meet the same machine
        for name, run in runs.items():
            start = time.process_time()
            run()
            took[name].append((time.process_time() - start) * 1e3)
    best = {name: min(times) for name, times in took.items()}
    vectors = (images.N // 5) ** 2
    for name, asked in (("piv", 0.45), ("stereo", None)):
        rate = vectors / best[name] / 1e3
        row(
            f"{name}",
            asked,
            best[name] / best["DIS"],
            "",
            note=f"{best[name]:.1f} ms, {rate:.2f} million vectors/s",
        )
    print(f"  DIS MEDIUM itself: {best['DIS']:.1f} ms; least of 15 runs each")


def stereo() -> None:
    title("Stereo-like pairs: 40 px, gradient .15, gain and offset different between cameras")
    hole = images.holes()
    holes_grown = cv2.dilate(hole.astype(np.uint8), np.ones((17, 17), np.uint8)) > 0
    preset = MatchSettings.stereo()
    strong = MatchSettings.stereo(window=32.0, smoother_sigma=2.8, coarse_smoother_sigma=2.8)
    weights = MatchSettings.stereo(robust=1.5)
    dirty = {"unmatched": 0.25, "noise": 0.04, "lit": True}
    cases = (
        ("clean texture", images.texture(images.parallax, lit=True), None, preset, 0.006, 0),
        (
            "clean texture, holes",
            images.texture(images.parallax, lit=True, hole=hole),
            holes_grown,
            preset,
            0.006,
            0,
        ),
        (
            "clean particles, holes",
            images.particles(images.parallax, lit=True, hole=hole),
            holes_grown,
            preset,
            0.006,
            0,
        ),
        ("25 % unmatched, 4 % noise", images.particles(images.parallax, **dirty), None, preset, 0.12, 0.001),
        (
            "25 % unmatched, 4 % noise, with robust=1.5",
            images.particles(images.parallax, **dirty),
            None,
            weights,
            0.12,
            0.001,
        ),
        (
            "the same and gain of each particle e^N(0,1)",
            images.particles(images.parallax, gain=1.0, **dirty),
            None,
            preset,
            None,
            0.001,
        ),
        (
            "   with window=32, smoother_sigma=2.8",
            images.particles(images.parallax, gain=1.0, **dirty),
            None,
            strong,
            None,
            0.001,
        ),
    )
    for name, (a, b), exclude, settings, limit, outliers in cases:
        d = match(a, b, settings)
        s = Scores(d, images.parallax, exclude=exclude)
        row(name, limit, s.rms, note=f"{100 * s.valid.mean():.1f} % valid")
        row(f"{name}: outliers", 100 * outliers, 100 * s.outliers / s.total, "%")
        if exclude is not None:
            x, y = np.meshgrid(d.x.astype(int), d.y.astype(int))
            deep = cv2.erode(hole.astype(np.uint8), np.ones((25, 25), np.uint8))[y, x] > 0
            print(
                f"  {'':4s}{100 * np.mean(~d.valid[deep]):.1f} % of the blocks deep inside holes are rejected"
            )


def hard() -> None:
    title("Bias, resolution, steep and dirty displacement fields (PIV)")
    for sigma, limit in ((0.675, 0.002), (0.35, 0.005)):
        worst = 0.0
        for fraction in (0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9):
            a, b = images.particles(images.uniform(fraction, fraction / 2), sigma=sigma)
            s = Scores(match(a, b, MatchSettings.piv()), images.uniform(fraction, fraction / 2))
            worst = max(worst, abs(s.u.mean()), abs(s.v.mean()))
        row(f"piv: largest mean bias, particles of {4 * sigma:.1f} px", limit, worst)
    for name, settings in (
        ("piv", MatchSettings.piv()),
        ("stereo", MatchSettings.stereo()),
    ):
        for windows, least in ((2, 0.84), (4, 0.97)):
            wave = images.shear_wave(32.0 * windows)
            d = match(*images.particles(wave), settings)
            x, y = np.meshgrid(d.x, d.y)
            inside = (x > 64) & (x < images.N - 64) & (y > 64) & (y < images.N - 64)
            u, _ = wave(x, y)
            gain = float(np.sum((d.u * u)[inside]) / np.sum((u * u)[inside]))
            row(
                f"{name}: amplitude gain at {32 * windows} px",
                least if name == "piv" else None,
                gain,
                "",
                at_least=True,
            )
    tests = (
        ("10 px, gradient .31", {}, 10.0),
        ("gain .3, 10 % unmatched, 3 % noise", {"gain": 0.3, "unmatched": 0.1, "noise": 0.03}, 4.0),
        ("gain .5, 25 % unmatched, 5 % noise", {"gain": 0.5, "unmatched": 0.25, "noise": 0.05}, 4.0),
        (
            "0.01 per px, gain .5, 20 % unmatched, 3 % noise",
            {"density": 0.01, "gain": 0.5, "unmatched": 0.2, "noise": 0.03},
            4.0,
        ),
        ("particles of 1.4 px", {"sigma": 0.35}, 4.0),
        ("particles of 4.8 px", {"sigma": 1.2}, 4.0),
    )
    for name, options, amplitude in tests:
        field = images.cellular(amplitude)
        a, b = images.particles(field, **options)
        s = Scores(match(a, b), field)
        note = f"{s.outliers} outliers of {s.total}"
        row(f"match: {name}", None, s.rms, note=note)
        if amplitude == 10:
            row(f"match: {name}: outliers", 0, s.outliers, "")


_MEMORY = """
import re, numpy as np, cv2
from wavefield.matching import MatchSettings, match
def peak():  # not getrusage: that counts what the parent held when this process was made
    return int(re.search(r"VmHWM:\\s*(\\d+)", open("/proc/self/status").read())[1]) / 1024
noise = np.random.default_rng(0).integers(0, 255, (1728, 2432), dtype=np.uint8)
match(noise[:200, :200], noise[:200, :200], MatchSettings.{0}())
a = cv2.GaussianBlur(noise, (0, 0), 1.0); b = np.roll(a, 3, 1)
before = peak(); match(a, b, MatchSettings.{0}()); print(before, peak())
"""


def memory() -> None:
    title("Memory of a pair of 2432 x 1728 (peak of the whole process)")
    if not Path("/proc/self/status").exists():
        print("  Only Linux reports the peak memory of a process: skipped.")
        return
    for preset in ("piv", "stereo"):
        done = subprocess.run(
            [sys.executable, "-c", _MEMORY.format(preset)], capture_output=True, text=True, check=True
        )
        before, peak = map(float, done.stdout.split())
        row(
            preset, 300, peak, "MB", note=f"of these {before:.0f} MB are Python, its libraries and the images"
        )


def profile() -> None:
    """Where the time of a pair goes; wrapping the functions costs a little itself."""
    from wavefield.matching import prepared, pyramid

    a, b = images.particles(images.cellular(4.0), noise=0.02)
    stages = {
        "kernels: plain, robust and last steps": (
            pyramid,
            ("plain_sums", "robust_sums", "final_sums", "unweighted_sums", "gradient_moments"),
        ),
        "windows": (pyramid, ("filtered",)),
        "smoother": (pyramid, ("smoothed",)),
        "median of neighbours": (pyramid, ("replace_outliers",)),
        "search": (pyramid, ("search",)),
        "solve, slopes, levels, masks": (
            pyramid,
            ("step", "slopes", "subtract_slopes", "to_finer", "block_weights"),
        ),
        "correlation, scores, reasons": (pyramid, ("assess",)),
        "prepare: normalise": (prepared, ("_normalize",)),
        "prepare: saturation": (prepared, ("_saturated",)),
    }
    for preset in ("piv", "stereo"):
        settings = getattr(MatchSettings, preset)()
        spent: dict[str, float] = dict.fromkeys(stages, 0.0)
        saved = []

        def timed(function: Callable, stage: str, spent: dict[str, float] = spent) -> Callable:
            def run(*arguments, **options):
                start = time.process_time()
                result = function(*arguments, **options)
                spent[stage] += time.process_time() - start
                return result

            return run

        first, second = prepare(a, settings), prepare(b, settings)
        match(first, second, settings)
        for stage, (module, names) in stages.items():
            for name in names:
                saved.append((module, name, getattr(module, name)))
                setattr(module, name, timed(getattr(module, name), stage))
        rounds, start = 10, time.process_time()
        for count in range(rounds):
            first, second = second, prepare(a if count % 2 else b, settings)
            match(first, second, settings)
        total = (time.process_time() - start) / rounds * 1e3
        for module, name, function in saved:
            setattr(module, name, function)
        print(f"\nWhere {total:.1f} ms of CPU time go ({preset}, 1024 x 1024, one image prepared)")
        rest = total
        for stage, seconds in sorted(spent.items(), key=lambda item: -item[1]):
            share = seconds / rounds * 1e3
            rest -= share
            print(f"  {stage:42s} {share:6.2f} ms {100 * share / total:5.1f} %")
        print(f"  {'copies, pyramid and the rest':42s} {rest:6.2f} ms {100 * rest / total:5.1f} %")
        passes = sum(n / 4**level for level, n in enumerate(reversed(settings.iterations)))
        read = _reading(first, second)
        print(f"  floor: reading b {passes:.2f} times, no more: {passes * read:.1f} ms ({read:.2f} ms each)")


@nb.njit(nogil=True)
def _read(image, u, v, work):
    for by in range(len(u)):
        kernels._warp_strip(image, by, u[by], v[by], work)


def _reading(first: PreparedImage, second: PreparedImage) -> float:
    """Least time, ms, to read the second image once under all blocks."""
    u = np.full(first.levels[0].blocks, np.float32(1.3))
    work = kernels.work_space(u.shape[1])
    times = []
    for _ in range(8):
        start = time.process_time()
        _read(second.levels[0].padded, u, u, work)
        times.append((time.process_time() - start) * 1e3)
    return min(times)


def _uvmat(path: Path, stage: int):
    """Positions, displacements and flags that UVMAT stored."""
    try:
        from scipy.io import netcdf_file

        data = netcdf_file(path, mmap=False).variables
    except TypeError:  # the newer files are HDF5
        import h5py

        data = h5py.File(path)
    names = [f"Civ{stage}_{k}" for k in ("X", "Y", "U", "V", "F")]
    return [np.asarray(data[name][:], float) for name in names]


def _at(d: Displacement, x: np.ndarray, y: np.ndarray):
    column, line = (x - d.x[0]) / 5, (y - d.y[0]) / 5
    nearest = (
        np.clip(np.rint(line), 0, len(d.y) - 1).astype(int),
        np.clip(np.rint(column), 0, len(d.x) - 1).astype(int),
    )
    return sample(d.u, column, line), sample(d.v, column, line), d.valid[nearest]


def real(pictures: Path | None = None) -> None:
    data = SHARED / "data"
    if not data.is_dir():
        print("\nThe real images are not here: set WAVEFIELD_SHARED to their folder.")
        return
    title("Real PIV images against UVMAT's own vectors (its origin is at the lower left)")
    samples = data / "piv_samples"
    pairs = {
        "Karman 1-2": (
            samples / "Karman/Images",
            "Karman_01.bmp",
            "Karman_02.bmp",
            "../Images.civ/Karman_1-2.nc",
            (1,),
        ),
        "Karman 3-4": (
            samples / "Karman/Images",
            "Karman_03.bmp",
            "Karman_04.bmp",
            "../Images.civ/Karman_3-4.nc",
            (1,),
        ),
        "Oseen": (
            samples / "Oseen/Images",
            "Oseen_center_01.tif",
            "Oseen_center_02.tif",
            "../Images.civ_uvmat/Oseen_center_1-2.nc",
            (1, 2),
        ),
        "Jet 60": (samples / "Jet/Images", "c060a.png", "c060b.png", None, ()),
        "Jet 61": (samples / "Jet/Images", "c061a.png", "c061b.png", None, ()),
        "wake_legi": (samples / "wake_legi/images", "B00001A.png", "B00001B.png", None, ()),
        "Milestone": (samples / "Milestone/Images", "im00505a.png", "im00505b.png", None, ()),
    }
    for name, (folder, first, second, vectors, stages) in pairs.items():
        a, b = read_image(folder / first), read_image(folder / second)
        d = match(a, b, WEAK_PARTICLES if name == "Milestone" else None)
        for stage in stages:
            x, y, u, v, flag = _uvmat(folder / vectors, stage)
            # UVMAT: pixel centres at half integers, y upwards
            got_u, got_v, valid = _at(d, x - 0.5, a.shape[0] - 0.5 - y)
            good = valid & (flag == 0)
            error = np.hypot(got_u - u, got_v + v)[good]
            note = f"{good.sum()} of {len(x)} vectors, 90th percentile {np.percentile(error, 90):.3f}"
            row(f"{name}: median difference from civ{stage}", None, float(np.median(error)), note=note)
        if pictures:
            _picture(pictures / f"{name.replace(' ', '_')}.png", name, a, d)
    title("D-specimen: a loaded speckled plate against a public code's reference points")
    specimen(data / "d_specimen")


def specimen(folder: Path) -> None:
    def reference(n: int) -> dict[str, np.ndarray]:
        lines = (folder / "reference" / f"DICe_solution_{n}.txt").read_text().splitlines()
        lines = [line for line in lines if line and not line.startswith("*")]
        values = np.array([[float(q) for q in line.split(",")] for line in lines[1:]])
        return {name: values[:, k] for k, name in enumerate(lines[0].split(","))}

    left = [read_image(folder / "images" / f"GT4-000{n}_0.tif") for n in range(6)]
    right = read_image(folder / "images" / "GT4-0000_1.tif")
    ref = reference(0)
    good = ref["MATCH"] >= 0
    x, y = ref["COORDINATE_X"], ref["COORDINATE_Y"]
    d = match(left[0], right, MatchSettings.stereo(search_x=(-80, 10), search_y=(-90, 10)))
    u, v, valid = _at(d, x, y)
    du, dv = (u - ref["CROSS_CORR_Q"])[good & valid], (v - ref["CROSS_CORR_R"])[good & valid]
    pooled = float(np.median(np.abs(np.concatenate([du, dv]))))
    row("left to right, median difference of a component", 0.02, pooled, note=_medians(du, dv, good))
    from wavefield.rig.formats import load_rig
    from wavefield.rig.stereo import epipolar_distance

    rig = load_rig(folder / "cal.xml")
    one, two = (rig[name] for name in list(rig)[:2])
    for who, (p, q) in {"this": (u, v), "reference": (ref["CROSS_CORR_Q"], ref["CROSS_CORR_R"])}.items():
        off = epipolar_distance(one, two, x, y, x + p, y + q)[good & valid]
        row(
            f"   distance from the epipolar lines, spread: {who}",
            None,
            float(off.std()),
            note=f"mean {off.mean():.3f}",
        )
    for n in range(1, 6):
        ref = reference(n)
        good = ref["MATCH"] >= 0
        d = match(left[0], left[n])
        u, v, valid = _at(d, ref["COORDINATE_X"], ref["COORDINATE_Y"])
        du, dv = (u - ref["DISPLACEMENT_X"])[good & valid], (v - ref["DISPLACEMENT_Y"])[good & valid]
        pooled = float(np.median(np.abs(np.concatenate([du, dv]))))
        row(f"state 0 to {n}, median difference of a component", 0.02, pooled, note=_medians(du, dv, good))


def _medians(du: np.ndarray, dv: np.ndarray, good: np.ndarray) -> str:
    u, v = np.median(np.abs(du)), np.median(np.abs(dv))
    return f"u {u:.4f}, v {v:.4f}, {len(du)} of {good.sum()} points"


def _picture(path: Path, name: str, a: np.ndarray, d: Displacement) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(2, 2, figsize=(10, 9), layout="constrained")
    axes[0, 0].imshow(a, cmap="gray", vmax=np.percentile(a, 99.5))
    axes[0, 0].set_title(name)
    box = (d.x[0], d.x[-1], d.y[-1], d.y[0])
    for axis, what, field in ((axes[0, 1], "u", d.u), (axes[1, 1], "v", d.v)):
        low, high = np.percentile(field[d.valid], (1, 99)) if d.valid.any() else (-1, 1)
        picture = axis.imshow(
            np.where(d.valid, field, np.nan), extent=box, vmin=low, vmax=high, cmap="RdBu_r"
        )
        axis.set_title(f"{what}, px (blank: invalid)")
        figure.colorbar(picture, ax=axis)
    picture = axes[1, 0].imshow(d.correlation, extent=box, vmin=0, vmax=1)
    axes[1, 0].set_title("correlation")
    figure.colorbar(picture, ax=axes[1, 0])
    figure.savefig(path, dpi=60)
    plt.close(figure)


PARTS = {f.__name__: f for f in (peers, speed, stereo, hard, memory, profile, real)}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the real fields")
    options = parser.parse_args()
    for name in options.only:
        if name == "real":
            real(options.pictures)
        else:
            PARTS[name]()
    print(f"\n{len(MISSED)} figures missed" + (": " + "; ".join(MISSED) if MISSED else ""))


if __name__ == "__main__":
    main()
