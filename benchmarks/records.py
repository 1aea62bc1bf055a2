"""Other records of the same sea: waves added to it or missing, other frame rates, other seeding.

    python -m benchmarks.records [--only waves shortest rate seeding current jitter] [--seeds N ...]

Waves: of 20, 12 and 8 cm, slope 0.03 each, are added to the random sea: their gain in z and w,
in good and in poor light. Shortest: four scenes without waves below 8 cm, where they have them down to 5 cm:
half of the squared error of velocities is that of waves of 5 to 7 cm. Rate: half and twice as many frames per
second. Seeding: a third and three times the beads. Current: of 0.72 m/s, 20 px a frame,
which sweeps short waves past a node, and still water: the random sea and one that is lower (JONSWAP).
Jitter: frames whose times depart from even ones by 1 ms rms, the same in all cameras, with time stamps and
without; exact cameras. Half size (see `benchmarks.scenes`), calibrated cameras.
"""

import argparse
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.options import run_parts
from benchmarks.scenes import SEEDS, Case, calibrated, draw, inside, reconstruct, scene
from benchmarks.scores import Score
from wavefield.measurement import GridGeometry, LearnedRecord, Model, Settings, learn, measure, sample_steps
from wavefield.measurement.resolution import gains as theory

SLOPE = 0.03
WAVES = {0.20: 30.0, 0.12: 100.0, 0.08: 250.0}  # length, m: where it goes, degrees
ASKED_GAIN = {"random": "1.00 0.99 0.93", "low_light": "0.85 at 8 cm"}


def added() -> list[dict[str, float]]:
    return [
        {"wavelength": length, "amplitude": SLOPE * length / (2 * np.pi), "direction": direction}
        for length, direction in WAVES.items()
    ]


def wave_vectors() -> tuple[NDArray[Any], NDArray[Any]]:
    """kx and ky of the added waves, rad/m."""
    k = 2 * np.pi / np.array(list(WAVES))
    angle = np.radians(list(WAVES.values()))
    return k * np.cos(angle), k * np.sin(angle)


def measured(case: Case) -> tuple[GridGeometry, LearnedRecord, dict[str, NDArray[Any]]]:
    """The geometry, the learned record of a case's frames, and their cube."""
    geometry = GridGeometry(case.rig, case.grid, Settings())
    steps = sample_steps(len(next(iter(case.frames.values()))) - 1)
    pairs = [tuple({n: f[k + i] for n, f in case.frames.items()} for i in (0, 1)) for k in steps]
    record = learn(pairs, geometry, frame_rate=case.frame_rate)
    if record is None:
        raise SystemExit("these frames cannot be measured")
    return geometry, record, measure(case.frames, geometry, case.frame_rate, Model(geometry, record))


def amplitudes(field: NDArray[Any], case: Case, window: NDArray[Any]) -> NDArray[np.complex128]:
    """Amplitude of each of the added waves in a field (ny, nx), by a windowed Fourier integral."""
    x, y = np.meshgrid(case.grid.x_nodes, case.grid.y_nodes)
    found = []
    for length, direction in WAVES.items():
        k, angle = 2 * np.pi / length, np.radians(direction)
        phase = k * (np.cos(angle) * x + np.sin(angle) * y)
        found.append(np.sum(np.nan_to_num(field) * window * np.exp(-1j * phase)))
    return np.array(found)


def gains(case: Case, cube: dict[str, Any]) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
    """Cross power of measured and true waves and power of the true ones, for z and w: each (waves,)."""
    shape = case.grid.shape
    taper = np.outer(np.hanning(shape[0]), np.hanning(shape[1]))
    out = {}
    for name in ("z", "w"):
        cross, power = np.zeros(len(WAVES), complex), np.zeros(len(WAVES))
        for step, truth in enumerate(case.truth):
            window = taper * inside(case, truth["z"])
            exact = amplitudes(truth[name], case, window)
            cross += amplitudes(cube[name][step], case, window) * exact.conj()
            power += np.abs(exact) ** 2
        out[name] = (cross, power)
    return out


def waves(options: argparse.Namespace) -> None:
    """Gain of short waves."""
    for name, asked in ASKED_GAIN.items():
        sums: dict[str, list[Any]] = {"z": [0.0, 0.0], "w": [0.0, 0.0]}
        undone: dict[str, list[Any]] = {"z": [], "w": []}
        for seed in options.seeds:
            case = draw(scene(name, seed, sea={"added": added()}), calibrated(False))
            geometry, record, cube = measured(case)
            predicted = theory(geometry, record, *wave_vectors())
            for key, parts in gains(case, cube).items():
                sums[key] = [total + part for total, part in zip(sums[key], parts, strict=True)]
                undone[key].append(parts[0].real / parts[1] / predicted[key])
        lengths = ", ".join(f"{100 * length:.0f}" for length in WAVES)
        print(f"{name} with waves of {lengths} cm: gain (asked {asked})")
        for key, (cross, power) in sums.items():
            gain = cross / power
            print(f"    {key}: {' '.join(f'{g.real:.3f}' for g in gain)}", end="")
            print(f"  (out of phase {' '.join(f'{g.imag:+.3f}' for g in gain)})", end="")
            after = np.mean(undone[key], axis=0)
            print(f"; undone by theory {' '.join(f'{g:.3f}' for g in after)}", flush=True)


def compare(kinds: dict[str, dict[str, Any]], options: argparse.Namespace, name: str = "random") -> None:
    for kind, changes in kinds.items():
        score = Score()
        for seed in options.seeds:
            case = draw(scene(name, seed, **changes), calibrated(False))
            score.add(case, reconstruct(case, Settings()))
        score.report(f"{kind}: beyond 5 std {score.wrong():.2f} %")


def shortest(options: argparse.Namespace) -> None:
    """Seas without their shortest waves."""
    for name in ("random", "steep", "low_light", "gaps"):
        compare({f"{name} without waves below 8 cm": {"sea": {"shortest": 0.08}}}, options, name)


def rate(options: argparse.Namespace) -> None:
    """Frame rates."""
    compare({f"{hertz:.0f} frames/s": {"frame_rate": hertz} for hertz in (10.0, 20.0, 40.0)}, options)


def seeding(options: argparse.Namespace) -> None:
    """Numbers of beads."""
    kinds = {f"{17.6 * part:.0f} beads per 4 x 4 cm": part for part in (1 / 3, 1.0, 3.0)}
    compare({name: {"surface": {"density": 1.1e4 * part}} for name, part in kinds.items()}, options)


def current(options: argparse.Namespace) -> None:
    """Water that moves as a whole. Asked: z 0.05 px, 0.1 % beyond five standard uncertainties."""
    lower = {"kind": "random", "rms": 0.0125, "shortest": 0.055, "spectrum": {"kind": "jonswap", "peak": 0.7}}
    kinds = {}
    for sea, parts in (("random sea", {}), ("Hs 5 cm, 0.7 to 5.5 Hz", lower)):
        for speed in ((0.0, 0.0), (0.6, 0.4)):
            kinds[f"{sea}, current {np.hypot(*speed):.2f} m/s"] = {"sea": parts | {"current": speed}}
    compare(kinds, options)


def jitter(options: argparse.Namespace) -> None:
    """Uneven frame times. Asked: with stamps as at even times."""
    scores = {kind: Score() for kind in ("even times", "1 ms of jitter, stamps", "1 ms of jitter, no stamps")}
    for seed in options.seeds:
        for kind, score in scores.items():
            described = scene("random", seed, timing={"jitter": 0.0 if kind == "even times" else 1e-3})
            case = draw(described, described.build_rig())
            frames = np.arange(described.frames)
            late = np.array([described.frame_time(k) - described.time(k) for k in frames]) * case.frame_rate
            stamps = late if kind == "1 ms of jitter, stamps" else None
            score.add(case, reconstruct(case, Settings(), stamps))
    for kind, score in scores.items():
        print(f"{kind}: beyond 5 std {score.wrong():.2f} %")
        print("".join(f"    {line}\n" for line in score.lines()), end="", flush=True)


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {
    "waves": waves,
    "shortest": shortest,
    "rate": rate,
    "seeding": seeding,
    "current": current,
    "jitter": jitter,
}


if __name__ == "__main__":
    sys.exit(run_parts(__doc__, PARTS, sys.argv[1:], SEEDS))
