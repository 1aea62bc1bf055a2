"""Learn bead widths, wave spectra and noise, which the estimator needs, from sample steps of a record."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.execution.process import one_opencv_thread
from wavefield.pipeline.chunk import Source, read_frame
from wavefield.quality.cameras import PatchMatcher, compare
from wavefield.sampling import evenly_spaced

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry
    from wavefield.measurement.model import LearnedRecord

_TRIES = 3  # sets of sample steps that are tried if frames are missing or bad
_SEARCHED_STEPS = 64  # steps in which waves are looked for
# Smallest ratio of the median energy of the sample steps to the largest energy found: with spectra of weaker
# waves, the estimator would suppress the strongest ones
_MIN_ENERGY_RATIO = 1 / 32
_MIN_MOTION_PX = 0.1  # px rms: less is noise


def learn_record(
    sources: Mapping[str, Source], steps: int, geometry: "GridGeometry", frame_rate: float, threads: int = 1
) -> dict[str, Any]:
    """Choose sample steps, and learn bead widths, wave spectra and noise from them.
    ``sources`` holds the frames by camera, and ``steps`` is the number of steps of the record. Returns plain
    data (`LearnedRecord.to_dict`, and sample ``steps``); empty if three sets of sample steps fail."""
    from wavefield.measurement import sample_steps

    for number in range(_TRIES):
        usual = sample_steps(steps, number)
        chosen = usual if number else steps_with_waves(sources, steps, geometry, threads)
        if found := learn_from(samples(sources, chosen), geometry, frame_rate, threads):
            return found | {"steps": chosen}
    return {}


def samples(sources: Mapping[str, Source], steps: Sequence[int]) -> list[Mapping[str, Source]]:
    """Return, for each step, three frames by camera: the two of the step, and the frame before them.
    There is no frame before the first step of a record."""
    return [{n: s.window(max(k - 1, 0), k + 2) for n, s in sources.items()} for k in steps]


def both_frames(sample: Mapping[str, Source]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the first images and the second images of a step, each by camera; None for bad or repeated ones.
    ``sample`` is an element of the list that `samples` returns."""
    first = {name: read_frame(source, len(source) - 2) for name, source in sample.items()}
    second = {name: read_frame(source, len(source) - 1, first[name].image) for name, source in sample.items()}
    one, two = ({n: None if f.fault else f.image for n, f in frames.items()} for frames in (first, second))
    return one, two


def steps_with_waves(
    sources: Mapping[str, Source], steps: int, geometry: "GridGeometry", threads: int = 1
) -> list[int]:
    """Return steps to learn from: evenly spaced ones or, if waves are weak there, steps with strong waves.
    Strength is the variance of the displacements in the images of one camera about the mean current."""
    from wavefield.measurement import sample_steps

    usual = sample_steps(steps)
    if steps <= len(usual):
        return usual
    name = geometry.velocity_cameras[0]
    places = sorted({*usual, *evenly_spaced(steps, _SEARCHED_STEPS)})
    matcher = PatchMatcher(lambda name, k: sources[name].read(k).image, geometry.rig, geometry.grid)
    if not len(matcher.x):  # the grid is narrower than a patch
        return usual

    def displacements(k: int) -> np.ndarray:
        first, second = (matcher.sampled(name, frame, name) for frame in (k, k + 1))
        if first is None or second is None:
            return np.zeros((0, 2))
        moved = compare(first[::2], second[::2])  # about thirty patches suffice
        assert moved is not None
        return moved[np.isfinite(moved[:, 0])]

    with ThreadPoolExecutor(threads) as pool:
        motion = list(pool.map(displacements, places))
    current = np.mean(np.concatenate(motion), axis=0) if any(map(len, motion)) else 0.0
    energy = {k: float(np.mean((m - current) ** 2)) if len(m) else 0.0 for k, m in zip(places, motion)}
    largest = max(*energy.values(), _MIN_MOTION_PX**2)
    if np.median([energy[k] for k in usual]) >= _MIN_ENERGY_RATIO * largest:
        return usual
    strong = [k for k in places if energy[k] > 0.25 * largest] or usual
    return [strong[k] for k in evenly_spaced(len(strong), len(usual))]


def learn_from(
    pairs: Sequence[Mapping[str, Source]], geometry: "GridGeometry", frame_rate: float, threads: int = 1
) -> dict[str, Any]:
    """Learn bead widths, wave spectra and noise from sample steps, ``pairs``, which `samples` returned.
    Returns the result as plain data (`LearnedRecord.to_dict`); empty if no step can be measured."""
    from wavefield.measurement import learn

    def masks(pair: Mapping[str, Source], back: int) -> dict[str, Any]:
        return {name: source.covered(len(source) - back) for name, source in pair.items()}

    steps = list(map(both_frames, pairs))
    covered = [(masks(pair, 2), masks(pair, 1)) for pair in pairs]
    with one_opencv_thread():  # in each of our threads
        record = learn(steps, geometry, covered, threads, frame_rate)
    return {} if record is None else record.to_dict()


def once_per_cube(geometry: "GridGeometry", record: "LearnedRecord | None") -> dict[str, np.ndarray]:
    """Return the variables that a cube has once, not per step, by name: the response of the measurement
    to waves (`tabulated`), and ``z_level_std``, the standard uncertainty of the level z = 0, m."""
    from wavefield.measurement.error_budget import level_std
    from wavefield.measurement.model import tabulated

    return tabulated(geometry, record) | {"z_level_std": np.asarray(level_std(geometry, record), np.float64)}
