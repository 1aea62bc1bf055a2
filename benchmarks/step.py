"""What a step costs: `python -m benchmarks.step [--half] [--set FILE.yaml] [--profile] [--repeats N]`.

Images in memory, full size (150 x 200 nodes) unless ``--half``; CPU time of one thread, the least of
several, over that of two runs of OpenCV's DIS optical flow (MEDIUM) on 1024 x 1024 in the same run,
because absolute times move with the machine. ``--profile``: where the time goes, function by function.
"""

import cProfile
import pstats
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import yaml

from benchmarks.options import parser_of
from benchmarks.scenes import Case, draw, scene
from wavefield.measurement import GridGeometry, Model, Settings, learn, measure
from wavefield.tank import Tank

STEPS = 3  # steps whose time is the difference between a long block and a short one


def block(case: Case, steps: int) -> Case:
    """The case with its frames repeated back and forth to so many steps."""
    order = [0, 1, 2, 3, 2, 1] * (steps // 6 + 2)
    frames = {name: [images[k] for k in order[: steps + 5]] for name, images in case.frames.items()}
    return Case(case.rig, case.grid, case.frame_rate, frames, ())


def seconds(case: Case, geometry: GridGeometry, model: Model) -> float:
    began = time.process_time()
    measure(case.frames, geometry, case.frame_rate, model)
    return time.process_time() - began


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--half", action="store_true", help="half size")
    parser.add_argument("--set", type=Path, help="YAML of measurement settings that differ")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args(words)
    changed = yaml.safe_load(options.set.read_text()) if options.set else {}
    settings = Settings.from_dict(changed)
    described = scene("random", 71, not options.half)
    case = draw(described.with_(frames=4), Tank(described).rig)
    short, long = block(case, 1), block(case, 1 + STEPS)
    geometry = GridGeometry(case.rig, case.grid, settings)
    began = time.process_time()
    sample = tuple({name: images[k] for name, images in case.frames.items()} for k in (1, 2))
    model = Model(geometry, learn([sample], geometry))
    learned = time.process_time() - began
    full = draw(scene("random", 71, True).with_(frames=4), case.rig) if options.half else case
    first, second = (np.asarray(image) for image in full.frames["cam1"][1:3])
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow.calc(first, second, None)
    seconds(short, geometry, model)  # compiles
    steps, pairs = [], []
    for _ in range(options.repeats):
        steps.append((seconds(long, geometry, model), seconds(short, geometry, model)))
        began = time.process_time()
        flow.calc(first, second, None)
        flow.calc(second, first, None)
        pairs.append(time.process_time() - began)
    least = (min(s[0] for s in steps) - min(s[1] for s in steps)) / STEPS
    size = "half size" if options.half else "full size"
    print(f"a step over two DIS MEDIUM, {size}: {least / min(pairs):.3f}", end="")
    print(f"  ({1e3 * least:.0f} ms; {1e3 * min(pairs):.0f} ms; least of {options.repeats})")
    print(f"learning from one sample step, once per run (four there): {1e3 * learned:.0f} ms")
    if options.profile:
        profile = cProfile.Profile()
        profile.runcall(measure, long.frames, geometry, case.frame_rate, model)
        pstats.Stats(profile).sort_stats("tottime").print_stats(45)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
