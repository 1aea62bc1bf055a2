"""Kalibr's camera chain, YAML: cam0, cam1, ... each placed from the one before, metres."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import Stated, rotation_near
from wavefield.rig.rig import Rig


def is_kalibr(data: Any) -> bool:
    """Whether the content of a YAML file is a camera chain."""
    return (
        isinstance(data, Mapping) and isinstance(data.get("cam0"), Mapping) and "intrinsics" in data["cam0"]
    )


def load_kalibr(data: Mapping[str, Any], path: Path, stated: Stated) -> Rig:
    """Read a camera chain."""
    chain = sorted((key for key in data if key.startswith("cam")), key=lambda key: int(key[3:] or 0))
    R, T = np.eye(3), np.zeros(3)
    cameras = {}
    for n, (name, key) in enumerate(zip(stated.named(len(chain)), chain, strict=True)):
        entry = data[key]
        if entry.get("camera_model", "pinhole") != "pinhole":
            raise RigError(f"{key} is of the model {entry['camera_model']}: calibrate it as pinhole")
        model = entry.get("distortion_model", "none")
        if model not in ("radtan", "none"):
            raise RigError(f"{key} has {model} distortion: calibrate it with pinhole-radtan")
        if n:
            if "T_cn_cnm1" not in entry:
                raise RigError(f"{key} has no pose (T_cn_cnm1)")
            step = np.array(entry["T_cn_cnm1"], float)
            R, T = step[:3, :3] @ R, step[:3, :3] @ T + step[:3, 3]
        fx, fy, cx, cy = (float(v) for v in entry["intrinsics"])
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        D = entry.get("distortion_coeffs") if model == "radtan" else None
        stored = tuple(entry["resolution"]) if "resolution" in entry else None
        size = stated.size(name, "this Kalibr file", stored)
        cameras[name] = Camera.from_opencv(K, D, rotation_near(R), T, size)
    left = "no pose in the world: the frame is that of the first camera; level it on the water"
    return Rig(cameras, {"imported": {"program": "Kalibr", "file": path.name, "unit": "m", "left_out": left}})
