"""Read and write UVMAT's XML files (ImaDoc), one per camera."""

import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import ImportOptions, numbers_of, refuse_terms, rotation_near
from wavefield.rig.rig import Rig

# UVMAT counts Y upwards, so its camera frame is left-handed: invert its y axis
_FLIP = np.diag([1.0, -1.0, 1.0])


def load_uvmat(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Read one camera from a file of UVMAT (ImaDoc), whose root element is `root`; returns a rig."""
    calibration = root.find("GeometryCalib")
    if calibration is None:
        raise RigError("it has no <GeometryCalib>: the images were not calibrated")
    rows = calibration.findall("R")
    if len(rows) != 3:
        raise RigError(
            "its calibration is not in three dimensions: redo it in UVMAT as 3D_linear or 3D_extrinsic"
        )
    (name,) = options.named(1, [path.stem])
    size = options.size(name, "UVMAT")
    _check_size(calibration, size)
    stated = (calibration.findtext("CoordUnit") or "").strip()
    if not stated:
        raise RigError("its <CoordUnit> is missing")
    length, unit = options.length(None, stated)
    fx, fy = numbers_of(calibration, "fx_fy", 2)
    Cx, Cy = numbers_of(calibration, "Cx_Cy", 2)
    k1 = numbers_of(calibration, "kc")[0] if calibration.find("kc") is not None else 0.0
    R = np.array([[float(v) for v in (row.text or "").split()] for row in rows])
    T = length * np.array(numbers_of(calibration, "Tx_Ty_Tz", 3))
    # UVMAT has pixel centres at half-integers, that of the lowest row at Y = 1/2
    camera = Camera(fx, fy, Cx - 0.5, size[1] - 0.5 - Cy, rotation_near(_FLIP @ R), _FLIP @ T, size, k1=k1)
    note = {"program": "UVMAT", "file": path.name, "unit": unit}
    index = calibration.findtext("RefractionIndex")
    if index is not None and float(index) != 1.0:
        note["left_out"] = f"refraction index {float(index)}: sight lines are straight here, as in air"
    return Rig({name: camera}, {"imported": note})


def _check_size(calibration: ET.Element, size: tuple[int, int]) -> None:
    """Raise a RigError if a point of the calibration is outside an image of the size (width, height), px."""
    marked = [
        [float(v) for v in (point.text or "").split()]
        for point in calibration.iterfind("SourceCalib/PointCoord")
    ]
    pixel = np.array([row[3:5] for row in marked if len(row) >= 5]).reshape(-1, 2)
    if len(pixel) and (pixel.max(axis=0) > size).any():
        x, y = pixel.max(axis=0)
        raise RigError(
            f"it has a point marked at ({x:.0f}, {y:.0f}) px, outside an image of {size[0]} x {size[1]} px: "
            "state the size of the images from which it was made"
        )


def save_uvmat(camera: Camera, path: str | Path) -> None:
    """Write one camera as a file of UVMAT (ImaDoc), in cm; RigError if it has distortion other than k1."""
    refuse_terms(camera, "UVMAT", "k1")
    root = ET.Element("ImaDoc")
    calibration = ET.SubElement(root, "GeometryCalib")
    R, T = _FLIP @ camera.R, _FLIP @ camera.T * 100.0

    def put(tag: str, *values: object, **attributes: str) -> None:
        ET.SubElement(calibration, tag, attributes).text = "\t".join(str(v) for v in values)

    put("CalibrationType", "3D_extrinsic")
    put("fx_fy", camera.fx, camera.fy)
    put("Cx_Cy", camera.cx + 0.5, camera.size[1] - 0.5 - camera.cy)
    put("kc", camera.k1)
    put("CoordUnit", "cm")
    put("Tx_Ty_Tz", *(repr(float(v)) for v in T))
    for i, row in enumerate(R):
        put("R", *(repr(float(v)) for v in row), i=str(i + 1))
    # rotation vector in degrees, which UVMAT states for the right-handed frame
    put("omc", *(repr(float(v)) for v in np.degrees(cv2.Rodrigues(camera.R)[0].ravel())))
    ET.indent(root, "   ")
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
