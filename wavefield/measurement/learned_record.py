"""What sample frames show of a record, once per run: stored in the recipe, so that all steps are alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from wavefield.matching import Prior
from wavefield.measurement.temporal_truncation import NOTHING, TemporalTruncation


@dataclass(frozen=True)
class LearnedRecord:
    """Beads, spectra and noise of a record, from sample frames (`learn`).

    Parameters
    ----------
    beads : tuple of (str, float)
        Width of the beads' images per camera, raw px; 0 where a camera sees a texture.
    elevation : Prior
        Of z on the rectified lattice, metres.
    displacement : tuple of (str, Prior)
        Of each velocity camera's displacement from frame to frame, px of the binned image.
    moved : (float, float, float)
        Standard deviation of dx, dy, dz of the water from frame to frame, metres.
    temporal_truncation : TemporalTruncation
        Error of the finite time step.
    noise : tuple of (str, float)
        Noise of each camera's displacement relative to that of all; 1 where not named.
    camera_jitter : (float, float)
        Rms motion of the cameras' pictures from frame to frame, along the row of cameras and across it, px of
        the binned image.
    path_frames : int
        Of the paths of velocities and of the rate of rise, the kind with the smallest error: 4, 6 or 7
        (`PATH_WEIGHTS`).
    unresolved : (float, float)
        Standard deviation of the rise from frame to frame by waves that blocks do not resolve, and their
        wavelength, metres (`stated_rise`); 0 where cameras side by side share changes of light as well.
    motion : tuple of (str, float)
        Largest variance over the field of each camera's matched displacement in the sample steps, px^2.
    shown : tuple of (str, (float, float))
        Information at the nodes on each camera's displacement along columns and along rows, over that of its
        prior; 1 where not named.
    """

    beads: tuple[tuple[str, float], ...]
    elevation: Prior
    displacement: tuple[tuple[str, Prior], ...]
    moved: tuple[float, float, float]
    temporal_truncation: TemporalTruncation = NOTHING
    noise: tuple[tuple[str, float], ...] = ()
    camera_jitter: tuple[float, float] = (0.0, 0.0)
    path_frames: int = 4
    unresolved: tuple[float, float] = (0.0, 0.0)
    motion: tuple[tuple[str, float], ...] = ()
    shown: tuple[tuple[str, tuple[float, float]], ...] = ()

    def width(self, camera: str) -> float:
        """Width of a camera's beads, raw px."""
        return dict(self.beads)[camera]

    def own_noise(self, camera: str) -> float:
        """Noise of a camera's displacement relative to that of all."""
        return dict(self.noise).get(camera, 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a recipe.

        Returns
        -------
        dict
        """
        return {
            "beads": dict(self.beads),
            "elevation": self.elevation.to_dict(),
            "displacement": {name: prior.to_dict() for name, prior in self.displacement},
            "moved": list(self.moved),
            "temporal_truncation": self.temporal_truncation.to_dict(),
            "noise": dict(self.noise),
            "camera_jitter": list(self.camera_jitter),
            "path_frames": self.path_frames,
            "unresolved": list(self.unresolved),
            "motion": dict(self.motion),
            "shown": {name: list(each) for name, each in self.shown},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> LearnedRecord:
        """Inverse of `to_dict`.

        Parameters
        ----------
        data : mapping
            As given by `to_dict`.

        Returns
        -------
        LearnedRecord
        """
        x, y, z = map(float, data["moved"])
        along, across = map(float, data["camera_jitter"])
        rise, wavelength = map(float, data.get("unresolved", (0.0, 0.0)))
        return cls(
            tuple((str(name), float(width)) for name, width in data["beads"].items()),
            Prior.from_dict(data["elevation"]),
            tuple((str(name), Prior.from_dict(p)) for name, p in data["displacement"].items()),
            (x, y, z),
            TemporalTruncation.from_dict(data["temporal_truncation"]),
            tuple((str(name), float(factor)) for name, factor in data["noise"].items()),
            (along, across),
            int(data["path_frames"]),
            (rise, wavelength),
            tuple((str(name), float(variance)) for name, variance in data.get("motion", {}).items()),
            tuple((str(name), (float(x), float(y))) for name, (x, y) in data.get("shown", {}).items()),
        )
