"""Learn beads, spectra and noise from sample frames of the record before its first chunk is measured."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.execution.process import one_opencv_thread
from wavefield.pipeline.chunk import Source, read_frame
from wavefield.quality.cameras import PatchMatcher, compare
from wavefield.sampling import evenly_spaced
from wavefield.series import Frame

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, LearnedRecord

_TRIES = 3  # sets of samples, where frames are missing or bad
_SEARCHED_STEPS = 64  # of a record, for waves that come and go
_MIN_ENERGY_RATIO = 1 / 32  # median of the sample steps over the largest: spectra suppress stronger waves
_MIN_MOTION_PX = 0.1  # rms: less is noise


def learn_record(
    sources: Mapping[str, Source], steps: int, geometry: "GridGeometry", frame_rate: float, threads: int = 1
) -> dict[str, Any]:
    """Learn from sample steps of a record; the result lists them as `steps`."""
    from wavefield.measurement import sample_steps

    for number in range(_TRIES):
        usual = sample_steps(steps, number)
        chosen = usual if number else steps_with_waves(sources, steps, geometry, threads)
        if found := learn_from(samples(sources, chosen), geometry, frame_rate, threads):
            return found | {"steps": chosen}
    return {}


def samples(sources: Mapping[str, Source], steps: Sequence[int]) -> list[Mapping[str, Source]]:
    """The two frames of some steps of a record, and the one before them if there is one."""
    return [{n: s.window(max(k - 1, 0), k + 2) for n, s in sources.items()} for k in steps]


def both_frames(sample: Mapping[str, Source]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Both frames of a sample step, by camera; None where one is bad or repeats the frame before it."""
    first = {name: read_frame(source, len(source) - 2) for name, source in sample.items()}
    second = {name: read_frame(source, len(source) - 1, first[name].image) for name, source in sample.items()}

    def usable(frames: Mapping[str, Frame]) -> dict[str, Any]:
        return {name: None if frame.fault else frame.image for name, frame in frames.items()}

    return usable(first), usable(second)


def steps_with_waves(
    sources: Mapping[str, Source], steps: int, geometry: "GridGeometry", threads: int = 1
) -> list[int]:
    """Steps to learn from: evenly over the record or, if these miss its waves, over the part with waves."""
    from wavefield.measurement import sample_steps

    usual = sample_steps(steps)
    if steps <= len(usual):
        return usual
    name = geometry.velocity_cameras[0]
    places = sorted({*usual, *evenly_spaced(steps, _SEARCHED_STEPS)})
    layout = PatchMatcher(lambda name, k: sources[name].read(k).image, geometry.rig, geometry.grid)

    if not len(layout.x):  # the grid is narrower than a patch
        return usual

    def moved_from(k: int) -> np.ndarray:
        first, second = (layout.sampled(name, frame) for frame in (k, k + 1))
        if first is None or second is None:
            return np.zeros((0, 2))
        moved = compare(first[::2], second[::2])  # some thirty patches suffice
        assert moved is not None
        return moved[np.isfinite(moved[:, 0])]

    with ThreadPoolExecutor(threads) as pool:
        motion = list(pool.map(moved_from, places))
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
    """Learn from sample steps; frame rate in Hz."""
    from wavefield.measurement import learn
    from wavefield.measurement.stabilize import corrected

    def masks(pair: Mapping[str, Source], back: int) -> dict[str, Any]:
        return {name: source.covered(len(source) - back) for name, source in pair.items()}

    steps = list(map(both_frames, pairs))
    if geometry.settings.vibration == "correct":
        steps = [(corrected(first, geometry), corrected(second, geometry)) for first, second in steps]
    covered = [(masks(pair, 2), masks(pair, 1)) for pair in pairs]
    with one_opencv_thread():  # each of them
        record = learn(steps, geometry, covered, threads, frame_rate)
    return {} if record is None else record.to_dict()


def once_per_cube(geometry: "GridGeometry", record: "LearnedRecord | None") -> dict[str, np.ndarray]:
    """Values that a cube holds once for all steps: its response to waves, and the uncertainty of z = 0."""
    from wavefield.measurement.error_budget import level_std
    from wavefield.measurement.resolution import tabulated

    return tabulated(geometry, record) | {"z_level_std": np.asarray(level_std(geometry, record), np.float64)}
