"""The command line; each command calls a public function of the package.

Exit status: 0 done, 1 failed (one sentence gives the reason), 2 wrong use, 3 done with remarks that matter,
130 interrupted.
"""

import logging
import sys
import traceback
import warnings
from collections.abc import Sequence

import click

import wavefield
from wavefield.commands import (
    archive,
    check_command,
    demo,
    experiment_commands,
    look,
    rig_commands,
    wave_commands,
)
from wavefield.errors import WavefieldError
from wavefield.execution.process import stop_signals

_EPILOG = """\b
A first look:   wavefield demo
Your own data:  wavefield init FOLDER    (proposes experiment.yaml)
                wavefield calibrate experiment.yaml
                wavefield check experiment.yaml
                wavefield run experiment.yaml
                wavefield analyze cube.zarr
                wavefield report cube.zarr
                wavefield look cube.zarr

Where a command takes an experiment, its file, its folder or its cube may be given.

\b
To complete commands with the Tab key, add this line to ~/.bashrc
(zsh: zsh_source, ~/.zshrc):
  eval "$(_WAVEFIELD_COMPLETE=bash_source wavefield)"
"""


class _GroupInOrder(click.Group):
    """The group of all commands; its help lists them in the order in which they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


def _print_version(context: click.Context, option: click.Parameter, asked: bool) -> None:
    if asked:
        click.echo(f"wavefield {wavefield.__version__}")  # slow to look up, so not at every start
        context.exit()


@click.group(
    cls=_GroupInOrder,
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
@click.option("-q", "--quiet", is_flag=True, help="Only results, warnings and errors; no progress.")
@click.option("-v", "--verbose", is_flag=True, help="Print more about what is done.")
@click.option("--debug", is_flag=True, help="Show the whole traceback of an error.")
def cli(quiet: bool, verbose: bool, debug: bool) -> None:
    """Measure elevation and velocity of a water surface with cameras, and analyse the waves."""
    level = logging.DEBUG if debug else logging.INFO if verbose else logging.WARNING
    handler = logging.StreamHandler()
    handler.setLevel(level)  # a run lowers the level of its logger for the log file next to the cube
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    logger = logging.getLogger("wavefield")
    logger.handlers[:] = [handler]
    logger.setLevel(level)
    context = click.get_current_context()
    context.meta["wavefield.quiet"] = quiet
    context.meta["wavefield.command"] = main  # `wavefield demo` runs other commands


for _command in (
    demo.demo,
    experiment_commands.init,
    rig_commands.calibrate,
    rig_commands.refine,
    archive.rig,
    experiment_commands.background,
    check_command.check,
    check_command.explain,
    look.follow,
    experiment_commands.run,
    experiment_commands.status,
    experiment_commands.verify,
    wave_commands.analyze,
    wave_commands.report,
    look.look,
    archive.export,
    wave_commands.smooth,
    wave_commands.paper,
    archive.catalog,
    demo.simulate,
):
    cli.add_command(_command)


def _one_line_warning(message, category, filename, lineno, file=None, line=None) -> None:  # type: ignore[no-untyped-def]
    print(f"wavefield: warning: {message}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line `arguments`, by default that of this process; return the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    try:
        with stop_signals(), warnings.catch_warnings():
            warnings.showwarning = _one_line_warning
            result = cli.main(words, prog_name="wavefield", standalone_mode=False)
            sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        print("wavefield: interrupted; the same command resumes", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader of the pipe has ended: print nothing more, not even at exit
        return 1
    except OSError as error:
        if debug:
            traceback.print_exc()
        print(f"wavefield: {error.filename or 'the output'}: {error.strerror or error}", file=sys.stderr)
        if error.filename is None:
            sys.stdout = None  # Python would try to print the rest at exit
        return 1
    except Exception as error:
        if debug:
            traceback.print_exc()
        print(f"wavefield: {_sentence(error)}", file=sys.stderr)
        return 1


def _sentence(error: Exception) -> str:
    """Return a sentence that tells the user what went wrong, with a remedy if wavefield has one."""
    if isinstance(error, WavefieldError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"memory ran out ({error}); end other programs, or use a machine with more"
    return (
        f"{type(error).__name__}: {error} (an error that wavefield did not foresee; "
        "`wavefield --debug ...` shows where it happened)"
    )


if __name__ == "__main__":
    sys.exit(main())
