"""Placing and levelling the cameras of an experiment by images of moving water."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from wavefield.calibration.relative_pose import Levelled, Pixels, level_on_water, match_features, place_second
from wavefield.errors import RigError
from wavefield.rig import Rig
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment


def level_experiment(
    experiment: str | Path | Experiment,
    rig: str | Path | None = None,
    distance: float | None = None,
    frames: int = 20,
    progress: Callable[[int, int], None] | None = None,
) -> Levelled:
    """Bring z = 0 to the mean surface of moving water, after placing the second camera if requested.

    Parameters
    ----------
    experiment : path or Experiment
        Of cameras that see natural texture from not too different sides.
    rig : path, optional
        In place of the one that the experiment names; its frame may be any, such as that of a camera.
    distance : float, optional
        Between two cameras, metres: the second one's pose is computed from common features; only its lens is
        used.
    frames : int
        Instants to use, spread over the record.
    progress : callable, optional
        Called with (instants done, all instants).

    Returns
    -------
    Levelled

    Raises
    ------
    RigError
        If the cameras share too few features, or are in one place and no distance is stated.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.level("experiment.yaml")  # doctest: +SKIP
    >>> found.instants  # doctest: +SKIP
    20
    >>> found.rig.save("rig.yaml")  # doctest: +SKIP
    """
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    series = experiment.open_frames()
    loaded = experiment.load_rig(rig, series)
    first, *others = loaded
    if distance is not None and len(others) != 1:
        raise RigError(f"a distance places the second of two cameras; this rig has {len(loaded)}")
    if distance is None and any(np.allclose(loaded[first].centre, loaded[n].centre) for n in others):
        raise RigError(
            "the rig does not contain the positions of its cameras: state the distance between them"
        )
    instants = evenly_spaced(len(series[first]), frames)
    matches: list[dict[tuple[str, str], Pixels]] = []
    for done, instant in enumerate(instants, 1):
        images = {name: image for name in loaded if (image := series[name].read(instant).image) is not None}
        pairs = [(first, n) for n in others if first in images and n in images]
        matches.append({(a, b): match_features(images[a], images[b]) for a, b in pairs})
        if progress:
            progress(done, len(instants))
    if distance is not None:
        pair = first, others[0]
        found = [by_pair[pair] for by_pair in matches if pair in by_pair]
        a, b = (np.concatenate([m[side] for m in found] or [np.empty((0, 2))]) for side in (0, 1))
        second = place_second(loaded[first], loaded[others[0]], (a, b), distance)
        note = {"distance_m": distance, "matches": len(a)}
        loaded = Rig({first: loaded[first], others[0]: second}, {**loaded.provenance, "placed": note})
    return level_on_water(loaded, matches)
