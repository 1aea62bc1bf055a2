"""The first and last sections of a report: main results, remarks, summary, and settings of the run."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from wavefield.pipeline import Run
from wavefield.reports.fields import pack, probes_of, surface_picture
from wavefield.reports.html import Facts, Item, Player, Remarks, ReportSection, Table, Text
from wavefield.reports.numbers import (
    RunNumbers,
    in_folder,
    in_light_sheet,
    median_of,
    number,
    reason_of,
    rms_of,
    snapshot,
    thinned,
    with_interval,
)
from wavefield.store.verdict import Verdict
from wavefield.text import spell_time
from wavefield.variables import Quality, frames_of_path

_STATED = ("wavefield_version", "recipe_hash", "frame_rate", "water_depth", "pixel_size")
_HEIGHT, _PERIOD = "Significant wave height Hs", "Peak period"
_NO_PEAK = "No spectral peak"  # first words of the note that gives the reason


def result(numbers: RunNumbers) -> ReportSection:
    """Return the section at the top of the report: an animation of the surface and the main results."""
    player = Player(pack(numbers.run.cube), surface_picture(snapshot(numbers.run.cube)))
    return ReportSection("Result", [player, Facts(facts(numbers))], layout="result")


def facts(numbers: RunNumbers) -> list[tuple[str, str, str]]:
    """Return the main results (waves, velocity, coverage, ...) as rows of texts: name, value, note."""
    run, cube = numbers.run, numbers.run.cube
    rate, u, v, w = float(cube.attrs["frame_rate"]), *(number(100 * rms_of(numbers.part[n])) for n in "uvw")
    duration = cube.sizes["time"] / rate
    lasting = spell_time(duration) if duration > 120 else f"{duration:.3g} s"
    std = {n: 1e3 * median_of(thinned(cube, f"{n}_std")[f"{n}_std"]) for n in "zuvw"}
    in_view = (
        ""
        if numbers.in_view > 0.9995
        else f"; {_percent(numbers.measured / numbers.in_view)} of what is in view"
    )
    sheet, level = in_light_sheet(run), ""
    if "z_level_std" in cube and not sheet:
        level = f"; common to all z: {number(1e3 * float(cube.z_level_std), 'mm', 2)}"
    return [
        *([] if sheet else _of_waves(run)),
        (f"Rms of the {'' if sheet else 'surface '}velocity u, v, w", f"{u}, {v}, {w} cm/s", ""),
        ("Coverage", _percent(numbers.measured), f"of the grid's nodes were measured{in_view}"),
        (
            "Standard uncertainty, median",
            f"z {number(std['z'], 'mm', 2)}",
            f"u, v, w {', '.join(number(std[n], digits=2) for n in 'uvw')} mm/s{level}",
        ),
        ("Record", lasting, f"{cube.sizes['time']} steps at {rate:g} Hz: {numbers.step_status}"),
        ("Grid", f"{cube.sizes['x']} × {cube.sizes['y']} nodes", f"{run.grid.step * 100:g} cm apart"),
    ]


def _percent(share: float) -> str:
    """Return the fraction `share` as text in percent; only exactly 1 becomes "100 %"."""
    if share == 1:
        return "100 %"
    return f"{min(100 * share, 99.99):.{4 if share > 0.99 else 3}g} %"


def _of_waves(run: Run) -> list[tuple[str, str, str]]:
    """Return rows of texts (name, value ± standard uncertainty, note) for wave height and peak period."""
    statistics = run.wave_group("statistics")
    if statistics is None:
        reason = reason_of(run, "waves") or "the waves have no statistics"
        return [(_HEIGHT, "–", reason), (_PERIOD, "–", reason)]
    if {"peak_frequency", "peak_frequency_std"} <= set(statistics):
        f, std = (statistics[f"peak_frequency{end}"] for end in ("", "_std"))
        statistics = statistics.assign(peak_period=1 / f, peak_period_std=std / f**2)
    notes = str(run.waves.attrs.get("notes", "")).splitlines() if run.waves is not None else []
    no_peak = [note.partition(": ")[2].rstrip(".") for note in notes if note.startswith(_NO_PEAK)]
    short = "the record is too short to state it with its uncertainty"
    rows = []
    for title, name, unit, factor, reason in (
        (_HEIGHT, "significant_height", "cm", 100.0, short),
        (_PERIOD, "peak_period", "s", 1.0, no_peak[0] if no_peak else short),
    ):
        found = with_interval(statistics, name, factor)
        rows.append((title, f"{found} {unit}", "") if found else (title, "–", reason))
    return rows


def attention(run: Run, verdict: Verdict | None) -> ReportSection:
    """Return the section with the remarks of the verdict, and with what the report lacks, and why."""
    items: list[Item] = []
    if verdict is None:
        items.append(Text("This cube has no verdict yet: rerun `wavefield run` on its experiment."))
    elif verdict.weight == "note":
        items.append(Text("Nothing was found that limits the use of this cube."))
    if verdict is not None and verdict.remarks:
        items.append(Remarks(verdict.remarks))
    absent = {
        "spectra and coherence": "" if in_light_sheet(run) else reason_of(run, "waves"),
        "pictures of the cameras' frames": reason_of(run, "frames"),
        "wave probes": in_folder(run, probes_of(run)[1]),
    }
    missing = [f"{what} ({reason})" for what, reason in absent.items() if reason]
    if missing:
        items.append(Text(f"Not in this report: {'; '.join(missing)}."))
    return ReportSection("What needs attention", items)


def run_summary(numbers: RunNumbers) -> ReportSection:
    """Return the section with misfits, steepness and other numbers of the run."""
    run, cube = numbers.run, numbers.run.cube
    eps_y, eps_piv = 1e3 * rms_of(numbers.part.eps_y), rms_of(numbers.part.eps_piv)
    gist = f"displacements differ by {number(eps_piv, 'px', 2)} (rms)"
    if not in_light_sheet(run):
        gist = f"epipolar error {number(eps_y, 'mm', 2)} (rms), {gist}"
    rows = []
    if "path_frames" in cube:
        frames = int(cube.path_frames)
        stated = {1: "instantaneous", 2: "displacements over one step"}
        rows.append(("velocities", stated.get(frames, f"along paths of {frames_of_path(frames)} frames")))
    misfit = f"{number(eps_piv, 'px')} (published for a similar rig: 0.34 to 0.37 px)"
    epipolar = f"{number(eps_y, 'mm')} (published for a similar rig: 0.4 to 0.8 mm)"
    rows += [
        *without_cameras(numbers.part.quality, numbers.n_in_view, cube.attrs.get("cameras", ())),
        ("rms of z about its mean", number(100 * float(numbers.part.z.std()), "cm")),
        ("epipolar error (eps_y), rms", epipolar),
        ("misfit of the displacements (eps'), rms", misfit),
    ]
    statistics = run.wave_group("statistics")
    for name, label in (("steepness", "steepness k_p σ"), ("slope_rms", "rms slope")):
        if statistics is not None and name in statistics:
            rows.append((label, number(float(statistics[name]))))
    table = Table("Run summary", ("quantity", "value"), rows)
    return ReportSection("Run summary", [table], folded=True, gist=gist)


def without_cameras(quality: xr.DataArray, n_in_view: int, cameras: Sequence[str]) -> list[tuple[str, str]]:
    """Return a table row with the percentage of values measured without each camera; [] if all are 0.
    `quality` has any shape. Percentages refer to `n_in_view`, the number of its values at visible nodes."""
    shares = []
    for index, camera in enumerate(cameras):
        bit = np.uint16(Quality.without(index) & ~Quality.FEWER_CAMERAS)
        share = float(((quality & bit) != 0).sum()) / n_in_view
        if share > 0:
            shares.append(f"{camera} {100 * share:.2f} %")
    return [("nodes measured without", ", ".join(shares))] if shares else []


def recipe(run: Run) -> ReportSection:
    """Return the section "Recipe": versions, grid, frames, and all settings with which the cube was made."""
    attrs, made = run.cube.attrs, run.recipe
    stated = {name: attrs[name] for name in _STATED if name in attrs}
    stated |= {name: made[name] for name in ("algorithm", "frames", "grid") if name in made}
    for name, value in made.get("settings", {}).items():
        parts = value if isinstance(value, dict) else {"": value}
        stated |= {f"{name}.{key}".rstrip("."): part for key, part in parts.items()}
    rows = [(name, str(value)) for name, value in stated.items()]
    version = str(attrs.get("wavefield_version", ""))
    table = Table("Versions, and settings of the measurement", ("name", "value"), rows)
    gist = version and f"measured by wavefield {version}"
    return ReportSection("Recipe", [table], folded=True, gist=gist)
