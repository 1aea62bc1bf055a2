"""OpenCV's YAML or XML, whatever the program that wrote it called its nodes."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import Stated, rotation_near
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig

_LENS = ("m", "k", "cameramatrix", "intrinsics", "intrinsic", "intrinsicspinhole", "camera", "mtx", "kmat")
_DISTORTION = (
    "d",
    "distcoeffs",
    "distortioncoefficients",
    "distortion",
    "dist",
    "distcoefs",
    "kc",
    "distcoeff",
)
_ROTATION = ("r", "rotation", "rotationmatrix", "rmat", "om")
_TRANSLATION = ("t", "translation", "translationvector", "tvec")
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")


@dataclass(frozen=True)
class _Node:
    """A value of the file: its name in small letters and digits only, and what it holds."""

    name: str
    value: Array


def _nodes(storage: cv2.FileStorage) -> list[_Node]:
    """All matrices and numbers at the file's first two levels."""
    out: list[_Node] = []

    def take(node: Any, prefix: str, depth: int) -> None:
        for key in list(node.keys()):
            child = node.getNode(key)
            name = re.sub(r"[^a-z0-9]", "", f"{prefix}{key}".lower())
            if child.isInt() or child.isReal():
                out.append(_Node(name, np.array(child.real())))
            elif child.isSeq() and child.size() and (child.at(0).isInt() or child.at(0).isReal()):
                out.append(_Node(name, np.array([child.at(k).real() for k in range(child.size())])))
            elif child.isMap():
                matrix = child.mat()
                if matrix is not None and matrix.size:
                    out.append(_Node(name, np.asarray(matrix, float)))
                elif depth:
                    take(child, key, depth - 1)

    take(storage.root(), "", 1)
    return out


def _camera_nodes(nodes: list[_Node]) -> dict[str, dict[str, Array]]:
    """Per camera, told by the number (or left, right) in a node's name: K, D and the image size."""
    found: dict[str, dict[str, Array]] = {}
    for node in nodes:
        head = re.match(r"(?:cam(?:era)?)?(\d+)", node.name)
        tail = re.search(r"(\d+|left|right|l|r)$", node.name)
        candidates = [("", node.name)]
        candidates += [(head[1], node.name[head.end() :])] if head else []
        candidates += [(tail[1], node.name[: tail.start()])] if tail else []
        for which, stem in candidates:
            kind = _kind(stem, node.value)
            if kind:
                found.setdefault(which, {}).setdefault(kind, node.value)
                break
    return found


def _kind(stem: str, value: Array) -> str:
    if value.shape == (3, 3) and stem in _LENS and value[2, 2] == 1.0:
        return "K"
    if stem in _DISTORTION and value.size in (4, 5, 8, 12, 14):
        return "D"
    if stem in _WIDTH and value.size == 1:
        return "width"
    if stem in _HEIGHT and value.size == 1:
        return "height"
    if stem in ("imagesize", "size", "resolution") and value.size == 2:
        return "size"
    if stem in ("worldr", "worldt"):
        return stem
    return ""


def load_opencv(path: Path, stated: Stated) -> Rig:
    """Read OpenCV's storage: one camera, or several with the pose of the second from the first."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        nodes = _nodes(storage)
    finally:
        storage.release()
    lenses = _lenses(nodes)
    by_name = {node.name: node.value for node in nodes}
    cameras: dict[str, Camera] = {}
    note: dict[str, Any] = {"program": "OpenCV", "file": path.name, "unit": stated.unit}
    for n, (name, lens) in enumerate(zip(stated.named(len(lenses)), lenses, strict=True)):
        R, T = _pose(n, name, lens, by_name, note)
        D = lens.get("D", np.zeros(0)).ravel()
        size = stated.size(name, "this OpenCV file", _stored_size(lens, by_name))
        cameras[name] = Camera.from_opencv(lens["K"], D, R, stated.length * T, size)
    return Rig(cameras, {"imported": note})


def _lenses(nodes: list[_Node]) -> list[dict[str, Array]]:
    found = _camera_nodes(nodes)
    order = sorted((which for which in found if "K" in found[which]), key=_order)
    if "" in order and len(order) > 1:  # numbered cameras, and an own matrix such as P or K of something else
        order.remove("")
    if not order:
        odd = [node for node in nodes if node.value.shape == (3, 3) and node.value[2, 2] == 1.0]
        odd = [
            node for node in odd if abs(np.linalg.det(node.value)) > 100.0
        ]  # no rotation: focal lengths in px
        if not odd:
            raise RigError("it holds no camera matrix (3 x 3, with focal lengths in px)")
        rest = [node for node in nodes if node.value.size in (4, 5, 8, 12, 14) and node.value.ndim == 2]
        return [
            {"K": node.value, **({"D": rest[n].value} if n < len(rest) else {}), **found.get("", {})}
            for n, node in enumerate(odd)
        ]
    return [{**found.get("", {}), **found[which]} for which in order]


def _order(which: str) -> tuple[int, str]:
    return (int(which) if which.isdigit() else {"left": 0, "l": 0, "right": 1, "r": 1}.get(which, -1), which)


def _stored_size(lens: dict[str, Array], by_name: dict[str, Array]) -> tuple[float, float] | None:
    if "width" in lens and "height" in lens:
        return float(lens["width"]), float(lens["height"])
    if "size" in lens:
        return float(lens["size"].ravel()[0]), float(lens["size"].ravel()[1])
    return None


def _pose(
    n: int, name: str, lens: dict[str, Array], by_name: dict[str, Array], note: dict[str, Any]
) -> tuple[Array, Array]:
    if "worldr" in lens and "worldt" in lens:
        return rotation_near(lens["worldr"]), lens["worldt"].ravel()
    if n == 0:
        note["left_out"] = (
            "no pose in the world: the frame is that of the first camera; level it on the water"
        )
        return np.eye(3), np.zeros(3)
    R = next((by_name[key] for key in ("r", "rotation", "rotationmatrix", "rmat") if key in by_name), None)
    T = next(
        (by_name[key] for key in ("t", "translation", "translationvector", "tvec") if key in by_name), None
    )
    if n == 1 and R is not None and T is not None:
        full = np.asarray(cv2.Rodrigues(R)[0], float) if R.size == 3 else R
        return rotation_near(full), T.ravel()
    raise RigError(f"camera {name!r} has no pose: a stereo file holds R and T of the second camera")


def save_opencv(rig: Rig, path: str | Path) -> None:
    """Write a rig as OpenCV's YAML: M1, D1, M2, D2, ..., and R, T of the second camera from the first.

    The poses in the physical frame are added as ``world_R1``, ``world_T1``, ..., metres.
    """
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
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
        storage.release()
