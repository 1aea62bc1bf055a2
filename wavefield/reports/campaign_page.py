"""One page that compares the runs of a campaign, with links to the report of each."""

import html
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.ticker import LogLocator, NullFormatter

from wavefield.atomic_write import PAGE, write_text
from wavefield.figures.style import LINES, panels
from wavefield.reports.html_page import Head, Markup, Picture, ReportSection, render
from wavefield.reports.number_text import number
from wavefield.store.ledger import status
from wavefield.store.store_paths import beside
from wavefield.store.wave_store import open_waves

_MOST_LINES = 12  # spectra in one picture
_COLUMNS = (
    ("significant_height", "Hs, cm", 100.0),
    ("peak_frequency", "peak, Hz", 1.0),
    ("steepness", "steepness k_p σ", 1.0),
    ("nonlinear_fraction", "nonlinear fraction of w", 1.0),
)


@dataclass(frozen=True)
class CampaignEntry:
    """One run of a campaign."""

    run: str  # Its name
    cube: Path  # Its cube; it need not be there yet

    @property
    def there(self) -> bool:
        """Whether the run was begun."""
        return self.cube.is_dir()

    def numbers(self) -> dict[str, float]:
        """What its waves say; without what they do not."""
        waves = beside(self.cube, "waves", ".zarr")
        out: dict[str, float] = {}
        for group in ("statistics", "kinematics"):
            found = _group(waves, group)
            names = [name for name, _, _ in _COLUMNS if found is not None and name in found]
            out |= {name: float(found[name]) for name in names if found is not None}
        return out

    def spectrum(self) -> xr.DataArray | None:
        """Of its elevation over frequency, if it was analysed."""
        found = _group(beside(self.cube, "waves", ".zarr"), "spectra")
        return None if found is None else found["Ez_fusion"].where(found["valid_fusion"]).load()


def _group(waves: Path, name: str) -> xr.Dataset | None:
    if not waves.is_dir():
        return None
    found = open_waves(waves)
    return found[name].to_dataset() if name in found.children else None


def compare(title: str, entries: Sequence[CampaignEntry], output: str | Path) -> Path:
    """Write the page."""
    output = Path(output)
    table = ReportSection("The runs", [Markup(_table(entries, output))])
    sections = [(table, table.html())]
    spectra = {e.run: found for e in entries if e.there and (found := e.spectrum()) is not None}
    if spectra:
        picture = Picture(
            _figure(dict(list(spectra.items())[:_MOST_LINES])),
            "Spectra of the elevation, where they can be trusted.",
            f"Curves of E(omega) of {', '.join(spectra)}.",
        )
        part = ReportSection("Spectra", [picture])
        sections.append((part, part.html()))
    begun = sum(e.there for e in entries)
    write_text(output, render(Head(title, (f"{begun} of {len(entries)} runs measured",)), sections, {}), PAGE)
    return output


def _table(entries: Sequence[CampaignEntry], output: Path) -> str:
    head = ("run", "verdict", "steps", *(label for _, label, _ in _COLUMNS), "report")
    rows = "".join(f"<tr>{''.join(_cells(entry, output))}</tr>" for entry in entries)
    cells = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in head)
    return (
        '<div class="table"><table><caption>A dash: not measured, not analysed, or not to be said of '
        f"so short a record</caption><thead><tr>{cells}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _cells(entry: CampaignEntry, output: Path) -> list[str]:
    first = f'<th scope="row">{html.escape(entry.run)}</th>'
    if not entry.there:
        return [first, *(f"<td>{word}</td>" for word in ("not run yet", *"–" * (len(_COLUMNS) + 2)))]
    state, numbers = status(entry.cube), entry.numbers()
    verdict = "not finished"
    if state.complete:
        verdict = state.verdict.line if state.verdict else "none yet: run it once more"
    words = [verdict, f"{state.steps - state.left} of {state.steps}"]
    words += [number(factor * numbers.get(name, np.nan)) for name, _, factor in _COLUMNS]
    report = beside(entry.cube, "report", ".html")
    link = "–"
    if report.exists():
        place = html.escape(Path(os.path.relpath(report, output.absolute().parent)).as_posix(), quote=True)
        link = f'<a href="{place}">report</a>'
    return [first, *(f"<td>{html.escape(word)}</td>" for word in words), f"<td>{link}</td>"]


def _figure(spectra: Mapping[str, xr.DataArray]) -> Any:
    figure, axes = panels(1, width=8.0, height=4.5)
    for k, (run, one) in enumerate(spectra.items()):
        style = {**LINES[k % len(LINES)], "linewidth": 1.0 + 0.8 * (k // len(LINES))}
        positive = one.where(one > 0)
        axes[0, 0].loglog(one["omega"].values / (2 * np.pi), positive.values, label=run, **style)
    axes[0, 0].set(xlabel="ω / 2π (Hz)", ylabel="E(ω) of z (m² s rad⁻¹)")
    axes[0, 0].xaxis.set_major_formatter("{x:g}")  # powers of ten over a decade or two run into each other
    axes[0, 0].xaxis.set_minor_formatter(NullFormatter())
    axes[0, 0].xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes[0, 0].legend(frameon=False, fontsize=9)
    return figure
