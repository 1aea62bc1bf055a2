"""Each pair of cameras by itself: what the paper's accuracy section compares."""

from collections.abc import Mapping

from wavefield.measurement import Diagnosis, Plan, diagnose, pooled
from wavefield.series import FrameSeries

_STEPS = 3
_TRIED = 12  # around the one asked for, where frames are missing or bad


def diagnose_around(
    series: Mapping[str, FrameSeries], plan: Plan, middle: int, pixel: float
) -> Diagnosis | None:
    """Compare the pairs of cameras on a few steps of a record.

    Parameters
    ----------
    series : mapping of str to FrameSeries
        The images of the cameras that measure.
    plan : Plan
        Rig, grid and settings.
    middle : int
        Step around which to measure.
    pixel : float
        Length that counts as one pixel, metres.

    Returns
    -------
    Diagnosis or None
        Of the three steps nearest to `middle` that can be measured; None if none of the nearest twelve can.
    """
    steps = min(len(series[name]) for name in plan.cameras) - 1
    found: list[Diagnosis] = []
    for step in sorted(range(steps), key=lambda step: abs(step - middle))[:_TRIED]:
        frames = {name: [series[name].read(step + k).image for k in (0, 1)] for name in plan.cameras}
        try:
            found.append(diagnose(frames, plan, pixel))
        except ValueError:  # a frame is missing or bad
            continue
        if len(found) == _STEPS:
            break
    return pooled(found) if found else None
