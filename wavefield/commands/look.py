"""`wavefield look` and `wavefield follow`: interactive pages of a cube, and of cameras at work."""

import atexit
import os
import tempfile
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wavefield.commands.sources import CUBE, EXPERIMENT, PATH, RIG, find_cube

if TYPE_CHECKING:
    from wavefield.explorer.server import PageServer

_PORT = click.option(
    "--port", type=click.IntRange(0, 65535), help="Port; by default 5006 or the next that is free."
)
_OPEN = click.option(
    "--open/--no-open", "open_page", default=True, help="Whether to open the page in a browser."
)
LAST = 19  # niceness of a process that takes what the others leave


def serve(server: "PageServer", open_page: bool) -> None:
    """Serve a page until Ctrl-C."""
    server.start()
    announce(server.url, int(server.port or 0), open_page)
    try:
        server.io_loop.start()
    except KeyboardInterrupt:
        server.stop()


def announce(url: str, port: int, open_page: bool) -> None:
    """Print the address of a page, with how to reach it from another machine, or open it in a browser."""
    click.echo(f"Open {url} in a browser; Ctrl-C stops.")
    if os.environ.get("SSH_CONNECTION"):
        click.echo(
            f"From your own machine first: ssh -L {port}:localhost:{port} and this machine's name. If {port} "
            "is taken there, write another number before the colon, and in the address."
        )
    elif open_page and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or os.name == "nt"):
        webbrowser.open(_link_file(url).as_uri())


def _link_file(url: str) -> Path:
    """A file that leads a browser to an address, readable by this user only: command lines are not."""
    handle, name = tempfile.mkstemp(prefix="wavefield-", suffix=".html")  # mode 0600
    with os.fdopen(handle, "w") as stream:
        stream.write(f'<!doctype html><meta http-equiv="refresh" content="0; url={url}">')
    atexit.register(Path(name).unlink, missing_ok=True)
    return Path(name)


def give_way(steps_to_come: int) -> None:
    """Let a run that may be at work on this machine go first: the page should not slow it down."""
    if steps_to_come and hasattr(os, "nice"):  # Windows has none
        os.nice(LAST - os.nice(0))


@click.command(
    epilog="""\b
Examples:
  wavefield look cube.zarr
  wavefield look experiment.yaml              # the cube that `wavefield run` writes next to it
  wavefield look campaign.yaml run07          # the cube of a run of a catalog
  wavefield look cube.zarr --port 5010        # behind ssh -L 5010:localhost:5010
"""
)
@click.argument("source", metavar=f"{CUBE}|CATALOG", type=PATH)
@click.argument("run", required=False)
@click.option(
    "--waves",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Wave store; by default the one next to the cube.",
)
@_PORT
@_OPEN
def look(source: Path, run: str | None, waves: Path | None, port: int | None, open_page: bool) -> None:
    """Open an interactive page of a cube.

    It shows maps, series, spectra, camera images and waves. The page can be opened from this machine only.
    While the cube is being written, the page shows new steps as they come. For a catalog name the RUN, unless
    only one of its runs has a cube.
    """
    from wavefield.explorer.record import LookSession
    from wavefield.explorer.server import session_server

    session = LookSession(find_cube(source, run), waves)
    record = session.record
    give_way(record.layout.steps - record.steps_done)
    server = session_server(session, port)
    session.load()
    serve(server, open_page)


@click.command(
    epilog="""\b
Examples:
  wavefield follow experiment.yaml             # while the cameras write
  wavefield follow experiment.yaml --rig rig.yaml
"""
)
@EXPERIMENT
@RIG
@_PORT
@_OPEN
def follow(experiment: Path, rig: Path | None, port: int | None, open_page: bool) -> None:
    """Monitor cameras while they record: newest map, status lights.

    Measures the newest complete set of frames as often as it can, and shows how many it skips. The lights
    show brightness, saturation, seeding, focus, synchronisation, consistency and coverage; most of them work
    before there is a rig. Writes nothing.
    """
    from wavefield.explorer.follow import follow_server
    from wavefield.explorer.live import Follower
    from wavefield.series import Experiment

    follower = Follower(Experiment.load(experiment), rig)
    server = follow_server(follower, port)
    follower.start()
    serve(server, open_page)
    follower.stop()
