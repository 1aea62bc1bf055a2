"""A rig: several named cameras that look at the same water."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from wavefield.errors import RigError
from wavefield.rig.camera import Camera


@dataclass(frozen=True)
class Rig:
    """Named cameras in one physical frame, with where they come from.

    Parameters
    ----------
    cameras : mapping of str to Camera
        The cameras, in the order of the experiment.
    provenance : mapping, optional
        Images, date, model, residuals, uncertainties: whatever the calibration has to say.
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

    def save(self, path: str | Path) -> None:
        """Write the rig as readable YAML.

        Parameters
        ----------
        path : path
            File to write.
        """
        data = {
            "units": {"length": "m", "image": "px", "angle": "rad"},
            "cameras": {name: camera.to_dict() for name, camera in self.cameras.items()},
            "provenance": dict(self.provenance),
        }
        Path(path).write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110))

    @classmethod
    def load(cls, path: str | Path) -> "Rig":
        """Read a rig written by `save`.

        Parameters
        ----------
        path : path
            File to read.

        Returns
        -------
        Rig

        Raises
        ------
        RigError
            If the file is missing or is not a rig.
        """
        try:
            data = yaml.safe_load(Path(path).read_text())
            cameras = {str(name): Camera.from_dict(c) for name, c in data["cameras"].items()}
        except FileNotFoundError:
            raise RigError(f"{path}: no such rig file; make one with `wavefield calibrate`") from None
        except (yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError) as error:
            raise RigError(f"{path} is not a rig file: {error}") from None
        return cls(cameras, data.get("provenance") or {})
