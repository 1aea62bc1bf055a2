"""The record of the wave probes: the elevation at fixed places."""

from pathlib import Path

import numpy as np

from wavefield.atomic_write import NEW_FILE, write_text
from wavefield.tank.scene import Scene
from wavefield.tank.sea import Sea


def write_probes(path: Path, scene: Scene, sea: Sea) -> None:
    """Write the record of a scene's probes, with their noise, as CSV: seconds and metres."""
    settings = scene.probes
    times = np.arange(int(scene.frames / scene.frame_rate * settings.rate) + 1) / settings.rate
    x, y = np.array(list(settings.positions.values()), float).T
    z = np.array([sea.at(x, y, time, ("z",))["z"] for time in times + scene.start])
    z += settings.noise * np.random.default_rng([scene.seed, 10]).standard_normal(z.shape)
    lines = [f"# {name} {x:.6g} {y:.6g}" for name, (x, y) in settings.positions.items()]
    lines.append(",".join(["time", *settings.positions]))
    for time, row in zip(times, z, strict=True):
        lines.append(",".join(f"{value:.6f}" for value in (time, *row)))
    write_text(path, "\n".join(lines) + "\n", NEW_FILE)
