"""What the estimators make of a cube measured from images, beside exact fields: for `benchmarks.waves`."""

from pathlib import Path

import numpy as np
import xarray as xr

import wavefield.waves as wv
from benchmarks import crests


def row(what: str, asked: str, reached: str) -> None:
    print(f"  {what:74s} {asked:>12s} {reached:>16s}", flush=True)


def title(text: str) -> None:
    print(f"\n{text}\n  {'':74s} {'asked':>12s} {'reached':>16s}", flush=True)


def smooth(values: np.ndarray) -> np.ndarray:
    return np.convolve(values, np.ones(5) / 5, "same")


def reach(energy: xr.DataArray, truth: xr.DataArray) -> tuple[float, float]:
    """Frequency and decades below the peak up to which a spectrum is right within a factor 2."""
    ratio = smooth(np.nan_to_num(energy.values)) / smooth(truth.values)
    hertz = energy.omega.values / (2 * np.pi)
    bad = np.flatnonzero((hertz > 0.9) & ((ratio > 2) | (ratio < 0.5)))
    stop = max(int(bad[0]) - 1 if bad.size else hertz.size - 3, 0)
    return float(hertz[stop]), float(np.log10(truth.max() / smooth(truth.values)[stop]))


def ranges(fused: xr.Dataset, elevation: xr.DataArray, how: str, asked: dict[str, str]) -> None:
    for method in ("stereo", "w", "cross", "fusion"):
        hertz, decades = reach(fused[f"Ez_{method}"], elevation)
        row(
            f"E^z within a factor 2, {method}, {how}: decades, Hz",
            asked.get(method, ""),
            f"{decades:.1f} {hertz:.1f} Hz",
        )


def show_ridge(mine: xr.Dataset, theirs: xr.Dataset) -> None:
    """The ridge by bands of half a hertz: measured, and from the exact fields."""
    inside = (mine.band_frequency > 1.5) & (mine.band_frequency < 5)
    k = mine.ridge_error.where(inside, drop=True)
    exact = theirs.ridge_error.reindex_like(mine.ridge_error).where(inside, drop=True)
    # an error of k at given omega is one of omega at given k times k c_g / omega
    number = wv.wavenumber(2 * np.pi * k.band_frequency.values, float(mine.depth))
    slope = number * wv.group_velocity(number, float(mine.depth)) / (2 * np.pi * k.band_frequency.values)
    largest = float(np.abs(k.values * slope).max())
    row("ridge against theory up to 5 Hz, in omega, largest band, %", "1", f"{100 * largest:.2f}")
    row("  in k, largest band, %", "", f"{100 * float(np.abs(k).max()):.2f}")
    row("  by bands of half a hertz, in k, %: measured (exact fields)", "", "")
    bands = zip(k.band_frequency.values, k.values, exact.values)
    print("    " + "  ".join(f"{f:.2f} Hz {100 * e:+.2f} ({100 * t:+.2f})" for f, e, t in bands))


def show_analysis(out: xr.DataTree, elevation: xr.DataArray, asked: dict[str, str]) -> None:
    """What `analyze` gives by itself, with the gain that the cube holds."""
    row("windows undone by the cube's own gain", "", str(out.attrs["windows_undone"])[:16])
    ranges(out["spectra"].to_dataset(), elevation, "as analyze has it", asked)


def show_coherence(mine: xr.Dataset, theirs: xr.Dataset) -> None:
    print("\n  coherence over k / 2 pi (1/m): measured | from the exact fields")
    print(f"  {'':8s} {'C_w':>8s} {'C_nl':>8s} {'C_tot':>8s} | {'C_w':>8s} {'C_nl':>8s} {'C_tot':>8s}")
    for j in range(2, mine.sizes["k"], 2):
        cycles = float(mine.k[j]) / (2 * np.pi)
        if cycles > 30:
            break
        values = [
            " ".join(f"{abs(complex(c[f'C_{n}'][j])):8.3f}" for n in ("w", "nl", "tot"))
            for c in (mine, theirs)
        ]
        print(f"  {cycles:8.2f} {values[0]} | {values[1]}")


def draw(path: Path, mine: xr.Dataset, theirs: xr.Dataset, spectra: dict[str, xr.DataArray]) -> None:
    """The coherence curves beside the exact fields', and the elevation spectra beside the truth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, colour in (("w", "tab:blue"), ("nl", "tab:orange"), ("tot", "tab:green")):
        for curves, style, who in ((mine, "-", "images"), (theirs, "--", "exact fields")):
            part = curves.isel(k=slice(2, None)).where(curves.k < 2 * np.pi * 30, drop=True)
            left.plot(
                part.k / (2 * np.pi), np.abs(part[f"C_{name}"]), style, color=colour, label=f"C_{name}, {who}"
            )
    left.set(xlabel="k / 2 pi (1/m)", ylabel="coherence", ylim=(0, 1.2))
    for name, energy in spectra.items():
        positive = energy.where(energy > 0)
        right.semilogy(energy.omega / (2 * np.pi), positive, "k" if name == "truth" else "-", label=name)
    right.set(xlabel="frequency (Hz)", ylabel="E^z (m2 s/rad)")
    for axes in (left, right):
        axes.legend(fontsize=7)
    figure.savefig(path, dpi=120)


def experiment(
    store: Path, truth: Path, segment: int | None, picture: Path | None, kept: Path | None
) -> None:
    """What the estimators make of a cube measured from images, beside the exact fields."""
    cube = xr.open_zarr(store, chunks=None, consolidated=False).load()
    exact = xr.open_zarr(truth, chunks=None, consolidated=False).load()
    cube = cube.sel(time=slice(None, float(exact.time[-1]) + 1e-6))
    exact = exact.sel(time=cube.time, method="nearest").interp(y=cube.y, x=cube.x, assume_sorted=True)
    exact = exact.assign_coords(time=cube.time).assign_attrs(cube.attrs)
    exact = exact.where(np.isfinite(cube.z))
    record = wv.find_record(cube)
    out = wv.analyze(cube, segment=segment, gain=False)
    segment = int(out.attrs["segment"])
    depth = float(cube.attrs.get("water_depth") or np.inf)
    title(
        f"Simulated experiment from images: {out.attrs['steps_used']} steps, {record.shape[0]} x"
        f" {record.shape[1]} nodes, segments of {segment}"
    )
    density = wv.spectrum(exact.dz / record.dt, segment=segment, record=record).E
    show_ridge(out["dispersion"].to_dataset(), wv.fit_dispersion(density, depth))

    true = wv.cross_spectra(exact, ("z_t",), segment=segment, record=record).E_z_t
    omega = true.omega
    dk = float(true.k[1] - true.k[0])
    # the exact z_t is the difference of two frames, as the measured one
    elevation = (true.sum("k") * dk * wv.elevation_from_w(omega, record.dt)).where(omega > 0, 0.0)
    level = np.log10(float(elevation.max()) / smooth(elevation.values))
    falls = [f"{f} Hz {np.interp(2 * np.pi * f, omega, level):.1f}" for f in (3, 4, 5, 6, 7, 8)]
    print("  decades that the sea itself has fallen below its peak: " + ", ".join(falls))
    plain = out["fusion"].to_dataset().assign(out["spectra"].to_dataset().data_vars)
    asked = {"stereo": "4.0", "w": "5.0", "fusion": "6.0"}
    ranges(plain, elevation, "as measured", asked)
    predicted = wv.read_gain(cube)
    results = {"as measured": plain}
    for how, gain in (
        ("windows undone by theory", predicted),
        ("windows undone as kept", kept),
    ):
        if gain is not None:
            results[how] = wv.fused_spectra(cube, gain=gain, depth=depth, segment=segment, record=record)
            ranges(results[how], elevation, how, asked)
    undone = results["windows undone by theory"]
    for name in ("stereo", "w"):
        noise = plain[f"noise_{'z' if name == 'stereo' else 'w'}_fit"]
        crossed = np.flatnonzero((noise > elevation).values & (omega > 2 * np.pi).values)
        hertz = float(omega[crossed[0]]) / (2 * np.pi) if crossed.size else np.inf
        row(f"noise, summed over all k, exceeds the true E^z from, {name}, Hz", "", f"{hertz:.1f}")
    row("noise of z, cm", "", f"{100 * float(undone.sigma_z):.4f}")
    row("noise of dz, cm", "", f"{100 * float(undone.sigma_dz):.4f}")
    row("correlation of the two noises", "", f"{float(undone.noise_coherence):.3f}")
    shares = out["kinematics"].to_dataset()
    row("nonlinear term over w", "", f"{float(shares.nonlinear_fraction):.3f}")
    row("residual over nonlinear term, Eulerian", "", f"{float(shares.residual_fraction):.3f}")
    row(
        "residual over nonlinear term, finite displacements",
        "",
        f"{float(shares.finite_residual_fraction):.3f}",
    )
    mine, theirs = out["coherence"].to_dataset(), wv.coherence(exact, segment=segment, record=record)
    show_coherence(mine, theirs)
    show_analysis(wv.analyze(cube, segment=segment), elevation, asked)
    crests.print_table(cube, xr.open_zarr(truth, chunks=None, consolidated=False))
    if picture is not None:
        curves = {"truth": elevation} | {
            f"{method}, {how}": results[how][f"Ez_{method}"]
            for how in ("as measured", "windows undone by theory")
            for method in ("stereo", "w", "fusion")
        }
        draw(picture, mine, theirs, curves)
