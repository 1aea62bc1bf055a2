"""Errors of a cube against the truth, and against its stated uncertainty."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import PIXEL, Case, inside
from wavefield.variables import Quality

NAMES = ("z", "u", "v", "w")
Array = NDArray[np.float64]


def rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


@dataclass
class Score:
    """Errors gathered over steps and seeds, px of 1.8 mm (velocities times the step's length).

    ``error`` and ``std`` of z, u, v, w: of nodes flagged as measured; ``filled``, ``filled_std``: of
    the others; ``nodes``: all that are compared.
    """

    error: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    std: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    filled: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    filled_std: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    nodes: int = 0
    measured: int = 0
    missing: int = 0

    def add(self, case: Case, cube: Mapping[str, NDArray[Any]]) -> None:
        """Add every step of a cube."""
        for step, truth in enumerate(case.truth):
            compared = inside(case, truth["z"])
            measured = (cube["quality"][step] & Quality.MEASURED) > 0
            self.nodes += int(compared.sum())
            self.measured += int((compared & measured).sum())
            self.missing += int((compared & ~np.isfinite(cube["z"][step])).sum())
            for name in NAMES:
                scale = (1.0 if name == "z" else 1.0 / case.frame_rate) / PIXEL
                error = (np.asarray(cube[name][step], float) - truth[name]) * scale
                std = np.asarray(cube[f"{name}_std"][step], float) * scale
                for where, errors, stds in (
                    (compared & measured, self.error, self.std),
                    (compared & ~measured & np.isfinite(error), self.filled, self.filled_std),
                ):
                    errors[name].append(error[where])
                    stds[name].append(std[where])

    def rms(self, name: str, filled: bool = False) -> float:
        return rms(np.concatenate((self.filled if filled else self.error)[name]))

    def bias(self, name: str) -> float:
        return float(np.mean(np.concatenate(self.error[name])))

    def fractions(self, name: str, filled: bool = False) -> tuple[float, float, float]:
        """Per cent of the errors within one and two standard uncertainties, and beyond three."""
        errors, stds = (self.filled, self.filled_std) if filled else (self.error, self.std)
        error, std = np.abs(np.concatenate(errors[name])), np.concatenate(stds[name])
        if not error.size:
            return (float("nan"),) * 3
        within = [100.0 * float(np.mean(error <= n * std)) for n in (1, 2, 3)]
        return within[0], within[1], 100.0 - within[2]

    def outliers(self) -> int:
        """Nodes flagged as measured of which any variable is off by more than a pixel, or is not a number."""
        error = np.array([np.concatenate(self.error[name]) for name in NAMES])
        return int(np.sum(~(np.abs(error) <= 1).all(axis=0)))

    def wrong(self, times: float = 5.0) -> float:
        """Per cent of the compared nodes that are flagged as measured and off by more than so many std."""
        off = [
            ~(np.abs(np.concatenate(self.error[name])) <= times * np.concatenate(self.std[name]))
            for name in NAMES
        ]
        return 100.0 * float(np.sum(np.any(off, axis=0))) / max(self.nodes, 1)

    def report(self, head: str, *more: str) -> None:
        """Print a head and the lines of the score below it."""
        print(head)
        print("".join(f"    {line}\n" for line in (*self.lines(), *more)), end="", flush=True)

    def cells(self, filled: bool = False) -> list[str]:
        """Cells of a row of the validation page: z; u, v, w; nodes measured; within one std."""
        z, *moved = (f"{rms:.{4 if rms < 2e-3 else 3}f}" for rms in (self.rms(n, filled) for n in "zuvw"))
        within = ", ".join(f"{self.fractions(name, filled)[0]:.0f}" for name in NAMES)
        measured = "" if filled else f"{100 * self.measured / max(self.nodes, 1):.1f} %"
        return [z, ", ".join(moved), measured, f"{within} %"]

    def lines(self) -> list[str]:
        """The results in words, a line each."""

        def columns(values: Iterable[float], form: str) -> str:
            return " ".join(form.format(v) for v in values)

        shares = np.array([self.fractions(name) for name in NAMES]).T
        lines = [
            f"rms z {self.rms('z'):.4f}; u v w {columns((self.rms(n) for n in 'uvw'), '{:.4f}')}"
            f"; bias z {self.bias('z'):+.4f}, u {self.bias('u'):+.4f}",
            f"within 1 std: {columns(shares[0], '{:.0f}')}; 2: {columns(shares[1], '{:.0f}')}"
            f"; beyond 3: {columns(shares[2], '{:.1f}')} % (z u v w)",
            f"measured {100 * self.measured / max(self.nodes, 1):.2f} %; outliers {self.outliers()}"
            f"; no value {100 * self.missing / max(self.nodes, 1):.2f} %",
        ]
        if self.filled["z"] and np.concatenate(self.filled["z"]).size > 20:
            shares = np.array([self.fractions(name, True) for name in NAMES]).T
            lines.append(
                f"filled: rms z {self.rms('z', True):.3f}; u v w "
                f"{columns((self.rms(n, True) for n in 'uvw'), '{:.3f}')}; within 1: "
                f"{columns(shares[0], '{:.0f}')}; 2: {columns(shares[1], '{:.0f}')}; beyond 3: "
                f"{columns(shares[2], '{:.1f}')} %"
            )
        return lines
