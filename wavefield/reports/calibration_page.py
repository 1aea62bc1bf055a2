"""The page of a calibration, from its numbers and pictures."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wavefield.reports.html_page import Head, Item, Listing, Picture, ReportSection, Table, Text, render

Content = Mapping[str, Any]
_PREDICTED = (
    "rms: of the fitted points. Predicted: standard uncertainty of a pixel within 5 cm of z = 0, from the "
    "covariance of the fit; judge the rig by it, not by the rms."
)
_CORRELATED = "Parameters are correlated with the pose: judge the rig by the predicted errors above."


@dataclass(frozen=True)
class CalibrationPicture:
    """A picture of the page."""

    file: str  # name of the file next to the page that contains it, too
    title: str
    png: bytes


def calibration_page(content: Content, drawn: Sequence[CalibrationPicture]) -> str:
    """The page, from the content of the file of numbers and the pictures."""
    usable = content["usable"]
    verdict = "the rig can be used" if usable else "the rig cannot be used"
    weight = "grave" if not usable else "remark" if content["notes"] else "note"
    head = Head("Calibration of the rig", (accuracy_sentence(content),), verdict, weight)
    return render(head, list(_sections(content, drawn)))


def accuracy_sentence(content: Content) -> str:
    """How well the rig measures z, how far the cameras are and how large a pixel is; empty without a fit."""
    if "predicted" not in content or not content.get("cameras"):
        return ""
    cameras = content["cameras"].values()
    distances = [float(np.linalg.norm(c["position_m"])) for c in cameras]
    pixels = [c["rms_mm"] / c["rms_px"] for c in cameras if c["rms_px"] > 0]
    width = f", and a pixel there is {_span(pixels, 'mm')} wide" if pixels else ""
    return (
        f"z is good to {_length(content['predicted']['z_mm'])} near the target's plane (one standard "
        f"uncertainty, from the fit); the cameras are {_span(distances, 'm')} from the origin{width}."
    )


def _length(mm: float) -> str:
    return f"{1e3 * mm:.2g} µm" if mm < 0.0995 else f"{mm:.2g} mm"


def _span(values: Sequence[float], unit: str) -> str:
    """One value where they are alike, else the range."""
    low, high = f"{min(values):.2g}", f"{max(values):.2g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _sections(content: Content, drawn: Sequence[CalibrationPicture]) -> Iterator[ReportSection]:
    rows = [("problem", words) for words in content["problems"]]
    rows += [("note", words) for words in content["notes"]]
    if rows:
        table = Table("Problems must be solved before the rig can be used", ("kind", "remark"), rows)
        yield ReportSection("What needs attention", [table])
    pictures = {one.file: Picture(one.png, f"{one.title} ({one.file})", one.title) for one in drawn}
    residuals = [picture for file, picture in pictures.items() if file.startswith("residuals_")]
    general: list[Item] = [picture for picture in pictures.values() if picture not in residuals]
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
    gist = f"every point, and means over cells of the image; at most {largest:.2g} px"
    yield ReportSection("Residuals", list(residuals), folded=True, gist=gist)
    items = [*_models(content), _lens(content), Text(_CORRELATED)]
    strongest = content["predicted"]["strongest_correlations"]
    words = "\n".join(f"{a} with {b}: {r:.4f}" for a, b, r in strongest)
    if words:
        items.append(Listing("Strongest correlations of the parameters", words))
    yield ReportSection(
        "Camera model", items, folded=True, gist=f"{content['model']}, parameters of the lenses"
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
        f"{flat['z_rms_mm']:.2g} mm, {flat['z_about_its_plane_rms_mm']:.2g} mm about its plane, "
        f"tilt {flat['tilt_mrad']:.2g} mrad. "
        f"Predicted uncertainty of z: {predicted['z_mm']:.2g} mm, of which tilt and level "
        f"{predicted['z_of_which_tilt_mm']:.2g} mm."
    )


def _models(content: Content) -> list[Item]:
    rows = [
        (
            m["model"],
            str(m["parameters"]),
            f"{m['rms_over_stated']:.3f}",
            f"{m['bic']:.0f}",
            f"{m['expected_px']:.4f}",
        )
        for m in content["models_compared"]
    ]
    head = ("model", "parameters", "rms over stated uncertainty", "BIC", "expected error, px")
    return [Table("Models that were compared", head, rows)] if rows else []


def with_std(value: float, std: float) -> str:
    """A value and its uncertainty to the digits that are certain; one that was not fitted is held."""
    if not std > 0:
        return f"{value:.6g} (held)"
    digits = max(0, 1 - int(np.floor(np.log10(std))))
    form = f".{digits}f" if digits <= 7 else ".2g"
    return f"{value:{form}} ± {std:{form}}"


def _lens(content: Content) -> Table:
    cameras = content["parameters"]
    terms = dict.fromkeys(term for values in cameras.values() for term in values)
    rows = [
        (term.replace("_", " "), *(with_std(*v[term]) if term in v else "" for v in cameras.values()))
        for term in terms
        if not term.startswith(("rotation", "translation"))
    ]
    return Table("Parameters of the lenses, with their standard uncertainty", ("parameter", *cameras), rows)
