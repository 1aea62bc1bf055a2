"""Conditions drawn at random: are measured nodes wrong by five standard uncertainties without a warning?

    python -m benchmarks.waters [--draws 40] [--seed 0] [--only NUMBER ...] [--fault NAME] [--workers 1]

Every draw is a record of nine frames of a part of every sensor, with exact cameras: a sea (peak from 4 cm to
3 m; band, slope, direction and spread; no higher than 0.6 of the depth), a current to 0.8 m/s, the depth, the
frame rate, the size of a pixel, light, seeding, two to four cameras, and in every second draw one fault of
the frames' times, of the beads or of the view. It is checked and measured as a user would, with
`wavefield.check` and `wavefield.run`. Counted are the nodes 4 cm (20 pixels where these are small) inside the
edge of the common view, of all steps; those that are flagged as measured and wrong by more than five standard
uncertainties in z, u, v or w; and whether `check` or the verdict of the run has a remark. A draw fails if
more than 1 % of its nodes are wrong and there is no remark. ``--only`` repeats single draws; ``--fault``
gives every draw the same fault.
"""

import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

import wavefield as wf
from benchmarks.results import parser_of
from benchmarks.scenes import Case, inside
from wavefield.errors import WavefieldError
from wavefield.images import write_image
from wavefield.tank import Scene, Tank
from wavefield.tank.truth import truth
from wavefield.variables import Quality

FRAMES = 9
CROP = 0.22  # of every sensor, along both axes
NAMES = ("z", "u", "v", "w")
MAX_WRONG = 0.01  # of the judged nodes, without a remark
MIN_LIGHT = 0.2  # of a camera's median: with less, flicker has blackened a frame, which is a fault
MIN_MEASURED = 0.7  # of them: with fewer, holes are remarked upon with reason
MAX_HEIGHT = 0.6  # of waves, of a sea the significant one, over the depth
FAULTS = (
    "duplicated", "lost", "duplicated in one", "lost in one", "jitter, with stamps",
    "late", "rolling shutter", "ripples", "submerged beads", "floating object", "blurred camera",
)  # fmt: skip

Images = dict[str, list[NDArray[Any] | None]]


@dataclass
class Conditions:
    """One draw: the scene, its fault and what of it the experiment file has to state."""

    number: int
    scene: Scene
    fault: str
    frame: int  # at which a fault of single frames happens
    camera: str  # the camera that a fault of one camera concerns
    text: str


@dataclass
class Outcome:
    """What became of a draw."""

    text: str
    wrong: float = 0.0  # share of the judged nodes that are flagged as measured and wrong by five std
    measured: float = 0.0
    within: dict[str, tuple[float, float]] = field(default_factory=dict)  # shares within one and two std
    remarks: tuple[str, ...] = ()
    refused: str = ""
    seconds: float = 0.0

    @property
    def failed(self) -> bool:
        """Wrong without a warning."""
        return self.wrong > MAX_WRONG and not self.remarks and not self.refused

    @property
    def sound(self) -> bool:
        """Without a fault, measured and right: any remark is a false alarm."""
        right = self.wrong <= MAX_WRONG and self.measured >= MIN_MEASURED
        return self.text.endswith("no fault") and right and not self.refused

    @property
    def false_alarm(self) -> bool:
        """Sound, with a remark."""
        return self.sound and bool(self.remarks)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is evenly distributed."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_sea(rng: np.random.Generator, period: float) -> tuple[dict[str, Any], str]:
    """A sea and its description."""
    peak, slope = log_uniform(rng, 0.04, 3.0), log_uniform(rng, 0.01, 0.2)
    direction = float(rng.uniform(0, 360))
    kind = rng.choice(["single", "band", "wide", "still"], p=[0.15, 0.35, 0.45, 0.05])
    if kind == "still":
        return {"kind": "still"}, "still water"
    if kind == "single":
        amplitude = np.sqrt(2) * slope * peak / (2 * np.pi)
        wave = {"kind": "single", "wavelength": peak, "amplitude": float(amplitude), "direction": direction}
        return wave, f"one wave of {100 * peak:.1f} cm, slope {slope:.3f}"
    longest = peak * float(rng.uniform(1.15, 1.6)) if kind == "band" else np.inf
    shortest = max(peak / float(rng.uniform(1.15, 1.6)) if kind == "band" else peak / 8, 0.04)
    shape: dict[str, Any] = {"kind": "power", "peak": 1.0, "exponent": 3.0}
    if kind == "wide":
        frequency = float(np.sqrt(9.81 / (2 * np.pi * peak)))
        shape = {"kind": "jonswap", "peak": frequency, "enhancement": float(rng.uniform(1, 5))}
    sea = {
        "kind": "random", "rms": slope * peak / (2 * np.pi), "spectrum": shape, "direction": direction,
        "spread": float(rng.choice([0.0, 2.0, 10.0, 40.0])), "shortest": shortest,
        "longest": max(longest, 1.3 * shortest), "period": max(period, 4.2 * shortest, 2.5 * peak),
    }  # fmt: skip
    return sea, f"{kind} sea at {100 * peak:.1f} cm, slope {slope:.3f}, spread {sea['spread']:.0f}"


def draw_conditions(seed: int, number: int, asked: str | None = None) -> Conditions:
    """Conditions of one number of a seed, with the fault asked for or one that is drawn."""
    rng = np.random.default_rng([seed, number])
    scale = log_uniform(rng, 0.4, 2.0)  # of the image: a pixel of 0.9 to 4.5 mm
    crop = min(CROP / scale, 0.9)
    half = np.array([0.9, 0.7]) * crop  # of the nodes, m
    sea, text = draw_sea(rng, period=2.0)
    speed, towards = float(rng.uniform(0, 0.8) * (rng.random() < 0.5)), float(rng.uniform(0, 2 * np.pi))
    sea |= {"current": (speed * np.cos(towards), speed * np.sin(towards))}
    sea |= {"depth": float(rng.choice([np.inf, 0.7, log_uniform(rng, 0.05, 0.7)]))}
    for size, part in (("rms", 0.25), ("amplitude", 0.5)):  # higher waves break
        if sea.get(size, 0.0) > part * MAX_HEIGHT * sea["depth"]:
            sea[size], text = part * MAX_HEIGHT * sea["depth"], f"{text}, as high as depth allows"
    rate = log_uniform(rng, 10.0, 100.0)
    drawn = str(rng.choice(FAULTS)) if rng.random() < 0.5 else ""
    fault = drawn if asked is None else asked
    beads = {
        "density": log_uniform(rng, 0.4, 1.6) * 1.1e4 * scale**2, "brightness": log_uniform(rng, 50, 200),
        "clustered": float(rng.choice([0.0, 0.0, 0.3])), "one_camera": float(rng.choice([0.0, 0.0, 0.1])),
        "diameter": 0.7e-3 / scale,
    }  # fmt: skip
    light = {
        "blur": float(rng.uniform(0.5, 1.1)), "background": float(rng.uniform(5, 35)),
        "read_noise": log_uniform(rng, 0.8, 6.0), "flicker": float(rng.choice([0.0, 0.1, 0.3])),
    }  # fmt: skip
    cameras = int(rng.choice([2, 3, 3, 3, 4]))
    camera, frame = f"cam{rng.integers(1, cameras + 1)}", int(rng.integers(3, FRAMES - 2))
    scene: dict[str, Any] = {
        "name": "waters", "seed": int(rng.integers(2**31)), "frames": FRAMES + 1, "frame_rate": rate,
        "grid": {"x": (-round(half[0], 2), round(half[0], 2)), "y": (-round(half[1], 2), round(half[1], 2)),
                 "step": 0.01},
        "rig": {"scale": scale, "crop": crop, "cameras": cameras}, "light": light, "faults": {},
    }  # fmt: skip
    if fault.startswith("jitter"):
        scene["timing"] = {"jitter": log_uniform(rng, 0.01, 0.1) / rate}
    elif fault == "late":
        scene["faults"] = {camera: {"delay": float(rng.uniform(0.05, 1.0)) / rate}}
    elif fault == "rolling shutter":
        rows = 1728 * scale * crop
        row_time = min(log_uniform(rng, 1e-3, 1e-2), 0.8 / rate) / rows
        scene["faults"] = {f"cam{n + 1}": {"row_time": row_time} for n in range(cameras)}
    elif fault == "ripples":
        lengths = np.exp(rng.uniform(np.log(0.01), np.log(0.04), 12))
        slope = log_uniform(rng, 0.02, 0.1)
        sea["added"] = [
            {"wavelength": float(length), "amplitude": float(slope * length / (2 * np.pi) * np.sqrt(2 / 12)),
             "direction": float(rng.uniform(0, 360)), "phase": float(rng.uniform(0, 360))}
            for length in lengths
        ]  # fmt: skip
    elif fault == "submerged beads":
        beads["submerged"] = float(rng.uniform(0.05, 0.4))
    elif fault == "blurred camera":
        scene["faults"] = {camera: {"defocus": float(rng.uniform(0.5, 2.5))}}
    made = Scene.model_validate(scene | {"sea": sea, "surface": beads})
    text = (
        f"{text}; current {speed:.2f} m/s, depth {sea['depth']:.2g} m, {rate:.0f} Hz, {cameras} cameras, "
        f"{1.8 / scale:.1f} mm/px; {fault or 'no fault'}"
    )
    return Conditions(number, made, fault, frame, camera, text)


def faulty_cameras(conditions: Conditions, tank: Tank) -> set[str]:
    """The cameras whose frames are repeated or lost: the drawn one or all."""
    names = list(tank.rig)
    count = 1 if conditions.fault.endswith(" in one") else len(names)
    first = names.index(conditions.camera)
    return {names[(first + k) % len(names)] for k in range(count)}


def take_images(conditions: Conditions, tank: Tank) -> Images:
    """Frames as they are stored: with frames repeated, lost or covered."""
    taken = [tank.render(frame) for frame in range(conditions.scene.frames)]
    order = {name: list(range(FRAMES)) for name in tank.rig}
    concerned = faulty_cameras(conditions, tank)
    images: Images = {}
    for name, numbers in order.items():
        if name in concerned and conditions.fault.startswith("duplicated"):
            numbers[conditions.frame] = conditions.frame - 1
        if name in concerned and conditions.fault.startswith("lost"):  # and the numbers go on
            numbers[conditions.frame :] = range(conditions.frame + 1, FRAMES + 1)
        images[name] = [taken[number][name] for number in numbers]
    if conditions.fault == "floating object":
        for name, frames in images.items():
            images[name] = [cover(tank, name, frame, k) for k, frame in enumerate(frames)]
    return images


def cover(tank: Tank, name: str, image: NDArray[Any] | None, frame: int) -> NDArray[Any]:
    """The image with a grey disc of 5 cm that drifts 3 cm above the water at 0.1 m/s."""
    assert image is not None
    angle = np.linspace(0, 2 * np.pi, 60)
    x = 0.025 * np.cos(angle) + 0.03 + 0.1 * frame / tank.scene.frame_rate
    column, row = tank.rig[name].project(x, 0.025 * np.sin(angle), np.full(60, 0.03))
    outline = np.round(np.stack([column, row], axis=-1)).astype(np.int32)
    return np.asarray(cv2.fillPoly(image.copy(), [outline], 90))


def has_dark_frame(images: Images) -> bool:
    """Whether flicker has left one of the frames of a camera nearly without light."""
    light = [[float(np.std(np.asarray(frame))) for frame in frames] for frames in images.values()]
    return any(min(one) < MIN_LIGHT * float(np.median(one)) for one in light)


def write_experiment(conditions: Conditions, tank: Tank, folder: Path) -> Path:
    """The record as files, with the exact cameras."""
    images = take_images(conditions, tank)
    if has_dark_frame(images):
        conditions.text = conditions.text.replace("no fault", "a dark frame")
    for name, frames in images.items():
        for number, image in enumerate(frames):
            write_image(folder / name / f"img_{number:05d}.tif", np.asarray(image))
    tank.rig.save(folder / "rig.yaml")
    grid = conditions.scene.grid
    note: dict[str, Any] = {
        "name": "waters", "frame_rate": conditions.scene.frame_rate, "rig": "rig.yaml",
        "cameras": {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in tank.rig},
        "grid": {"x": list(grid.x), "y": list(grid.y), "step": grid.step},
    }  # fmt: skip
    if conditions.fault == "jitter, with stamps":
        for name in tank.rig:
            lines = [f"{number} {tank.frame_time(number):.7f}" for number in range(FRAMES)]
            (folder / f"{name}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
            note["cameras"][name]["times"] = f"{name}.txt"
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump(note, sort_keys=False), encoding="utf-8")
    return path


def compare(
    conditions: Conditions, tank: Tank, cube: Any
) -> tuple[float, float, dict[str, tuple[float, float]]]:
    """Share of the nodes that are wrong, share flagged as measured, shares within one and two std."""
    scene = conditions.scene
    case = Case(tank.rig, scene.grid, scene.frame_rate, {}, ())
    nodes = wrong = measured = 0
    # stamps have no zero of their own: the even times of the cube are theirs on average
    late = [tank.frame_time(k) - scene.time(k) for k in range(FRAMES)]
    clock = float(np.mean(late)) if conditions.fault == "jitter, with stamps" else 0.0
    ratios: dict[str, list[NDArray[np.float64]]] = {name: [] for name in NAMES}
    margin = min(0.04, 20 * 1.8e-3 / scene.rig.scale)
    # the time of a step is that of most cameras
    lost = conditions.fault.startswith("lost")
    most_ahead = lost and 2 * len(faulty_cameras(conditions, tank)) > len(tank.rig)
    for step in range(cube.sizes["time"]):
        shown = step + (most_ahead and step >= conditions.frame)
        when = (
            float(cube.time[step])
            - float(cube.time[0])
            + scene.start
            + (0.5 + shown - step) / scene.frame_rate
        )
        when += clock
        exact = vars(truth(tank.basin, scene.grid, when, 1.0 / scene.frame_rate))
        judged = inside(case, exact["z"], margin)
        flagged = judged & ((cube.quality.values[step] & int(Quality.MEASURED)) > 0)
        off = np.zeros_like(judged)
        for name in NAMES:
            ratio = np.abs(cube[name].values[step] - exact[name]) / cube[f"{name}_std"].values[step]
            off |= ~(ratio <= 5)
            ratios[name].append(ratio[flagged])
        nodes, measured, wrong = (
            nodes + int(judged.sum()),
            measured + int(flagged.sum()),
            wrong + int((off & flagged).sum()),
        )
    joined = {name: np.concatenate(parts) for name, parts in ratios.items()}
    shares = {
        name: (float(np.mean(values <= 1)), float(np.mean(values <= 2)))
        for name, values in joined.items()
        if values.size
    }
    return wrong / max(nodes, 1), measured / max(nodes, 1), shares


def one_draw(seed: int, number: int, fault: str | None = None) -> Outcome:
    """Simulate, check, measure and compare one draw."""
    conditions, began = draw_conditions(seed, number, fault), time.process_time()
    outcome = Outcome(f"{number:4d}  {conditions.text}")
    folder = Path(tempfile.mkdtemp(prefix="waters-"))
    try:
        tank = Tank(conditions.scene)
        path = write_experiment(conditions, tank, folder)
        outcome.text = f"{number:4d}  {conditions.text}"
        found = wf.check(path)
        refusals = [str(problem) for problem in found.problems]
        verdicts = [found.verdict] if found.verdict else []
        if found.problems:
            outcome.refused = refusals[0]
        else:
            wf.run(path, workflow=wf.Workflow(cluster="none"))
            verdict = wf.status(folder / "cube.zarr").verdict
            verdicts += [verdict] if verdict else []
            outcome.wrong, outcome.measured, outcome.within = compare(
                conditions, tank, wf.open_cube(folder / "cube.zarr").load()
            )
        outcome.remarks = tuple(
            f"{one.subject} {one.kind}"
            for verdict in verdicts
            for one in verdict.remarks
            if one.weight != "note"
        )
    except WavefieldError as error:
        outcome.refused = str(error)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    outcome.seconds = time.process_time() - began
    return outcome


def report(outcome: Outcome) -> str:
    """One line on a draw."""
    if outcome.refused:
        return f"{outcome.text}\n      refused: {outcome.refused[:150]}"
    shares = " ".join(f"{100 * outcome.within[n][0]:.0f}" for n in NAMES if n in outcome.within)
    remarks = ", ".join(dict.fromkeys(outcome.remarks)) or "sound"
    return (
        f"{outcome.text}\n      wrong {100 * outcome.wrong:.1f} %, measured {100 * outcome.measured:.0f} %, "
        f"within 1 std {shares} (z u v w); {remarks}{'   <-- WRONG, NOT WARNED' if outcome.failed else ''}"
    )


def summary(outcomes: Sequence[Outcome]) -> str:
    """Counts of all draws, and the shares within one and two standard uncertainties."""
    measured = [one for one in outcomes if not one.refused]
    clean = [one for one in measured if one.within]
    lines = [
        f"{len(outcomes)} draws: {sum(bool(one.refused) for one in outcomes)} refused, "
        f"{sum(bool(one.remarks) for one in measured)} with remarks, "
        f"{sum(one.wrong > MAX_WRONG for one in measured)} with more than 1 % wrong, "
        f"of which without a warning: {sum(one.failed for one in outcomes)}",
        f"{sum(one.sound for one in outcomes)} draws are sound; false alarms: "
        f"{sum(one.false_alarm for one in outcomes)}",
    ]
    for k, asked in enumerate(("68", "95")):
        shares = np.array([one.within[name][k] for one in clean for name in NAMES if name in one.within])
        if shares.size:
            low, middle, high = 100 * np.percentile(shares, (5, 50, 95))
            lines.append(
                f"within {k + 1} std: median {middle:.0f} % (ideal {asked}); "
                f"5th and 95th percentile {low:.0f}, {high:.0f} %"
            )
    return "\n".join(lines)


def run_draws(
    seed: int, numbers: Sequence[int], workers: int, show: Callable[[Outcome], None], fault: str | None = None
) -> list[Outcome]:
    """Outcomes of some draws, in order."""
    outcomes = []
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for outcome in pool.map(partial(one_draw, seed, fault=fault), numbers):
            show(outcome)
            outcomes.append(outcome)
    return outcomes


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", type=int, help="numbers of single draws")
    parser.add_argument("--fault", choices=FAULTS, help="of every draw")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--most", type=int, help="exit status 1 if more draws are wrong without a warning")
    options = parser.parse_args(words)
    outcomes = run_draws(
        options.seed,
        options.only or range(options.draws),
        options.workers,
        lambda one: print(report(one), flush=True),
        options.fault,
    )
    print(
        summary(outcomes), f"seed {options.seed}; CPU {sum(one.seconds for one in outcomes):.0f} s", sep="\n"
    )
    return int(options.most is not None and sum(one.failed for one in outcomes) > options.most)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    sys.exit(main(sys.argv[1:]))
