"""Calibrations of other programs: UVMAT, VIC-3D, DICe, DaVis, OpenCV, and MATLAB (Bouguet's toolbox too).

Lengths become metres. Pixel coordinates become (column, row) with pixel centres at integers.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import yaml

from wavefield.errors import RigError
from wavefield.rig.formats.common import LENGTHS, ImportOptions, Size
from wavefield.rig.formats.correlation import load_dice, load_vic
from wavefield.rig.formats.davis import load_davis
from wavefield.rig.formats.matlab import load_matlab, save_matlab
from wavefield.rig.formats.opencv import load_opencv, save_opencv
from wavefield.rig.formats.uvmat import load_uvmat, save_uvmat
from wavefield.rig.rig import Rig, read_rig_text
from wavefield.text import one_line

__all__ = [
    "LENGTHS",
    "load_rig",
    "save_opencv",
    "save_rig",
    "save_uvmat",
]


# errors of the readers for damaged or unknown files
_BROKEN = (
    ET.ParseError,
    yaml.YAMLError,
    cv2.error,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    OSError,
)


def load_rig(
    path: str | Path | Mapping[str, str | Path],
    sizes: Mapping[str, Size] | None = None,
    names: Sequence[str] | None = None,
    unit: str | None = None,
) -> Rig:
    """Read a rig from a file of any supported program, which is recognised by the content of the file.

    Parameters
    ----------
    path : path, or mapping of camera name to path
        One file, a folder that contains ``rig.yaml``, or one file per camera (UVMAT).
    sizes : mapping of str to (width, height), optional
        Image size by camera, px; UVMAT's files and OpenCV's stereo files do not store it.
    names : sequence of str, optional
        Names of the cameras, in the file's order; by default those in the file, or cam1, cam2, ...
    unit : str, optional
        Unit of length (m, cm, mm, inch) or its size in metres. It is needed if the file does not state its
        unit (OpenCV, MATLAB: the unit of the target; default m), or if this is not the program's usual unit
        (VIC-3D, DICe, DaVis: mm).

    Returns
    -------
    Rig
        Lengths in metres; the provenance names the program, the file and its unit.

    Raises
    ------
    RigError
        If a file is missing or not supported, or if a camera is incomplete.

    Examples
    --------
    >>> import tempfile
    >>> from wavefield.tank import paper_rig
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paper_rig().save(Path(folder) / "rig.yaml")
    ...     rig = load_rig(Path(folder) / "rig.yaml")
    >>> list(rig)
    ['cam1', 'cam2', 'cam3']
    """
    if isinstance(path, Mapping):
        rigs = {name: load_rig(p, sizes, [name], unit) for name, p in path.items()}
        several = [name for name, rig in rigs.items() if len(rig) != 1]
        if several:
            count = len(rigs[several[0]])
            raise RigError(f"{path[several[0]]} holds {count} cameras: give it as the rig alone")
        return Rig(
            {name: rig[name] for name, rig in rigs.items()},
            {"imported": {name: rig.provenance.get("imported", {}) for name, rig in rigs.items()}},
        )
    path = Path(path)
    options = ImportOptions(sizes, names, unit)
    try:
        rig = _imported(path, options)
        if rig is None:  # a file of wavefield, or a folder
            return Rig.load(path / "rig.yaml" if path.is_dir() else path)
        return rig
    except RigError as error:
        sentence = str(error)
        if str(path) not in sentence:
            sentence = f"{path} is not a usable rig file: {sentence}"
        raise RigError(sentence) from None
    except _BROKEN as error:
        raise RigError(
            f"{path} is not a rig file of a program that `wavefield rig convert --help` lists: "
            f"{one_line(error)}"
        ) from None


def _imported(path: Path, options: ImportOptions) -> Rig | None:
    """Read a rig that another program wrote; return None for a folder or for wavefield's own file."""
    if path.is_dir():
        return None
    if path.suffix == ".mat" and path.exists():
        return load_matlab(path, options)
    text = read_rig_text(path)
    if text.lstrip().startswith("<"):
        return _load_xml(path, options)
    if text.startswith("%YAML:1.0") or "opencv-matrix" in text:
        return load_opencv(path, options)
    return None


def _load_xml(path: Path, options: ImportOptions) -> Rig:
    root = ET.fromstring(path.read_bytes())
    if root.tag == "ImaDoc":
        return load_uvmat(root, path, options)
    if root.tag == "opencv_storage":
        return load_opencv(path, options)
    if root.tag == "ParameterList":
        return load_dice(root, path, options)
    if root.find("calibration") is not None:
        return load_vic(root, path, options)
    if root.find(".//CoordinateMapper") is not None:
        return load_davis(root, path, options)
    raise RigError(f"its outermost element <{root.tag}> is not that of a supported program")


def save_rig(rig: Rig, path: str | Path, program: str) -> None:
    """Write a rig in the format of another program: ``opencv``, ``matlab`` or ``uvmat``.
    For ``uvmat``, `path` is an existing folder, which receives one file per camera. RigError if the program
    lacks one of the lens terms."""
    path = Path(path)
    if program == "uvmat":
        for name, camera in rig.cameras.items():
            save_uvmat(camera, path / f"{name}.xml")
        return
    (save_opencv if program == "opencv" else save_matlab)(rig, path)
