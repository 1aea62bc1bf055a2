"""MATLAB's .mat files: Bouguet's toolbox, and the structs of MATLAB's own Camera Calibrator."""

from pathlib import Path
from typing import Any

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import Stated, rotation_near
from wavefield.rig.lens import Array
from wavefield.rig.rig import Rig

_LEVEL = "no pose in the world: the frame is that of the first camera; level it on the water"


def load_matlab(path: Path, stated: Stated) -> Rig:
    """Read a calibration made in MATLAB."""
    import scipy.io  # half a second that no other rig needs

    try:
        data = scipy.io.loadmat(str(path), simplify_cells=True)
    except NotImplementedError:
        raise RigError("it is of version 7.3: save it in MATLAB with the option '-v7'") from None
    if "fc_left" in data:
        lenses = [_bouguet(data, "_left"), _bouguet(data, "_right")]
        R, T = np.asarray(data["R"], float), np.asarray(data["T"], float).ravel()
    elif "fc" in data:
        lenses, R, T = [_bouguet(data, "")], np.eye(3), np.zeros(3)
    else:
        lenses, R, T = _structs(data)
    names = stated.named(len(lenses))
    poses = [(np.eye(3), np.zeros(3)), (rotation_near(R), stated.length * T)]
    cameras = {
        name: Camera.from_opencv(K, D, *pose, stated.size(name, "this .mat file", size))
        for name, (K, D, size), pose in zip(names, lenses, poses, strict=False)
    }
    note = {"program": "MATLAB", "file": path.name, "unit": stated.unit, "left_out": _LEVEL}
    return Rig(cameras, {"imported": note})


Lens = tuple[Array, Array, tuple[float, float] | None]


def _bouguet(data: dict[str, Any], side: str) -> Lens:
    """Pixels count from zero here, as ours."""
    fx, fy = np.ravel(data[f"fc{side}"]).tolist()
    cx, cy = np.ravel(data[f"cc{side}"]).tolist()
    skew = float(np.ravel(data.get(f"alpha_c{side}", 0.0))[0]) * fx
    K = np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    size = (float(data["nx"]), float(data["ny"])) if "nx" in data and "ny" in data else None
    return K, np.ravel(np.asarray(data[f"kc{side}"], float)), size


def _structs(data: dict[str, Any]) -> tuple[list[Lens], Array, Array]:
    for value in data.values():
        if isinstance(value, dict) and "CameraParameters1" in value and "CameraParameters2" in value:
            lenses = [_own(value["CameraParameters1"]), _own(value["CameraParameters2"])]
            if "PoseCamera2" in value and isinstance(value["PoseCamera2"], dict):
                pose = value["PoseCamera2"]
                return lenses, np.asarray(pose["R"], float), np.ravel(np.asarray(pose["Translation"], float))
            # rows of points there: x2 = x1 R + t
            R = np.asarray(value["RotationOfCamera2"], float).T
            return lenses, R, np.ravel(np.asarray(value["TranslationOfCamera2"], float))
    for value in data.values():
        if isinstance(value, dict) and "RadialDistortion" in value:
            return [_own(value)], np.eye(3), np.zeros(3)
    raise RigError(
        "it holds no calibration: save Bouguet's results, or toStruct(params) of MATLAB's Camera Calibrator"
    )


def _own(value: dict[str, Any]) -> Lens:
    """MATLAB's own: the matrix transposed in older versions, and pixels count from one."""
    K = np.asarray(value["K"] if "K" in value else np.transpose(value["IntrinsicMatrix"]), float).copy()
    K[:2, 2] -= 1.0
    k = [*np.ravel(value["RadialDistortion"]).tolist(), 0.0, 0.0][:3]
    p = [*np.ravel(value.get("TangentialDistortion", (0.0, 0.0))).tolist(), 0.0, 0.0][:2]
    D = np.array([k[0], k[1], *p, k[2]])
    size = np.ravel(value["ImageSize"]).tolist() if np.size(value.get("ImageSize", ())) == 2 else None
    return K, D, None if size is None else (size[1], size[0])
