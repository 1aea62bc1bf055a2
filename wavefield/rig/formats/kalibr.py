"""Kalibr's camera chain, YAML: cam0, cam1, ... each placed from the one before, metres.

Its equidistant distortion is OpenCV's fisheye model.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from wavefield.errors import RigError
from wavefield.rig.formats.common import (
    FIRST_CAMERA,
    ImportOptions,
    StoredCamera,
    refuse_terms,
    rig_of_file,
    rotation_near,
)
from wavefield.rig.rig import Rig


def is_kalibr(data: object) -> bool:
    """Whether the content of a YAML file is a camera chain."""
    return (
        isinstance(data, Mapping) and isinstance(data.get("cam0"), Mapping) and "intrinsics" in data["cam0"]
    )


def load_kalibr(data: Mapping[str, Any], path: Path, options: ImportOptions) -> Rig:
    """Read a camera chain."""
    chain = sorted((key for key in data if key.startswith("cam")), key=lambda key: int(key[3:] or 0))
    R, T = FIRST_CAMERA
    cameras: list[StoredCamera] = []
    for key in chain:
        entry = data[key]
        if entry.get("camera_model", "pinhole") != "pinhole":
            raise RigError(f"{key} is of the model {entry['camera_model']}: calibrate it as pinhole")
        model = entry.get("distortion_model", "none")
        if model not in ("radtan", "equidistant", "none"):
            raise RigError(f"{key} has {model} distortion: calibrate it with pinhole-radtan or pinhole-equi")
        if cameras:
            if "T_cn_cnm1" not in entry:
                raise RigError(f"{key} has no pose (T_cn_cnm1)")
            step = np.array(entry["T_cn_cnm1"], float)
            R, T = step[:3, :3] @ R, step[:3, :3] @ T + step[:3, 3]
        fx, fy, cx, cy = (float(v) for v in entry["intrinsics"])
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        D = entry.get("distortion_coeffs") if model != "none" else None
        size = tuple(entry["resolution"]) if "resolution" in entry else None
        pose = (rotation_near(R), T) if cameras else FIRST_CAMERA
        cameras.append(StoredCamera(K, D, pose, size, model == "equidistant"))
    note = {"program": "Kalibr", "file": path.name, "unit": "m"}
    return rig_of_file(cameras, options, "this Kalibr file", note)


def save_kalibr(rig: Rig, path: str | Path) -> None:
    """Write a rig as a camera chain in the frame of its first camera."""
    chain: dict[str, dict[str, object]] = {}
    before = None
    for number, (name, camera) in enumerate(rig.cameras.items()):
        refuse_terms(
            camera, "Kalibr", *(("k1", "k2", "k3", "k4") if camera.fisheye else ("k1", "k2", "p1", "p2"))
        )
        entry: dict[str, object] = {
            "camera_model": "pinhole",
            "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
            "distortion_model": "equidistant" if camera.fisheye else "radtan",
            "distortion_coeffs": camera.D[:4].tolist(),
            "resolution": list(camera.size),
            "rostopic": f"/{name}/image_raw",
        }
        if before is not None:
            step = np.eye(4)
            step[:3, :3] = camera.R @ before.R.T
            step[:3, 3] = camera.T - step[:3, :3] @ before.T
            entry["T_cn_cnm1"] = step.tolist()
        chain[f"cam{number}"] = entry
        before = camera
    Path(path).write_text(yaml.safe_dump(chain, sort_keys=False, default_flow_style=None))
