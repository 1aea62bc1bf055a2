"""VIC-3D and DICe, programs of digital image correlation.

Lengths are in millimetres unless VIC-3D's file states another unit. DICe may place the second camera from
the first.
"""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import (
    FIRST_CAMERA,
    NO_WORLD_POSE,
    ImportOptions,
    Size,
    numbers_of,
    stated_unit,
    turned_about_axes,
)
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig

RELATIVE = "extrinsics_relative_camera_to_camera"
_TEXT = ("CX", "CY", "FX", "FY", "FS", "K1", "K2", "K3")
_POSE = ("ALPHA", "BETA", "GAMMA", "TX", "TY", "TZ")
_OPENCV_ONLY = ("K4", "K5", "K6", "S1", "S2", "S3", "S4")

Parameters = dict[str, str]


def is_dice_xml(root: ET.Element) -> bool:
    """Whether an XML file is a camera system of DICe."""
    return root.tag == "ParameterList" and root.find("ParameterList") is not None


def load_dice_xml(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Read cam_sys.xml."""
    relative = _parameters(root).get(RELATIVE, "false").lower() in ("true", "1")
    cameras = []
    for element in root.findall("ParameterList"):
        parameters = _parameters(element)
        matrix = element.find("ParameterList")  # rows of the rotation, in place of angles
        turn = None
        if matrix is not None:
            rows = _parameters(matrix)
            turn = np.array([_braces(rows[f"ROW {row}"]) for row in range(3)])
        cameras.append(_camera(parameters, turn, parameters.get("LENS_DISTORTION_MODEL", "NONE")))
    own = [_parameters(e).get("CAMERA_ID", "") for e in root.findall("ParameterList")]
    return _rig(cameras, own, relative, path, options)


def is_dice_text(text: str) -> bool:
    """Whether a text holds one number a line, as many as DICe's calibration of two cameras."""
    values = _values(text)
    return values is not None and len(values) in (24, 30)


def load_dice_text(text: str, path: Path, options: ImportOptions) -> Rig:
    """Read cal.txt: both lenses, then the second camera from the first, then height and width."""
    values = _values(text) or []
    height, width = values[-2:]
    outer = values[16:-2]
    size = {"IMAGE_HEIGHT_WIDTH": f"{{ {height}, {width} }}"}
    lenses = [
        {name: repr(v) for name, v in zip(_TEXT, values[8 * n : 8 * n + 8], strict=True)} | size
        for n in (0, 1)
    ]
    angles = ("ALPHA", "BETA", "GAMMA") if len(outer) == 6 else ()
    numbers = outer if angles else outer[9:]
    second = {name: repr(v) for name, v in zip((*angles, "TX", "TY", "TZ"), numbers, strict=True)}
    turn = None if angles else np.array(outer[:9]).reshape(3, 3)
    model = "K1R1_K2R2_K3R3"
    cameras = [_camera(lenses[0], None, model), _camera(lenses[1] | second, turn, model)]
    return _rig(cameras, [], True, path, options)


def _parameters(element: ET.Element) -> Parameters:
    return {e.attrib["name"]: e.attrib.get("value", "") for e in element.findall("Parameter")}


def _braces(text: str) -> list[float]:
    return [float(v) for v in text.strip(" {}").split(",")]


def _values(text: str) -> list[float] | None:
    lines = [line.split("#")[0].split() for line in text.splitlines()]
    try:
        return [float(words[0]) for words in lines if words] if all(len(w) < 2 for w in lines) else None
    except ValueError:
        return None


def _camera(parameters: Parameters, turn: Array | None, model: str) -> tuple[Camera, bool]:
    """A camera of a file, and whether it has a pose."""

    def value(name: str) -> float:
        return float(parameters.get(name, 0.0))

    extra = [name for name in _OPENCV_ONLY if value(name)]
    if extra:
        raise RigError(f"its lens has {', '.join(extra)}: calibrate with the terms K1 to K3, P1, P2, T1, T2")
    fx, fy, skew = value("FX"), value("FY"), value("FS")
    k = [value("K1"), value("K2"), value("K3")]
    model = re.sub(r"_(LENS_DISTORTION|DIS)$", "", model)
    if model == "K1R1_K2R2_K3R3" and k[1] == 0.0:  # the first term is a scale, the third our k1
        scale = 1.0 + k[0]
        fx, fy, skew, k = scale * fx, scale * fy, scale * skew, [k[2] / scale, 0.0, 0.0]
    elif model not in ("NONE", "NO", "OPENCV", "VIC3D", "K1R3_K2R5_K3R7") and any(k):
        raise RigError(f"its lens model is {model}: calibrate with OPENCV_LENS_DISTORTION")
    placed = turn is not None or any(name in parameters for name in _POSE)
    if turn is None:
        turn = turned_about_axes(*np.radians([value("ALPHA"), value("BETA"), value("GAMMA")]).tolist())
    T = np.array([value("TX"), value("TY"), value("TZ")])
    size: Size = (0, 0)
    if "IMAGE_HEIGHT_WIDTH" in parameters:
        height, width = _braces(parameters["IMAGE_HEIGHT_WIDTH"])
        size = (int(width), int(height))
    camera = Camera(
        fx, fy, value("CX"), value("CY"), turn, T, size, k[0], k[1], value("P1"), value("P2"), k[2],
        value("T1"), value("T2"), skew,
    )  # fmt: skip
    return camera, placed


def _rig(
    cameras: list[tuple[Camera, bool]], own: list[str], relative: bool, path: Path, options: ImportOptions
) -> Rig:
    if not cameras:
        raise RigError("it holds no camera")
    names = options.named(len(cameras), own if own and all(own) and len(set(own)) == len(own) else None)
    length, unit = options.length("mm")
    R, T = FIRST_CAMERA
    out: dict[str, Camera] = {}
    for name, (camera, _) in zip(names, cameras, strict=True):
        turn, shift = (camera.R @ R, camera.R @ T + camera.T) if relative else (camera.R, camera.T)
        if relative and not out:
            R, T = camera.R, camera.T
        size = options.size(name, "this DICe file", camera.size if any(camera.size) else None)
        out[name] = replace(camera, rotation=turn, translation=length * shift, size=size)
    note = {"program": "DICe", "file": path.name, "unit": unit}
    if not cameras[0][1]:
        note["left_out"] = NO_WORLD_POSE
    return Rig(out, {"imported": note})


def load_vic(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Read VIC-3D's project."""
    elements = root.findall("calibration/camera")
    if not elements:
        raise RigError("it has no <camera>: the project was not calibrated")
    mask = root.find(".//polygonmask")
    length, unit = options.length("mm", stated_unit(root))
    cameras = {}
    for name, element in zip(options.named(len(elements)), elements, strict=True):
        values = [float(v) for v in (element.text or "").split()]
        if len(values) not in (5, 6, 7, 8):
            raise RigError(f"a <camera> holds {len(values)} numbers instead of cx cy fx fy skew k1 k2 k3")
        cx, cy, fx, fy, skew = values[:5]
        k1, k2, k3 = [*values[5:], 0.0, 0.0, 0.0][:3]
        pose = numbers_of(element, "orientation", 6)
        stored = None if mask is None else (int(mask.attrib["width"]), int(mask.attrib["height"]))
        size = options.size(name, "this VIC-3D file", stored)
        T = length * np.array(pose[3:])
        cameras[name] = Camera(
            fx, fy, cx, cy, turned_about_axes(*np.radians(pose[:3])), T, size, k1, k2, k3=k3, skew=skew
        )
    return Rig(cameras, {"imported": {"program": "VIC-3D", "file": path.name, "unit": unit}})
