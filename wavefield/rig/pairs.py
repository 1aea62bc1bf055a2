"""Which cameras are compared with which."""

from collections.abc import Sequence

import numpy as np

from wavefield.rig.rig import Rig


def middle_camera(rig: Rig, names: Sequence[str]) -> str:
    """The camera nearest to all others; of two, the first.

    Examples
    --------
    >>> from wavefield.rig import Camera
    >>> down = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    >>> at = {"left": -1.0, "right": 1.0, "middle": 0.2}
    >>> rig = Rig({n: Camera(900, 900, 50, 50, down, (-x, 0, 4), (101, 101)) for n, x in at.items()})
    >>> middle_camera(rig, list(rig))
    'middle'
    """
    centres = np.array([rig[n].centre for n in names])
    reach = np.linalg.norm(centres[:, None] - centres, axis=-1).sum(axis=1)
    return names[int(np.argmin(np.round(reach / max(reach.max(), 1e-30), 9)))]


def pairs_of(rig: Rig, names: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """The middle camera with each of the others."""
    reference = middle_camera(rig, names)
    return tuple((reference, n) for n in names if n != reference)
