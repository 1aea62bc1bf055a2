"""VIC-3D's XML, lengths in millimetres unless it states another unit."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import (
    ImportOptions,
    numbers_of,
    refuse_terms,
    stated_unit,
    turned_about_axes,
)
from wavefield.rig.rig import Rig


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


def save_vic(rig: Rig, path: str | Path) -> None:
    """Write a rig as VIC-3D's XML, in millimetres."""
    root = ET.Element("project", dir=".")
    calibration = ET.SubElement(root, "calibration", lri="calibration")
    for n, camera in enumerate(rig.cameras.values()):
        refuse_terms(camera, "VIC-3D", "k1", "k2", "k3", "skew")
        R = camera.R
        beta = -np.arcsin(np.clip(R[2, 0], -1.0, 1.0))
        if abs(R[2, 0]) < 1.0 - 1e-14:
            alpha, gamma = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
        else:  # only the sum or difference of the two is defined
            alpha, gamma = np.arctan2(-R[1, 2], R[1, 1]), 0.0
        element = ET.SubElement(calibration, "camera", id=str(n))
        terms = (camera.cx, camera.cy, camera.fx, camera.fy, camera.skew, camera.k1, camera.k2, camera.k3)
        element.text = " ".join(repr(float(v)) for v in terms)
        pose = [*np.degrees([alpha, beta, gamma]), *(1e3 * camera.T)]
        ET.SubElement(element, "orientation").text = " ".join(repr(float(v)) for v in pose)
    width, height = next(iter(rig.cameras.values())).size
    aoi = ET.SubElement(ET.SubElement(root, "projectaois", lri="projectaois"), "aoinode", lri="aoinode")
    ET.SubElement(aoi, "polygonmask", width=str(width), height=str(height), lri="polygonmask")
    ET.indent(root, " ")
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
