"""Pictures and numbers by which a person can judge a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import yaml

if TYPE_CHECKING:
    from wavefield.calibration.solve import Calibration


def write_report(calibration: Calibration, directory: Path) -> Path:
    """Write numbers.

    Parameters
    ----------
    calibration : Calibration
        What to report.
    directory : Path
        Made if it is not there.

    Returns
    -------
    Path
        The file of numbers.
    """
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / "numbers.yaml"
    path.write_text(yaml.safe_dump(dict(calibration.rig.provenance), sort_keys=False))
    return path
