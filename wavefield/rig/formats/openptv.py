"""OpenPTV: a working folder with parameters/ptv.par and, for each camera, an .ori and an .addpar file.

Lengths in millimetres; pixel centres at halves, y up. Sight lines are straight here: cameras that look
through a window into water are refused.
"""

from pathlib import Path

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.formats.common import ImportOptions, refuse_terms
from wavefield.rig.formats.fitted_lens import fit_lens
from wavefield.rig.lens import Array, distort
from wavefield.rig.rig import Rig
from wavefield.rig.rotation import rotation_about

MM = 1e-3
PARAMETERS = Path("parameters") / "ptv.par"
PIXEL_MM = 0.01  # written where a rig has no size of its pixels
_UP = np.diag([1.0, -1.0, -1.0])  # their axes: x right, y up, z towards the camera


def is_openptv(folder: Path) -> bool:
    """Whether a folder is a working folder."""
    return (folder / PARAMETERS).is_file()


def load_openptv(folder: Path, options: ImportOptions) -> Rig:
    """Read the cameras of a working folder."""
    words = (folder / PARAMETERS).read_text().split()
    count = int(words[0])
    width, height = (int(v) for v in words[2 * count + 4 : 2 * count + 6])
    pixel = np.array([float(v) for v in words[2 * count + 6 : 2 * count + 8]])
    indices = {float(v) for v in words[2 * count + 9 : 2 * count + 12]}
    if len(indices) > 1:
        raise RigError(f"{PARAMETERS} has refracting media, {sorted(indices)}: sight lines are straight here")
    images = [folder / words[2 * n + 2] for n in range(count)]
    own = [image.stem for image in images]
    cameras = {
        name: _camera(image, (width, height), pixel)
        for name, image in zip(options.named(count, own), images, strict=True)
    }
    return Rig(cameras, {"imported": {"program": "OpenPTV", "file": folder.name, "unit": "mm"}})


def save_openptv(rig: Rig, folder: str | Path) -> None:
    """Write a rig as a working folder's parameters and cal/<camera>.tif.ori, .addpar."""
    folder = Path(folder)
    sizes = {camera.size for camera in rig.cameras.values()}
    if len(sizes) > 1:
        raise RigError("OpenPTV has one image size for all cameras")
    (folder / "parameters").mkdir(exist_ok=True)
    (folder / "cal").mkdir(exist_ok=True)
    (width, height) = sizes.pop()
    lines = [str(len(rig))]
    for name, camera in rig.cameras.items():
        refuse_terms(camera, "OpenPTV", "k1", "k2", "k3", "p1", "p2")
        offset = np.array([camera.cx + 0.5 - 0.5 * width, 0.5 * height - camera.cy - 0.5]) * PIXEL_MM
        lens = (camera.k1, camera.k2, camera.k3, camera.p1, camera.p2)
        if abs(camera.fx - camera.fy) > 1e-9 * camera.fx or (any(lens) and np.abs(offset).max() > 1e-9):
            raise RigError(
                f"OpenPTV has one focal length, and distortion about the image's middle: {name!r} differs"
            )
        f = camera.fx * PIXEL_MM
        dm = camera.R.T @ _UP
        angles = np.arctan2(-dm[1, 2], dm[2, 2]), np.arcsin(dm[0, 2]), np.arctan2(-dm[0, 1], dm[0, 0])
        rows = [camera.centre / MM, angles, *dm, [*offset, f], [0.0, 0.0, 1.0]]
        base = folder / "cal" / f"{name}.tif"
        text = "\n".join(" ".join(repr(float(v)) for v in row) for row in rows)
        base.with_name(base.name + ".ori").write_text(text + "\n")
        terms = [lens[0] / f**2, lens[1] / f**4, lens[2] / f**6, lens[4] / f, -lens[3] / f, 1.0, 0.0]
        base.with_name(base.name + ".addpar").write_text(" ".join(repr(float(v)) for v in terms) + "\n")
        lines += [f"img/{name}.1", f"cal/{name}.tif"]
    lines += ["0", "0", "1", str(width), str(height), str(PIXEL_MM), str(PIXEL_MM), "0", "1", "1", "1", "0"]
    (folder / PARAMETERS).write_text("\n".join(lines) + "\n")


def _camera(image: Path, size: tuple[int, int], pixel: Array) -> Camera:
    values = [float(v) for v in image.with_name(image.name + ".ori").read_text().split()]
    if len(values) < 18:
        raise RigError(f"{image.name}.ori holds {len(values)} numbers instead of 21")
    centre = MM * np.array(values[:3])
    about_x, about_y, about_z = (rotation_about(a * e) for a, e in zip(values[3:6], np.eye(3), strict=True))
    R = _UP @ (about_x @ about_y @ about_z).T
    xh, yh, f = values[15:18]
    extra = image.with_name(image.name + ".addpar")
    terms = [float(v) for v in extra.read_text().split()] if extra.exists() else [0.0] * 5 + [1.0, 0.0]
    k1, k2, k3, p1, p2, scale, shear = terms
    middle = 0.5 * np.array(size)
    if not any(terms[:5]) and scale == 1.0 and shear == 0.0:
        cx, cy = middle + np.array([xh, -yh]) / pixel - 0.5
        return Camera(f / pixel[0], f / pixel[1], cx, cy, R, -R @ centre, size)
    # distortion is about the middle of the image there, about the optical axis here
    reach = 0.6 * np.hypot(*size) * pixel.max()
    flat = np.stack(np.meshgrid(np.linspace(-reach, reach, 61), np.linspace(-reach, reach, 61)), -1).reshape(
        -1, 2
    )
    x, y = distort(flat[:, 0], flat[:, 1], (k1, k2, k3), (p2, p1))
    x, y = scale * (x - np.sin(shear) * y), scale * np.cos(shear) * y
    pixels = np.stack([x / pixel[0], -y / pixel[1]], -1) + middle - 0.5
    edge = np.array(size) - 0.5
    inside = ((pixels > -0.5) & (pixels < edge)).all(-1)
    tangents = (flat[inside] - (xh, yh)) * (1.0, -1.0) / f
    lens, turn, _ = fit_lens(pixels[inside], tangents)
    R = turn @ R
    return Camera(rotation=R, translation=-R @ centre, size=size, **lens)
