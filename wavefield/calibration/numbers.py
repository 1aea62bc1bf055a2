"""Residuals of a calibration in px and mm: the numbers of its report."""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.observations import Observations
from wavefield.rig import Rig
from wavefield.rig.epipolar import epipolar_distance
from wavefield.rig.lens import Array
from wavefield.rig.stereo import triangulate
from wavefield.rig.water_level import WaterPlane, fit_plane
from wavefield.robust import robust_std


@dataclass(frozen=True)
class FlatSurface:
    """The flat target as the rig measures it."""

    x: Array  # (n,): Nodes in view of two cameras at least, triangulated from their pixels, metres
    y: Array
    z: Array
    plane: WaterPlane  # Through them

    @property
    def rms(self) -> float:
        """Of z about zero, metres."""
        return _rms(self.z[self.plane.kept])

    @property
    def tilt(self) -> float:
        """Of the plane, milliradians."""
        return float(1e3 * np.hypot(*self.plane.slope))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def flat_surface(observations: Observations, fit: Fit, rig: Rig, pose: str) -> FlatSurface | None:
    """Triangulate the nodes of the flat target."""
    o = observations
    N, C = len(o.nodes), len(o.cameras)
    apparent, sight = np.full((C, 2, N), np.nan), np.full((C, 2, N), np.nan)
    for c, name in enumerate(o.cameras):
        rows = (o.camera == c) & (o.pose == o.poses.index(pose))
        apparent[c][:, o.node[rows]] = np.stack(rig[name].unproject(*o.pixel[rows].T))
        sight[c] = np.stack(rig[name].sight_line(*apparent[c]))
    x, y, z, _ = triangulate(apparent, sight)
    z = z - fit.geometry.offset[:, 2] - o.plan[:, 2]
    measured = np.isfinite(z)
    if measured.sum() < 10:
        return None
    x, y, z = x[measured], y[measured], z[measured]
    return FlatSurface(x, y, z, fit_plane(x, y, z))


def epipolar_residuals(observations: Observations, rig: Rig) -> dict[tuple[str, str], Array]:
    """Distances of nodes from the epipolar lines of each pair of cameras, px in the second image."""
    o = observations
    key = o.pose * len(o.nodes) + o.node
    out = {}
    for a, b in combinations(range(len(o.cameras)), 2):
        rows_a, rows_b = np.flatnonzero(o.camera == a), np.flatnonzero(o.camera == b)
        _, ia, ib = np.intersect1d(key[rows_a], key[rows_b], return_indices=True)
        if len(ia):
            one, other = o.cameras[a], o.cameras[b]
            pa, pb = o.pixel[rows_a[ia]], o.pixel[rows_b[ib]]
            out[one, other] = epipolar_distance(rig[one], rig[other], *pa.T, *pb.T)
    return out


def _pixel_on_target(fit: Fit, observations: Observations, camera: int) -> float:
    """Size of a camera's pixel on the target, metres (median)."""
    g = fit.geometry
    world = g.world(observations)[observations.camera == camera]
    depth = (world @ g.R[camera].T + g.T[camera])[:, 2]
    return float(np.median(depth) / np.sqrt(g.lens[camera, 0] * g.lens[camera, 1]))


def numbers(
    observations: Observations, fit: Fit, rig: Rig, reference: str
) -> tuple[dict[str, Any], FlatSurface | None]:
    """All numbers of the report that follow from residuals."""
    o = observations
    cameras = {}
    for c, name in enumerate(o.cameras):
        rows = o.camera == c
        mm = 1e3 * _pixel_on_target(fit, o, c)
        rms, worst = _rms(fit.residual[rows]), float(np.abs(fit.residual[rows]).max())
        views = {}
        for p in np.unique(o.pose[rows]):
            view = rows & (o.pose == p)
            views[o.poses[p]] = {"points": int(view.sum()), "rms_px": _rms(fit.residual[view])}
        cameras[name] = {
            "rms_px": rms,
            "rms_mm": rms * mm,
            "max_px": worst,
            "max_mm": worst * mm,
            "position_m": [float(v) for v in rig[name].centre],
            "views": views,
        }
    out: dict[str, Any] = {
        "cameras": cameras,
        "epipolar": {
            f"{a} - {b}": {
                "rms_px": _rms(d),
                "median_px": float(np.median(np.abs(d))),
                "scatter_px": robust_std(d),
                "max_px": float(np.abs(d).max()),
                "points": len(d),
            }
            for (a, b), d in epipolar_residuals(o, rig).items()
        },
        "errors_over_stated_uncertainty": fit.scale,
    }
    surface = flat_surface(o, fit, rig, reference)
    if surface is not None:
        out["flat_target"] = {
            "view": reference,
            "nodes": len(surface.z),
            "z_rms_mm": 1e3 * surface.rms,
            "z_about_its_plane_rms_mm": 1e3 * surface.plane.rms,
            "height_mm": 1e3 * surface.plane.height,
            "tilt_mrad": surface.tilt,
        }
    offset = fit.geometry.offset[np.unique(o.node)]
    if offset.any():
        out["node_offsets_rms_mm"] = [float(v) for v in 1e3 * np.sqrt(np.mean(offset**2, axis=0))]
    return out, surface
