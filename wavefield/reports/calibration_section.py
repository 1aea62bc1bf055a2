"""Section on the calibration, from the report that `wavefield calibrate` left next to the rig."""

from pathlib import Path

import yaml

from wavefield.pipeline import Run
from wavefield.reports.html_page import Picture, ReportSection, Table
from wavefield.reports.number_text import number

# file: caption, alternative text
_PICTURES = {
    "target": (
        "The target in one image of each camera: nodes found (+), the origin (circle), and their positions "
        "on z = 0 by the rig.",
        "Images of the target with the nodes found in them, and the same nodes in physical coordinates.",
    ),
    "rig": ("The rig and the poses of the target.", "Drawing of the cameras and of the poses of the target."),
    "coverage": (
        "Positions of the target in the images.",
        "Map of the nodes of all views in each camera's image.",
    ),
    "flat_target": (
        "z of the flat target's nodes, triangulated by the rig.",
        "Map of z of the flat target's nodes.",
    ),
}


def calibration_folder(run: Run) -> Path | None:
    """Folder that `wavefield calibrate` left next to the rig file; None if there is none."""
    if run.experiment is None or isinstance(run.experiment.rig, dict):
        return None
    rig = run.experiment.resolve(run.experiment.rig or "rig.yaml")
    folder = rig.with_name(f"{rig.stem}_report")
    return folder if (folder / "numbers.yaml").is_file() else None


def calibration_section(run: Run) -> ReportSection:
    """Residuals and pictures of the calibration."""
    section = ReportSection("Calibration")
    folder = calibration_folder(run)
    if folder is None:
        return section
    numbers = yaml.safe_load((folder / "numbers.yaml").read_text(encoding="utf-8")) or {}
    rows = {
        name: (
            name,
            str(len(c["views"])),
            number(c["rms_px"], "px"),
            number(c["rms_mm"], "mm"),
            number(c["max_px"], "px"),
        )
        for name, c in (numbers.get("cameras") or {}).items()
    }
    if rows:
        head = ("camera", "views", "rms", "rms", "largest")
        section.items.append(Table("Residuals of the fitted points", head, list(rows.values())))
    for stem, (caption, alt) in _PICTURES.items():
        file = folder / f"{stem}.png"
        if stem == "flat_target" and stem in numbers:
            alt += f" Rms {numbers[stem]['z_rms_mm']:.3g} mm."
        if file.is_file():
            section.items.append(Picture(file.read_bytes(), caption, alt))
    for file in sorted(folder.glob("residuals_*.png")):
        name = file.stem.removeprefix("residuals_")
        rms = f" Rms {rows[name][2]}, largest {rows[name][4]}." if name in rows else ""
        caption = f"Residuals of {name}: every point, and their mean over cells of the image."
        alt = f"Arrows of the residuals over the image of {name}.{rms}"
        section.items.append(Picture(file.read_bytes(), caption, alt))
    return section
