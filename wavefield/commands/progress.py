"""Progress of long work, on a terminal or in a log, and the line `Next:` at the end of a command."""

import shlex
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TextIO

import click

from wavefield.text import short_path, spell_time


class Progress:
    """Prints how much of a stage, such as "Reading cube.zarr", is done and how long the rest will take.
    Call it with the number of parts done and the number of all parts; `unit` names them, such as "steps".
    On a terminal it shows one line. In a log it writes a line at the start, at each quarter, once a minute,
    and at the end."""

    def __init__(self, stage: str, unit: str = "", stream: TextIO | None = None) -> None:
        self.stream = stream if stream is not None else sys.stderr
        context = click.get_current_context(silent=True)
        self.quiet = bool(context and context.meta.get("wavefield.quiet"))
        self.terminal = self.stream.isatty()
        self._begin(stage, unit)

    def _begin(self, stage: str, unit: str) -> None:
        self.stage, self.unit = stage, unit
        self.start = time.monotonic()
        self.first: tuple[float, int] | None = None  # time and parts done at the first call
        self.paced: tuple[float, int] | None = None  # time and parts done after the first new part
        self.last_line, self.last_quarter = -1e9, -1
        self.done, self.total = 0, 0

    def stage_of(self, stage: str) -> Callable[[int, int], None]:
        """Return a function `report(done, total)` for another stage, which begins at its first call."""

        def report(done: int, total: int) -> None:
            if self.stage != stage:
                self.__exit__(None, None, None)
                self._begin(stage, "")
                self.__enter__()
            self(done, total)

        return report

    def __enter__(self) -> "Progress":
        self._write(f"{self.stage} ...", final=not self.terminal)
        return self

    def __call__(self, done: int, total: int) -> None:
        """Print that `done` of `total` parts are done, unless the last line is too recent or `total` is 0."""
        if not total:
            return
        now = time.monotonic()
        self.done, self.total = int(done), int(total)
        if self.first is None:  # steps that were done before a resumed run do not count for its speed
            self.first = (now, self.done)
        if self.paced is None and self.done > self.first[1]:
            self.paced = (now, self.done)
        quarter = 4 * self.done // self.total if self.total else 0
        due = 0.2 if self.terminal else 60.0
        if now - self.last_line >= due or (not self.terminal and quarter > max(self.last_quarter, 0)):
            self.last_line, self.last_quarter = now, quarter
            self._write(f"{self.stage}: {self._count()}{self._left(now)}", final=not self.terminal)

    @property
    def had_nothing_to_do(self) -> bool:
        """Whether all parts were done before the work began."""
        return self.first is not None and 0 < self.total == self.first[1]

    def _count(self) -> str:
        share = 100 * self.done // self.total if self.total else 100
        return f"{self.done} of {self.total}{' ' + self.unit if self.unit else ''} ({share} %)"

    def _left(self, now: float) -> str:
        """Return the estimated time left as text such as ", 5 min left"; empty if it is not known yet.
        The estimate leaves out the first part, which includes compilation."""
        if self.first is None or self.paced is None or not self.paced[1] < self.done < self.total:
            return ""
        spent, first = now - self.paced[0], self.paced[0] - self.first[0]
        if spent < first / 2:  # other workers are still at their first parts
            return ""
        pace = spent / (self.done - self.paced[1])
        return f", {spell_time(pace * (self.total - self.done))} left"

    def _write(self, text: str, *, final: bool) -> None:
        if self.quiet:
            return
        if self.terminal:
            self.stream.write(
                f"\r\033[2K{text[: shutil.get_terminal_size((100, 24)).columns - 1]}"
                + ("\n" if final else "")
            )
        else:
            self.stream.write(text + "\n")
        self.stream.flush()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        spent = spell_time(time.monotonic() - self.start)
        unit = self.unit.removesuffix("s") if self.total == 1 else self.unit
        counted = f", {self.total} {unit}" if self.total and self.unit else ""
        word = f"done in {spent}{counted}" if kind is None else f"stopped after {spent}"
        self._write(f"{self.stage}: {word}", final=True)


def command_line(*words: object) -> str:
    """Return a command of wavefield as a line for the shell, with quotes where they are needed."""
    return shlex.join(["wavefield", *(str(word) for word in words)])


def print_next(*words: object, first: str = "") -> None:
    """Print "Next:" and a command of wavefield, given by its `words`; with --quiet print nothing.
    `first` is what the user should do before this command, such as "correct what is not ready"."""
    context = click.get_current_context(silent=True)
    if not (context and context.meta.get("wavefield.quiet")):
        shown = (short_path(word) if isinstance(word, Path) else word for word in words)
        click.echo(f"Next: {first}{', then: ' if first else ''}{command_line(*shown)}")
