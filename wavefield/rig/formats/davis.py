"""DaVis' Calibration.xml of pinhole cameras ("PinholeOpenCV"), lengths in millimetres.

LaVision does not document the file. According to public readers the angles are R = Rz Ry Rx,
FocalLengthPixel is in millimetres, and PrincipalPoint and marks count pixels alike. One of these readers
reproduces DaVis' own FitError from its table of marks to fourteen digits. Where the table is in the folder of
the file, the same is checked here.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import ImportOptions, turned_about_axes
from wavefield.rig.rig import Rig

AGAIN = (
    "calibrate again from its target images, which are read as they are (.im7), or from tables of its marks"
)
MARK_TABLE = "MarkPositionTable.xml"
MAX_ERROR_RATIO = 2.0  # of the marks' misfit over the error that DaVis states
ACCEPTED_MISFIT = 0.1  # px, in any case


def load_davis(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Read a calibration of DaVis."""
    if any(folder.is_dir() for folder in path.parent.glob("[Cc]orrection field")):
        raise RigError(
            "a correction field of DaVis' self-calibration is next to it, which is not read: take the "
            f"calibration before that from `Calibration History`, or {AGAIN}"
        )
    systems = [one for one in root.iter() if one.find("CoordinateMapper") is not None]
    if len(systems) > 1:
        raise RigError(f"it holds {len(systems)} coordinate systems, one for each view of the plate: {AGAIN}")
    mappers = systems[0].findall("CoordinateMapper")
    other = [one for one in mappers if one.get("Type") != "PinholeOpenCV"]
    if other:
        raise RigError(
            f"it is DaVis', of the kind {other[0].get('Type', 'unknown')}, not PinholeOpenCV: {AGAIN}"
        )
    names = options.named(len(mappers))
    length, unit = options.length("mm")
    cameras = {name: _camera(mapper, length) for name, mapper in zip(names, mappers, strict=True)}
    note: dict[str, object] = {"program": "DaVis", "file": path.name, "unit": unit}
    misfits = {}
    for name, mapper in zip(names, mappers, strict=True):
        rms = _misfit_of_marks(cameras[name], path.parent, mapper.get("CameraIdentifier", ""), length)
        if rms is None:
            continue
        misfits[name] = round(rms, 4)
        stated_rms = _number(mapper, "FitError", "RMS", np.inf)
        if rms > max(MAX_ERROR_RATIO * stated_rms, ACCEPTED_MISFIT):
            raise RigError(
                f"{name} misses its own marks ({MARK_TABLE}) by {rms:.2f} px, where DaVis states "
                f"{stated_rms:.2f}: if it was calibrated on particles since, remove the table; if not, "
                f"{AGAIN}"
            )
    if misfits:
        note["marks_px"] = misfits
    return Rig(cameras, {"imported": note})


def _camera(mapper: ET.Element, length: float) -> Camera:
    pixel = _number(mapper, "SensorPixelSizeMm", "Value")
    fx, fy = (_number(mapper, "FocalLengthPixel", axis) / pixel for axis in "xy")
    cx, cy = (_number(mapper, "PrincipalPoint", axis) for axis in "xy")
    k1, k2 = (_number(mapper, "RadialDistortion", f"radialDistortionCoefficient{n}", 0.0) for n in (1, 2))
    p1, p2 = (
        _number(mapper, "TangentialDistortion", f"tangentialDistortionCoefficient{n}", 0.0) for n in (1, 2)
    )
    R = turned_about_axes(*(_number(mapper, "RotationAngles", name) for name in ("Rx", "Ry", "Rz")))
    T = [length * _number(mapper, "TranslationMm", name) for name in ("Tx", "Ty", "Tz")]
    width, height = (int(_number(mapper, "OriginalImageSize", name)) for name in ("Width", "Height"))
    return Camera(fx, fy, cx, cy, R, T, (width, height), k1=k1, k2=k2, p1=p1, p2=p2)


def _number(mapper: ET.Element, tag: str, name: str, absent: float | None = None) -> float:
    element = mapper.find(f".//{tag}")
    text = None if element is None else element.get(name)
    if text is None:
        if absent is None:
            raise RigError(f"<{tag} {name}=...> is missing")
        return absent
    return float(text)


def _misfit_of_marks(camera: Camera, folder: Path, number: str, length: float) -> float | None:
    """Rms distance of marks from their projections by a camera, weighted as in DaVis, px; None without any.
    The tables in the cameras' folders are alike: each holds the marks of all cameras.
    """
    tables = sorted([*folder.glob(MARK_TABLE), *folder.glob(f"*/{MARK_TABLE}")])
    if not tables:
        return None
    rows = []
    for mark in ET.fromstring(tables[0].read_bytes()).iterfind(f".//Camera[@CameraNumber='{number}']//Mark"):
        world, raw = mark.find("WorldPos"), mark.find("RawPos")
        if world is not None and raw is not None:
            place = [float(world.get(axis, 0)) for axis in "xyz"] + [float(raw.get(axis, 0)) for axis in "xy"]
            rows.append([*place, float(mark.get("w", 1))])
    if not rows:
        return None
    x, y, z, column, row, weight = np.array(rows).T
    X, Y = camera.project(length * x, length * y, length * z)
    apart = (X - column) ** 2 + (Y - row) ** 2
    return float(np.sqrt((weight * apart).sum() / max(weight.sum(), 1e-12)))
