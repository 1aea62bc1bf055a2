"""Placing and levelling the cameras of an experiment by the moving water that they see."""

from collections.abc import Callable
from dataclasses import replace
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
    """Bring z = 0 to the mean surface of moving water, after placing the second camera if that is asked for.

    Parameters
    ----------
    experiment : path or Experiment
        Of cameras that see natural texture from not too different sides.
    rig : path, optional
        In place of the one that the experiment names; its frame may be any, such as that of a camera.
    distance : float, optional
        Between two cameras, metres: the second one is placed anew by what both see, its lens alone is used.
    frames : int
        Instants to use, spread over the record.
    progress : callable, optional
        Told (instants done, all instants).

    Returns
    -------
    Levelled

    Raises
    ------
    RigError
        If too little is seen alike, or the cameras are in one place and no distance is stated.

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
    names = list(loaded)
    first, *others = names
    if distance is not None and len(names) != 2:
        raise RigError(f"a distance places the second of two cameras; this rig has {len(names)}")
    if distance is None and any(np.allclose(loaded[first].centre, loaded[n].centre) for n in others):
        raise RigError("the rig says nothing of where its cameras are: state the distance between them")
    count = len(series[first])
    instants = evenly_spaced(count, frames)
    matches: list[dict[tuple[str, str], Pixels]] = []
    for done, instant in enumerate(instants, 1):
        images = {name: series[name].read(instant).image for name in names}
        one = images[first]
        seen = {
            (first, n): match_features(one, other)
            for n in others
            if (other := images[n]) is not None and one is not None
        }
        matches.append(seen)
        if progress:
            progress(done, len(instants))
    if distance is not None:
        pair = first, others[0]
        found = [seen[pair] for seen in matches if pair in seen]
        both = tuple(np.concatenate([m[side] for m in found] or [np.empty((0, 2))]) for side in (0, 1))
        second = place_second(loaded[first], loaded[others[0]], (both[0], both[1]), distance)
        note = {"distance_m": distance, "matches": len(both[0])}
        loaded = Rig({first: loaded[first], others[0]: second}, {**loaded.provenance, "placed": note})
    return level_on_water(replace(loaded), matches)
