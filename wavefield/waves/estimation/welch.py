"""Welch's method on one record: what every spectrum of it shares."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.variables import INSTANTANEOUS, frames_of_path
from wavefield.water import WATER, water_of
from wavefield.waves.estimation import rings, segments
from wavefield.waves.estimation.record import Record, find_record
from wavefield.waves.estimation.segments import degrees_of_freedom, effective_duration

Array = NDArray[np.float64]
Coordinates = dict[str, tuple[str, Array]]

LEAST_COUNT = 4  # segments
VELOCITY = "velocity"  # attribute of a cube, or of its fields, that states what its velocities are
MEANINGS = {"displacement": 2, "instantaneous": INSTANTANEOUS}  # over one step; and their frames
# of what filled nodes add to a spectrum if their error is white: holes that stay for some steps add more to
# the lower lines, up to twice as much
MIN_OVER_FILLED = 4.0
_NEAR = 3  # lines over which the spread over cells is averaged
LOWEST = 2  # cells: a Hann window mixes what is nearer to zero with the mean


def omega_coords(omega: Array) -> Coordinates:
    """Coordinates ``omega`` (rad/s) and ``frequency`` (Hz)."""
    return {"omega": ("omega", omega), "frequency": ("omega", omega / (2 * np.pi))}


def k_coords(k: Array) -> Coordinates:
    """Coordinates ``k`` (rad/m) and ``cycles`` (1/m)."""
    return {"k": ("k", k), "cycles": ("k", k / (2 * np.pi))}


@dataclass(frozen=True)
class Welch:
    """Segments of a record and the rings of its k plane."""

    record: Record  # Rectangle and runs
    segment: int  # Steps of a segment
    # Width of the rings, rad/m; by default 2 pi over the shorter side of the rectangle
    dk: float | None = None
    frames: int = 2  # `path_frames` of velocities and z_t (`transfer.path_factor`)
    z_frames: int = 4  # Frames that z comes from (`transfer.to_frame_time`)
    moving: bool = False  # Whether z is interpolated in time in a frame that moves with the mean flow
    # Mean current along x and y that nonlinear quantities are relative to, m/s
    current: tuple[float, float] = (0.0, 0.0)
    depth: float = np.inf  # of the water, m: with it, how fast waves cross the rectangle

    @classmethod
    def of(
        cls,
        fields: xr.DataArray | xr.Dataset,
        segment: int | None = None,
        record: Record | None = None,
        dk: float | None = None,
    ) -> "Welch":
        """Lay segments over fields, with rings of width dk, rad/m."""
        record = find_record(fields) if record is None else record
        length = segments.segment_length(record, segment)
        frames = frames_of(fields), frames_of_z(fields), moves_with_flow(fields)
        return cls(record, length, dk, *frames, depth=water_of(fields.attrs)[0])

    @cached_property
    def count(self) -> int:
        """Number of segments, overlapping by half, in all runs."""
        return segments.count_segments(self.record, self.segment)

    @property
    def half(self) -> int:
        """Steps of half a segment."""
        return self.segment // 2

    @cached_property
    def omega(self) -> Array:
        """Angular frequencies, (segment // 2 + 1,), rad/s."""
        return np.asarray(2 * np.pi * np.arange(self.half + 1) / (self.segment * self.record.dt), float)

    @cached_property
    def table(self) -> rings.Rings:
        """Rings of the k plane."""
        record = self.record
        return rings.rings(*record.shape, record.dy, record.dx, self.dk)

    @property
    def dof(self) -> float:
        """Degrees of freedom of a single cell."""
        return degrees_of_freedom(self.count)

    @property
    def duration(self) -> float:
        """Length of the record as its segments weigh it, s."""
        return effective_duration(self.count, self.segment * self.record.dt)

    @property
    def density(self) -> float:
        """Factor from summed |F|^2 to a two-sided density in rad/m, rad/m and rad/s."""
        record = self.record
        energy = segments.window_energy(self.segment, *record.shape)
        return record.dt * record.dy * record.dx / ((2 * np.pi) ** 3 * energy * self.count)

    @property
    def ring_density(self) -> float:
        """Factor from ring sums of |F|^2 to E(k, omega)."""
        ny, nx = self.record.shape
        cell = (2 * np.pi) ** 2 / (ny * self.record.dy * nx * self.record.dx)
        return self.density * cell / self.table.dk

    @property
    def plane(self) -> Coordinates:
        """Coordinates ``ky`` and ``kx`` (rad/m), ascending."""
        record = self.record
        lengths = zip(("ky", "kx"), record.shape, (record.dy, record.dx))
        return {name: (name, np.sort(rings.wavenumbers(n, step))) for name, n, step in lengths}

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where E(k, omega) can be trusted, (omega, k): off the lowest cells, below Nyquist in x and y."""
        nyquist = np.pi / max(self.record.dy, self.record.dx)
        table = self.table
        in_k = (table.k > LOWEST * table.dk) & (table.k + table.dk / 2 <= nyquist * (1 + 1e-9))
        return inner(self.omega.size)[:, None] & in_k

    def over_filled(self, energy: Any, added: float) -> Any:
        """Where E(k, omega), (omega, k), exceeds what filled nodes add; ``added`` to E(omega) at most."""
        plane = 2 * np.pi * self.table.k * self.table.coverage
        white = added * plane * self.record.dy * self.record.dx / (2 * np.pi) ** 2
        return energy > MIN_OVER_FILLED * white

    def freedom(self, sums: Array) -> Array:
        """Degrees of freedom (rings, n // 2 + 1) of E(k, omega) from how energy is spread in a ring's cells.
        (sum A_c E_c)^2 / sum A_c E_c^2 (rho^2 A)_c, with <|F_c|^4> / 2 for squares of Gaussian waves' power.
        """
        power, square = sums[0], sums[1]
        filled = power > 0
        spread = np.divide(self.count * square, power**2, out=np.zeros_like(power), where=filled)
        weight = ndimage.uniform_filter1d(filled.astype(float), _NEAR, axis=-1, mode="nearest")
        spread = ndimage.uniform_filter1d(spread, _NEAR, axis=-1, mode="nearest")
        # squares are averaged over segments first, so the number does not depend on K; what chance adds, 1 /
        # K, is taken off
        cells = np.divide(weight, spread, out=np.zeros_like(power), where=spread > 0) - 1 / self.count
        cells = np.where(filled, cells, self.table.cells[:, None])  # where there is no energy at all
        return np.asarray(self.dof * cells.clip(1))

    @property
    def ring_variables(self) -> Mapping[str, tuple[str, Array]]:
        """Variables along k that every E(k, omega) carries: coverage and cells."""
        return {"coverage": ("k", self.table.coverage), "cells": ("k", self.table.cells)}

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes that state how a spectrum was estimated."""
        record = self.record
        return {
            "estimator": "Welch, Hann windows in t, y and x, half overlap, mean and trend removed",
            "segment": self.segment,
            "segments": self.count,
            "degrees_of_freedom": self.dof,
            "steps_bridged": len(record.bridged),
            "nodes_filled": record.holes,
            "nodes": list(record.shape),
            "node_step": [record.dy, record.dx],
            "dt": record.dt,
            "frames": self.frames,
            "convention": "k points where the wave goes; density in rad/m and rad/s, one-sided in omega",
        }


def with_stated(given: Any) -> Any:
    """A field or a cube whose `path_frames` and water are coordinates, as results keep them, where fields
    state them as attributes (those of `wavefield.open_cube` do); anything else as it is.
    """
    if not isinstance(given, xr.DataArray | xr.Dataset):
        return given
    out = given.copy()
    fields = [out] if isinstance(out, xr.DataArray) else list(out.data_vars.values())
    stated: dict[str, Any] = {}
    for name in ("path_frames", *WATER):
        for field in fields:
            if name in field.attrs:
                stated[name] = field.attrs.pop(name)
    if isinstance(out, xr.Dataset) and "path_frames" in out:
        stated["path_frames"] = out["path_frames"].drop_vars(out["path_frames"].coords)
    return out.assign_coords({name: value for name, value in stated.items() if name not in out.coords})


def frames_of(fields: xr.DataArray | xr.Dataset) -> int:
    """`path_frames` of a cube: 4, 6 or 7 of velocities along paths, 1 of those of an instant, else 2."""
    fields = with_stated(fields)
    if "path_frames" in fields.coords:
        return int(fields["path_frames"])
    arrays = (
        [fields[n] for n in ("z_t", "w", "u", "v") if n in fields]
        if hasattr(fields, "data_vars")
        else [fields]
    )
    stated = {str(one.attrs[VELOCITY]) for one in (fields, *arrays) if VELOCITY in one.attrs}
    if stated:
        return frames_of_meaning(*sorted(stated))
    return max((int(array.attrs.get("frames", 2)) for array in arrays), default=2)


def frames_of_meaning(*stated: str) -> int:
    """Frames of velocities that are stated to be displacements over a step, or instantaneous."""
    if len(stated) > 1 or stated[0] not in MEANINGS:
        raise CubeError(
            f"the velocities are stated to be {' and '.join(stated)}: state one of {', '.join(MEANINGS)}"
        )
    return MEANINGS[stated[0]]


def with_velocity(cube: xr.Dataset, meaning: str | None) -> tuple[Any, str]:
    """A cube that states what its velocities are, and a note where neither it nor the argument does."""
    cube = with_stated(cube)
    arrays = [cube[name] for name in ("u", "v", "w") if name in cube]
    stated = "path_frames" in cube.coords or any(
        key in one.attrs for one in (cube, *arrays) for key in (VELOCITY, "frames", "recipe")
    )
    if meaning is None:
        note = (
            "The cube does not state what its velocities are: displacements over one step were assumed (give"
            " `velocity: instantaneous` for those of a model)."
        )
        return cube, "" if stated else note
    frames = frames_of_meaning(meaning)
    if stated and frames_of(cube) != frames:
        raise CubeError(
            f"velocity is {meaning!r}, but the cube states that its velocities come from"
            f" {frames_of_path(frames_of(cube))} frames: leave velocity out"
        )
    return cube.assign_coords(path_frames=np.uint8(frames)), ""


def along_paths(fields: xr.DataArray | xr.Dataset) -> bool:
    """Whether the velocities of a cube are those at mid-time; of a lazy one nothing is computed."""
    return "path_frames" in with_stated(fields).coords or frames_of(fields) != 2


def frames_of_z(fields: xr.DataArray | xr.Dataset) -> int:
    """Frames that the elevations of a cube come from: 6, or 4 where it does not state it."""
    if not hasattr(fields, "data_vars"):
        return int(fields.attrs.get("frames", 4)) if fields.name == "z" else 4
    return int(fields["z"].attrs.get("frames", 4)) if "z" in fields else 4


def moves_with_flow(fields: xr.DataArray | xr.Dataset) -> bool:
    """Whether the elevations of a cube are interpolated in time in a frame that moves with the mean flow."""
    return hasattr(fields, "data_vars") and "z" in fields and bool(fields["z"].attrs.get("moving", 0))


def inner(lines: int) -> NDArray[np.bool_]:
    """Lines of a spectrum off its mean and off the Nyquist frequency, (lines,)."""
    index = np.arange(lines)
    return (index >= LOWEST) & (index < lines - 1)
