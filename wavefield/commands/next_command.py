"""The line `Next:` that ends a command."""

import shlex
from pathlib import Path

import click

from wavefield.text import short_path


def command_line(*words: object) -> str:
    """A command as a shell reads it.

    Examples
    --------
    >>> command_line("check", "run 7/experiment.yaml")
    "wavefield check 'run 7/experiment.yaml'"
    """
    return shlex.join(["wavefield", *(str(word) for word in words)])


def print_next(*words: object, first: str = "") -> None:
    """Print the command that usually follows, after what is to be done first; nothing with `--quiet`."""
    context = click.get_current_context(silent=True)
    if not (context and context.meta.get("wavefield.quiet")):
        shown = (short_path(word) if isinstance(word, Path) else word for word in words)
        click.echo(f"Next: {first}{', then: ' if first else ''}{command_line(*shown)}")
