"""WASS, the stereo of sea waves: a folder of OpenCV matrices, the second camera placed from the first."""

from pathlib import Path

import cv2
import numpy as np

from wavefield.errors import RigError
from wavefield.rig.formats.common import (
    FIRST_CAMERA,
    ImportOptions,
    StoredCamera,
    as_pair,
    refuse_terms,
    rig_of_file,
    rotation_near,
)
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig


def load_wass(folder: Path, options: ImportOptions) -> Rig:
    """Read the configuration, or one working folder, of WASS."""
    lenses, distortions, R, T = (
        [_only_matrix(path) for path in sorted(folder.glob(pattern))]
        for pattern in ("intr*.xml", "dist*.xml", "ext_R.xml", "ext_T.xml")
    )
    if len(lenses) < 2 or len(distortions) != len(lenses):
        raise RigError("it holds no intrinsics_*.xml and distortion_*.xml of two cameras")
    note = {"program": "WASS", "file": folder.name}
    second = FIRST_CAMERA
    if R and T:
        second = rotation_near(R[0]), options.length * T[0].ravel()
    else:
        note["left_out"] = "no poses: place and level the cameras with `wavefield rig level --distance`"
    cameras = [
        StoredCamera(K, D, pose)
        for K, D, pose in zip(lenses, distortions, (FIRST_CAMERA, second), strict=False)
    ]
    return rig_of_file(cameras, options, "WASS", note)


def _only_matrix(path: Path) -> Array:
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


def save_wass(rig: Rig, folder: Path) -> None:
    """Write the configuration of WASS into a folder: lenses, and the second camera's pose from the first."""
    one, two, R, T = as_pair(rig, "WASS")
    for n, camera in enumerate((one, two)):
        refuse_terms(camera, "WASS", "k1", "k2", "p1", "p2", "k3")
        _save_matrix(folder / f"intrinsics_0{n}.xml", "intr", camera.K)
        _save_matrix(folder / f"distortion_0{n}.xml", "dist", camera.D[:, None])
    _save_matrix(folder / "ext_R.xml", "R", R)
    _save_matrix(folder / "ext_T.xml", "T", T[:, None])


def _save_matrix(path: Path, name: str, matrix: Array) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    try:
        storage.write(name, matrix)
    finally:
        storage.release()
