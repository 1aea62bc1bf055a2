"""Calibrations of other programs: UVMAT's XML, VIC-3D's XML, OpenCV's YAML or XML.

All lengths become metres, all pixel coordinates (column, row) with centres at integers.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2

from wavefield.errors import RigError
from wavefield.rig.formats.common import LENGTHS, Size, Stated
from wavefield.rig.formats.opencv import load_opencv, save_opencv
from wavefield.rig.formats.uvmat import load_uvmat, save_uvmat
from wavefield.rig.formats.vic import load_vic, save_vic
from wavefield.rig.rig import Rig, read_rig_text

__all__ = ["LENGTHS", "load_rig", "save_opencv", "save_uvmat", "save_vic"]


def load_rig(
    path: str | Path | Mapping[str, str | Path],
    sizes: Mapping[str, Size] | None = None,
    names: Sequence[str] | None = None,
    unit: str = "m",
) -> Rig:
    """Read a rig in any known format, recognised from the file's content.

    Parameters
    ----------
    path : path, or mapping of camera name to path
        One file, or one file per camera (UVMAT writes one per camera).
    sizes : mapping of str to (width, height), optional
        Image size per camera, px; UVMAT's files and OpenCV's stereo files do not store it.
    names : sequence of str, optional
        Names for the cameras, in the file's order; cam1, cam2, ... if left out.
    unit : str, default "m"
        Unit of length in OpenCV's files, which do not state it: that of the target's mesh.

    Returns
    -------
    Rig

    Raises
    ------
    RigError
        If a file is missing, is of no known kind, or lacks what a camera in space needs.
    """
    if isinstance(path, Mapping):
        rigs = {name: load_rig(p, sizes, [name], unit) for name, p in path.items()}
        several = [name for name, rig in rigs.items() if len(rig) != 1]
        if several:
            raise RigError(
                f"{path[several[0]]} holds {len(rigs[several[0]])} cameras: give it as the rig alone"
            )
        return Rig(
            {name: rig[name] for name, rig in rigs.items()},
            {"imported": {name: rig.provenance.get("imported", {}) for name, rig in rigs.items()}},
        )
    path = Path(path)
    text = read_rig_text(path)
    stated = Stated(sizes, names, unit)
    try:
        if text.lstrip().startswith("<"):
            root = ET.fromstring(path.read_bytes())
            if root.tag == "ImaDoc":
                return load_uvmat(root, path, stated)
            if root.tag == "opencv_storage":
                return load_opencv(path, stated)
            if root.find("calibration") is not None:
                return load_vic(root, path, stated)
            raise RigError(f"its outermost element is <{root.tag}>: neither UVMAT's, VIC-3D's nor OpenCV's")
        if text.startswith("%YAML:1.0") or "opencv-matrix" in text:
            return load_opencv(path, stated)
    except RigError as error:
        raise RigError(f"{path} is not a usable rig file: {error}") from None
    except (
        ET.ParseError,
        cv2.error,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
    ) as error:
        raise RigError(f"{path} is not a rig file: {' '.join(str(error).split())}") from None
    return Rig.load(path)
