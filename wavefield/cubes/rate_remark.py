"""Whether the frame rate of an experiment file is the one that its recordings state."""

from collections.abc import Iterator

from wavefield.series import Experiment
from wavefield.series.rates import is_alike, recorded_rates
from wavefield.store.verdict import Remark


def remark_on_rate(experiment: Experiment) -> Iterator[Remark]:
    """Say where recordings state another frame rate than the experiment file.

    Parameters
    ----------
    experiment : Experiment
        The experiment.

    Yields
    ------
    Remark
        At most one for a camera; none for a camera with `times`.
    """
    named = {name: one.images for name, one in experiment.cameras.items() if one.times is None}
    for name, rate in recorded_rates(named, experiment.image_folder).items():
        if not is_alike(rate, experiment.frame_rate):
            yield Remark(
                name,
                "frame rate",
                "remark",
                f"its recording states {rate:g} Hz, {experiment.path.name} {experiment.frame_rate:g} Hz",
                "the rate of the recording",
                "leave frame_rate out to take the recording's; all is well if frames were left out since",
                values={"recorded_hz": rate, "stated_hz": experiment.frame_rate},
            )
