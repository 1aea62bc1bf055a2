"""Results of benchmarks as files of `benchmarks/results`, from which `docs/validation.md` is made."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from wavefield.measurement.algorithm import ALGORITHM

RESULTS = Path(__file__).with_name("results")


@dataclass(frozen=True)
class Result:
    """A table that a benchmark measured, with what it takes to measure it again."""

    name: str
    command: str
    algorithm: int  # version of the measurement, part of every cube's recipe
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """The table, and below it the command, unless its rows name theirs, and the version."""
        lines = [self.columns, ["---"] * len(self.columns), *self.rows]
        table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        command = f"`{self.command}`, " if self.command else ""
        return f"{table}\n\n*{command}ALGORITHM {self.algorithm}*"

    def save(self, folder: Path = RESULTS) -> Path:
        """Write it, in place of the one before."""
        path = folder / f"{self.name}.yaml"
        plain = asdict(self) | {"columns": list(self.columns), "rows": [list(row) for row in self.rows]}
        path.write_text(
            yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=110), encoding="utf-8"
        )
        return path

    @classmethod
    def load(cls, path: Path) -> "Result":
        """Read one."""
        return cls(**yaml.safe_load(path.read_text(encoding="utf-8")))


def save_result(name: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Path:
    """Save a table of the benchmark that runs, under the command that was given (without ``--save``)."""
    module = Path(sys.argv[0]).stem
    words = [word for word in sys.argv[1:] if word != "--save"]
    command = shlex.join(["python", "-m", f"benchmarks.{module}", *words])
    return Result(name, command, ALGORITHM, columns, rows).save()
