"""Section on the calibration, from the report that `wavefield calibrate` left next to the rig."""

from pathlib import Path

import yaml

from wavefield.pipeline import Run
from wavefield.reports.calibration_page import accuracy_sentence
from wavefield.reports.html_page import ReportSection, Table, Text
from wavefield.reports.number_text import number


def calibration_folder(run: Run) -> Path | None:
    """Folder that `wavefield calibrate` left next to the rig file; None if there is none."""
    if run.experiment is None or isinstance(run.experiment.rig, dict):
        return None
    rig = run.experiment.resolve(run.experiment.rig or "rig.yaml")
    folder = rig.with_name(f"{rig.stem}_report")
    return folder if (folder / "numbers.yaml").is_file() else None


def calibration_section(run: Run) -> ReportSection:
    """Accuracy and residuals of the calibration; its pictures are on its own page."""
    section = ReportSection("Calibration", folded=True)
    folder = calibration_folder(run)
    if folder is None:
        return section
    numbers = yaml.safe_load((folder / "numbers.yaml").read_text(encoding="utf-8")) or {}
    rows = [
        (name, str(len(c["views"])), number(c["rms_px"]), number(c["rms_mm"]), number(c["max_px"]))
        for name, c in (numbers.get("cameras") or {}).items()
    ]
    if sentence := accuracy_sentence(numbers):
        section.gist = sentence.removesuffix(".")
    if rows:
        head = ("camera", "views", "rms, px", "rms, mm", "largest, px")
        section.items.append(Table("Residuals of the fitted points", head, rows))
    section.items.append(
        Text(f"Pictures and parameters are on the page of the calibration, `{folder.name}/index.html`.")
    )
    return section
