"""DaVis' Calibration.xml of pinhole cameras ("PinholeOpenCV"), lengths in millimetres.

LaVision does not document the file. According to public readers, one of which reproduces DaVis' own FitError
to fourteen digits, the angles are R = Rz Ry Rx and FocalLengthPixel is in millimetres.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import ImportOptions, turned_about_axes
from wavefield.rig.rig import Rig

AGAIN = (
    "calibrate again from its target images, which are read as they are (.im7), or from tables of its marks"
)


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
    note = {"program": "DaVis", "file": path.name, "unit": unit}
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
