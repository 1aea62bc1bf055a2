"""Agisoft Metashape's cameras, XML. Its p1 and p2 are our p2 and p1; pixel centres at halves.

Lengths are those of the chunk; without a transform of it they have no unit: state the metres of one.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.formats.common import (
    ImportOptions,
    Pose,
    StoredCamera,
    refuse_terms,
    rig_of_file,
    rotation_near,
)
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig

MAX_DISTANCE = 1e5  # m from the origin: beyond, the chunk's places are those of a globe


def load_agisoft(root: ET.Element, path: Path, options: ImportOptions) -> Rig:
    """Read what `Export Cameras` wrote."""
    lenses = {sensor.attrib["id"]: sensor for sensor in root.iter("sensor")}
    chunk, scale = _chunk(root)
    cameras, own = [], []
    for element in root.iter("camera"):
        transform = element.find("transform")
        if transform is None or not transform.text:
            continue  # not aligned
        place = chunk @ np.array([float(v) for v in transform.text.split()]).reshape(4, 4)
        R = rotation_near(place[:3, :3].T / scale)
        T = -options.length * R @ place[:3, 3]
        if not np.abs(T).max() < MAX_DISTANCE:
            raise RigError("its cameras are placed on the globe: export them in local coordinates")
        name = element.attrib.get("label", "")
        cameras.append(_stored(lenses[element.attrib["sensor_id"]], name, (R, T)))
        own.append(Path(name).stem)
    if not cameras:
        raise RigError("it holds no aligned camera")
    note = {"program": "Metashape", "file": path.name, "unit": options.unit}
    return rig_of_file(cameras, options, "this Metashape file", note, own)


def save_agisoft(rig: Rig, path: str | Path) -> None:
    """Write a rig as Metashape's cameras, metres."""
    root = ET.Element("document", version="1.5.0")
    chunk = ET.SubElement(root, "chunk", label="wavefield", enabled="true")
    sensors, cameras = ET.SubElement(chunk, "sensors"), ET.SubElement(chunk, "cameras")
    for number, (name, camera) in enumerate(rig.cameras.items()):
        refuse_terms(camera, "Metashape", "k1", "k2", "k3", "k4", "p1", "p2", "skew")
        kind = "fisheye" if camera.fisheye else "frame"
        width, height = camera.size
        sensor = ET.SubElement(sensors, "sensor", id=str(number), label=name, type=kind)
        lens = ET.SubElement(sensor, "calibration", {"type": kind, "class": "adjusted"})
        ET.SubElement(lens, "resolution", width=str(width), height=str(height))
        terms = {
            "f": camera.fy, "cx": camera.cx + 0.5 - 0.5 * width, "cy": camera.cy + 0.5 - 0.5 * height,
            "b1": camera.fx - camera.fy, "b2": camera.skew, "k1": camera.k1, "k2": camera.k2, "k3": camera.k3,
            "k4": camera.k4, "p1": camera.p2, "p2": camera.p1,
        }  # fmt: skip
        for term, value in terms.items():
            ET.SubElement(lens, term).text = repr(float(value))
        element = ET.SubElement(cameras, "camera", id=str(number), sensor_id=str(number), label=name)
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = camera.R.T, camera.centre
        ET.SubElement(element, "transform").text = " ".join(map(repr, place.ravel().tolist()))
    ET.indent(root, "  ")
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _chunk(root: ET.Element) -> tuple[Array, float]:
    """From the chunk to the world, (4, 4), and its scale."""
    out, scale = np.eye(4), 1.0
    element = root.find("chunk/transform")
    if element is not None:
        scale = float(element.findtext("scale") or 1.0)
        turn = element.findtext("rotation")
        shift = element.findtext("translation")
        if turn:
            out[:3, :3] = np.array([float(v) for v in turn.split()]).reshape(3, 3)
        out[:3, :3] *= scale
        if shift:
            out[:3, 3] = [float(v) for v in shift.split()]
    return out, scale


def _stored(sensor: ET.Element, name: str, pose: Pose) -> StoredCamera:
    found = sensor.findall("calibration")
    if not found:
        raise RigError(f"the sensor of {name!r} has no calibration")
    lens = next((one for one in found if one.attrib.get("class") == "adjusted"), found[-1])
    kind = lens.attrib.get("type", "frame")
    if kind not in ("frame", "fisheye") or lens.find("f") is None:
        raise RigError(f"the sensor of {name!r} is not of the type frame or fisheye, with a focal length f")

    def term(tag: str) -> float:
        return float(lens.findtext(tag) or 0.0)

    extra = [tag for tag in (("k4",) if kind == "frame" else ("p1", "p2")) + ("p3", "p4") if term(tag)]
    if extra:
        raise RigError(f"the sensor of {name!r} has {', '.join(extra)}: optimize without them")
    size = lens.find("resolution")
    if size is None:
        size = sensor.find("resolution")
    if size is None:
        raise RigError(f"the sensor of {name!r} has no resolution")
    width, height = float(size.attrib["width"]), float(size.attrib["height"])
    f = term("f")
    cx, cy = 0.5 * width + term("cx") - 0.5, 0.5 * height + term("cy") - 0.5
    K = np.array([[f + term("b1"), term("b2"), cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
    order = ("k1", "k2", "p2", "p1", "k3") if kind == "frame" else ("k1", "k2", "k3", "k4")
    return StoredCamera(K, [term(tag) for tag in order], pose, (width, height), kind == "fisheye")
