"""The line `Next:` that ends a command."""

import shlex
from pathlib import Path

import click


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
        click.echo(f"Next: {first}{', then: ' if first else ''}{command_line(*map(_from_here, words))}")


def _from_here(word: object) -> object:
    """A path relative to the current folder, where it is inside."""
    if isinstance(word, Path) and word.is_relative_to(Path.cwd()):
        return word.relative_to(Path.cwd())
    return word
