"""Read and write .mat files: results of Bouguet's toolbox, and structs of MATLAB's Camera Calibrator."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from wavefield.errors import RigError
from wavefield.rig.formats.common import (
    ImportOptions,
    Pose,
    StoredCamera,
    as_pair,
    camera_matrix,
    refuse_implausible,
    refuse_terms,
    rig_of_file,
    rotation_near,
)
from wavefield.rig.rig import Rig


def load_matlab(path: Path, options: ImportOptions) -> Rig:
    """Read a .mat file of Bouguet's toolbox or of MATLAB's Camera Calibrator; returns the rig."""
    import scipy.io  # here, because the import takes half a second

    try:
        data = scipy.io.loadmat(str(path), simplify_cells=True)
    except NotImplementedError:
        raise RigError("it is of version 7.3: save it in MATLAB with the option '-v7'") from None

    length, unit = options.length(None, _world_units(data))

    def second(R: ArrayLike, T: ArrayLike) -> Pose:
        """Return the pose of the second camera in the first camera's frame, translation in metres."""
        return rotation_near(np.asarray(R, float)), length * np.ravel(np.asarray(T, float))

    if "fc_left" in data:
        right = _bouguet(data, "_right")
        cameras = [_bouguet(data, "_left"), replace(right, pose=second(data["R"], data["T"]))]
    elif "fc" in data:
        cameras = [_bouguet(data, "")]
    else:
        structs = [value for value in data.values() if isinstance(value, dict)]
        pairs = [value for value in structs if {"CameraParameters1", "CameraParameters2"} <= set(value)]
        single = [value for value in structs if "RadialDistortion" in value]
        if pairs:
            pair = pairs[0]
            if isinstance(pair.get("PoseCamera2"), dict):
                pose = second(pair["PoseCamera2"]["R"], pair["PoseCamera2"]["Translation"])
            else:  # older versions multiply rows: x2 = x1 R + t
                pose = second(np.asarray(pair["RotationOfCamera2"], float).T, pair["TranslationOfCamera2"])
            one, two = _struct(pair["CameraParameters1"]), _struct(pair["CameraParameters2"])
            cameras = [one, replace(two, pose=pose)]
        elif single:
            cameras = [_struct(single[0])]
        else:
            raise RigError(
                "it holds no calibration: save Bouguet's results, or toStruct(params) of MATLAB's Camera "
                "Calibrator"
            )
    refuse_implausible(cameras, unit)
    note = {"program": "MATLAB", "file": path.name, "unit": unit or "m"}
    return rig_of_file(cameras, options, "this .mat file", note)


def _world_units(data: object) -> str:
    """Return the unit of length that any of the nested structs of a calibration states; "" if none does."""
    if not isinstance(data, Mapping):
        return ""
    own = data.get("WorldUnits")
    return own if isinstance(own, str) else next(filter(None, map(_world_units, data.values())), "")


def _bouguet(data: Mapping[str, Any], side: str) -> StoredCamera:
    """Read a camera of Bouguet's toolbox; its variables end in `side`: _left, _right or nothing."""
    fx, fy = np.ravel(data[f"fc{side}"]).tolist()
    cx, cy = np.ravel(data[f"cc{side}"]).tolist()
    skew = float(np.ravel(data.get(f"alpha_c{side}", 0.0))[0]) * fx
    K = camera_matrix(fx, fy, cx, cy, skew)
    size = (float(data["nx"]), float(data["ny"])) if "nx" in data and "ny" in data else None
    return StoredCamera(K, np.ravel(np.asarray(data[f"kc{side}"], float)), size=size)


def _struct(value: Mapping[str, Any]) -> StoredCamera:
    """Read a camera of MATLAB's Camera Calibrator, which counts pixels from one.
    Older versions of MATLAB store the transposed camera matrix."""
    K = np.asarray(value["K"] if "K" in value else np.transpose(value["IntrinsicMatrix"]), float).copy()
    K[:2, 2] -= 1.0
    k = [*np.ravel(value["RadialDistortion"]).tolist(), 0.0, 0.0][:3]
    p = [*np.ravel(value.get("TangentialDistortion", (0.0, 0.0))).tolist(), 0.0, 0.0][:2]
    size = np.ravel(value["ImageSize"]).tolist() if np.size(value.get("ImageSize", ())) == 2 else None
    return StoredCamera(K, [k[0], k[1], *p, k[2]], size=None if size is None else (size[1], size[0]))


def save_matlab(rig: Rig, path: Path) -> None:
    """Write a rig of two cameras as stereo results of Bouguet's toolbox, with lengths in metres.
    RigError if there are not two cameras, or if their images differ in size."""
    import scipy.io  # here, because the import takes half a second

    one, two, R, T = as_pair(rig, "MATLAB")
    if one.size != two.size:
        raise RigError(
            "MATLAB's stereo results have one image size, and these cameras two: write OpenCV's file"
        )
    values: dict[str, ArrayLike] = {
        "R": R,
        "T": T[:, None],
        "om": Rotation.from_matrix(R).as_rotvec()[:, None],
    }
    for side, camera in (("left", one), ("right", two)):
        refuse_terms(camera, "MATLAB", "k1", "k2", "p1", "p2", "k3", "skew")
        values |= {
            f"fc_{side}": [[camera.fx], [camera.fy]],
            f"cc_{side}": [[camera.cx], [camera.cy]],
            f"alpha_c_{side}": camera.skew / camera.fx,
            f"kc_{side}": camera.D[:, None],
            f"KK_{side}": camera.K,
        }
    scipy.io.savemat(str(path), values | {"nx": float(one.size[0]), "ny": float(one.size[1])})
