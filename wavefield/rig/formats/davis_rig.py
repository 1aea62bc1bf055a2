"""DaVis' Calibration.xml of pinhole cameras ("PinholeOpenCV"), lengths in millimetres.

LaVision describes the file nowhere. That the angles are R = Rz Ry Rx, that FocalLengthPixel is in
millimetres and that PrincipalPoint and marks count pixels alike rests on public readers. One of them finds
DaVis' own FitError again from its table of marks, to fourteen digits; with the angles as a rotation vector,
which another takes them for, it misses the marks by a thousand times as much. Where the table lies beside the
file, the same is checked here.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import Stated, turned_about_axes
from wavefield.rig.rig import Rig

_AGAIN = (
    "calibrate again from its target images, which are read as they are (.im7), or from tables of its marks"
)
_TABLE = "MarkPositionTable.xml"
_ALIKE = 2.0  # times the error that DaVis states, by which its marks may be missed
_LEAST = 0.1  # px, which marks may be missed by in any case
_UNIT = 1e-3  # m


def load_davis(root: ET.Element, path: Path, stated: Stated) -> Rig:
    """Read a calibration of DaVis."""
    if any(beside.is_dir() for beside in path.parent.glob("[Cc]orrection field")):
        raise RigError(
            "a correction field of DaVis' self-calibration lies beside it, which is not read: take the "
            f"calibration before that from `Calibration History`, or {_AGAIN}"
        )
    systems = [one for one in root.iter() if one.find("CoordinateMapper") is not None]
    if len(systems) > 1:
        raise RigError(
            f"it holds {len(systems)} coordinate systems, one for each view of the plate: {_AGAIN}"
        )
    mappers = systems[0].findall("CoordinateMapper")
    strange = [one for one in mappers if one.get("Type") != "PinholeOpenCV"]
    if strange:
        raise RigError(
            f"it is DaVis', of the kind {strange[0].get('Type', 'unknown')}, not PinholeOpenCV: {_AGAIN}"
        )
    names = stated.named(len(mappers))
    cameras = {name: _camera(mapper) for name, mapper in zip(names, mappers, strict=True)}
    note: dict[str, object] = {"program": "DaVis", "file": path.name, "unit": "mm"}
    missed = {}
    for name, mapper in zip(names, mappers, strict=True):
        rms = _missed(cameras[name], path.parent, mapper.get("CameraIdentifier", ""))
        if rms is None:
            continue
        missed[name] = round(rms, 4)
        stated_rms = _number(mapper, "FitError", "RMS", np.inf)
        if rms > max(_ALIKE * stated_rms, _LEAST):
            raise RigError(
                f"{name} misses its own marks ({_TABLE}) by {rms:.2f} px, where DaVis states "
                f"{stated_rms:.2f}: if "
                f"it was calibrated on particles since, take the table away from there; if not, {_AGAIN}"
            )
    if missed:
        note["marks_px"] = missed
    return Rig(cameras, {"imported": note})


def _camera(mapper: ET.Element) -> Camera:
    pixel = _number(mapper, "SensorPixelSizeMm", "Value")
    fx, fy = (_number(mapper, "FocalLengthPixel", axis) / pixel for axis in "xy")
    cx, cy = (_number(mapper, "PrincipalPoint", axis) for axis in "xy")
    k1, k2 = (_number(mapper, "RadialDistortion", f"radialDistortionCoefficient{n}", 0.0) for n in (1, 2))
    p1, p2 = (
        _number(mapper, "TangentialDistortion", f"tangentialDistortionCoefficient{n}", 0.0) for n in (1, 2)
    )
    R = turned_about_axes(*(_number(mapper, "RotationAngles", name) for name in ("Rx", "Ry", "Rz")))
    T = [_UNIT * _number(mapper, "TranslationMm", name) for name in ("Tx", "Ty", "Tz")]
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


def _missed(camera: Camera, folder: Path, number: str) -> float | None:
    """Rms distance of the marks from where a camera sees them, weighted as DaVis does, px; None without any.

    The tables in the cameras' folders are alike: each holds the marks of all cameras.
    """
    tables = sorted([*folder.glob(_TABLE), *folder.glob(f"*/{_TABLE}")])
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
    seen = camera.project(_UNIT * x, _UNIT * y, _UNIT * z)
    apart = (seen[0] - column) ** 2 + (seen[1] - row) ** 2
    return float(np.sqrt((weight * apart).sum() / max(weight.sum(), 1e-12)))
