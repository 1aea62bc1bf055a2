"""Whether a rig can be trusted, from its predicted errors; and the numbers stored with it."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.findings import Findings
from wavefield.calibration.limits import LIMITS
from wavefield.calibration.observations import Observations
from wavefield.calibration.parameters import covariance_to_dict
from wavefield.calibration.predicted_errors import PredictedErrors
from wavefield.calibration.result import Calibration


def assess_rig(
    o: Observations,
    result: Fit,
    errors: PredictedErrors,
    target_std: float,
    camera_distance: Mapping[str, float],
    findings: Findings,
) -> None:
    """Add problems and notes of a rig to the findings; target_std and camera_distance in metres."""
    for c, name in enumerate(o.cameras):
        stated = camera_distance.get(name)
        if stated:
            distance = float(np.linalg.norm(result.geometry.R[c].T @ result.geometry.T[c]))
            if abs(np.log(distance / stated)) > LIMITS.max_distance_error:
                findings.problems.append(
                    f"{name} is {distance:.2f} m from the origin by this calibration, not {stated:.2f} m as "
                    f"stated: the mesh is given as {1e3 * o.mesh:g} mm; measure it, "
                    f"it may be {1e3 * o.mesh * stated / distance:.3g} mm"
                )
        if not errors.reprojection[name] < LIMITS.max_reprojection_std:
            findings.problems.append(
                f"{name} is determined to {errors.reprojection[name]:.2f} px only {errors.volume}: "
                "photograph more tilted views that fill its image"
            )
    if len(o.cameras) > 1 and not errors.z_std < LIMITS.max_z_std:
        findings.problems.append(
            f"z would be uncertain by {1e3 * errors.z_std:.1f} mm: photograph more tilted views"
        )
    if len(o.cameras) == 1:
        findings.notes.append("one camera only: z and the velocity need two at least")
    if target_std > 0.0:
        findings.notes.append(
            "the target is uncertain, and so is its plane: level the rig on the water at rest"
        )
    for name, coverage in errors.coverage.items():
        if coverage < LIMITS.min_coverage:
            findings.notes.append(
                f"the target's views cover {100 * coverage:.0f} % of {name}'s image: its edges are "
                "extrapolated"
            )


def provenance(calibration: Calibration) -> dict[str, Any]:
    """Numbers and texts that are stored with the rig."""
    o, result, errors = calibration.observations, calibration.fit, calibration.predicted
    assert o is not None
    assert result is not None
    assert errors is not None
    std = np.sqrt(np.diag(result.covariance))
    cameras = {}
    for c, name in enumerate(o.cameras):
        rows = o.camera == c
        first = result.layout.camera[c]
        columns = [*(k for k, _ in result.layout.lens[c]), *range(first, first + 6)]
        cameras[name] = {
            "views": [o.poses[p] for p in np.unique(o.pose[rows])],
            "points": int(rows.sum()),
            "rms_px": float(np.sqrt(np.mean(result.residual[rows] ** 2))),
            "max_px": float(np.abs(result.residual[rows]).max()),
            "reprojection_std_px": errors.reprojection[name],
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
        "z_std_m": errors.z_std,
        "left_out_points": dict(calibration.left_out),
        "cameras": cameras,
        "parameter_units": "f, aspect: log of the focal lengths; c: px; R: rad; T: m; k, p: 1; tau: rad",
        "covariance": covariance_to_dict(result.layout.names, result.covariance, o.cameras),
    }
