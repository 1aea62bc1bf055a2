"""The report of a calibration: pictures, numbers as YAML, and a page that shows them."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure

from wavefield.atomic_write import PAGE, OwnFile, atomic, marked, write_text
from wavefield.calibration.assess import FlatSurface, numbers
from wavefield.calibration.bundle import Fit
from wavefield.calibration.observations import Observations
from wavefield.calibration.result import Calibration
from wavefield.figures.style import file_of
from wavefield.reports import calibration_pictures as pictures
from wavefield.reports.calibration_page import CalibrationPicture, calibration_page

NUMBERS = OwnFile("the numbers of a calibration", marked(b"\nproblems:", start=b"usable: "))
PICTURE = OwnFile("a picture of a calibration", marked(b"Software\0wavefield", start=b"\x89PNG"))
_LENS_TERMS = {
    "cx": "_px", "cy": "_px", "k1": "", "k2": "", "p1": "", "p2": "", "k3": "", "k4": "", "tau_x": "_rad",
    "tau_y": "_rad",
}  # fmt: skip


def write_calibration(
    calibration: Calibration, directory: str | Path, target: Callable[[], bytes | None] | None = None
) -> Path:
    """Write the report of a calibration into a folder; `target` draws the target in the images as a PNG."""
    directory = Path(directory)
    content: dict[str, Any] = {
        "usable": calibration.usable,
        "problems": list(calibration.problems),
        "notes": list(calibration.notes),
        "left_out_points": dict(calibration.left_out),
    }
    drawn: list[CalibrationPicture] = []
    if target is not None and (found := target()) is not None:
        title = "The target as it was found in an image of each camera"
        drawn.append(CalibrationPicture("target.png", title, found))
    observations, fit = calibration.observations, calibration.fit
    if observations is not None and fit is not None and calibration.predicted is not None:
        fitted, surface = numbers(observations, fit, calibration.rig, calibration.reference)
        content |= fitted | _predicted(calibration)
        content["parameters"] = _parameters(calibration, observations, fit)
        for stem, title, figure in _figures(calibration, observations, fit, surface):
            png = file_of(figure, metadata={"Software": "wavefield"})
            drawn.append(CalibrationPicture(f"{stem}.png", title, png))
    for picture in drawn:
        with atomic(directory / picture.file, PICTURE) as draft:
            draft.write_bytes(picture.png)
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110)
    write_text(directory / "numbers.yaml", text, NUMBERS)
    page = directory / "index.html"
    write_text(page, calibration_page(content, drawn), PAGE)
    return page


def _predicted(calibration: Calibration) -> dict[str, Any]:
    """The models that were compared, and the uncertainties predicted from the fit."""
    errors = calibration.predicted
    assert errors is not None
    return {
        "model": calibration.model,
        "models_compared": [
            {
                "model": c.model,
                "parameters": c.parameters,
                "rms_over_stated": c.rms,
                "bic": c.bic,
                "expected_px": c.expected,
            }
            for c in calibration.models
        ],
        "predicted": {
            "reprojection_px": dict(errors.reprojection),
            "z_mm": 1e3 * errors.z_std,
            "z_of_which_tilt_mm": 1e3 * errors.z_tilt,
            "image_covered": dict(errors.coverage),
            "condition_number": errors.condition,
            "strongest_correlations": [[a, b, round(r, 6)] for a, b, r in errors.correlation],
        },
    }


def _figures(
    calibration: Calibration, observations: Observations, fit: Fit, surface: FlatSurface | None
) -> Iterator[tuple[str, str, Figure]]:
    cameras = [calibration.rig[name] for name in observations.cameras]
    yield "rig", "The rig and the target's poses", pictures.rig_drawing(observations, fit, cameras)
    yield "coverage", "Positions of the target in the images", pictures.coverage(observations)
    if surface is not None:
        title = f"z of the target in view {calibration.reference}, triangulated"
        yield "flat_target", title, pictures.flat_target(surface, observations.mesh)
    for c, name in enumerate(observations.cameras):
        yield f"residuals_{name}", f"Residuals of {name}", pictures.residual_map(observations, fit, c)


def _parameters(calibration: Calibration, observations: Observations, fit: Fit) -> dict[str, Any]:
    """Values of each camera's lens and pose with their standard uncertainty."""
    std, covariance = np.sqrt(np.diag(fit.covariance)), fit.covariance
    out: dict[str, Any] = {}
    for c, name in enumerate(observations.cameras):
        camera, index = calibration.rig[name], {term: k for k, term in fit.layout.lens[c]}
        f, aspect = index.get("f"), index.get("aspect")
        var_fy = covariance[f, f] if f is not None else 0.0
        var_fx = var_fy
        if f is not None and aspect is not None:
            var_fx = covariance[f, f] + 2.0 * covariance[f, aspect] + covariance[aspect, aspect]
        rows: dict[str, Any] = {
            "fx_px": [camera.fx, float(camera.fx * np.sqrt(var_fx))],
            "fy_px": [camera.fy, float(camera.fy * np.sqrt(var_fy))],
        }
        for term, unit in _LENS_TERMS.items():
            value = float(getattr(camera, term))
            if value != 0.0 or term in index:
                rows[term + unit] = [value, float(std[index[term]]) if term in index else 0.0]
        first = fit.layout.camera[c]
        rows["rotation_std_rad"] = std[first : first + 3].tolist()
        rows["translation_m"] = [float(v) for v in camera.T]
        rows["translation_std_m"] = std[first + 3 : first + 6].tolist()
        out[name] = rows
    return out
