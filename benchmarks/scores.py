"""Errors of a cube against the truth, and against its stated uncertainty."""

from collections.abc import Mapping
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

    def fractions(self, name: str, filled: bool = False) -> tuple[float, float, float]:
        """Per cent of the errors within one and two standard uncertainties, and beyond three."""
        errors, stds = (self.filled, self.filled_std) if filled else (self.error, self.std)
        error, std = np.abs(np.concatenate(errors[name])), np.concatenate(stds[name])
        if not error.size:
            return (float("nan"),) * 3
        within = [100.0 * float(np.mean(error <= n * std)) for n in (1, 2, 3)]
        return within[0], within[1], 100.0 - within[2]

    def wrong(self, times: float = 5.0) -> float:
        """Per cent of the compared nodes that are flagged as measured and off by more than so many std."""
        off = [
            ~(np.abs(np.concatenate(self.error[name])) <= times * np.concatenate(self.std[name]))
            for name in NAMES
        ]
        return 100.0 * float(np.sum(np.any(off, axis=0))) / max(self.nodes, 1)

    def cells(self, filled: bool = False) -> list[str]:
        """Cells of a row: z; u, v, w; nodes measured; within one std; measured and wrong by five std."""
        z, *moved = (f"{rms:.{4 if rms < 2e-3 else 3}f}" for rms in (self.rms(n, filled) for n in NAMES))
        within = ", ".join(f"{self.fractions(name, filled)[0]:.0f}" for name in NAMES)
        measured = "" if filled else f"{100 * self.measured / max(self.nodes, 1):.1f} %"
        wrong = "" if filled else f"{self.wrong():.2f} %"
        return [z, ", ".join(moved), measured, f"{within} %", wrong]

    def __str__(self) -> str:
        """What a row of the table does not show."""
        shares = np.array([self.fractions(name) for name in NAMES]).T
        two, three = (" ".join(f"{share:.1f}" for share in shares[k]) for k in (1, 2))
        missing = 100 * self.missing / max(self.nodes, 1)
        return f"within 2 std {two}, beyond 3 std {three} % (z u v w); no value {missing:.2f} %"
