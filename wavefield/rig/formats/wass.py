"""WASS, the stereo of sea waves: a folder of OpenCV matrices, the second camera placed from the first."""

from pathlib import Path

import cv2
import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import Stated, rotation_near
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig


def load_wass(folder: Path, stated: Stated) -> Rig:
    """Read the configuration, or one working folder, of WASS."""
    lenses = [_only(path) for path in _files(folder, ("intr*.xml",))]
    distortions = [_only(path) for path in _files(folder, ("dist*.xml",))]
    if len(lenses) < 2 or len(distortions) != len(lenses):
        raise RigError("it holds no intrinsics_*.xml and distortion_*.xml of two cameras")
    R, T = (_files(folder, (f"ext_{what}.xml",)) for what in "RT")
    poses = [(np.eye(3), np.zeros(3))] * 2
    left = "no pose in the world: the frame is that of the first camera; level it on the water"
    if R and T:
        poses[1] = rotation_near(_only(R[0])), stated.length * _only(T[0]).ravel()
    else:
        left = "no poses at all: place and level the cameras with `wavefield rig level --distance`"
    cameras = {
        name: Camera.from_opencv(K, D, *pose, stated.size(name, "WASS"))
        for name, K, D, pose in zip(stated.named(2), lenses, distortions, poses, strict=False)
    }
    return Rig(cameras, {"imported": {"program": "WASS", "file": folder.name, "left_out": left}})


def _files(folder: Path, patterns: tuple[str, ...]) -> list[Path]:
    return sorted(path for pattern in patterns for path in folder.glob(pattern))


def _only(path: Path) -> Array:
    """The first matrix of a file, whatever its name."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        for key in list(storage.root().keys()):
            matrix = storage.getNode(key).mat()
            if matrix is not None:
                return np.asarray(matrix, float)
    finally:
        storage.release()
    raise RigError(f"{path.name} holds no matrix")
