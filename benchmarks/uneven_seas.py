"""Short waves in a part of the field only: do the stated uncertainties hold where they are high?

    python -m benchmarks.uneven_seas [--seeds N ...]

The reference sea of `benchmarks.short_waves`, whose waves below 13 cm are multiplied by an envelope over x:
none at the left edge of the field, all at the right. The envelope is made of free waves. Scored by thirds of
the field.
"""

import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.options import parser_of
from benchmarks.scenes import Case, reconstruct, truths
from benchmarks.scores import Score
from benchmarks.short_waves import described
from wavefield.measurement import Settings
from wavefield.tank import Tank
from wavefield.tank.basin import Basin
from wavefield.tank.sea import Sea

SHORT, ENVELOPE = 0.13, 2.0  # m: the longest wave under the envelope, and the envelope's own length
# (1 + cos)^2 / 4 as a sum of harmonics
HARMONICS = {0: 3 / 8, 1: 1 / 4, -1: 1 / 4, 2: 1 / 16, -2: 1 / 16}


def uneven(sea: Sea, highest_at: float) -> Sea:
    """A sea whose short waves have an envelope with its maximum at an x, metres."""
    short, step = sea.k > 2 * np.pi / SHORT, 2 * np.pi / ENVELOPE
    kx, ky, amplitude = [sea.kx[~short]], [sea.ky[~short]], [sea.amplitude[~short]]
    for n, share in HARMONICS.items():
        kx.append(sea.kx[short] + n * step)
        ky.append(sea.ky[short])
        amplitude.append(sea.amplitude[short] * share * np.exp(-1j * n * step * highest_at))
    waves = np.concatenate(kx), np.concatenate(ky), np.concatenate(amplitude)
    return Sea(*waves, sea.depth, sea.surface_tension, sea.current)


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[921, 922])
    options = parser.parse_args(words)
    thirds = ("calm third", "middle", "rough third")
    scores = {name: Score() for name in thirds}
    for seed in options.seeds:
        scene = described("reference", seed, 0.5)
        tank = Tank(scene)
        tank.basin = Basin(uneven(tank.sea, scene.grid.x[1]), tank.basin.x, tank.basin.y)
        images = [tank.render(k) for k in range(scene.frames)]
        frames = {name: [image[name] for image in images] for name in tank.rig}
        case = Case(tank.rig, scene.grid, scene.frame_rate, frames, truths(tank))
        cube = reconstruct(case, Settings())
        columns = np.arange(cube["z"].shape[2]) * len(thirds) // cube["z"].shape[2]
        for n, name in enumerate(thirds):
            scores[name].add(case, cube | {"quality": np.where(columns == n, cube["quality"], 0)})
    for name, score in scores.items():
        print("\n    ".join([name, *score.lines()[:2]]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
