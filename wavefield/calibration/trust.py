"""Whether a rig can be trusted, from what it predicts of itself, and what stays with it."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.derived_uncertainty import Derived
from wavefield.calibration.findings import Findings
from wavefield.calibration.observations import Observations
from wavefield.calibration.parameters import covariance_to_dict
from wavefield.calibration.result import Calibration

ENOUGH = 0.3  # px: a camera known less well than this is not used


def assess_rig(
    o: Observations,
    result: Fit,
    derived: Derived,
    target_std: float,
    camera_distance: Mapping[str, float],
    findings: Findings,
) -> None:
    """Say what stands against a rig.

    With target_std, metres; camera_distance, metres.
    """
    for c, name in enumerate(o.cameras):
        stated = camera_distance.get(name)
        if stated:
            found = float(np.linalg.norm(result.geometry.R[c].T @ result.geometry.T[c]))
            if abs(np.log(found / stated)) > 0.05:
                findings.problems.append(
                    f"{name} stands {found:.2f} m from the origin by this calibration, not {stated:.2f} m as "
                    f"stated: the mesh is given as {1e3 * o.mesh:g} mm; measure it, "
                    f"it may be {1e3 * o.mesh * stated / found:.3g} mm"
                )
        reach = derived.reprojection[name]
        if not reach < ENOUGH:
            findings.problems.append(
                f"{name} is determined to {reach:.2f} px only {derived.where}: photograph more tilted views "
                "that fill its image"
            )
    if len(o.cameras) > 1 and not derived.z_std < 1e-3:
        findings.problems.append(
            f"z would be uncertain by {1e3 * derived.z_std:.1f} mm: photograph more tilted views"
        )
    if len(o.cameras) == 1:
        findings.notes.append("one camera only: z and the velocity need two at least")
    if target_std > 0.0:
        findings.notes.append(
            "the target is uncertain, and so is its plane: level the rig on the water at rest"
        )
    for name in o.cameras:
        cover = derived.coverage[name]
        if cover < 0.4:
            findings.notes.append(
                f"the target's views cover {100 * cover:.0f} % of {name}'s image: its edges are extrapolated"
            )


def provenance(calibration: Calibration) -> dict[str, Any]:
    """Plain numbers that stay with the rig."""
    o, result, derived = calibration.observations, calibration.fit, calibration.derived
    assert o is not None
    assert result is not None
    assert derived is not None
    std = np.sqrt(np.diag(result.covariance))
    cameras = {}
    for c, name in enumerate(o.cameras):
        rows = o.camera == c
        columns = [k for k, _ in result.layout.lens[c]] + list(
            range(result.layout.camera[c], result.layout.camera[c] + 6)
        )
        cameras[name] = {
            "views": [o.poses[p] for p in np.unique(o.pose[rows])],
            "points": int(rows.sum()),
            "rms_px": float(np.sqrt(np.mean(result.residual[rows] ** 2))),
            "max_px": float(np.abs(result.residual[rows]).max()),
            "reprojection_std_px": derived.reprojection[name],
            "parameter_std": {result.layout.names[k].split()[-1]: float(std[k]) for k in columns},
        }
    return {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "usable": calibration.usable,
        "problems": list(calibration.problems),
        "notes": list(calibration.notes),
        "model": calibration.model,
        "mesh_m": float(o.mesh),
        "target_std_m": float(calibration.target_std),
        "reference_view": calibration.reference,
        "z_std_m": derived.z_std,
        "left_out_points": dict(calibration.left_out),
        "cameras": cameras,
        "parameter_units": "f, aspect: log of the focal lengths; c: px; R: rad; T: m; k, p: 1; tau: rad",
        "covariance": covariance_to_dict(result.layout.names, result.covariance, o.cameras),
    }
