"""Progress on a terminal and in a log."""

import io

import pytest

from wavefield.commands import progress
from wavefield.commands.progress import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_a_log_gets_plain_lines_at_the_quarters(clock):
    stream = io.StringIO()
    with Progress("Measuring", "steps", stream) as report:
        for done in range(101):
            clock[0] += 0.1
            report(done, 100)
    lines = stream.getvalue().splitlines()
    assert lines[0] == "Measuring ..."
    assert lines[-1] == "Measuring: done in 10 s, 100 steps"
    assert "Measuring: 25 of 100 steps (25 %), 8 s left" in lines
    assert len(lines) <= 7
    assert "\r" not in stream.getvalue()


def test_a_terminal_gets_one_line_redrawn(clock):
    stream = Terminal()
    with Progress("Measuring", "steps", stream) as report:
        for done in range(11):
            clock[0] += 1.0
            report(done, 10)
    assert stream.getvalue().count("\n") == 1
    assert "5 of 10 steps (50 %), 5 s left" in stream.getvalue()


def test_time_left_of_a_resumed_run_counts_only_what_this_run_did(clock):
    stream = Terminal()
    with Progress("Measuring", "steps", stream) as report:
        report(900, 1000)
        for done in (910, 920):
            clock[0] += 10.0
            report(done, 1000)
    assert "920 of 1000 steps (92 %), 1 min 20 s left" in stream.getvalue()


def test_time_left_does_not_count_the_compilation_before_the_first_part(clock):
    stream = Terminal()
    with Progress("Measuring", "steps", stream) as report:
        for done, spent in ((0, 0), (10, 60), (20, 1), (30, 29), (40, 30)):
            clock[0] += spent
            report(done, 100)
    assert "10 of 100 steps (10 %)\r" in stream.getvalue()
    assert "20 of 100 steps (20 %)\r" in stream.getvalue()
    assert "30 of 100 steps (30 %), 1 min 45 s left" in stream.getvalue()
    assert "40 of 100 steps (40 %), 2 min 00 s left" in stream.getvalue()


def test_a_failure_is_reported_as_stopped(clock):
    stream = io.StringIO()
    with pytest.raises(ValueError, match="no"), Progress("Measuring", "steps", stream):
        raise ValueError("no")
    assert stream.getvalue().splitlines()[-1] == "Measuring: stopped after 0 s"
