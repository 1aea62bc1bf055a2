"""Whether frames are fit to be measured: read, of one size, neither blank nor one image again and again."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.series import FrameSeries
from wavefield.store.verdict import Remark
from wavefield.text import spell_ranges
from wavefield.variables import FrameFault

MAX_FRAMES_READ_ALL = 40  # a record of no more frames is read as a whole
SAMPLED_STEPS = 12  # of a longer one
FAULT_WORDS = {
    FrameFault.UNREADABLE: ("unreadable", "cannot be read", "copy them again from the recording"),
    FrameFault.BLANK: ("blank", "are blank (all pixels equal)", "was the lens covered, or the light off?"),
    FrameFault.WRONG_SIZE: (
        "other size",
        "have another size or type than the others",
        "put the frames of one setting of the camera into one record",
    ),
}


@dataclass(frozen=True)
class FrameInspection:
    """What reading some frames of one camera has shown."""

    read: tuple[int, ...]  # Indices of the frames that were read
    # (FrameFault, str): Fault and sentence of those that are bad
    faults: Mapping[int, tuple[FrameFault, str]]
    repeated: frozenset[int]  # Indices of those that equal the frame before them in every pixel

    def numbers(self, first: int, fault: FrameFault) -> tuple[int, ...]:
        """Numbers of the frames with a fault."""
        return tuple(first + index for index, (kind, _) in self.faults.items() if kind == fault)


def sample_frames(series: Mapping[str, FrameSeries]) -> tuple[int, ...]:
    """Indices of the frames to be read: all of a short record, else those of some steps drawn at random."""
    complete = complete_steps(series)
    if len(complete) < MAX_FRAMES_READ_ALL:
        return tuple(range(len(complete) + 1))
    # evenly spaced ones would all be good, or all be bad, where every second frame is
    drawn = np.random.default_rng(0).permutation(np.flatnonzero(complete))[:SAMPLED_STEPS]
    return tuple(sorted({int(frame) for step in drawn for frame in (step, step + 1)}))


def inspect_frames(series: FrameSeries, indices: tuple[int, ...]) -> FrameInspection:
    """Read some frames of a camera and compare each with the one before it, where that was read, too."""
    faults: dict[int, tuple[FrameFault, str]] = {}
    repeated, read = set(), []
    before, image_before = -2, None
    for index in indices:
        if series.entries[index] is None:
            continue
        read.append(index)
        image, fault, message = series.read(index)
        alike = image is not None and image_before is not None and np.array_equal(image, image_before)
        if fault:
            faults[index] = fault, message
        elif alike and before == index - 1:
            repeated.add(index)
        before, image_before = index, image
    return FrameInspection(tuple(read), faults, frozenset(repeated))


def remark_on_frames(
    series: Mapping[str, FrameSeries], inspections: Mapping[str, FrameInspection], sample: tuple[int, ...]
) -> Iterator[Remark]:
    """Report cameras with many bad or repeated frames, and records of which few steps can be measured."""
    for name, found in inspections.items():
        read = [index for index in found.read if index in set(sample)]
        if not read:
            continue
        for fault, (kind, words, remedy) in FAULT_WORDS.items():
            everywhere = [index for index, (other, _) in found.faults.items() if other == fault]
            bad = [index for index in everywhere if index in read]
            count, those = len(read), "frames read"
            if len(bad) <= _most(fault, count):  # files of unusual sizes were read beside the sample
                bad, count, those = everywhere, len(series[name]), "frames"
            if len(bad) <= _most(fault, count):
                continue
            numbers = spell_ranges([series[name].first + index for index in bad], 3)
            yield Remark(
                name,
                kind,
                "grave" if len(bad) > RECORD_LIMITS.usable_steps * count else "remark",
                f"{len(bad)} of {count} {those} {words}: frames {numbers} ({found.faults[bad[0]][1]})",
                "none"
                if fault == FrameFault.WRONG_SIZE
                else f"{100 * RECORD_LIMITS.bad_frames:.0f} % at most",
                remedy,
                {"bad": len(bad), "read": count},
            )
        pairs = sum(index - 1 in read for index in read)
        if len(found.repeated) > max(1, RECORD_LIMITS.bad_frames * pairs):
            numbers = spell_ranges([series[name].first + index for index in sorted(found.repeated)], 3)
            yield Remark(
                name,
                "frozen",
                "grave" if len(found.repeated) > RECORD_LIMITS.usable_steps * pairs else "remark",
                f"{len(found.repeated)} of {pairs} frames read equal the frame before them in every pixel: "
                f"frames {numbers}",
                "none",
                "the recording repeats images; copy it again, or leave these frames out (`frames`)",
                {"repeated": len(found.repeated), "pairs": pairs},
            )
    yield from _usable(series, inspections, sample)


def _most(fault: FrameFault, frames: int) -> float:
    """Number of bad frames that is not remarked upon: one setting of the camera gives frames of one size."""
    return 0 if fault == FrameFault.WRONG_SIZE else max(1, RECORD_LIMITS.bad_frames * frames)


def _usable(
    series: Mapping[str, FrameSeries], inspections: Mapping[str, FrameInspection], sample: tuple[int, ...]
) -> Iterator[Remark]:
    complete = complete_steps(series)
    good = {
        name: {index for index in found.read if index not in found.faults}
        for name, found in inspections.items()
    }
    drawn = [index for index in sample if index + 1 in sample and index < len(complete) and complete[index]]
    usable = [
        all(
            index in good[name] and index + 1 in good[name] and index + 1 not in inspections[name].repeated
            for name in inspections
        )
        for index in drawn
    ]
    share = float(complete.mean()) * float(np.mean(usable)) if usable else 0.0
    if share < RECORD_LIMITS.usable_steps and complete.any() and not all(usable):
        yield Remark(
            "record",
            "few usable steps",
            "grave",
            f"only about {100 * share:.0f} % of {len(complete)} steps have two good frames of every camera",
            f"{100 * RECORD_LIMITS.usable_steps:.0f} % at least",
            "copy the frames named here again, or state a range of good ones (`frames`)",
            {"share": share, "steps": len(complete)},
        )


def complete_steps(series: Mapping[str, FrameSeries]) -> NDArray[np.bool_]:
    """Steps of which both frames have a file in every camera."""
    present = np.all([[entry is not None for entry in one.entries] for one in series.values()], axis=0)
    return np.asarray(present[:-1] & present[1:])


def remark_on_absent_frames(series: Mapping[str, FrameSeries]) -> Iterator[Remark]:
    """Report cameras with many missing frames, and cameras that have few steps in common."""
    for name, one in series.items():  # recordings with a clock report dropped images themselves
        missing = one.missing
        if one.times is not None or len(missing) <= RECORD_LIMITS.bad_frames * len(one):
            continue
        there = one.first + np.flatnonzero([entry is not None for entry in one.entries])
        gap = int(np.argmax(np.diff(there))) if len(there) > 1 else 0
        leap = (
            f"; the longest gap is between frames {there[gap]} and {there[gap + 1]}"
            if len(there) > 1 and there[gap + 1] - there[gap] > 1
            else ""
        )
        yield Remark(
            name,
            "missing frames",
            "grave" if len(missing) > RECORD_LIMITS.usable_steps * len(one) else "remark",
            f"{len(missing)} of {len(one)} are missing: frames {spell_ranges(missing.tolist(), 3)}{leap}",
            f"{100 * RECORD_LIMITS.bad_frames:.0f} % at most",
            "copy them, or state the range of frames that is complete (`frames`)",
            {"missing": len(missing), "frames": len(one)},
        )
    if not series:
        return
    complete = complete_steps(series)
    share = float(complete.mean())
    if share < RECORD_LIMITS.usable_steps:
        yield Remark(
            "record",
            "few common steps",
            "grave",
            f"only {100 * share:.0f} % of {len(complete)} steps have both frames of every camera",
            f"{100 * RECORD_LIMITS.usable_steps:.0f} % at least",
            "copy the missing frames; do the frames of one moment have one number (`offset`)?",
            {"share": share, "steps": len(complete)},
        )
