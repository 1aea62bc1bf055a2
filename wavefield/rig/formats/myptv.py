"""MyPTV's cameras of its Tsai model, one text file each. Its polynomial is fitted by a lens of our terms."""

from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import ImportOptions, refuse_terms
from wavefield.rig.formats.fitted_lens import fit_lens, image_lattice
from wavefield.rig.rig import Rig
from wavefield.rig.rotation import rotation_about

_HEAD = "Tsai model camera"
_OTHER = "extendedZolof"


def is_myptv(text: str) -> bool:
    """Whether a text is a camera of MyPTV."""
    return text.startswith((_HEAD, _OTHER))


def load_myptv(text: str, path: Path, options: ImportOptions) -> Rig:
    """Read a camera."""
    if text.startswith(_OTHER):
        raise RigError(f"it is of MyPTV's model {_OTHER}: calibrate with its Tsai model")
    lines = text.splitlines()
    (name,) = options.named(1, [lines[1].strip() or path.stem])
    numbers = [[float(v) for v in line.split()] for line in lines[2:11]]
    size = options.size(name, "MyPTV", (numbers[0][0], numbers[0][1]))
    centre = options.length * np.array(numbers[1])
    about_x, about_y, about_z = (rotation_about(a * e) for a, e in zip(numbers[2], np.eye(3), strict=True))
    R = about_x @ about_y @ about_z
    (f,), (xh, yh) = numbers[3], numbers[4]
    pixels = image_lattice(size)
    eta, zeta = pixels.T
    bent = np.array(numbers[5:8]) @ np.stack([eta, zeta, eta**2, zeta**2, eta * zeta])
    middle = 0.5 * np.array(size) + (xh, yh)
    note = {"program": "MyPTV", "file": path.name, "unit": options.unit}
    if bent.any():
        x, y = eta - middle[0] + bent[0], zeta - middle[1] + bent[1]
        lens, turn, misfit = fit_lens(pixels, np.stack([x, y], -1) / (f + bent[2])[:, None])
        note["lens"] = f"fitted to {misfit:.2g} px"
        R = turn @ R
    else:
        lens = {"fx": f, "fy": f, "cx": middle[0], "cy": middle[1]}
    camera = Camera(rotation=R, translation=-R @ centre, size=size, **lens)
    return Rig({name: camera}, {"imported": note})


def save_myptv(name: str, camera: Camera, path: str | Path) -> None:
    """Write a camera without distortion, metres."""
    refuse_terms(camera, "MyPTV")
    if abs(camera.fx - camera.fy) > 1e-9 * camera.fx:
        raise RigError(f"MyPTV has one focal length: {name!r} has {camera.fx:g} and {camera.fy:g} px")
    R = camera.R
    angles = np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(R[0, 2]), np.arctan2(-R[0, 1], R[0, 0])
    offset = camera.cx - 0.5 * camera.size[0], camera.cy - 0.5 * camera.size[1]
    rows = [camera.centre, angles, [camera.fx], offset, *np.zeros((3, 5))]
    lines = [_HEAD, name, f"{camera.size[0]} {camera.size[1]} "]
    lines += ["".join(f"{float(v)!r} " for v in row) for row in rows]
    Path(path).write_text("\n".join(lines) + "\n")
