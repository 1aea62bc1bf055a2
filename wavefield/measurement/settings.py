"""Settings of the measurement: the keys under `settings` of an experiment file, and their presets."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from wavefield import matching
from wavefield.config_files import CHECKED, file_and_line, make
from wavefield.errors import ExperimentError

# Presets, as differences from the defaults. The defaults are for floating beads.
_PRESETS: dict[str, dict[str, Any]] = {
    "floating": {"stereo": {}, "piv": {}},
    "sheet": {
        "stereo": {"window": 32.0, "min_correlation": 0.2},
        "piv": {"window": 24.0, "min_correlation": 0.2},
    },
    "texture": {
        "stereo": {"window": 36.0, "min_correlation": 0.3, "max_deviation": 5.0},
        "piv": {"window": 24.0, "min_correlation": 0.3},
        "eps_limit": 5.0,  # on the open sea, the epipolar error grows with the distance of the water
    },
}
_STEREO = matching.MatchSettings(
    iterations=(2, 1, 2),
    window=21.0,
    smoother_sigma=1.8,
    coarse_smoother_sigma=1.5,
    normalization=10.0,
    search_x=(-48.0, 48.0),
    search_y=(-8.0, 8.0),
    search_window=24.0,
    min_correlation=0.5,
    min_gradient_energy=0.1,
)
_PIV = matching.MatchSettings(
    iterations=(2, 1, 2),
    window=12.0,
    smoother_sigma=1.3,
    coarse_smoother_sigma=1.0,
    normalization=10.0,
    min_correlation=0.5,
)


@dataclass(frozen=True)
class Settings:
    """Settings of the measurement. Defaults that are None or empty are derived from the rig.

    Parameters
    ----------
    pairs : tuple of (str, str)
        Pairs of cameras that measure z; all contain one common camera, the reference. Default: the middle
        camera with each other one.
    velocity_cameras : tuple of str
        Two or more cameras that measure u, v, w. Default: all.
    z_range : (float, float) or None
        Lowest and highest elevation to search, m. Default: at least 2 % of the reference camera's distance,
        up and down.
    sheet_thickness : float or None
        Thickness of a light sheet on z = 0, m. Default: None, a water surface.
    bead_height : float
        Height of the visible part of a bead above the water, m; corrects u and v for its tilt, not z.
    pixel : float or None
        Side of a pixel of the rectified images, m. Default: that of the coarsest camera, reduced to as little
        as half if blocks of 5 px would exceed 0.8 grid steps.
    eps_limit : float
        Matches with an epipolar error above this many times its rms are rejected.
    row_delays : tuple of (str, float)
        Camera with a rolling shutter, and its delay per row in frame intervals; `run` fills it in.
    stereo : matching.MatchSettings
        Matching between cameras; its search range is set from z_range.
    piv : matching.MatchSettings
        Matching from frame to frame.
    """

    __pydantic_config__ = CHECKED

    pairs: tuple[tuple[str, str], ...] = ()
    velocity_cameras: tuple[str, ...] = ()
    z_range: tuple[float, float] | None = None
    sheet_thickness: float | None = None
    bead_height: float = 0.0
    pixel: float | None = None
    eps_limit: float = 3.0
    row_delays: tuple[tuple[str, float], ...] = ()
    stereo: matching.MatchSettings = _STEREO
    piv: matching.MatchSettings = _PIV

    def __post_init__(self) -> None:
        for name in ("pairs", "velocity_cameras"):
            if isinstance(getattr(self, name), str) or not isinstance(getattr(self, name), Sequence):
                raise ExperimentError(f"{name}: give a list of camera names, not {getattr(self, name)!r}")
        for pair in self.pairs:
            if isinstance(pair, str) or len(pair) != 2 or pair[0] == pair[1]:
                raise ExperimentError(f"surface: pairs: {pair!r} is not a pair of two cameras")
        object.__setattr__(self, "pairs", tuple((str(a), str(b)) for a, b in self.pairs))
        object.__setattr__(self, "row_delays", tuple((str(a), float(b)) for a, b in self.row_delays if b))
        object.__setattr__(self, "velocity_cameras", tuple(str(name) for name in self.velocity_cameras))
        if len(self.velocity_cameras) == 1 or len(set(self.velocity_cameras)) < len(self.velocity_cameras):
            raise ExperimentError(
                "velocity: cameras: name at least two different cameras, or leave it out for all"
            )
        if self.z_range is not None:
            low, high = (float(v) for v in self.z_range)
            if not low < high:
                raise ExperimentError(f"z_range: the lowest elevation comes first, not {self.z_range}")
            object.__setattr__(self, "z_range", (low, high))
        self._check_numbers()

    def _check_numbers(self) -> None:
        for name in ("pixel", "sheet_thickness"):
            length = getattr(self, name)
            if length is not None and not length > 0:
                raise ExperimentError(f"{name}: give a length above 0 m, not {length}")
        for name in ("eps_limit", "bead_height"):
            if not getattr(self, name) >= 0:
                raise ExperimentError(f"{name} must be 0 or more, not {getattr(self, name)}")
        if self.sheet_thickness is not None and self.bead_height:
            raise ExperimentError("bead_height: particles in a light sheet do not float; leave it out")

    def adjusted(self, preset: str) -> Settings:
        """Return these settings, changed by a preset for another kind of images.

        "floating" is for beads: no change. "sheet" is for particles that enter and leave a light sheet, so
        that frames are weakly correlated. "texture" is for a natural surface, such as the sea.

        >>> Settings().adjusted("texture").stereo.window
        36.0
        """
        changes = dict(_PRESETS[preset])
        stereo, piv = changes.pop("stereo"), changes.pop("piv")
        return replace(self, stereo=replace(self.stereo, **stereo), piv=replace(self.piv, **piv), **changes)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain data (numbers, strings, lists, dicts), to be stored with results."""
        out: dict[str, Any] = json.loads(json.dumps(asdict(self)))  # tuples become lists
        if not self.row_delays:  # older recipes have no such key
            del out["row_delays"]
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, object], path: Path | None = None) -> Settings:
        """Make settings from data in the form that `to_dict` returns; missing settings keep their defaults.

        Only settings that differ are needed in ``stereo`` and ``piv``. With ``preset``, the defaults are
        those of `adjusted`. If a setting is not valid, ExperimentError names the file `path` and the line.
        """
        values: dict[str, Any] = dict(data)
        preset = values.pop("preset", "floating")
        if not isinstance(preset, str) or preset not in _PRESETS:
            where = f"{file_and_line(path, ('settings', 'preset'))}: " if path else ""
            raise ExperimentError(
                f"{where}settings.preset: choose one of {', '.join(_PRESETS)}, not {preset!r}"
            )
        base = cls().adjusted(preset)
        values.setdefault("eps_limit", base.eps_limit)
        for name, default in (("stereo", base.stereo), ("piv", base.piv)):
            if isinstance(values.get(name, {}), Mapping):
                values[name] = asdict(default) | dict(values.get(name, {}))
        return make(cls, values, path=path, location=("settings",))
