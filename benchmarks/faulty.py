"""Cameras that lie are named, sound ones are not: `wavefield check`'s look at the images, half size.

    python -m benchmarks.faulty [--only sound named delay] [--seeds 20 [--first 101]]

Sound: seeds that raise any remark. Named: mirrored, swapped, a frame late, reversed, out of focus, half
covered, knocked (across and along the parallax). Delay: of a camera by .2 ms on a moving sea, and of none.
Images alone are looked at, by exact cameras; nothing is measured.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import HALF
from wavefield.measurement import GridGeometry, Settings
from wavefield.quality.camera_delay import delays, remarks
from wavefield.quality.camera_faults import CameraFaults, find_camera_faults
from wavefield.quality.patch_matching import PatchMatcher
from wavefield.store.verdict import Remark
from wavefield.tank import Scene, Tank

COUNT, LOOKS = 8, (1, 3, 5, 6)
INSTANTS = range(2, 50, 2)  # of a delay
FIRST = 101  # seed; none of them was tuned on

Read = Callable[[str, int], NDArray[Any]]


def shots(seed: int, frames: int = COUNT, **faults: Any) -> tuple[Tank, Read]:
    """A tank, and its images from memory."""
    tank = Tank(Scene.load("full").with_(seed=seed, faults=faults, frames=frames, **HALF))
    drawn = [tank.render(k) for k in range(frames)]
    return tank, lambda name, frame: drawn[frame][name]


def look(tank: Tank, read: Read) -> CameraFaults:
    """As `wavefield check` looks at cameras."""
    return find_camera_faults(PatchMatcher(read, tank.rig, tank.scene.grid), COUNT, LOOKS)


def clocks(tank: Tank, read: Read) -> list[Remark]:
    """As `wavefield check` looks at their clocks."""
    witness, geometry = (
        PatchMatcher(read, tank.rig, tank.scene.grid),
        GridGeometry(tank.rig, tank.scene.grid, Settings()),
    )
    return list(remarks(*delays(geometry, None, witness, (2, 3, 4, 5), tank.scene.frame_rate)))


def sound(options: argparse.Namespace) -> None:
    """Seeds that raise an alarm though nothing is wrong."""
    alarms = []
    for seed in range(options.first, options.first + options.seeds):
        images = shots(seed)
        found = [*look(*images).remarks, *clocks(*images)]
        alarms += [f"seed {seed}: {remark}" for remark in found]
    print(f"sound seeds with an alarm: {len(alarms)} of {options.seeds} (asked 0)")
    print("".join(f"    {alarm}\n" for alarm in alarms), end="", flush=True)


def named(options: argparse.Namespace) -> None:
    """Faults that are named rightly."""
    tank, read = shots(FIRST + 50)

    def reverse(name: str, frame: int) -> NDArray[Any]:
        return read(name, COUNT - 1 - frame if name == "cam2" else frame)

    def cover(name: str, frame: int) -> NDArray[Any]:
        image = np.array(read(name, frame))
        if name == "cam3":
            image[:, : image.shape[1] // 2] = 3
        return image

    def swap(name: str, frame: int) -> NDArray[Any]:
        return read({"cam1": "cam2", "cam2": "cam1"}.get(name, name), frame)

    def late(name: str, frame: int) -> NDArray[Any]:
        return read(name, max(frame - 1, 0) if name == "cam1" else frame)

    def mirror(name: str, frame: int) -> NDArray[Any]:
        image = read(name, frame)
        return image[:, ::-1] if name == "cam1" else image

    cases: list[tuple[str, set[str], str, Read]] = [
        ("mirrored", {"cam1"}, "mirrored", mirror),
        ("swapped", {"cam1 and cam2"}, "swapped", swap),
        ("a frame late", {"cam1"}, "late", late),
        ("reversed", {"cam2"}, "reversed", reverse),
        ("out of focus by 3 px", {"cam1"}, "out of focus", shots(FIRST + 50, cam1={"defocus": 3.0})[1]),
        ("half covered", {"cam3"}, "covered", cover),
        ("knocked by 1 px across", {"cam1"}, "moved", shots(FIRST + 50, cam1={"shift": (0.0, 1.0)})[1]),
        ("knocked by 1 px along", {"rig"}, "moved", shots(FIRST + 50, cam1={"shift": (1.0, 0.0)})[1]),
    ]
    right = 0
    for what, subjects, kind, images in cases:
        seen = look(tank, images).remarks
        good = [(r.subject in subjects, r.kind) for r in seen] == [(True, kind)]
        right += good
        print(f"    {what}: {'; '.join(f'{r.subject} {r.kind}' for r in seen) or 'nothing'}", flush=True)
    print(f"faults named rightly: {right} of {len(cases)}")


def delay(options: argparse.Namespace) -> None:
    """A delay of .2 ms, and of none: found, and how sure."""
    for seed, late in ((FIRST + 60, 2e-4), (FIRST + 61, 2e-4), (FIRST + 62, 0.0)):
        tank, read = shots(seed, max(INSTANTS) + 3, cam2={"delay": late})
        witness = PatchMatcher(read, tank.rig, tank.scene.grid)
        geometry = GridGeometry(tank.rig, tank.scene.grid, Settings())
        found, _ = delays(geometry, None, witness, tuple(INSTANTS), tank.scene.frame_rate)
        words = ", ".join(f"{n} {1e3 * d.seconds:+.4f} +- {1e3 * d.std:.4f}" for n, d in found.items())
        print(f"    cam2 late by {1e3 * late:g} ms, found (ms): {words or 'nothing'}", flush=True)


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {"sound": sound, "named": named, "delay": delay}


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=FIRST, help="seed of the first sound experiment")
    options = parser.parse_args(words)
    for name in options.only:
        began = time.process_time()
        PARTS[name](options)
        print(f"({name}: CPU {time.process_time() - began:.0f} s)", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
