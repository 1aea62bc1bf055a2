"""Learning beads, spectra and noise from sample frames of a whole record, before its first chunk."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.execution.worker_settings import one_thread
from wavefield.pipeline.chunk import Source

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, LearnedRecord

_TRIES = 3  # sets of samples, where frames are missing or bad


def learn_record(
    sources: Mapping[str, Source], steps: int, geometry: "GridGeometry", threads: int = 1
) -> dict[str, Any]:
    """Learn from sample frames of a record."""
    for number in range(_TRIES):
        if found := learn_from(samples(sources, steps, number), geometry, threads):
            return found
    return {}


def samples(sources: Mapping[str, Source], steps: int, number: int = 0) -> list[Mapping[str, Source]]:
    """Sample steps of a record, two frames each."""
    from wavefield.measurement import sample_steps

    return [{n: s.window(k, k + 2) for n, s in sources.items()} for k in sample_steps(steps, number)]


def learn_from(
    pairs: Sequence[Mapping[str, Source]], geometry: "GridGeometry", threads: int = 1
) -> dict[str, Any]:
    """Learn from some steps."""
    from wavefield.measurement import learn
    from wavefield.quality.stabilized import corrected

    def frames(pair: Mapping[str, Source], k: int) -> dict[str, Any]:
        images = {name: source.read(k).image for name, source in pair.items()}
        return corrected(images, geometry)[0] if geometry.settings.vibration == "correct" else images

    def masks(pair: Mapping[str, Source], k: int) -> dict[str, Any]:
        return {name: source.covered(k) for name, source in pair.items()}

    steps = [(frames(pair, 0), frames(pair, 1)) for pair in pairs]
    covered = [(masks(pair, 0), masks(pair, 1)) for pair in pairs]
    with one_thread():  # each of them
        record = learn(steps, geometry, covered, threads)
    return {} if record is None else record.to_dict()


def once_per_cube(geometry: "GridGeometry", record: "LearnedRecord | None") -> dict[str, np.ndarray]:
    """What a cube holds once for all steps: its response to waves, and the uncertainty of z = 0."""
    from wavefield.measurement.bead_tilt import level_std
    from wavefield.measurement.response import tabulated

    return tabulated(geometry, record) | {"z_level_std": np.asarray(level_std(geometry, record), np.float64)}
