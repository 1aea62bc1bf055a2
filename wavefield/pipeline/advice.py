"""What would help where little is measured: other settings that measure more of the same step, or why not."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from wavefield.pipeline.chunk import make_chunk, measure_chunk
from wavefield.pipeline.cost import fraction_measured, in_view, whole_step
from wavefield.pipeline.prepare import PreparedRun
from wavefield.quality.frame_remarks import complete_steps
from wavefield.store.verdict import Remark
from wavefield.variables import Quality

if TYPE_CHECKING:
    from wavefield.measurement import Settings

ENOUGH = 0.8  # of the nodes in view: images that measure so much need no advice
_GAIN = 0.1  # of the nodes in view: settings that measure no more than this besides are not worth a word
_OTHERS = {"sheet": "particles in a light sheet", "texture": "natural texture"}
_WHY = {
    Quality.REJECTED_CORRELATION: "the images do not match there: more light, more seeding, a sharper "
    "focus or a higher frame rate would help; `wavefield check --pairs` compares the cameras",
    Quality.REJECTED_EPS: "sight lines miss one another: does the rig belong to these images? "
    "`wavefield refine` corrects one that was knocked",
    Quality.REJECTED_NEIGHBOURS: "values far from their neighbours: are the frames of one moment the "
    "cameras' own?",
    Quality.REJECTED_RANGE: "they are beyond the range that is searched: is the range of elevations "
    "wide enough (`settings: {z_range: ...}`), and that of the displacements "
    "(`piv: {search_x: ..., search_y: ...}`)? Or are waves four times as high as in the steps that were "
    "sampled (measure this part of the record in a run of its own, by `frames:`)?",
}


def advise(prepared: PreparedRun, quality: np.ndarray, wrong: Sequence[Remark] = ()) -> str:
    """What would measure more: a camera of the remarks, or settings, tried on the step of the forecast.

    ``quality`` is that of the forecast: zeros where it could not be measured.
    """
    measured = fraction_measured(quality)
    if measured >= ENOUGH or not complete_steps(prepared.series).any():
        return ""
    found = f"advice: only {100 * measured:.0f} % measured"
    if wrong:
        return f"{found}: {_of_cameras(prepared, wrong)}"
    settings = prepared.geometry.settings
    tried = {name: fraction_measured(_quality(prepared, settings.adjusted(name))) for name in _OTHERS}
    best = max(tried, key=lambda name: tried[name])
    if tried[best] > measured + _GAIN:
        return (
            f"{found}; with `settings: {{preset: {best}}}`, for {_OTHERS[best]}, the same step measures "
            f"{100 * tried[best]:.0f} %, short waves less well"
        )
    return f"{found}, mostly because {_why(quality)}"


def grave_cameras(prepared: PreparedRun, remarks: Iterable[Remark]) -> list[Remark]:
    """Remarks on single cameras with which nothing good can be measured."""
    cameras = set(prepared.rig)
    return [one for one in remarks if one.weight == "grave" and set(one.subject.split(" and ")) <= cameras]


def _of_cameras(prepared: PreparedRun, wrong: Sequence[Remark]) -> str:
    """Which cameras to correct, and that no pair of those that are named does without one of them."""
    names = {name for one in wrong for name in one.subject.split(" and ")}
    sentence = f"correct {', '.join(sorted(names))} first, as stated below"
    others = [name for name in prepared.rig if name not in names]
    pairs = prepared.geometry.pairs
    if prepared.experiment.surface and len(others) > 1 and all(names & set(pair) for pair in pairs):
        sentence += (
            f"; every pair of `surface: pairs` contains {' or '.join(sorted(names))}, so z cannot be measured"
            f" from the others: [{others[0]}, {others[1]}] would be such a pair"
        )
    return sentence


def _why(quality: np.ndarray) -> str:
    """What most of the nodes that are not measured lack."""
    lost = quality[in_view(quality) & (quality & Quality.MEASURED == 0)]
    return _WHY[max(_WHY, key=lambda flag: int((lost & flag != 0).sum()))]


def _quality(prepared: PreparedRun, settings: "Settings") -> np.ndarray:
    """Of the step that was tried, measured with some settings."""
    from wavefield.measurement import GridGeometry

    start = whole_step(prepared.series)
    geometry = GridGeometry(prepared.rig, prepared.grid, settings, prepared.geometry.covered)
    chunk = make_chunk(prepared.series, start, start + 1)
    return measure_chunk(chunk, geometry, prepared.experiment.frame_rate).fields["quality"]
