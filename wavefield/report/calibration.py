"""The report of a calibration: pictures, numbers as YAML, and a page that shows them."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure

from wavefield.calibration.numbers import numbers
from wavefield.calibration.result import Calibration
from wavefield.report import calibration_pictures as pictures

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1120px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; margin: 1em 0; } th, td { padding: .2em .9em .2em 0; text-align: right; }
th { font-weight: 600; border-bottom: 1px solid #bbb; } th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } .good { color: #00724f; } .bad { color: #b03000; } p.note { color: #555; }
"""


def write_calibration(calibration: Calibration, directory: str | Path) -> Path:
    """Write the report of a calibration.

    Parameters
    ----------
    calibration : Calibration
        What to report; also one without a rig, to say what to photograph again.
    directory : path
        Made if it is not there.

    Returns
    -------
    Path
        The page, ``index.html``; beside it ``numbers.yaml`` and the pictures.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    content: dict[str, Any] = {
        "usable": calibration.usable,
        "problems": list(calibration.problems),
        "notes": list(calibration.notes),
        "left_out_points": dict(calibration.left_out),
    }
    drawn: list[tuple[str, str]] = []
    o, fit, derived = calibration.observations, calibration.fit, calibration.derived
    if o is not None and fit is not None and derived is not None:
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
        cameras = [calibration.rig[name] for name in o.cameras]
        figures: list[tuple[str, str, Figure]] = [
            ("rig", "The rig and the target's poses", pictures.rig_drawing(o, fit, cameras)),
            ("coverage", "Where the target was seen", pictures.coverage(o)),
        ]
        if surface is not None:
            figures.append(
                (
                    "flat_target",
                    f"z of the target in view {calibration.reference}, triangulated",
                    pictures.flat_target(surface, o.mesh),
                )
            )
        for c, name in enumerate(o.cameras):
            figures.append((f"residuals_{name}", f"Residuals of {name}", pictures.residual_map(o, fit, c)))
        for stem, title, figure in figures:
            figure.savefig(directory / f"{stem}.png")
            drawn.append((f"{stem}.png", title))
    (directory / "numbers.yaml").write_text(
        yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110), encoding="utf-8"
    )
    page = directory / "index.html"
    page.write_text(_page(content, drawn), encoding="utf-8")
    return page


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


def _value(value: float, std: float) -> str:
    return f"{value:.7g} ± {std:.2g}" if std else f"{value:.7g} (held)"


def _table(head: list[str], rows: list[list[str]]) -> str:
    cells = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{body}</table>"


def _page(content: dict[str, Any], drawn: list[tuple[str, str]]) -> str:
    parts = [f"<style>{STYLE}</style>", "<h1>Calibration of the rig</h1>"]
    if content["usable"]:
        parts.append('<p class="good"><b>The rig can be used.</b></p>')
    else:
        parts.append('<p class="bad"><b>The rig cannot be used:</b></p><ul class="bad">')
        parts += [f"<li>{escape(p)}</li>" for p in content["problems"]] + ["</ul>"]
    if content["notes"]:
        parts.append("<ul>" + "".join(f"<li>{escape(n)}</li>" for n in content["notes"]) + "</ul>")
    if "cameras" in content:
        predicted = content["predicted"]
        rows = [
            [
                name,
                str(len(c["views"])),
                str(sum(v["points"] for v in c["views"].values())),
                f"{c['rms_px']:.3g}",
                f"{c['rms_mm']:.2g}",
                f"{c['max_px']:.2g}",
                f"{predicted['reprojection_px'][name]:.2g}",
                f"{100 * predicted['image_covered'][name]:.0f} %",
                ", ".join(f"{v:.2f}" for v in c["position_m"]),
            ]
            for name, c in content["cameras"].items()
        ]
        head = [
            "camera",
            "views",
            "points",
            "rms px",
            "rms mm",
            "largest px",
            "predicted px",
            "covered",
            "position m",
        ]
        parts += ["<h2>Cameras</h2>", _table(head, rows)]
        parts.append(
            '<p class="note">rms: of the fitted points. Predicted: standard uncertainty of a pixel within '
            "5 cm of z = 0, from the covariance of the fit; it, and not the rms, measures the rig.</p>"
        )
        if content["epipolar"]:
            rows = [
                [pair, str(e["points"]), f"{e['rms_px']:.3f}", f"{e['median_px']:.3f}", f"{e['max_px']:.2f}"]
                for pair, e in content["epipolar"].items()
            ]
            parts += [
                "<h2>Between cameras: distance from the epipolar line</h2>",
                _table(["pair", "points", "rms px", "median px", "largest px"], rows),
            ]
        if "flat_target" in content:
            flat = content["flat_target"]
            parts.append(
                f"<p>z of the {flat['nodes']} nodes of view {escape(flat['view'])}, triangulated: rms "
                f"{flat['z_rms_mm']:.3f} mm, {flat['z_about_its_plane_rms_mm']:.3f} mm about its plane, tilt "
                f"{flat['tilt_mrad']:.3f} mrad. Predicted uncertainty of z: {predicted['z_mm']:.2g} mm, of "
                f"which tilt and level {predicted['z_of_which_tilt_mm']:.2g} mm.</p>"
            )
        rows = [
            [
                m["model"],
                str(m["parameters"]),
                f"{m['rms_over_stated']:.3f}",
                f"{m['bic']:.0f}",
                f"{m['expected_px']:.4f}",
            ]
            for m in content["models_compared"]
        ]
        parts.append(f"<h2>Camera model: {escape(content['model'])}</h2>")
        if rows:
            parts.append(
                _table(["model", "parameters", "rms / stated uncertainty", "BIC", "expected error px"], rows)
            )
        names = list(content["parameters"])
        terms = [
            t
            for t in dict.fromkeys(t for n in names for t in content["parameters"][n])
            if not t.startswith(("rotation", "translation"))
        ]
        rows = [
            [t.replace("_", " ")]
            + [
                "{:.6g} ± {:.2g}".format(*content["parameters"][n][t])
                if t in content["parameters"][n]
                else ""
                for n in names
            ]
            for t in terms
        ]
        parts.append(_table(["", *names], rows))
        parts.append(
            '<p class="note">Parameters are correlated with the pose: judge the rig by the predicted errors '
            "above.</p>"
        )
    for file, title in drawn:
        parts.append(f'<h2>{escape(title)}</h2><img src="{escape(file)}" alt="{escape(title)}">')
    body = "\n".join(parts)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Calibration</title></head>\n'
        f"<body>\n{body}\n</body></html>\n"
    )
