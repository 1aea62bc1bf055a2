"""What a verdict can contain: limits, explanations, and the remarks on the water level, fields and probes.

Every remark has a kind, which `explanations.yaml` explains, and three parts: what was found, what it means
for the result, what to do. Those on cameras are made in `cameras` and `camera_motion`, those
on frames and times in `record`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.rig import Rig
from wavefield.sampling import from_first_to_last
from wavefield.series import Experiment
from wavefield.store.ledger import Status
from wavefield.store.verdict import Remark, Weight
from wavefield.text import spell_ranges, spell_uncertain
from wavefield.variables import Quality

if TYPE_CHECKING:
    import xarray as xr

    from wavefield.waves.probes import ProbeFit

# What each kind of remark means and what to do: the text of `wavefield explain`
EXPLANATIONS: dict[str, str] = yaml.safe_load(
    Path(__file__).with_name("explanations.yaml").read_text(encoding="utf-8")
)


@dataclass(frozen=True)
class CameraLimits:
    """Limits of the remarks on cameras."""

    covered: float = 0.08  # fraction of the patches in which a camera shows nothing
    covered_grave: float = 0.6
    blur_ratio: float = 1.6  # blur over that of the other cameras, in px and on the water
    epipolar_error: float = 0.1  # px: smallest for which correcting a rig is advised
    epipolar_error_grave: float = 0.5  # px
    agreement: float = 0.2  # fraction of the patches: two cameras that agree in fewer do not agree
    agreement_to_best: float = 0.5  # the same over the agreement of the best pair
    delay: float = 2e-5  # s: less is not noted
    delay_motion: float = 0.1  # px that a bead moves during the delay
    jump: float = 0.05  # px: a smaller one is not separated from jitter
    motion: float = 0.1  # px by which the pictures of cameras move


@dataclass(frozen=True)
class RecordLimits:
    """Limits of the remarks on frames, recordings and stored fields."""

    bad_frames: float = 0.1  # fraction of the frames of a camera
    usable_steps: float = 0.5  # fraction of the steps
    uneven_interval: float = 0.5  # by which two frames may be further apart than their numbers state
    discontinuity: float = 0.3  # logarithm of a step's ratio over that of its neighbours: `time_check`
    jitter: float = 1.0  # standard uncertainties by which jitter of the frame times makes values wrong
    kinematic_misfit: float = 1.6  # sound seas have 0.1 to 1.2
    kinematic_misfit_grave: float = 3.0


CAMERA_LIMITS = CameraLimits()
RECORD_LIMITS = RecordLimits()
MIN_COVERAGE = 0.5  # of the grid in common view: less is remarked upon
MIN_USEFUL_COVERAGE = 0.05  # less is refused before a run, and makes a cube useless
MIN_MEASURED = 0.7  # of the nodes in view: fewer are remarked upon
MIN_USEFUL_MEASURED = 0.2  # fewer are worth nothing
MAX_EPS_PIV = 0.15  # px: a larger median eps' is remarked upon
MAX_USEFUL_EPS_PIV = 0.5  # px: a larger one makes values useless
MAX_UNRESOLVED = 0.3  # of the variance of w by waves that images or frames do not resolve
UNRESOLVED_STD = 2.0  # standard uncertainties of w with short waves over those without: more is noted
NOTED_FAST = 0.003  # of the variance of w by fast waves: more is noted
NOTED_WITHOUT_CAMERA, MAX_WITHOUT_CAMERA = 0.01, 0.1  # of the nodes: more are noted, remarked upon
NOTED_FAULTY = 0.01  # of the steps with bad frames: more are remarked upon
BEAD_HEIGHTS_M = 1e-4, 2e-3  # of visible beads above the water, if they are plausible
MAX_PLANE_STEPS = 60  # of a record, to which planes are fitted
MIN_SECONDS = 5  # of a record: the waves of a shorter one do not average out
MAX_TILT = 1.5e-3  # of the mean surface: wind and waves tilt it by less than 1 mm/m
PLANE_SIGNIFICANCE = 4.0  # standard deviations
MAX_PROBE_STEPS = 1500  # of a long record, in its middle
MAX_PROBE_NODES = 2000  # of each step


def first_sentence(text: str) -> str:
    """The first sentence of an explanation.

    Examples
    --------
    >>> first_sentence("It is blurred. Focus it.")
    'It is blurred.'
    """
    return text.partition(". ")[0].rstrip(".") + "."


def remark_on_coverage(seen: float) -> Iterator[Remark]:
    """Report a grid of which the cameras see little in common; ``seen`` is the share of its nodes."""
    if seen < MIN_COVERAGE:
        yield Remark(
            "grid",
            "coverage",
            "grave" if seen < MIN_USEFUL_COVERAGE else "remark",
            f"the cameras have {100 * seen:.2g} % of the grid's nodes in common view",
            "The other nodes are not measured",
            "Check the extent of the grid, which is in metres, or leave it out (`grid: auto`)",
            {"fraction": seen},
        )


def remark_on_holes(measured: float) -> Iterator[Remark]:
    """Report that few of the nodes in view were measured."""
    if measured < MIN_MEASURED:
        yield Remark(
            "surface",
            "holes",
            "grave" if measured < MIN_USEFUL_MEASURED else "remark",
            f"{100 * measured:.0f} % of the nodes in view were measured",
            "The others are filled from their neighbours, or empty",
            "Check seeding, light and whether a camera vibrates; `quality` gives the reason at each node",
            {"fraction": measured},
        )


def remark_on_eps_piv(z: NDArray[np.floating], eps_piv: NDArray[np.floating]) -> Iterator[Remark]:
    """Report if cameras disagree about the motion of the water: median of |eps'|, px, where z is finite."""
    valid = np.isfinite(z) & np.isfinite(eps_piv)
    misfit = float(np.median(np.abs(eps_piv[valid]))) if valid.any() else 0.0
    if misfit > MAX_EPS_PIV:
        yield Remark(
            "velocity",
            "eps'",
            "grave" if misfit > MAX_USEFUL_EPS_PIV else "remark",
            f"the cameras' displacements differ: median eps' {misfit:.2f} px (at most {MAX_EPS_PIV} px)",
            "u, v and w are wrong by about as much",
            "Are the frames of the same moments, and in the same order, for all cameras?",
            {"eps_piv": misfit},
        )


def remark_on_unresolved_waves(
    unresolved: float, wavelength: float, w: float, w_std: float
) -> Iterator[Remark]:
    """Report waves of a wavelength (m) that the images do not resolve, by the standard deviation of their w.

    w is the rms that was measured, w_std its standard uncertainty, which contains them, m/s all.
    """
    share = unresolved**2 / (unresolved**2 + w**2) if unresolved else 0.0
    others = max(w_std**2 - unresolved**2, 0.0)
    if share > MAX_UNRESOLVED or unresolved**2 > (UNRESOLVED_STD**2 - 1.0) * others:
        yield Remark(
            "surface",
            "unresolved waves",
            "remark" if share > MAX_UNRESOLVED else "note",
            f"waves of {100 * wavelength:.3g} cm and less have {100 * share:.3g} % of the variance of w",
            f"The images do not resolve them: they are missing in w, and its standard uncertainty contains"
            f" {1e3 * unresolved:.3g} mm/s for them. Longer waves are right",
            "Take images with smaller pixels to measure them",
            {"fraction": share, "w_std": unresolved},
        )


def remark_on_fast_waves(share: float, wavelength: float, frame_rate: float) -> Iterator[Remark]:
    """Report waves that turn by more than half a turn from frame to frame: their share of the variance of w,
    the longest of them, m, and frames per second. Shorter ones turn further and may not be detected.
    """
    if share > NOTED_FAST:
        yield Remark(
            "record",
            "unresolved waves",
            "remark" if share > MAX_UNRESOLVED else "note",
            f"waves of {100 * wavelength:.3g} cm and less have {100 * share:.3g} % of the variance of w",
            f"They are aliased at {frame_rate:.3g} Hz: their velocities are not measured, and the standard"
            " uncertainties may be too small. Longer waves are right",
            "Raise the frame rate to twice as much or more",
            {"fraction": share, "wavelength": wavelength},
        )


def remark_on_steps(status: Status) -> Iterator[Remark]:
    """Report steps that failed, or that have bad frames around them."""
    if status.failed:
        everything = status.failed == status.steps
        yield Remark(
            "record",
            "failed steps",
            "grave" if everything else "remark",
            f"{'all' if everything else status.failed} of {status.steps} steps could not be measured, "
            f"from frame {spell_ranges(status.failed_steps, 3)}",
            "They are NaN",
            "Check these frames: are they present, bright and seeded in all cameras, which do not vibrate?",
            {"failed": status.failed, "steps": status.steps},
        )
    if status.faulty:
        yield Remark(
            "record",
            "bad frames",
            "remark" if status.faulty > NOTED_FAULTY * status.steps else "note",
            f"{status.faulty} of {status.steps} steps have bad frames around them",
            "They are measured with fewer frames, less accurately",
            "Copy these frames again and run the same command",
            {"faulty": status.faulty, "steps": status.steps},
        )


def remark_on_cameras_left_out(quality: NDArray[np.uint16], cameras: Sequence[str]) -> Iterator[Remark]:
    """Report cameras without which many nodes were measured."""
    has_value = (quality & np.uint16(Quality.MEASURED | Quality.FILLED)) != 0
    for number, camera in enumerate(cameras):
        bit = np.uint16(Quality.without(number) & ~Quality.FEWER_CAMERAS)
        fraction = float(((quality & bit) != 0)[has_value].mean()) if has_value.any() else 0.0
        if fraction > NOTED_WITHOUT_CAMERA:
            yield Remark(
                camera,
                "left out",
                "remark" if fraction > MAX_WITHOUT_CAMERA else "note",
                f"{100 * fraction:.1f} % of the nodes were measured without {camera}",
                "Its frame was missing, or contradicted the others there; these nodes are less accurate",
                f"Check the images of {camera}: a drop on its window, a reflection, focus, vibration?",
                {"fraction": fraction},
            )


def remark_on_rest(experiment: Experiment, rig: Rig, level_std: float = float("nan")) -> Remark:
    """Report what z = 0 is; ``level_std`` is its uncertainty, metres."""

    def note(found: str, means: str, remedy: str = "", weight: Weight = "note", **values: float) -> Remark:
        return Remark("rig", "water level", weight, found, means, remedy, values)

    if experiment.settings.get("sheet_thickness") is not None:
        return _remark_on_sheet(experiment, rig)
    found = rig.provenance.get("levelled")
    if isinstance(found, dict) and {"height_m", "rms_m", "points"} <= set(found):
        height, rms = float(found["height_m"]), float(found["rms_m"])
        remedy = ""
        if BEAD_HEIGHTS_M[0] < height < BEAD_HEIGHTS_M[1] and "bead_height" not in experiment.settings:
            remedy = (
                "If the target's plane was the water's level, beads show so far above it, and "
                f"`settings: {{bead_height: {height:.2g}}}` corrects u and v"
            )
        return note(
            f"{found['points']} points of the water at rest were {1e3 * height:+.2f} mm from the target's "
            f"plane, {1e3 * rms:.2f} mm rms about their own",
            "z = 0 is the water at rest",
            remedy,
            height_m=height,
            rms_m=rms,
        )
    if isinstance(found, dict) and "camera_height_m" in found:
        tilt, height_std = found["tilt_std_deg"], found["camera_height_std_m"]
        certain = f"its tilt is uncertain by {tilt:.2g} degrees, " if np.isfinite(tilt) else ""
        certain += (
            f"{next(iter(rig))} is {spell_uncertain(found['camera_height_m'], height_std, 'm')} above it"
        )
        certain += "" if np.isfinite(height_std) else ", uncertainty unknown"
        return note(f"{found['by']}; {certain}", "z = 0 is the mean surface of moving water")
    if experiment.rest:
        file = experiment.path.name
        return note(
            "the rig was made without the still-water record that the experiment names",
            "z = 0 is the target's plane, not the water at rest",
            f"Run `wavefield calibrate {file}` again, or `wavefield refine {file}` for the rig of another "
            "program",
            "remark",
        )
    uncertain = f", uncertain by {1e3 * level_std:.2g} mm" if level_std > 0 else ""
    return note(
        "there is no still-water record",
        f"z = 0 is the target's plane{uncertain}; visible beads are above the water, which lowers u and v of "
        "12 cm waves by about 2 %",
        "Record some twenty frames of still, seeded water and name them with the key `rest`",
        "note",
        **({"level_std_m": level_std} if level_std > 0 else {}),
    )


def remark_on_mean_plane(cube: "xr.Dataset") -> Iterator[Remark]:
    """Report a mean surface of the record that is tilted or far from z = 0.

    A plane is fitted to each of some steps; steps within a second count as one: they see the same waves.
    """
    steps = from_first_to_last(cube.sizes["time"], MAX_PLANE_STEPS)
    independent = min(len(steps), int(cube.sizes["time"] / float(cube.attrs["frame_rate"])))
    if independent < MIN_SECONDS:
        return
    every = slice(None, None, max(1, int(np.sqrt(cube.z[0].size / MAX_PROBE_NODES))))
    z = cube.z.isel(time=steps, y=every, x=every)
    x, y = (part.ravel() for part in np.meshgrid(z.x - float(cube.x.mean()), z.y - float(cube.y.mean())))
    planes = []
    for one in z.values.reshape(len(steps), -1).astype(float):
        known = np.isfinite(one)
        if known.sum() > 0.5 * one.size:
            design = np.stack([np.ones(known.sum()), x[known], y[known]], axis=-1)
            planes.append(np.linalg.lstsq(design, one[known], rcond=None)[0])
    if len(planes) < 0.5 * len(steps):
        return
    (height, *slope), std = np.mean(planes, axis=0), np.std(planes, axis=0) / np.sqrt(independent)
    tilt, uncertain = float(np.hypot(*slope)), float(np.hypot(*std[1:]))
    level_std = float(cube.get("z_level_std", 0.0))
    tilted = tilt > max(MAX_TILT, PLANE_SIGNIFICANCE * uncertain)
    elsewhere = abs(height) > PLANE_SIGNIFICANCE * np.hypot(level_std, std[0])
    if tilted or elsewhere:
        yield Remark(
            "rig",
            "water level",
            "remark",
            f"the mean surface of the record is {1e3 * height:+.2g} mm from z = 0 in the middle of the grid "
            f"and tilted by {1e3 * tilt:.2g} +- {1e3 * uncertain:.1g} mm/m",
            "The target was not on the water, or not level: z is relative to the target's plane",
            "Run `wavefield rig level`, `wavefield refine` with still water, or subtract the plane",
            {"height_m": float(height), "tilt": tilt, "tilt_std": uncertain},
        )


def _remark_on_sheet(experiment: Experiment, rig: Rig) -> Remark:
    def remark(weight: Weight, found: str, means: str, remedy: str = "", **values: float) -> Remark:
        return Remark("rig", "light sheet", weight, found, means, remedy, values)

    sheet = rig.provenance.get("light_sheet")
    if not isinstance(sheet, dict) or "height_m" not in sheet:
        return remark(
            "remark",
            "the position of the light sheet has not been determined",
            "z = 0 is the target's plane; displacements are taken at wrong places if the sheet is elsewhere",
            f"Run `wavefield rig sheet {experiment.path.name} -o sheet.yaml`, and use that rig",
        )
    height, elsewhere = float(sheet["height_m"]), float(sheet.get("elsewhere_m", 0.0))
    if elsewhere > 0:
        return remark(
            "remark",
            "a camera has moved since the calibration; two cameras do not show which, nor how far along "
            "their parallax",
            f"All places in the sheet may be off by {1e3 * elsewhere:.1f} mm",
            "Calibrate again, or add a third camera",
            height_m=height,
            elsewhere_m=elsewhere,
        )
    return remark(
        "note",
        f"the middle of the light sheet was {round(1e3 * height, 2) + 0.0:+.2f} mm from the target's plane",
        "z = 0 is the middle of the light sheet",
        height_m=height,
    )


def remark_on_probe_file(experiment: Experiment, span: tuple[float, float]) -> Iterator[Remark]:
    """Report probes that cannot be read, or that were recorded at other times than the frames (s)."""
    try:
        probes = experiment.read_probes()
    except ExperimentError as error:
        yield Remark(
            "probes", "probe", "remark", str(error), "They are ignored", "Correct the file, or `probes:`"
        )
        return
    if probes is None:
        return
    first, last = float(probes["time"][0]), float(probes["time"][-1])
    if first > span[1] or last < span[0]:
        yield Remark(
            "probes",
            "probe",
            "remark",
            f"they were recorded from {first:g} to {last:g} s, the frames from {span[0]:g} to {span[1]:g} s",
            "They have no time in common and cannot be compared",
            "State the difference of the clocks as `clock` in `probes:`",
            {"first": first, "last": last},
        )


def compare_probes(experiment: Experiment, cube: "xr.Dataset") -> "tuple[list[ProbeFit], float]":
    """How the probes of an experiment fit the elevation of its cube, and the interval of its steps, s.

    Of a long record the middle is compared, thinned in space.
    """
    from wavefield.waves.probes import fit_probes  # imports all of the analysis

    every = slice(None, None, max(1, int(np.sqrt(cube.z[0].size / MAX_PROBE_NODES))))
    first = max(0, (len(cube.z) - MAX_PROBE_STEPS) // 2)
    z = cube.z.isel(time=slice(first, first + MAX_PROBE_STEPS), y=every, x=every).load()
    dt = float(z["time"][1] - z["time"][0]) if len(z) > 1 else 1.0
    return fit_probes(z, experiment.read_probes()), dt


def remark_on_fits(fits: "Sequence[ProbeFit]", dt: float) -> Iterator[Remark]:
    """Report what does not fit of each probe."""
    for fit in fits:
        values = {"correlation": fit.peak_correlation, "best": fit.best, "lag": fit.lag, "gain": fit.gain}
        for found, remedy in fit.problems(dt):
            means = "The probe and the measured elevation contradict each other"
            yield Remark(f"probe {fit.name}", "probe", "remark", found, means, remedy, values)


def remark_on_probes(
    experiment: Experiment, cube: "xr.Dataset", span: tuple[float, float]
) -> Iterator[Remark]:
    """Report what is wrong with the probes of an experiment, or between them and its cube."""
    of_file = list(remark_on_probe_file(experiment, span))
    yield from of_file
    if experiment.probes and not of_file:
        yield from remark_on_fits(*compare_probes(experiment, cube))
