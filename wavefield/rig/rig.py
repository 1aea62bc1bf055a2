"""A rig (named cameras in one physical frame), its YAML file, and the pairs of cameras to compare."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from wavefield.atomic_write import Product, identity_of, write_text
from wavefield.errors import RigError
from wavefield.file_access import refuse_pipe
from wavefield.rig.camera import Camera
from wavefield.text import html_table, one_line

YAML_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml, if present, is ten times as fast
UNITS = {"length": "m", "image": "px", "angle": "rad"}


def read_rig_text(path: Path) -> str:
    """Return the text of a rig file; RigError if it cannot be read."""
    try:
        refuse_pipe(path, RigError)
        return path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        raise RigError(
            f"{path}: no such rig file; make one with `wavefield calibrate` or state another program's"
        ) from None
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror}") from None


@dataclass(frozen=True)
class Rig:
    """Named cameras in one physical frame, with the provenance of their calibration.

    Parameters
    ----------
    cameras : mapping of str to Camera
        The cameras, in the order of the experiment.
    provenance : mapping, optional
        Details of the calibration (images, date, model, residuals, uncertainties) as plain numbers, texts,
        lists and mappings.

    Examples
    --------
    >>> facing_down = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    >>> rig = Rig({"cam1": Camera(2700, 2700, 511.5, 511.5, facing_down, (0, 0, 4), (1024, 1024))})
    >>> rig["cam1"].centre[2]
    np.float64(4.0)
    """

    cameras: Mapping[str, Camera]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Camera:
        try:
            return self.cameras[name]
        except KeyError:
            raise RigError(f"the rig has no camera {name!r}; it has {', '.join(self.cameras)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def lenses_alone(self) -> bool:
        """Whether the rig describes only the lenses of several cameras, which are then all at the origin."""
        return len(self) > 1 and all(np.allclose(c.centre, 0.0, atol=1e-9) for c in self.cameras.values())

    def __repr__(self) -> str:
        return f"Rig({', '.join(self.cameras)})"

    def _repr_html_(self) -> str:
        calibrated = self.provenance.get("cameras", {})
        rows = []
        for name, camera in self.cameras.items():
            x, y, z = camera.centre
            rms = calibrated.get(name, {}).get("rms_px") if isinstance(calibrated, Mapping) else None
            width, height = camera.size
            rows.append(
                [
                    name,
                    f"{width} x {height} px",
                    f"{camera.fx:.0f} px",
                    f"{x:.3f}, {y:.3f}, {z:.3f} m",
                    "" if rms is None else f"{rms:.3f} px",
                ]
            )
        head = ["camera", "image", "focal length", "position x, y, z", "rms of calibration"]
        return html_table(f"Rig of {len(self)} cameras", head, rows)

    def moved(self, axes: ArrayLike, origin: ArrayLike, **provenance: object) -> "Rig":
        """Return the rig with the same cameras described in another physical frame.

        Parameters
        ----------
        axes : array_like, (3, 3)
            The new frame's axes as columns, in the present frame; a rotation.
        origin : array_like, (3,)
            The new frame's origin in the present frame, metres.
        **provenance
            Entries to add to the provenance.
        """
        Q, o = np.asarray(axes, float), np.asarray(origin, float)
        cameras = {
            name: replace(camera, rotation=camera.R @ Q, translation=camera.R @ o + camera.T)
            for name, camera in self.cameras.items()
        }
        return Rig(cameras, {**self.provenance, **provenance})

    def save(self, path: str | Path, source: str = "") -> None:
        """Write the rig as YAML: lengths in metres, image quantities in px, angles in radians.

        Parameters
        ----------
        path : path
            File to write; its folder is created. An existing rig is replaced only if it was saved with the
            same source and has not been edited; otherwise, or if writing fails, a StoreError is raised.
        source : str, optional
            Text that identifies the inputs of the rig (`wavefield.atomic_write.identity_of`).
        """
        data = {
            "units": UNITS,
            "cameras": {name: camera.to_dict() for name, camera in self.cameras.items()},
            "provenance": dict(self.provenance),
        }
        text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
        write_text(path, text, Product("rig", source or identity_of()))

    @classmethod
    def load(cls, path: str | Path) -> "Rig":
        """Read the YAML file of a rig that `save` wrote; RigError if it is missing or is not a rig.
        `wavefield.rig.formats.load_rig` also reads other programs' files."""
        path = Path(path)
        try:
            data = yaml.load(read_rig_text(path), Loader=YAML_LOADER)
            if isinstance(data, dict) and "frame_rate" in data:
                raise RigError("it is an experiment file; give the rig.yaml that `wavefield calibrate` wrote")
            if not isinstance(data, dict) or not isinstance(data.get("cameras"), dict) or not data["cameras"]:
                raise RigError("it has no `cameras`")
            return cls.from_dict(data)
        except RigError as error:
            raise RigError(f"{path} is not a usable rig file: {error}") from None
        except yaml.YAMLError:
            raise RigError(f"{path} is not a rig file: it is not YAML") from None
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise RigError(f"{path} is not a rig file: {one_line(error)}") from None

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Rig":
        """Build a rig from the content of a rig's YAML file; RigError if a camera is incomplete or invalid.
        Lengths must be in m, pixels in px and angles in rad."""
        units = data.get("units") or {}
        for what, unit in units.items():
            if unit != UNITS.get(what, unit):
                raise RigError(f"{what} is given in {unit}; a rig file has it in {UNITS[what]}")
        cameras = {}
        for name, values in data["cameras"].items():
            try:
                camera = Camera.from_dict(values)
            except (TypeError, ValueError) as error:
                words = str(error).removeprefix("Camera.__init__() ")
                raise RigError(f"camera {name!r}: {words}") from None
            if unreal := [key for key, value in camera.to_dict().items() if not np.isfinite(value).all()]:
                raise RigError(f"camera {name!r}: {unreal[0]} is not a finite number")
            wrong = np.abs(camera.R @ camera.R.T - np.eye(3)).max()
            if not wrong < 1e-6 or np.linalg.det(camera.R) < 0:
                raise RigError(f"camera {name!r}: `rotation` is not a right-handed rotation matrix")
            if not (camera.fx > 0 and camera.fy > 0 and min(camera.size) > 0):
                raise RigError(f"camera {name!r}: focal lengths and image size must be positive")
            cameras[str(name)] = camera
        return cls(cameras, data.get("provenance") or {})


def middle_camera(rig: Rig, names: Sequence[str]) -> str:
    """Return the camera among `names` whose distances to the other cameras have the smallest sum."""
    centres = np.array([rig[n].centre for n in names])
    reach = np.linalg.norm(centres[:, None] - centres, axis=-1).sum(axis=1)
    return names[int(np.argmin(np.round(reach / max(reach.max(), 1e-30), 9)))]


def pairs_of(rig: Rig, names: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return the pairs of cameras, among `names`, whose images are compared with each other.
    Each pair is the `middle_camera` and one of the other cameras."""
    reference = middle_camera(rig, names)
    return tuple((reference, n) for n in names if n != reference)
