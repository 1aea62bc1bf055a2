"""The report of a calibration: pictures, numbers as YAML, and a page that shows them."""

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure

from wavefield.atomic_write import PAGE, Product, atomic, marked, write_text
from wavefield.calibration.numbers import FlatSurface, numbers
from wavefield.calibration.result import Calibration
from wavefield.reports import calibration_pictures as pictures
from wavefield.reports.calibration_page import Drawn, calibration_page

NUMBERS = Product("the numbers of a calibration", marked(b"\nproblems:", start=b"usable: "))
_marked = marked(b"Software\0wavefield", start=b"\x89PNG")
PICTURE = Product("a picture of a calibration", lambda path: _marked(path) or _marked_before(path))


def _marked_before(path: Path) -> bool:
    """Of versions that did not mark them: drawn with Matplotlib, beside the numbers of a calibration."""
    drawn = marked(b"Software\0Matplotlib", start=b"\x89PNG")
    return drawn(path) and NUMBERS.recognize(path.with_name("numbers.yaml"))


def write_calibration(
    calibration: Calibration, directory: str | Path, target: Callable[[], bytes | None] | None = None
) -> Path:
    """Write the report of a calibration."""
    directory = Path(directory)
    content: dict[str, Any] = {
        "usable": calibration.usable,
        "problems": list(calibration.problems),
        "notes": list(calibration.notes),
        "left_out_points": dict(calibration.left_out),
    }
    drawn: list[Drawn] = []
    if None not in (calibration.observations, calibration.fit, calibration.derived):
        surface = _add_numbers(content, calibration)
        drawn += [
            Drawn(f"{stem}.png", title, _png(figure))
            for stem, title, figure in _figures(calibration, surface)
        ]
    found = target() if target is not None else None
    if found is not None:
        drawn.insert(0, Drawn("target.png", "The target as it was found in an image of each camera", found))
    for picture in drawn:
        with atomic(directory / picture.file, PICTURE) as draft:
            draft.write_bytes(picture.png)
    write_text(
        directory / "numbers.yaml",
        yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110),
        NUMBERS,
    )
    page = directory / "index.html"
    write_text(page, calibration_page(content, drawn), PAGE)
    return page


def _add_numbers(content: dict[str, Any], calibration: Calibration) -> FlatSurface | None:
    """Add what was fitted and predicted; gives the triangulated target where there is a flat view."""
    o, fit, derived = calibration.observations, calibration.fit, calibration.derived
    assert o is not None
    assert fit is not None
    assert derived is not None
    found, surface = numbers(o, fit, calibration.rig, calibration.reference)
    content |= found
    content |= {
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
            "reprojection_px": dict(derived.reprojection),
            "z_mm": 1e3 * derived.z_std,
            "z_of_which_tilt_mm": 1e3 * derived.z_tilt,
            "image_covered": dict(derived.coverage),
            "condition_number": derived.condition,
            "strongest_correlations": [[a, b, round(r, 6)] for a, b, r in derived.correlation],
        },
        "parameters": _parameters(calibration),
    }
    return surface


def _figures(calibration: Calibration, surface: FlatSurface | None) -> Iterator[tuple[str, str, Figure]]:
    o, fit = calibration.observations, calibration.fit
    assert o is not None
    assert fit is not None
    cameras = [calibration.rig[name] for name in o.cameras]
    yield "rig", "The rig and the target's poses", pictures.rig_drawing(o, fit, cameras)
    yield "coverage", "Where the target was seen", pictures.coverage(o)
    if surface is not None:
        title = f"z of the target in view {calibration.reference}, triangulated"
        yield "flat_target", title, pictures.flat_target(surface, o.mesh)
    for c, name in enumerate(o.cameras):
        yield f"residuals_{name}", f"Residuals of {name}", pictures.residual_map(o, fit, c)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": "wavefield"})
    return buffer.getvalue()


def _parameters(calibration: Calibration) -> dict[str, Any]:
    """Values of each camera's lens with their standard uncertainty."""
    o, fit = calibration.observations, calibration.fit
    assert o is not None
    assert fit is not None
    std = np.sqrt(np.diag(fit.covariance))
    out: dict[str, Any] = {}
    for c, name in enumerate(o.cameras):
        camera = calibration.rig[name]
        sigma = {column: float(std[k]) for k, column in fit.layout.lens[c]}
        first = fit.layout.camera[c]
        k = {column: k for k, column in fit.layout.lens[c]}
        rows: dict[str, Any] = {}
        cov = fit.covariance
        f, a = k.get("f"), k.get("aspect")
        var_fy = cov[f, f] if f is not None else 0.0
        var_fx = var_fy
        if f is not None and a is not None:
            var_fx = cov[f, f] + 2.0 * cov[f, a] + cov[a, a]
        rows["fx_px"] = [camera.fx, float(camera.fx * np.sqrt(var_fx))]
        rows["fy_px"] = [camera.fy, float(camera.fy * np.sqrt(var_fy))]
        for term, unit in (
            *(("cx", "_px"), ("cy", "_px"), ("k1", ""), ("k2", ""), ("p1", ""), ("p2", ""), ("k3", "")),
            *(("tau_x", "_rad"), ("tau_y", "_rad")),
        ):
            if getattr(camera, term) != 0.0 or term in sigma:
                rows[term + unit] = [float(getattr(camera, term)), sigma.get(term, 0.0)]
        rows["rotation_std_rad"] = [float(v) for v in std[first : first + 3]]
        rows["translation_m"] = [float(v) for v in camera.T]
        rows["translation_std_m"] = [float(v) for v in std[first + 3 : first + 6]]
        out[name] = rows
    return out
