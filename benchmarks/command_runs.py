"""Experiments of any length, and runs of them through the command line, for benchmarks of commands."""

import shutil
import subprocess
import sys
from pathlib import Path

import psutil

from wavefield.images import write_image
from wavefield.pipeline import open_cube
from wavefield.tank import Scene, Tank
from wavefield.variables import CUBE_FIELDS


def print_row(test: str, asked: str, reached: str) -> None:
    print(f"{test:66s} {asked:>14s}   {reached}", flush=True)


def write_tank(folder: Path, scene: Scene, steps: int, drawn: int = 12) -> Path:
    """An experiment of any length from a few rendered frames, forwards and backwards in turn."""
    path = folder / "experiment.yaml"
    if path.exists():
        return path
    tank = Tank(scene)
    folder.mkdir(parents=True, exist_ok=True)
    tank.rig.save(folder / "rig.yaml")
    turn = [*range(drawn), *range(drawn - 2, 0, -1)]
    for number in range(min(drawn, steps + 1)):
        for camera, image in tank.render(number).items():
            write_image(folder / camera / f"img_{number:05d}.tif", image)
    for camera in tank.rig:
        for number in range(drawn, steps + 1):
            source = folder / camera / f"img_{turn[number % len(turn)]:05d}.tif"
            shutil.copyfile(source, folder / camera / f"img_{number:05d}.tif")
    cameras = "".join(f'  {name}: {{images: "{name}/img_{{frame:05d}}.tif"}}\n' for name in tank.rig)
    grid = scene.grid
    path.write_text(
        f"name: {folder.name}\nframe_rate: {scene.frame_rate}\ncameras:\n{cameras}rig: rig.yaml\n"
        f"grid: {{x: {list(grid.x)}, y: {list(grid.y)}, step: {grid.step}}}\n"
    )
    return path


def small_scene() -> Scene:
    return Scene.load("demo").with_(
        rig={"crop": 0.12},
        sea={"shortest": 0.15},
        grid={"x": [-0.04, 0.04], "y": [-0.06, 0.06], "step": 0.01},
    )


def start(experiment: Path, out: Path, **settings: object) -> subprocess.Popen:
    """A run through the command line."""
    workflow = out.with_suffix(".yaml")
    workflow.write_text("".join(f"{name}: {value}\n" for name, value in settings.items()))
    command = [sys.executable, "-m", "wavefield.commands.cli", "run", str(experiment)]
    command += ["-o", str(out), "--workflow", str(workflow)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def finish(process: subprocess.Popen, expected: tuple[int, ...] = (0,)) -> str:
    text, _ = process.communicate()
    if process.returncode not in expected:
        raise RuntimeError(f"a run ended with {process.returncode}: {text}")
    return text


def workers_of(process: subprocess.Popen) -> list[psutil.Process]:
    """Workers of a run; forked ones are children of the process that forks them."""
    children = psutil.Process(process.pid).children(recursive=True)
    return [c for c in children if c.ppid() != process.pid or "spawn_main" in " ".join(c.cmdline())]


def same(one: Path, other: Path) -> bool:
    a, b = open_cube(one).load(), open_cube(other).load()
    return all(a[n].values.tobytes() == b[n].values.tobytes() for n in (*CUBE_FIELDS, "frame_status"))
