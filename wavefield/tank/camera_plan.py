"""What to expect of a scene before simulating it, for those who plan an experiment."""

from typing import Any

import numpy as np

from wavefield.tank import rigs
from wavefield.tank.scene import Scene
from wavefield.tank.scene_parts import Beads
from wavefield.tank.tank import Tank

_BLOCK = 0.04  # the paper's finest correlation box, metres


def summary(scene: Scene) -> dict[str, Any]:
    """Expected resolution, seeding and coverage.

    Examples
    --------
    >>> summary(Scene.load("demo"))["beads_per_block"]
    17.6
    """
    tank = Tank(scene)
    x, y = np.meshgrid(scene.grid.x_nodes, scene.grid.y_nodes)
    seen = {name: tank.rig[name].sees(x, y, 0.0) for name in tank.rig}
    middle = (float(np.mean(scene.grid.x)), float(np.mean(scene.grid.y)))
    beads = scene.surface if isinstance(scene.surface, Beads) else None
    cameras, lean, size = {}, {}, {}
    for name in tank.rig:
        camera = tank.rig[name]
        size[name] = rigs.pixel_footprint(camera)
        lean[name] = np.array([float(d) for d in camera.sight_line(*middle)])
        cameras[name] = {
            "size": camera.size,
            "mm_per_px": tuple(round(1e3 * s, 3) for s in size[name]),
            "incidence": round(float(np.degrees(np.arctan(np.hypot(*lean[name])))), 1),
            "spot": round(tank.spot_width(camera), 2),
            "coverage": round(float(seen[name].mean()), 4),
        }
        if beads:
            cameras[name]["beads_per_pixel"] = round(beads.density * size[name][0] * size[name][1], 4)
    pairs = {}
    names = list(tank.rig)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            shift = lean[b] - lean[a]
            finer = min(np.hypot(*(shift / size[name])) for name in (a, b))
            pairs[f"{a}-{b}"] = {"parallax": round(float(0.01 * finer), 2)}
    fields = tank.sea.on_grid(scene.grid.x_nodes, scene.grid.y_nodes, scene.start)
    speed = np.sqrt(np.mean(fields["u"] ** 2 + fields["v"] ** 2 + fields["w"] ** 2))
    out: dict[str, Any] = {
        "cameras": cameras,
        "pairs": pairs,
        "coverage": round(float(np.logical_and.reduce(list(seen.values())).mean()), 4),
        "sea": {
            "elevation": round(float(fields["z"].std()), 4),
            "slope": round(float(np.sqrt(np.mean(fields["z_x"] ** 2 + fields["z_y"] ** 2))), 4),
            "w": round(float(fields["w"].std()), 4),
            "motion": round(float(1e3 * speed / scene.frame_rate), 2),
        },
        "frames": scene.frames,
        "megabytes": round(
            scene.frames * scene.light.bits / 8e6 * sum(np.prod(tank.rig[name].size) for name in names)
        ),
    }
    if beads:
        out["beads_per_block"] = round(beads.density * _BLOCK**2, 1)
    return out
