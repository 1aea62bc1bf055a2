"""The first screen of a report: the surface, the main numbers, and what needs attention."""

from wavefield import figures
from wavefield.pipeline import Run
from wavefield.reports.elevation_section import probes_of
from wavefield.reports.html_page import Facts, Item, Picture, Remarks, ReportSection, Text
from wavefield.reports.number_text import median_of, number, rms_of
from wavefield.reports.player import player
from wavefield.reports.run_data import extremes_of, in_folder, in_light_sheet, reason_of, snapshot, thinned
from wavefield.reports.run_numbers import RunNumbers
from wavefield.store.verdict import Verdict
from wavefield.text import spell_time

_NO_PEAK = "No spectral peak"  # how the note of the analysis begins that gives the reason


def result(numbers: RunNumbers) -> ReportSection:
    """The surface in motion beside the main numbers."""
    snap = snapshot(numbers.run.cube)
    still = Picture(
        figures.surface_3d(snap),
        "The surface at one moment; heights are exaggerated, colour is the vertical velocity.",
        f"Three-dimensional view of the surface. {extremes_of(snap)}",
    )
    return ReportSection("Result", [player(numbers.run.cube, still), Facts(facts(numbers))], layout="result")


def facts(numbers: RunNumbers) -> list[tuple[str, str, str]]:
    """Name, value and note of the main results."""
    run, cube = numbers.run, numbers.run.cube
    rate, u, v, w = float(cube.attrs["frame_rate"]), *(number(100 * rms_of(numbers.part[n])) for n in "uvw")
    duration = cube.sizes["time"] / rate
    lasting = spell_time(duration) if duration > 120 else f"{duration:.3g} s"
    std = {n: 1e3 * median_of(thinned(cube, f"{n}_std")[f"{n}_std"]) for n in "zuvw"}
    in_view = "" if numbers.in_view > 0.9995 else f"; {_percent(numbers.measured_in_view)} of what is in view"
    sheet = in_light_sheet(run)
    return [
        *([] if sheet else [_height(numbers), _peak(run)]),
        (f"Rms of the {'' if sheet else 'surface '}velocity u, v, w", f"{u}, {v}, {w} cm/s", ""),
        ("Coverage", _percent(numbers.measured), f"of the grid's nodes were measured{in_view}"),
        (
            "Standard uncertainty, median",
            f"z {number(std['z'], 'mm', 2)}",
            f"u, v, w {', '.join(number(std[n], digits=2) for n in 'uvw')} mm/s",
        ),
        ("Record", lasting, f"{cube.sizes['time']} steps at {rate:g} Hz: {numbers.step_status}"),
        ("Grid", f"{cube.sizes['x']} × {cube.sizes['y']} nodes", f"{run.grid.step * 100:g} cm apart"),
    ]


def _percent(share: float) -> str:
    """A fraction in percent, never rounded to all of it: 99.99 %."""
    if share == 1:
        return "100 %"
    return f"{min(100 * share, 99.99):.{4 if share > 0.99 else 3}g} %"


def _height(numbers: RunNumbers) -> tuple[str, str, str]:
    statistics = numbers.run.wave_group("statistics")
    if statistics is not None and "significant_height" in statistics:
        height, note = float(statistics["significant_height"]), ""
    else:
        height, note = 4 * float(numbers.part.z.std()), "four times the rms of z"
    return "Significant wave height Hs", number(100 * height, "cm"), note


def _peak(run: Run) -> tuple[str, str, str]:
    name, statistics = "Peak period", run.wave_group("statistics")
    if statistics is None:
        return name, "–", reason_of(run, "waves") or "the waves have no statistics"
    if "peak_frequency" in statistics:
        frequency = float(statistics["peak_frequency"])
        return name, number(1 / frequency, "s"), f"frequency {number(frequency, 'Hz')}"
    notes = str(run.waves.attrs.get("notes", "")).splitlines() if run.waves is not None else []
    reasons = [note.partition(": ")[2].rstrip(".") for note in notes if note.startswith(_NO_PEAK)]
    return name, "–", reasons[0] if reasons else "the analysis found none"


def attention(run: Run, verdict: Verdict | None) -> ReportSection:
    """Remarks of the verdict, the gravest first, and what is not in the report."""
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
