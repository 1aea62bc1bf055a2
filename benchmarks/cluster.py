"""Slurm jobs beside processes of this machine: `benchmarks.cluster FOLDER [WORKERS [STEPS [CROP]]]`.

Needs a Slurm, for example `workflows/one_node_slurm.sh start 4`: jobs of one worker each. FOLDER holds
images of a tank, made where they are not there: of full size, or CROP of it; some frames go to and fro. Each
run is the command, from its start to its end: the jobs' waiting in the queue and their imports count, which
on one machine take turns (on a cluster they do not), some 2 s of a core for each job.
"""

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import wavefield as wf
from wavefield.images import write_image
from wavefield.tank import Scene, Tank

_RENDERED = 13


def write_experiment(folder: Path, steps: int, crop: float) -> Path:
    """Images of a few frames, under as many names as steps need."""
    tank = Tank(Scene.load("full").with_(rig={"crop": crop}))
    folder.mkdir(parents=True, exist_ok=True)
    tank.rig.save(folder / "rig.yaml")
    for number in range(_RENDERED):
        for camera, image in tank.render(number).items():
            write_image(folder / camera / f"img_{number:05d}.tif", image)
    period = 2 * (_RENDERED - 1)
    for number in range(_RENDERED, steps + 1):
        like = min(number % period, period - number % period)
        for camera in tank.rig:
            os.link(folder / camera / f"img_{like:05d}.tif", folder / camera / f"img_{number:05d}.tif")
    path = folder / "experiment.yaml"
    cameras = {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in tank.rig}
    grid = {"x": [-crop, crop], "y": [-0.75 * crop, 0.75 * crop], "step": 0.01}
    data = {"name": "to and fro", "frame_rate": tank.scene.frame_rate, "cameras": cameras, "rig": "rig.yaml"}
    path.write_text(yaml.safe_dump(data | {"grid": grid, "water": {"depth": 0.7}}))
    return path


def timed(experiment: Path, out: Path, workflow: wf.Workflow) -> float:
    """Wall time of a run, s."""
    start = time.perf_counter()
    assert wf.run(experiment, out, workflow=workflow).complete
    return time.perf_counter() - start


def main() -> None:
    """Print both times, their ratio, and whether the cubes are the same."""
    folder = Path(sys.argv[1])
    workers, steps = (int(sys.argv[i]) if len(sys.argv) > i else n for i, n in ((2, 4), (3, 200)))
    crop = float(sys.argv[4]) if len(sys.argv) > 4 else 1.0
    experiment = folder / "experiment.yaml"
    if not experiment.exists():
        write_experiment(folder, steps, crop)
    both: dict[str, dict[str, Any]] = {
        "local": {"cluster": "local"},
        "slurm": {
            "cluster": "slurm",
            "slurm": {"cores": 1, "walltime": "00:20:00", "python": sys.executable},
        },
    }
    times, cubes = {}, {}
    with tempfile.TemporaryDirectory(dir=folder) as place:
        for name, where in both.items():
            workflow = wf.Workflow(workers=workers, memory="1 GB", steps_per_block=5, **where)
            times[name] = timed(experiment, Path(place) / f"{name}.zarr", workflow)
            print(f"{name}, {workers} workers, {steps} steps: {times[name]:.1f} s", flush=True)
            cubes[name] = wf.open_cube(Path(place) / f"{name}.zarr").load()
        print(f"ratio {times['slurm'] / times['local']:.2f}")
        alike = all(
            np.asarray(cubes["local"][name]).tobytes() == np.asarray(cubes["slurm"][name]).tobytes()
            for name in cubes["local"].data_vars
        )
        print("the same to the bit" if alike else "NOT the same")


if __name__ == "__main__":
    main()
