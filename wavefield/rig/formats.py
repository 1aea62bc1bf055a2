"""Calibrations of other programs: UVMAT's XML, VIC-3D's XML, OpenCV's YAML or XML.

All lengths become metres, all pixel coordinates (column, row) with centres at integers.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from wavefield.errors import RigError
from wavefield.rig.camera import Array, Camera
from wavefield.rig.rig import Rig

Size = tuple[int, int]
LENGTHS = {
    "m": 1.0,
    "meter": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "um": 1e-6,
    "km": 1000.0,
    "inch": 0.0254,
}


def load_rig(  # noqa: C901
    path: str | Path | Mapping[str, str | Path],
    sizes: Mapping[str, Size] | None = None,
    names: Sequence[str] | None = None,
    unit: str = "m",
) -> Rig:
    """Read a rig in any known format, recognised from the file's content.

    Parameters
    ----------
    path : path, or mapping of camera name to path
        One file, or one file per camera (UVMAT writes one per camera).
    sizes : mapping of str to (width, height), optional
        Image size per camera, px; UVMAT's files and OpenCV's stereo files do not store it.
    names : sequence of str, optional
        Names for the cameras, in the file's order; cam1, cam2, ... if left out.
    unit : str, default "m"
        Unit of length in OpenCV's files, which do not state it: that of the target's mesh.

    Returns
    -------
    Rig

    Raises
    ------
    RigError
        If a file is missing, is of no known kind, or lacks what a camera in space needs.
    """
    if isinstance(path, Mapping):
        rigs = {name: load_rig(p, sizes, [name], unit) for name, p in path.items()}
        several = [name for name, rig in rigs.items() if len(rig) != 1]
        if several:
            raise RigError(
                f"{path[several[0]]} holds {len(rigs[several[0]])} cameras: give it as the rig alone"
            )
        return Rig(
            {name: rig[name] for name, rig in rigs.items()},
            {"imported": {name: rig.provenance.get("imported", {}) for name, rig in rigs.items()}},
        )
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        raise RigError(
            f"{path}: no such rig file; make one with `wavefield calibrate` or state another program's"
        ) from None
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror}") from None
    try:
        if text.lstrip().startswith("<"):
            root = ET.fromstring(path.read_bytes())
            if root.tag == "ImaDoc":
                return _load_uvmat(root, path, sizes, names)
            if root.tag == "opencv_storage":
                return _load_opencv(path, sizes, names, unit)
            if root.find("calibration") is not None:
                return _load_vic(root, path, sizes, names)
            raise RigError(f"its outermost element is <{root.tag}>: neither UVMAT's, VIC-3D's nor OpenCV's")
        if text.startswith("%YAML:1.0") or "opencv-matrix" in text:
            return _load_opencv(path, sizes, names, unit)
        data = yaml.safe_load(text)
        if not isinstance(data, dict) or not isinstance(data.get("cameras"), dict) or not data["cameras"]:
            raise RigError("it has no `cameras`")
        return Rig.from_dict(data)
    except RigError as error:
        raise RigError(f"{path} is not a usable rig file: {error}") from None
    except (
        ET.ParseError,
        yaml.YAMLError,
        cv2.error,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
    ) as error:
        raise RigError(f"{path} is not a rig file: {' '.join(str(error).split())}") from None


def _size(name: str, sizes: Mapping[str, Size] | None, why: str) -> Size:
    size = (sizes or {}).get(name)
    if size is None:
        raise RigError(
            f"{why} does not store the image size: state it for {name!r} (`sizes`, width and height)"
        )
    return int(size[0]), int(size[1])


def _names(count: int, names: Sequence[str] | None) -> list[str]:
    if names is None:
        return [f"cam{n + 1}" for n in range(count)]
    if len(names) != count:
        raise RigError(f"it holds {count} cameras, but {len(names)} names were given")
    return list(names)


def _rotation(matrix: Array) -> Array:
    """Nearest rotation: files round to a few digits."""
    U, _, V = np.linalg.svd(matrix)
    if not np.abs(U @ V - matrix).max() < 1e-3 or np.linalg.det(U @ V) < 0:
        raise RigError("its rotation matrix is none")
    return U @ V


# -- UVMAT -------------------------------------------------------------------------------------------


def _numbers(parent: ET.Element, tag: str, count: int | None = None) -> list[float]:
    element = parent.find(tag)
    if element is None or element.text is None:
        raise RigError(f"<{tag}> is missing")
    values = [float(v) for v in element.text.split()]
    if count is not None and len(values) != count:
        raise RigError(f"<{tag}> holds {len(values)} numbers instead of {count}")
    return values


# UVMAT counts Y upwards, so its camera frame is left-handed: turn its y axis
_FLIP = np.diag([1.0, -1.0, 1.0])


def _load_uvmat(
    root: ET.Element, path: Path, sizes: Mapping[str, Size] | None, names: Sequence[str] | None
) -> Rig:
    calibration = root.find("GeometryCalib")
    if calibration is None:
        raise RigError("it has no <GeometryCalib>: the images were not calibrated")
    rows = calibration.findall("R")
    if len(rows) != 3:
        raise RigError(
            "its calibration is not in three dimensions: redo it in UVMAT as 3D_linear or 3D_extrinsic"
        )
    (name,) = _names(1, names or [path.stem])
    size = _size(name, sizes, "UVMAT")
    unit = (calibration.findtext("CoordUnit") or "").strip()
    if unit not in LENGTHS:
        raise RigError(f"its <CoordUnit> {unit!r} is no unit of length")
    fx, fy = _numbers(calibration, "fx_fy", 2)
    Cx, Cy = _numbers(calibration, "Cx_Cy", 2)
    k1 = _numbers(calibration, "kc")[0] if calibration.find("kc") is not None else 0.0
    R = np.array([[float(v) for v in (row.text or "").split()] for row in rows])
    T = LENGTHS[unit] * np.array(_numbers(calibration, "Tx_Ty_Tz", 3))
    # pixel centres at half-integers there, the lowest row's at Y = 1/2
    camera = Camera(fx, fy, Cx - 0.5, size[1] - 0.5 - Cy, _rotation(_FLIP @ R), _FLIP @ T, size, k1=k1)
    note: dict[str, Any] = {"program": "UVMAT", "file": path.name, "unit": unit}
    if calibration.find("ErrorRms") is not None:
        note["rms_px"] = _numbers(calibration, "ErrorRms")
    index = calibration.findtext("RefractionIndex")
    if index is not None and float(index) != 1.0:
        note["left_out"] = f"refraction index {float(index)}: sight lines are straight here, as in air"
    return Rig({name: camera}, {"imported": note})


def save_uvmat(camera: Camera, path: str | Path, unit: str = "cm") -> None:
    """Write one camera as UVMAT's ImaDoc XML.

    Parameters
    ----------
    camera : Camera
        With the paper's terms only: fx, fy, cx, cy, k1.
    path : path
        File to write.
    unit : str, default "cm"
        Unit of length in the file.

    Raises
    ------
    RigError
        If the camera has terms that UVMAT does not know.
    """
    _only(camera, "UVMAT", "k1")
    scale = 1.0 / LENGTHS[unit]
    root = ET.Element("ImaDoc")
    calibration = ET.SubElement(root, "GeometryCalib")
    R, T = _FLIP @ camera.R, _FLIP @ camera.T * scale

    def put(tag: str, *values: Any, **attributes: str) -> None:
        ET.SubElement(calibration, tag, attributes).text = "\t".join(str(v) for v in values)

    put("CalibrationType", "3D_extrinsic")
    put("fx_fy", camera.fx, camera.fy)
    put("Cx_Cy", camera.cx + 0.5, camera.size[1] - 0.5 - camera.cy)
    put("kc", camera.k1)
    put("CoordUnit", unit)
    put("Tx_Ty_Tz", *(repr(float(v)) for v in T))
    for i, row in enumerate(R):
        put("R", *(repr(float(v)) for v in row), i=str(i + 1))
    # UVMAT's rotation vector, degrees; it belongs to the right-handed frame
    put("omc", *(repr(float(v)) for v in np.degrees(cv2.Rodrigues(camera.R)[0].ravel())))
    ET.indent(root, "   ")
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _only(camera: Camera, program: str, *known: str) -> None:
    extra = [
        term
        for term in ("k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew")
        if term not in known and getattr(camera, term) != 0.0
    ]
    if extra:
        raise RigError(
            f"{program} does not know {', '.join(extra)}: calibrate again with a model of "
            f"fx, fy, cx, cy{', ' if known else ''}{', '.join(known)}"
        )


# -- VIC-3D ------------------------------------------------------------------------------------------


def _euler(alpha: float, beta: float, gamma: float) -> Array:
    """R = Rz(gamma) Ry(beta) Rx(alpha), angles in degrees: the convention that fits VIC-3D's own matches."""
    angles = np.radians([alpha, beta, gamma])
    (ca, cb, cg), (sa, sb, sg) = np.cos(angles), np.sin(angles)
    Rx = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    Rz = np.array([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def _load_vic(
    root: ET.Element, path: Path, sizes: Mapping[str, Size] | None, names: Sequence[str] | None
) -> Rig:
    elements = root.findall("calibration/camera")
    if not elements:
        raise RigError("it has no <camera>: the project was not calibrated")
    mask = root.find(".//polygonmask")
    cameras = {}
    for name, element in zip(_names(len(elements), names), elements, strict=True):
        values = [float(v) for v in (element.text or "").split()]
        if len(values) not in (5, 6, 7, 8):
            raise RigError(f"a <camera> holds {len(values)} numbers instead of cx cy fx fy skew k1 k2 k3")
        cx, cy, fx, fy, skew = values[:5]
        radial = dict(zip(("k1", "k2", "k3"), values[5:]))
        pose = _numbers(element, "orientation", 6)
        if sizes is not None and name in sizes:
            size = _size(name, sizes, "VIC-3D")
        elif mask is not None:
            size = int(mask.attrib["width"]), int(mask.attrib["height"])
        else:
            size = _size(name, sizes, "this VIC-3D file")
        T = 1e-3 * np.array(pose[3:])
        cameras[name] = Camera(fx, fy, cx, cy, _euler(*pose[:3]), T, size, skew=skew, **radial)
    return Rig(cameras, {"imported": {"program": "VIC-3D", "file": path.name, "unit": "mm"}})


def save_vic(rig: Rig, path: str | Path) -> None:
    """Write a rig as VIC-3D's XML, in millimetres.

    Parameters
    ----------
    rig : Rig
        Cameras without tangential terms and sensor tilt; image size of the first.
    path : path
        File to write.

    Raises
    ------
    RigError
        If a camera has terms that VIC-3D does not know.
    """
    root = ET.Element("project", dir=".")
    calibration = ET.SubElement(root, "calibration", lri="calibration")
    for n, camera in enumerate(rig.cameras.values()):
        _only(camera, "VIC-3D", "k1", "k2", "k3", "skew")
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


# -- OpenCV ------------------------------------------------------------------------------------------


def _load_opencv(path: Path, sizes: Mapping[str, Size] | None, names: Sequence[str] | None, unit: str) -> Rig:  # noqa: C901
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:

        def matrix(*keys: str) -> Array | None:
            for key in keys:
                node = storage.getNode(key)
                if not node.empty() and node.isMap():
                    return np.asarray(node.mat(), float)
            return None

        def number(*keys: str) -> int | None:
            for key in keys:
                node = storage.getNode(key)
                if not node.empty() and (node.isInt() or node.isReal()):
                    return int(node.real())
            return None

        lenses = []
        for n in range(1, 10):
            M = matrix(f"M{n}", f"K{n}", f"cameraMatrix{n}", f"camera_matrix_{n}")
            if M is None:
                break
            D = matrix(f"D{n}", f"distCoeffs{n}", f"dist_coeffs_{n}")
            width, height = (
                number(f"image_width{n}", "image_width"),
                number(f"image_height{n}", "image_height"),
            )
            lenses.append((M, D, width, height, matrix(f"world_R{n}"), matrix(f"world_T{n}")))
        if not lenses:
            M = matrix("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M")
            if M is None:
                raise RigError("it holds no camera matrix (M1, M2, ... or camera_matrix)")
            D = matrix("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "D")
            width, height = number("image_width", "image_Width"), number("image_height", "image_Height")
            lenses.append((M, D, width, height, None, None))
        R, T = matrix("R"), matrix("T")
    finally:
        storage.release()
    cameras: dict[str, Camera] = {}
    left_out = []
    for n, (name, (M, D, width, height, Rw, Tw)) in enumerate(
        zip(_names(len(lenses), names), lenses, strict=True)
    ):
        if sizes is not None and name in sizes:
            size = _size(name, sizes, "OpenCV")
        elif width and height:
            size = width, height
        else:
            size = _size(name, sizes, "this OpenCV file")
        if Rw is not None and Tw is not None:
            pose = Rw, Tw.ravel()
        elif n == 0:
            pose = np.eye(3), np.zeros(3)
            left_out.append(
                "no pose in the world: the frame is that of the first camera; level it on the water"
            )
        elif n == 1 and R is not None and T is not None:
            pose = (np.asarray(cv2.Rodrigues(R)[0], float) if R.size == 3 else R), T.ravel()
        else:
            raise RigError(f"camera {name!r} has no pose: a stereo file holds R and T of the second camera")
        terms = _opencv_terms(np.zeros(0) if D is None else D.ravel())
        cameras[name] = Camera(
            M[0, 0],
            M[1, 1],
            M[0, 2],
            M[1, 2],
            _rotation(pose[0]),
            LENGTHS[unit] * pose[1],
            size,
            skew=M[0, 1],
            **terms,
        )
    note: dict[str, Any] = {"program": "OpenCV", "file": path.name, "unit": unit}
    if left_out:
        note["left_out"] = left_out[0]
    return Rig(cameras, {"imported": note})


def _opencv_terms(D: Array) -> dict[str, float]:
    if D.size not in (0, 4, 5, 8, 12, 14):
        raise RigError(f"it has {D.size} distortion coefficients; OpenCV's models have 4, 5, 8, 12 or 14")
    full = np.zeros(14)
    full[: D.size] = D
    if np.any(full[5:12] != 0.0):
        raise RigError(
            "its lens model has rational or thin-prism terms (k4-k6, s1-s4): "
            "calibrate again in OpenCV without CALIB_RATIONAL_MODEL and CALIB_THIN_PRISM_MODEL"
        )
    keys = ("k1", "k2", "p1", "p2", "k3", *[""] * 7, "tau_x", "tau_y")
    return {key: float(value) for key, value in zip(keys, full, strict=True) if key}


def save_opencv(rig: Rig, path: str | Path) -> None:
    """Write a rig as OpenCV's YAML: M1, D1, M2, D2, ..., and R, T of the second camera from the first.

    The poses in the physical frame are added as ``world_R1``, ``world_T1``, ..., metres.

    Parameters
    ----------
    rig : Rig
        Any cameras.
    path : path
        File to write; .yml, .yaml or .xml.
    """
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    try:
        for n, (name, camera) in enumerate(rig.cameras.items(), 1):
            storage.write(f"name{n}", name)
            storage.write(f"image_width{n}", camera.size[0])
            storage.write(f"image_height{n}", camera.size[1])
            M = np.array([[camera.fx, camera.skew, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
            storage.write(f"M{n}", M)
            storage.write(f"D{n}", opencv_distortion(camera)[None])
            storage.write(f"world_R{n}", camera.R)
            storage.write(f"world_T{n}", camera.T[:, None])
        if len(rig) > 1:
            a, b = list(rig.cameras.values())[:2]
            R = b.R @ a.R.T
            storage.write("R", R)
            storage.write("T", (b.T - R @ a.T)[:, None])
    finally:
        storage.release()


def opencv_distortion(camera: Camera) -> Array:
    """Distortion of a camera as OpenCV's 14 coefficients (5 if the sensor is not tilted).

    Parameters
    ----------
    camera : Camera
        Any camera.

    Returns
    -------
    ndarray, (5,) or (14,)
        k1 k2 p1 p2 k3 [k4 k5 k6 s1 s2 s3 s4 tau_x tau_y].
    """
    D = np.array(
        [camera.k1, camera.k2, camera.p1, camera.p2, camera.k3, *[0.0] * 7, camera.tau_x, camera.tau_y]
    )
    return D if D[5:].any() else D[:5]
