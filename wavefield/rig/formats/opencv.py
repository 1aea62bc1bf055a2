"""Read and write OpenCV's YAML or XML files, with node names of OpenCV's samples and common programs."""

import re
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from wavefield.errors import RigError
from wavefield.rig.formats.common import (
    FIRST_CAMERA,
    ImportOptions,
    Pose,
    StoredCamera,
    refuse_implausible,
    rig_of_file,
    rotation_near,
)
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig
from wavefield.text import one_line

# names of nodes in lower case, without other characters and without the number of the camera
MATRICES = ("m", "k", "cameramatrix", "intrinsics", "intrinsic", "intrinsicspinhole", "camera", "mtx", "kmat")
DISTORTIONS = {"d", "kc", "dist", "distcoeff", "distcoeffs", "distcoefs"}
DISTORTIONS |= {"distortion", "distortioncoefficients"}
ROTATIONS = ("r", "rotation", "rotationmatrix", "rmat")
TRANSLATIONS = ("t", "translation", "translationvector", "tvec")

Nodes = list[tuple[str, Array]]  # names and values of a file's nodes
Parts = dict[str, Array]  # nodes of one camera: K, D, size or width and height, worldr and worldt


def _nodes(path: Path) -> Nodes:
    """Return the names and values of the matrices and numbers in the upper two levels of a file.
    Names are in lower case, and have only letters and digits."""
    text = path.read_text(errors="replace")
    if not text.endswith(("\n", "]", ">")):  # OpenCV does not report that a YAML file was cut
        raise RigError("it ends within a line: it is truncated; copy it again")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except SystemError as error:  # OpenCV's bindings raise it for damaged files
        raise RigError(f"OpenCV cannot read it ({one_line(error.__cause__ or error)})") from None
    out: Nodes = []

    def collect(node: cv2.FileNode, prefix: str, depth: int) -> None:
        for key in list(node.keys()):
            child = node.getNode(key)
            name = re.sub(r"[^a-z0-9]", "", f"{prefix}{key}".lower())
            if child.isInt() or child.isReal():
                out.append((name, np.array(child.real())))
            elif child.isSeq() and child.size() and (child.at(0).isInt() or child.at(0).isReal()):
                out.append((name, np.array([child.at(k).real() for k in range(child.size())])))
            elif child.isMap():
                matrix = child.mat()
                if matrix is not None and matrix.size:
                    out.append((name, np.asarray(matrix, float)))
                elif depth:
                    collect(child, key, depth - 1)

    try:
        collect(storage.root(), "", 1)
    finally:
        storage.release()
    return out


def _parts_of_cameras(nodes: Nodes) -> dict[str, Parts]:
    """Return the nodes of a file, by camera and then by their key in `Parts`.
    The camera is a number or side (left, right, l, r) in a node's name, or "" if there is neither."""
    out: dict[str, Parts] = {}
    for name, value in nodes:
        head = re.match(r"(?:cam(?:era)?)?(\d+)", name)
        tail = re.search(r"(\d+|left|right|l|r)$", name)
        candidates = [("", name)]
        candidates += [(head[1], name[head.end() :])] if head else []
        candidates += [(tail[1], name[: tail.start()])] if tail else []
        for camera, stem in candidates:
            part = _part(stem, value)
            if part:
                out.setdefault(camera, {}).setdefault(part, value)
                break
    return out


def _part(stem: str, value: Array) -> str:
    """Return the key in `Parts` for a node of the file, or "" if the node does not describe a camera.
    `stem` is the name of the node without the camera's number, `value` its content."""
    if value.shape == (3, 3) and stem in MATRICES and value[2, 2] == 1.0:
        return "K"
    if stem in DISTORTIONS and value.size in (4, 5, 8, 12, 14):
        return "D"
    if stem in ("imagewidth", "width") and value.size == 1:
        return "width"
    if stem in ("imageheight", "height") and value.size == 1:
        return "height"
    if stem in ("imagesize", "size", "resolution") and value.size == 2:
        return "size"
    return stem if stem in ("worldr", "worldt") else ""


def load_opencv(path: Path, options: ImportOptions) -> Rig:
    """Read a calibration file of OpenCV with one or several cameras; returns the rig.
    If `path` is a file called intrinsics and a file called extrinsics is next to it, both files are read."""
    nodes = _nodes(path)
    if any(name.startswith("fisheyemodel") and value.any() for name, value in nodes):
        raise RigError("its lens is a fisheye, which has no camera model here: calibrate a perspective lens")
    other = path.with_name(path.name.replace("intrinsics", "extrinsics"))
    if other != path and other.is_file():  # OpenCV's stereo sample writes intrinsics.yml and extrinsics.yml
        nodes += _nodes(other)
    length, unit = options.length(None)
    note = {"program": "OpenCV", "file": path.name, "unit": unit or "m"}
    all_parts = _cameras(nodes)
    cameras = []
    for n, (name, parts) in enumerate(zip(options.named(len(all_parts)), all_parts, strict=True)):
        R, T = _pose(n, name, parts, dict(nodes))
        D = parts.get("D", np.zeros(0)).ravel()
        pose = FIRST_CAMERA if R is FIRST_CAMERA[0] else (R, length * T)
        cameras.append(StoredCamera(parts["K"], D, pose, _stored_size(parts)))
    if not all("worldt" in parts for parts in all_parts):  # files of `save_opencv` are in metres
        refuse_implausible(cameras, unit)
    return rig_of_file(cameras, options, "this OpenCV file", note)


def _cameras(nodes: Nodes) -> list[Parts]:
    """Return the nodes of each camera, in order; nodes that belong to all cameras are added to each.
    RigError if there is no camera matrix."""
    found = _parts_of_cameras(nodes)
    shared = found.get("", {})
    order = sorted((camera for camera in found if "K" in found[camera]), key=_order)
    if "" in order and len(order) > 1:  # with numbered cameras, a matrix without a number is not a camera's
        order.remove("")
    if not order:
        raise RigError(f"it holds no camera matrix: a node called {', '.join(MATRICES)}")
    return [{**shared, **found[camera]} for camera in order]


def _order(camera: str) -> tuple[int, str]:
    sides = {"left": 0, "l": 0, "right": 1, "r": 1}
    return (int(camera) if camera.isdigit() else sides.get(camera, -1), camera)


def _stored_size(parts: Parts) -> tuple[float, float] | None:
    if "width" in parts and "height" in parts:
        return float(parts["width"]), float(parts["height"])
    if "size" in parts:
        width, height = parts["size"].ravel().tolist()
        return width, height
    return None


def _pose(n: int, name: str, parts: Parts, by_name: Mapping[str, Array]) -> Pose:
    """Return the pose of the camera at index `n`, in the world or else in the first camera's frame.
    `parts` are the nodes of the camera, `by_name` all nodes of the file. RigError if there is no pose."""
    if "worldr" in parts and "worldt" in parts:
        return rotation_near(parts["worldr"]), parts["worldt"].ravel()
    if n == 0:
        return FIRST_CAMERA
    R, T = (
        next((by_name[key] for key in keys if key in by_name), None) for keys in (ROTATIONS, TRANSLATIONS)
    )
    if n == 1 and R is not None and T is not None:
        matrix = np.asarray(cv2.Rodrigues(R)[0], float) if R.size == 3 else R
        return rotation_near(matrix), T.ravel()
    raise RigError(
        f"camera {name!r} has no pose: a stereo file holds R and T of the second camera; "
        "if they are in extrinsics.yml, put it next to intrinsics.yml"
    )


def save_opencv(rig: Rig, path: str | Path) -> None:
    """Write a rig as a YAML file of OpenCV, with lengths in metres.
    It holds M1, D1, M2, D2, ..., and R, T from the first to the second camera. The nodes ``world_R1``,
    ``world_T1``, ... are the poses of all cameras in the physical frame."""
    # write in memory first, because OpenCV does not report an incomplete file
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    try:
        for n, (name, camera) in enumerate(rig.cameras.items(), 1):
            storage.write(f"name{n}", name)
            storage.write(f"image_width{n}", camera.size[0])
            storage.write(f"image_height{n}", camera.size[1])
            storage.write(f"M{n}", camera.K)
            storage.write(f"D{n}", camera.D[None])
            storage.write(f"world_R{n}", camera.R)
            storage.write(f"world_T{n}", camera.T[:, None])
        if len(rig) > 1:
            a, b = list(rig.cameras.values())[:2]
            R = b.R @ a.R.T
            storage.write("R", R)
            storage.write("T", (b.T - R @ a.T)[:, None])
    finally:
        text = storage.releaseAndGetString()
    Path(path).write_text(text, encoding="utf-8")
