"""A rig in sentences that show a wrong mesh: distances, size of a pixel, and the field on the water."""

from collections.abc import Iterator

import numpy as np

from wavefield.errors import RigError
from wavefield.rig import Rig
from wavefield.rig.field import common_field
from wavefield.rig.resolution import pixel_size


def rig_sentences(rig: Rig) -> Iterator[str]:
    """How far the cameras are from the target, and what they see of the water.

    Examples
    --------
    >>> from wavefield.rig import Camera
    >>> down = Camera(1000, 1000, 499.5, 499.5, ((1, 0, 0), (0, -1, 0), (0, 0, -1)), (0, 0, 4), (1000, 1000))
    >>> print(*rig_sentences(Rig({"cam1": down})), sep="\\n")
    Distance from the target's origin: cam1 4.00 m; if you measure another, correct `mesh` by that ratio.
    On the water a pixel is 4 mm; all cameras see x -1.9 to 1.9 m, y -1.9 to 1.9 m.
    """
    distances = ", ".join(
        f"{name} {float(np.linalg.norm(camera.centre)):.2f} m" for name, camera in rig.cameras.items()
    )
    yield (
        f"Distance from the target's origin: {distances}; if you measure another, correct `mesh` by that "
        "ratio."
    )
    try:
        field = common_field(rig.cameras.values())
        (x0, x1), (y0, y1) = field.x, field.y
        yield (
            f"On the water a pixel is {1e3 * pixel_size(rig, field):.2g} mm; all cameras see "
            f"x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m."
        )
    except RigError as error:
        yield f"What the cameras see of the water: {error}"
