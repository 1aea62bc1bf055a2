"""Read XML files of VIC-3D and DICe, programs of digital image correlation; lengths in millimetres."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.formats.common import (
    FIRST_CAMERA,
    ImportOptions,
    StoredCamera,
    camera_matrix,
    numbers_of,
    rig_of_file,
    rotation_near,
    turned_about_axes,
)
from wavefield.rig.rig import Rig

# DICe's names of OpenCV's distortion coefficients, in OpenCV's order
_DISTORTION = ("K1", "K2", "P1", "P2", "K3", "K4", "K5", "K6", "S1", "S2", "S3", "S4", "T1", "T2")
_POSE = ("ALPHA", "BETA", "GAMMA", "TX", "TY", "TZ")

Parameters = dict[str, str]


def load_dice(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Read a camera system of DICe (cam_sys.xml), whose root element is `root`; returns the rig."""
    relative = _parameters(root).get("extrinsics_relative_camera_to_camera", "").lower() in ("true", "1")
    length, unit = options.length("mm")
    cameras: list[StoredCamera] = []
    names = []
    for element in root.findall("ParameterList"):
        parameters = _parameters(element)
        camera = _dice_camera(element, parameters, length)
        if relative and cameras:
            (R, T), (first_R, first_T) = camera.pose, cameras[0].pose
            camera = replace(camera, pose=(R @ first_R, R @ first_T + T))
        cameras.append(camera)
        names.append(parameters.get("CAMERA_ID", ""))
    if not cameras:
        raise RigError("it holds no camera")
    note = {"program": "DICe", "file": path.name, "unit": unit}
    return rig_of_file(cameras, options, "this DICe file", note, names)


def _parameters(element: ET.Element) -> Parameters:
    return {e.attrib["name"]: e.attrib.get("value", "") for e in element.findall("Parameter")}


def _braces(text: str) -> list[float]:
    return [float(v) for v in text.strip(" {}").split(",")]


def _dice_camera(element: ET.Element, parameters: Parameters, length: float) -> StoredCamera:
    """Read one camera of DICe; `length` is the size of the file's unit of length, metres."""

    def values(*names: str) -> list[float]:
        return [float(parameters.get(name, 0.0)) for name in names]

    model = re.sub(r"_(LENS_DISTORTION|DIS)$", "", parameters.get("LENS_DISTORTION_MODEL", "NONE"))
    if model not in ("NONE", "NO", "OPENCV", "VIC3D", "K1R3_K2R5_K3R7") and any(values("K1", "K2", "K3")):
        raise RigError(f"its lens model is {model}: calibrate with OPENCV_LENS_DISTORTION")
    matrix = element.find("ParameterList")  # rows of the rotation matrix, instead of angles
    pose = FIRST_CAMERA
    if matrix is not None or any(name in parameters for name in _POSE):
        R = turned_about_axes(*np.radians(values("ALPHA", "BETA", "GAMMA")))
        if matrix is not None:
            rows = _parameters(matrix)
            R = rotation_near(np.array([_braces(rows[f"ROW {row}"]) for row in range(3)]))
        pose = R, length * np.array(values("TX", "TY", "TZ"))
    size = None
    if "IMAGE_HEIGHT_WIDTH" in parameters:
        height, width = _braces(parameters["IMAGE_HEIGHT_WIDTH"])
        size = width, height
    K = camera_matrix(*values("FX", "FY", "CX", "CY", "FS"))
    return StoredCamera(K, values(*_DISTORTION), pose, size)


def load_vic(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Read a project of VIC-3D, whose root element is `root`; returns the rig."""
    mask = root.find(".//polygonmask")
    size = None if mask is None else (int(mask.attrib["width"]), int(mask.attrib["height"]))
    length, unit = options.length("mm")
    cameras = []
    for element in root.findall("calibration/camera"):
        values = [float(v) for v in (element.text or "").split()]
        if len(values) not in (5, 6, 7, 8):
            raise RigError(f"a <camera> holds {len(values)} numbers instead of cx cy fx fy skew k1 k2 k3")
        cx, cy, fx, fy, skew, k1, k2, k3 = [*values, 0.0, 0.0, 0.0][:8]
        pose = numbers_of(element, "orientation", 6)
        R, T = turned_about_axes(*np.radians(pose[:3])), length * np.array(pose[3:])
        cameras.append(
            StoredCamera(camera_matrix(fx, fy, cx, cy, skew), [k1, k2, 0.0, 0.0, k3], (R, T), size)
        )
    if not cameras:
        raise RigError("it has no <camera>: the project was not calibrated")
    return rig_of_file(
        cameras, options, "this VIC-3D file", {"program": "VIC-3D", "file": path.name, "unit": unit}
    )
