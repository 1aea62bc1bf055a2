"""WASS, the stereo of sea waves: a folder of OpenCV matrices, the second camera placed from the first."""

from pathlib import Path

import cv2
import numpy as np

from wavefield.errors import RigError
from wavefield.rig.formats.common import FIRST_CAMERA, ImportOptions, StoredCamera, rig_of_file, rotation_near
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
