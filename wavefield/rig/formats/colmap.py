"""COLMAP's text model, a folder with cameras.txt and images.txt: each image is a camera of the rig.

Pixel centres at halves. Lengths have no unit there: the unit is the number of metres of one.
"""

from pathlib import Path, PurePosixPath

import numpy as np
from scipy.spatial.transform import Rotation

from wavefield.errors import RigError
from wavefield.rig.formats.common import ImportOptions, StoredCamera, refuse_terms, rig_of_file
from wavefield.rig.rig import Rig

LENS_FILE, POSE_FILE = "cameras.txt", "images.txt"
FISHEYE = "OPENCV_FISHEYE"
# where each model has its parameters in fx fy cx cy k1 k2 p1 p2 k3; what follows must be zero
_ORDER = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2),
    "PINHOLE": (0, 1, 2, 3),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
    "RADIAL": (0, 0, 1, 2, 3, 4),
    "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7),
    "FULL_OPENCV": (0, 1, 2, 3, 4, 5, 6, 7, 8),
    FISHEYE: (0, 1, 2, 3, 4, 5, 6, 7),  # k1 to k4
}


def is_colmap(folder: Path) -> bool:
    """Whether a folder holds a model in text."""
    return (folder / LENS_FILE).is_file() and (folder / POSE_FILE).is_file()


def load_colmap(folder: Path, options: ImportOptions) -> Rig:
    """Read a model in text."""
    lenses = {words[0]: words[1:] for words in _lines(folder / LENS_FILE)}
    # the second line of each image holds its points, and may be empty
    poses = [words for words in _lines(folder / POSE_FILE) if len(words) == 10 and not _is_number(words[9])]
    if not poses:
        raise RigError(f"{POSE_FILE} holds no image with a pose")
    cameras, own = [], []
    for words in sorted(poses, key=lambda words: words[9]):
        qw, qx, qy, qz, *shift = (float(v) for v in words[1:8])
        model, width, height, *numbers = lenses[words[8]]
        if model not in _ORDER:
            raise RigError(f"camera {words[8]} is of the model {model}: use one of {', '.join(_ORDER)}")
        parameters = [float(v) for v in numbers]
        if any(parameters[max(_ORDER[model]) + 1 :]):
            raise RigError(f"camera {words[8]} has the terms k4 to k6: use the model OPENCV")
        terms = [parameters[k] for k in _ORDER[model]]
        fx, fy, cx, cy = terms[:4]
        K = np.array([[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]])
        D = terms[4:] if model == FISHEYE else [*terms[4:], *[0.0] * 5][:5]
        pose = Rotation.from_quat([qx, qy, qz, qw]).as_matrix(), options.length * np.array(shift)
        cameras.append(StoredCamera(K, D, pose, (float(width), float(height)), model == FISHEYE))
        name = PurePosixPath(words[9])
        own.append(name.parent.name or name.stem)
    if len(set(own)) < len(own):
        own = [PurePosixPath(words[9]).stem for words in sorted(poses, key=lambda words: words[9])]
    note = {"program": "COLMAP", "file": folder.name, "unit": options.unit}
    return rig_of_file(cameras, options, "this COLMAP model", note, own)


def save_colmap(rig: Rig, folder: str | Path) -> None:
    """Write a rig as a model in text, metres, with an image `<camera>.png` for each camera."""
    lenses = ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS"]
    poses = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then its points"]
    for number, (name, camera) in enumerate(rig.cameras.items(), 1):
        refuse_terms(camera, "COLMAP", "k1", "k2", "p1", "p2", "k3", "k4")
        terms = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]
        terms += camera.D.tolist() if camera.fisheye else [*camera.D[:5].tolist(), 0.0, 0.0, 0.0]
        model = FISHEYE if camera.fisheye else "FULL_OPENCV"
        lenses.append(f"{number} {model} {camera.size[0]} {camera.size[1]} {' '.join(map(repr, terms))}")
        qx, qy, qz, qw = Rotation.from_matrix(camera.R).as_quat().tolist()
        pose = " ".join(map(repr, [qw, qx, qy, qz, *camera.T.tolist()]))
        poses += [f"{number} {pose} {number} {name}.png", ""]
    for file, lines in ((LENS_FILE, lenses), (POSE_FILE, poses), ("points3D.txt", [])):
        (Path(folder) / file).write_text("\n".join([*lines, ""]))


def _lines(path: Path) -> list[list[str]]:
    lines = (line.split() for line in path.read_text().splitlines())
    return [words for words in lines if words and not words[0].startswith("#")]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
