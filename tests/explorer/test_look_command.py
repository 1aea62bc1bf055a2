import os

import click
import pytest
from click.testing import CliRunner
from explorer_cases import create_cube, make_cube

from wavefield.commands.look import LAST, look


@pytest.fixture
def given_way(monkeypatch):
    """Runs the command up to its server; returns by how much it has stepped back."""
    taken = []

    def nice(by):
        taken.append(by)
        return sum(taken)

    def no_server(*_):
        raise click.UsageError("far enough")

    monkeypatch.setattr(os, "nice", nice, raising=False)
    monkeypatch.setattr("wavefield.explorer.server.session_server", no_server)

    def run(path):
        result = CliRunner().invoke(look, [str(path), "--no-open"])
        assert "far enough" in result.output, result.output
        return sum(taken)

    return run


def test_looking_at_a_cube_that_is_being_written_leaves_the_processor_to_the_run(tmp_path, given_way):
    create_cube(tmp_path / "cube.zarr")
    assert given_way(tmp_path / "cube.zarr") == LAST


def test_looking_at_a_whole_cube_waits_for_nobody(tmp_path, given_way):
    make_cube(tmp_path / "cube.zarr")
    assert given_way(tmp_path / "cube.zarr") == 0
