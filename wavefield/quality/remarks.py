"""Limits and explanations used by all remarks, and the remarks on water level, grid, fields and probes.

A remark is one finding about a measurement. It has a kind, such as "holes", which `explanations.yaml`
explains, and three parts: what was found, what it means for the result, what to do. A step is the interval
between two consecutive frames; a node is a point of the grid.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.store.ledger import Status
from wavefield.store.verdict import Remark, Weight
from wavefield.text import spell_ranges, spell_uncertain
from wavefield.variables import Quality

if TYPE_CHECKING:
    import xarray as xr

# By kind of remark: the text of `wavefield explain`
EXPLANATIONS: dict[str, str] = yaml.safe_load(
    Path(__file__).with_name("explanations.yaml").read_text(encoding="utf-8")
)

SIGNIFICANCE = 4.0  # standard uncertainties: Gaussian noise exceeds them once in 16,000 times
CELLS = 3  # the field is divided into CELLS x CELLS parts, whose errors are taken as independent
MAX_SAMPLES = 2000  # nodes of each step, and steps, that are read; enough for means over the field
MAX_EPS_Y = 0.1  # px: largest epipolar error after a good calibration; more gives a remark
GRAVE_EPS_Y = 0.5  # px: about ten standard uncertainties of z in a sound record
MAX_LOST = 0.1  # fraction of frames, patches, nodes or variance; a larger loss gives a remark
MAX_EPS_PIV = 0.15  # px: median of |eps'|; sound records have less than 0.1


def remark_on_coverage(seen: float) -> Iterator[Remark]:
    """Yield a remark if ``seen``, the fraction of the grid that all cameras see, is less than half."""
    if seen < 0.5:
        sentence = f"all cameras together see {100 * seen:.2g} % of the grid's nodes"
        means = "The other nodes are not measured"
        remedy = "Check the extent of the grid, which is in metres, or leave it out (`grid: auto`)"
        yield Remark("grid", "coverage", "remark", sentence, means, remedy, {"fraction": seen})


def remark_on_holes(measured: float) -> Iterator[Remark]:
    """Yield a remark if ``measured``, the measured fraction of the nodes in view, is less than half."""
    if measured < 0.5:
        sentence = f"only {100 * measured:.0f} % of the nodes in view were measured"
        means = "The others are filled from their neighbours, or empty"
        remedy = "Check seeding, light and the cameras' mounts; `quality` gives the reason at each node"
        yield Remark("surface", "holes", "remark", sentence, means, remedy, {"fraction": measured})


def remark_on_eps_piv(z: NDArray[np.floating], eps_piv: NDArray[np.floating]) -> Iterator[Remark]:
    """Yield a remark if displacements in the images of different cameras do not fit one velocity u, v, w.
    ``eps_piv`` is the residual of this fit, px, and ``z`` the elevation, each (n, ny, nx)."""
    valid = np.isfinite(z) & np.isfinite(eps_piv)
    misfit = float(np.median(np.abs(eps_piv[valid]))) if valid.any() else 0.0
    if misfit > MAX_EPS_PIV:
        sentence = (
            f"the cameras' displacements differ: the median of |eps'| is {misfit:.2f} px (at most "
            f"{MAX_EPS_PIV} px in sound records)"
        )
        means = "u, v and w are wrong by about as much"
        remedy = "Check that the frames of all cameras are of the same moments and in the same order"
        weight: Weight = "grave" if misfit > GRAVE_EPS_Y else "remark"
        yield Remark("velocity", "eps'", weight, sentence, means, remedy, {"eps_piv": misfit})


def remark_on_unresolved_waves(
    fraction: float, wavelength: float, means: str, remedy: str
) -> Iterator[Remark]:
    """Yield a remark if waves that are not resolved cause over a tenth of the variance of w.
    `fraction` is this part of the variance; `wavelength` is that of the longest such waves, m. The sentences
    `means` (effect on the results) and `remedy` (action to take) become parts of the remark."""
    if fraction > MAX_LOST:
        sentence = (
            f"waves of {100 * wavelength:.3g} cm and less have {100 * fraction:.3g} % of the variance of w"
        )
        values = {"fraction": fraction, "wavelength": wavelength}
        yield Remark("surface", "unresolved waves", "remark", sentence, means, remedy, values)


def remark_on_steps(status: Status) -> Iterator[Remark]:
    """Yield remarks on steps (from frame to frame) that were not measured, or measured with bad frames."""
    if status.failed:
        everything = status.failed == status.steps
        yield Remark(
            "record",
            "failed steps",
            "grave" if everything else "remark",
            f"{'all' if everything else status.failed} of {status.steps} steps could not be measured, "
            f"from frame {spell_ranges(status.failed_steps, 3)}",
            "These steps are NaN",
            "Check that these frames are there, bright and seeded in all cameras, and that none vibrates",
            {"failed": status.failed, "steps": status.steps},
        )
    if status.faulty:
        sentence = f"{status.faulty} of {status.steps} steps use frames that are bad"
        means = "They are measured with fewer frames and are less accurate"
        remedy = "Copy these frames again and run the same command"
        weight: Weight = "remark" if status.faulty > MAX_LOST * status.steps else "note"
        values = {"faulty": status.faulty, "steps": status.steps}
        yield Remark("record", "bad frames", weight, sentence, means, remedy, values)


def remark_on_cameras_left_out(quality: NDArray[np.uint16], cameras: Sequence[str]) -> Iterator[Remark]:
    """Yield a remark on each camera that was left out at more than a tenth of the measured nodes.
    ``quality`` (n, ny, nx) holds the bit flags of the cube; ``cameras`` are names in the order of bits."""
    has_value = (quality & np.uint16(Quality.MEASURED | Quality.FILLED)) != 0
    for number, camera in enumerate(cameras):
        bit = np.uint16(Quality.without(number) & ~Quality.FEWER_CAMERAS)
        fraction = float(((quality & bit) != 0)[has_value].mean()) if has_value.any() else 0.0
        if fraction > MAX_LOST:
            sentence = f"{100 * fraction:.1f} % of the nodes were measured without {camera}"
            means = "Its frame was missing, or contradicted the others there; these nodes are less accurate"
            remedy = f"Check {camera} for drops on its window, reflections, focus and vibration"
            yield Remark(camera, "left out", "remark", sentence, means, remedy, {"fraction": fraction})


def remark_on_rest(experiment: Experiment, rig: Rig, level_std: float = float("nan")) -> Remark:
    """Return the remark that names the plane z = 0: water at rest, mean surface, target or light sheet.
    ``level_std`` is the standard uncertainty of this level, m; NaN if unknown."""
    if experiment.settings.get("sheet_thickness") is not None:
        return _remark_on_sheet(experiment, rig)
    weight: Weight = "note"
    remedy, values, found = "", {}, rig.provenance.get("levelled")
    if isinstance(found, dict) and {"height_m", "rms_m", "points"} <= set(found):
        values = {"height_m": float(found["height_m"]), "rms_m": float(found["rms_m"])}
        sentence = (
            f"the water at rest was {1e3 * values['height_m']:+.2f} mm from the target's plane "
            f"({found['points']} points, {1e3 * values['rms_m']:.2f} mm rms about their own plane)"
        )
        means = "z = 0 is the water at rest"
    elif isinstance(found, dict) and "camera_height_m" in found:
        tilt, height_std = found["tilt_std_deg"], found["camera_height_std_m"]
        height = spell_uncertain(found["camera_height_m"], height_std, "m")
        certain = f"its tilt is uncertain by {tilt:.2g} degrees, " if np.isfinite(tilt) else ""
        sentence = f"{found['by']}; {certain}{next(iter(rig))} is {height} above it"
        sentence += "" if np.isfinite(height_std) else ", uncertainty unknown"
        means = "z = 0 is the mean surface of moving water"
    elif experiment.rest:
        weight, file = "remark", experiment.path.name
        sentence = "the experiment names a still-water record, but the rig was made without it"
        means = "z = 0 is the target's plane, not the water at rest"
        remedy = f"Run `wavefield calibrate {file}` again, or `wavefield refine {file}` if another program "
        remedy += "made the rig"
    else:
        values = {"level_std_m": level_std} if level_std > 0 else {}
        uncertain = f", uncertain by {1e3 * level_std:.2g} mm" if level_std > 0 else ""
        sentence = "there is no still-water record"
        means = f"z = 0 is the target's plane{uncertain}; visible beads are above the water, which lowers u "
        means += "and v of 12 cm waves by about 2 %"
        remedy = "Record some twenty frames of still, seeded water and name them with the key `rest`"
    return Remark("rig", "water level", weight, sentence, means, remedy, values)


def _remark_on_sheet(experiment: Experiment, rig: Rig) -> Remark:
    """Return the remark on z = 0 in a light sheet: the height of the sheet, or that it is unknown."""
    sheet = rig.provenance.get("light_sheet")
    if not isinstance(sheet, dict) or "height_m" not in sheet:
        sentence = "the position of the light sheet has not been determined"
        means = "z = 0 is the target's plane; if the sheet is elsewhere, displacements are at wrong positions"
        remedy = f"Run `wavefield rig sheet {experiment.path.name} -o sheet.yaml`, and use that rig"
        return Remark("rig", "light sheet", "remark", sentence, means, remedy)
    height, elsewhere = float(sheet["height_m"]), float(sheet.get("elsewhere_m", 0.0))
    if elsewhere > 0:
        sentence = (
            "a camera has moved since the calibration; two cameras do not show which one, nor how far along "
            "their parallax"
        )
        means = f"All positions in the sheet may be wrong by {1e3 * elsewhere:.1f} mm"
        remedy = "Calibrate again, or add a third camera"
        values = {"height_m": height, "elsewhere_m": elsewhere}
        return Remark("rig", "light sheet", "remark", sentence, means, remedy, values)
    sentence = f"the middle of the light sheet was {1e3 * height:+.2f} mm from the target's plane"
    means = "z = 0 is the middle of the light sheet"
    return Remark("rig", "light sheet", "note", sentence, means, values={"height_m": height})


def remark_on_probe_file(experiment: Experiment, span: tuple[float, float]) -> Iterator[Remark]:
    """Yield a remark if the wave probes cannot be read, or have no time in common with the frames.
    ``span`` holds the times of the first and the last frame, s."""
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
        sentence = (
            f"they were recorded from {first:g} to {last:g} s, the frames from {span[0]:g} to {span[1]:g} s"
        )
        means = "They have no time in common with the frames and cannot be compared"
        remedy = "Give the difference of the clocks as `clock` in `probes:`"
        yield Remark("probes", "probe", "remark", sentence, means, remedy, {"first": first, "last": last})


def remark_on_probes(
    experiment: Experiment, cube: "xr.Dataset", span: tuple[float, float]
) -> Iterator[Remark]:
    """Yield remarks on unusable wave probes, and on probes that contradict the elevation in the cube.
    ``span`` holds the times of the first and the last frame, s."""
    of_file = list(remark_on_probe_file(experiment, span))
    yield from of_file
    if of_file or not experiment.probes:
        return
    from wavefield.waves.probes import fit_probes  # imports all of the analysis

    every = slice(None, None, max(1, int(np.sqrt(cube.z[0].size / MAX_SAMPLES))))
    first = max(0, (len(cube.z) - MAX_SAMPLES) // 2)
    z = cube.z.isel(time=slice(first, first + MAX_SAMPLES), y=every, x=every).load()
    dt = float(z["time"][1] - z["time"][0]) if len(z) > 1 else 1.0
    for fit in fit_probes(z, experiment.read_probes()):
        values = {"correlation": fit.at_zero_lag, "best": fit.best, "lag": fit.lag, "gain": fit.gain}
        for found, remedy in fit.problems(dt):
            means = "The probe and the measured elevation contradict each other"
            yield Remark(f"probe {fit.name}", "probe", "remark", found, means, remedy, values)
