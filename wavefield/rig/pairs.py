"""Which cameras are compared with which."""

from collections.abc import Sequence

import numpy as np

from wavefield.rig.rig import Rig


def middle_camera(rig: Rig, names: Sequence[str]) -> str:
    """The camera with the least sum of distances to all others; of two, the first."""
    centres = np.array([rig[n].centre for n in names])
    reach = np.linalg.norm(centres[:, None] - centres, axis=-1).sum(axis=1)
    return names[int(np.argmin(np.round(reach / max(reach.max(), 1e-30), 9)))]


def pairs_of(rig: Rig, names: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """The middle camera with each of the others."""
    reference = middle_camera(rig, names)
    return tuple((reference, n) for n in names if n != reference)
