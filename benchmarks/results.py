"""Results of benchmarks as JSON files, from which README and docs/validation.md are made."""

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from wavefield import __version__
from wavefield.measurement.step import ALGORITHM

RESULTS = Path(__file__).with_name("results")


@dataclass(frozen=True)
class Result:
    """A table that a benchmark measured, with what it takes to measure it again."""

    name: str
    command: str  # with the seeds
    version: str  # of the package
    algorithm: int | None  # version of the measurement; None where no image is measured
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """The table, and below it the command and the version of the measurement."""
        table = "\n".join(table_lines(self.columns, self.rows))
        return f"{table}\n\n*`{self.command}`, {self.origin}*"

    @property
    def origin(self) -> str:
        """Version of the package and of the measurement; says so if the measurement has changed since."""
        if self.algorithm is None:
            return f"version {self.version}"
        since = "" if self.algorithm == ALGORITHM else f", not measured again with ALGORITHM {ALGORITHM}"
        return f"version {self.version}, ALGORITHM {self.algorithm}{since}"

    def save(self, folder: Path = RESULTS) -> Path:
        """Write it, in place of the one before."""
        path = folder / f"{self.name}.json"
        path.write_text(json.dumps(asdict(self), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        return path

    @classmethod
    def load(cls, path: Path) -> "Result":
        """Read one."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))


def save_result(
    name: str, columns: Sequence[str], rows: Sequence[Sequence[str]], measures_images: bool = True
) -> Path:
    """Save a table of the benchmark that runs, under the command that was given (without ``--save``)."""
    module = Path(sys.argv[0]).stem
    words = [word for word in sys.argv[1:] if word != "--save"]
    command = shlex.join(["python", "-m", f"benchmarks.{module}", *words])
    algorithm = ALGORITHM if measures_images else None
    return Result(name, command, __version__, algorithm, columns, rows).save()


def table_lines(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    head, *body = ("| " + " | ".join(cells) + " |" for cells in (columns, *rows))
    return [head, "|" + "---|" * len(columns), *body]


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a Markdown table."""
    print("\n".join(table_lines(columns, rows)), flush=True)


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """A parser described by the first line of a benchmark's docstring, with ``--save``."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the table in benchmarks/results")
    return parser
