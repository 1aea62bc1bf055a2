"""Read Calibration.xml of DaVis, with pinhole cameras ("PinholeOpenCV") and lengths in millimetres.

LaVision does not document the file. According to public readers, one of which reproduces DaVis' own FitError
to fourteen digits, the rotation is R = Rz Ry Rx, and FocalLengthPixel is in millimetres.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.formats.common import (
    ImportOptions,
    StoredCamera,
    camera_matrix,
    rig_of_file,
    turned_about_axes,
)
from wavefield.rig.rig import Rig

REMEDY = "calibrate with wavefield from DaVis' target images (.im7), or from tables of its marks"


def load_davis(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Return the rig in a calibration file of DaVis at `path`; `root` is the root element of its XML."""
    if any(folder.is_dir() for folder in path.parent.glob("[Cc]orrection field")):
        raise RigError(
            "a correction field of DaVis' self-calibration is next to it, which is not supported: use the "
            f"calibration before it from `Calibration History`, or {REMEDY}"
        )
    systems = [one for one in root.iter() if one.find("CoordinateMapper") is not None]
    if len(systems) > 1:
        raise RigError(
            f"it holds {len(systems)} coordinate systems, one for each view of the plate: {REMEDY}"
        )
    mappers = systems[0].findall("CoordinateMapper")
    other = [one for one in mappers if one.get("Type") != "PinholeOpenCV"]
    if other:
        raise RigError(
            f"it is DaVis', of the kind {other[0].get('Type', 'unknown')}, not PinholeOpenCV: {REMEDY}"
        )
    length, unit = options.length("mm")
    cameras = [_camera(mapper, length) for mapper in mappers]
    note = {"program": "DaVis", "file": path.name, "unit": unit}
    return rig_of_file(cameras, options, "this DaVis file", note)


def _camera(mapper: ET.Element, length: float) -> StoredCamera:
    pixel = _number(mapper, "SensorPixelSizeMm", "Value")
    fx, fy = (_number(mapper, "FocalLengthPixel", axis) / pixel for axis in "xy")
    cx, cy = (_number(mapper, "PrincipalPoint", axis) for axis in "xy")
    k1, k2 = (_number(mapper, "RadialDistortion", f"radialDistortionCoefficient{n}", 0.0) for n in (1, 2))
    p1, p2 = (
        _number(mapper, "TangentialDistortion", f"tangentialDistortionCoefficient{n}", 0.0) for n in (1, 2)
    )
    R = turned_about_axes(*(_number(mapper, "RotationAngles", name) for name in ("Rx", "Ry", "Rz")))
    T = length * np.array([_number(mapper, "TranslationMm", name) for name in ("Tx", "Ty", "Tz")])
    width, height = (_number(mapper, "OriginalImageSize", name) for name in ("Width", "Height"))
    return StoredCamera(camera_matrix(fx, fy, cx, cy), [k1, k2, p1, p2], (R, T), (width, height))


def _number(mapper: ET.Element, tag: str, name: str, absent: float | None = None) -> float:
    """Return the number in the attribute `name` of the element `tag` inside `mapper`.
    If it is missing, `absent` is returned, or a RigError is raised if `absent` is None."""
    element = mapper.find(f".//{tag}")
    text = None if element is None else element.get(name)
    if text is None:
        if absent is None:
            raise RigError(f"<{tag} {name}=...> is missing")
        return absent
    return float(text)
