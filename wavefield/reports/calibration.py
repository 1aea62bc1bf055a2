"""The page of a calibration, with pictures and a file of numbers, and its section in the report of a run."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure

from wavefield.atomic_write import Product, write_text
from wavefield.calibration.assess import FlatSurface, residual_summary
from wavefield.calibration.bundle import Fit
from wavefield.calibration.observations import Observations
from wavefield.calibration.solve import Calibration
from wavefield.errors import RigError
from wavefield.figures import rig_views
from wavefield.pipeline import Run
from wavefield.reports import calibration_pictures as pictures
from wavefield.reports.html import Head, Item, Picture, ReportSection, Table, Text, render
from wavefield.reports.numbers import number, small
from wavefield.rig import Rig
from wavefield.rig.field import common_field, pixel_size
from wavefield.text import spell_uncertain

REPORT = Product("calibration report")
_PREDICTED = (
    "rms: of the fitted points. Predicted: standard uncertainty of a pixel within 5 cm of z = 0, from the "
    "covariance of the fit; judge the rig by it, not by the rms."
)
_CORRELATED = "Parameters are correlated with the pose: judge the rig by the predicted errors above."
CalibrationPicture = tuple[str, str, Figure]  # short name, title, picture
Content = Mapping[str, Any]  # of numbers.yaml
_LENS_TERMS = {
    "cx": "_px", "cy": "_px", "k1": "", "k2": "", "p1": "", "p2": "", "k3": "", "tau_x": "_rad",
    "tau_y": "_rad",
}  # fmt: skip


def write_calibration(
    calibration: Calibration,
    directory: str | Path,
    target: Figure | None = None,
    product: Product = REPORT,
) -> Path:
    """Write `index.html` and `numbers.yaml` of a calibration into a folder; return the path of the page.
    `target` is a figure of the target points found in the images. Raises StoreError if one of the files
    exists and is not an earlier, unchanged output with the same kind and source (`product`)."""
    directory = Path(directory)
    content: dict[str, Any] = {
        "usable": calibration.usable,
        "problems": list(calibration.problems),
        "notes": list(calibration.notes),
        "sentences": list(rig_sentences(calibration.rig)) if len(calibration.rig) else [],
        "left_out_points": dict(calibration.left_out),
    }
    drawn: list[CalibrationPicture] = []
    if target is not None:
        drawn.append(("target", "The target as it was found in an image of each camera", target))
    observations, fit = calibration.observations, calibration.fit
    if observations is not None and fit is not None and calibration.predicted is not None:
        fitted, surface = residual_summary(observations, fit, calibration.rig, calibration.reference)
        errors = calibration.predicted
        content |= fitted | {
            "model": calibration.model,
            "predicted": {
                "reprojection_px": dict(errors.reprojection),
                "z_mm": 1e3 * errors.z_std,
                "image_covered": dict(errors.coverage),
            },
        }
        content["parameters"] = _parameters(calibration, observations, fit)
        drawn += _figures(calibration, observations, fit, surface)
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110)
    write_text(directory / "numbers.yaml", text, product)
    page = directory / "index.html"
    write_text(page, calibration_page(content, drawn), product)
    return page


def _figures(
    calibration: Calibration, observations: Observations, fit: Fit, surface: FlatSurface | None
) -> Iterator[CalibrationPicture]:
    """Yield name, title and figure of each picture: rig, coverage, flat target, residuals of each camera.
    `surface` is the flat target, triangulated with the rig; None if no image shows it flat."""
    with suppress(RigError):  # cameras without a common field
        seen = common_field(calibration.rig.cameras.values())
        yield "rig", "The rig, and the water that all cameras see", rig_views(calibration.rig, seen)
    yield "coverage", "Positions of the target in the images", pictures.coverage(observations)
    if surface is not None:
        title = f"z of the target in view {calibration.reference}, triangulated"
        yield "flat_target", title, pictures.flat_target(surface, observations.mesh)
    for c, name in enumerate(observations.cameras):
        yield "residuals", f"Residuals of {name}", pictures.residual_map(observations, fit, c)


def _parameters(calibration: Calibration, observations: Observations, fit: Fit) -> dict[str, Any]:
    """Return, for each camera, [value, standard uncertainty] of each lens parameter by name, such as "fx_px".
    The uncertainty is 0 if the parameter was not fitted. Further entries are lists along x, y, z: the
    translation, m, and the standard uncertainties of rotation, rad, and translation, m."""
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


# -- the page ------------------------------------------------------------------------------------------


def calibration_page(content: Content, drawn: Sequence[CalibrationPicture]) -> str:
    """Return the HTML page of a calibration from the content of `numbers.yaml` and the pictures."""
    usable = content["usable"]
    verdict = "the rig can be used" if usable else "the rig cannot be used"
    weight = "grave" if not usable else "remark" if content["notes"] else "note"
    head = Head("Calibration of the rig", content.get("sentences", ()), verdict, weight)
    return render(head, list(_sections(content, drawn)))


def _sections(content: Content, drawn: Sequence[CalibrationPicture]) -> Iterator[ReportSection]:
    rows = [("problem", words) for words in content["problems"]]
    rows += [("note", words) for words in content["notes"]]
    if rows:
        table = Table("Problems must be solved before the rig can be used", ("kind", "remark"), rows)
        yield ReportSection("What needs attention", [table])
    shown = [(name, Picture(figure, f"{title}.", title)) for name, title, figure in drawn]
    residuals: list[Item] = [picture for name, picture in shown if name == "residuals"]
    general: list[Item] = [picture for name, picture in shown if name != "residuals"]
    if "cameras" not in content:
        yield ReportSection("Pictures", general)
        return
    yield ReportSection("Cameras", [_cameras(content), Text(_PREDICTED)])
    between = ReportSection("Between cameras")
    if content["epipolar"]:
        between.items.append(_epipolar(content))
    if "flat_target" in content:
        between.items.append(Text(_flat(content)))
    yield between
    yield ReportSection("Target and rig", general, layout="beside")
    largest = max(c["max_px"] for c in content["cameras"].values())
    gist = f"every point, and the mean per cell of the image; at most {largest:.2g} px"
    yield ReportSection("Residuals", residuals, folded=True, gist=gist)
    items = [_lens(content), Text(_CORRELATED)]
    yield ReportSection(
        "Camera model", items, folded=True, gist=f"{content['model']}; parameters of the lenses"
    )


def _cameras(content: Content) -> Table:
    predicted = content["predicted"]
    head = (
        "camera", "views", "points", "rms, px", "rms, mm", "largest, px", "predicted, px", "image covered",
        "position x, y, z, m",
    )  # fmt: skip
    rows = [
        (
            name,
            str(len(c["views"])),
            str(sum(view["points"] for view in c["views"].values())),
            f"{c['rms_px']:.3g}",
            f"{c['rms_mm']:.2g}",
            f"{c['max_px']:.2g}",
            f"{predicted['reprojection_px'][name]:.2g}",
            f"{100 * predicted['image_covered'][name]:.0f} %",
            ", ".join(f"{v:.2f}" for v in c["position_m"]),
        )
        for name, c in content["cameras"].items()
    ]
    return Table("The target in the images of each camera, and residuals of the fit", head, rows)


def _epipolar(content: Content) -> Table:
    rows = [
        (pair, str(e["points"]), f"{e['rms_px']:.3f}", f"{e['median_px']:.3f}", f"{e['max_px']:.2f}")
        for pair, e in content["epipolar"].items()
    ]
    head = ("pair", "points", "rms, px", "median, px", "largest, px")
    return Table("Distance of the points from the epipolar line", head, rows)


def _flat(content: Content) -> str:
    flat, predicted = content["flat_target"], content["predicted"]
    return (
        f"z of the {flat['nodes']} nodes of view {flat['view']}, triangulated: rms "
        f"{small(flat['z_rms_mm'], 'mm')}, {small(flat['z_about_its_plane_rms_mm'], 'mm')} about its plane, "
        f"tilt {small(flat['tilt_mrad'], 'mrad')}. By the fit alone, the standard uncertainty of z is "
        f"{small(predicted['z_mm'], 'mm')}. `check` and `run` add that of the water's level (`z_level_std`)."
    )


def _with_std(value: float, std: float) -> str:
    """Return a lens parameter and its standard uncertainty as text; `std` 0 means that it was not fitted."""
    return spell_uncertain(value, std, "").replace("+-", "±").strip() if std > 0 else f"{value:.6g} (held)"


def _lens(content: Content) -> Table:
    cameras = content["parameters"]
    terms = dict.fromkeys(term for values in cameras.values() for term in values)
    rows = [
        (term.replace("_", " "), *(_with_std(*v[term]) if term in v else "" for v in cameras.values()))
        for term in terms
        if not term.startswith(("rotation", "translation"))
    ]
    return Table("Parameters of the lenses, with their standard uncertainty", ("parameter", *cameras), rows)


def rig_sentences(rig: Rig) -> Iterator[str]:
    """Yield two sentences: camera distances from the target's origin; pixel size and area all cameras see."""
    distances = ", ".join(
        f"{name} {float(np.linalg.norm(camera.centre)):.2f} m" for name, camera in rig.cameras.items()
    )
    yield (
        f"Distance from the target's origin: {distances}; if you measure another, correct `mesh` by that "
        "ratio."
    )
    try:
        field = common_field(rig.cameras.values())
        (x0, x1), (y0, y1) = field.x, field.y
        yield (
            f"On the water a pixel is {1e3 * pixel_size(rig, field):.2g} mm; all cameras see "
            f"x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m."
        )
    except RigError as error:
        yield f"Common field of view: {error}"


# -- in a report ---------------------------------------------------------------------------------------


def calibration_folder(run: Run) -> Path | None:
    """Return the folder of the calibration report next to the run's rig file; None if it does not exist."""
    if run.experiment is None or isinstance(run.experiment.rig, dict):
        return None
    rig = run.experiment.resolve(run.experiment.rig or "rig.yaml")
    folder = rig.with_name(f"{rig.stem}_report")
    return folder if (folder / "numbers.yaml").is_file() else None


def calibration_section(run: Run) -> ReportSection:
    """Return the section on the residuals of the calibration; empty without a calibration report."""
    section = ReportSection("Calibration", folded=True)
    folder = calibration_folder(run)
    if folder is None:
        return section
    numbers = yaml.safe_load((folder / "numbers.yaml").read_text(encoding="utf-8")) or {}
    rows = [
        (name, str(len(c["views"])), number(c["rms_px"]), number(c["rms_mm"]), number(c["max_px"]))
        for name, c in (numbers.get("cameras") or {}).items()
    ]
    if sentences := numbers.get("sentences"):
        section.gist = sentences[-1].removesuffix(".")
    if rows:
        head = ("camera", "views", "rms, px", "rms, mm", "largest, px")
        section.items.append(Table("Residuals of the fitted points", head, rows))
    section.items.append(
        Text(f"Pictures and parameters are on the page of the calibration, `{folder.name}/index.html`.")
    )
    return section
