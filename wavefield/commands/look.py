"""`wavefield look` and `wavefield follow`: interactive pages of a cube, or of an experiment in progress."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wavefield.commands.sources import CUBE, EXPERIMENT, PATH, RIG, find_cube

if TYPE_CHECKING:
    from wavefield.explorer.server import PageServer

_PORT = click.option(
    "--port", type=click.IntRange(0, 65535), help="Port; by default 5006 or the next that is free."
)


def serve(server: "PageServer") -> None:
    """Start the web server of a page, print the address, and serve until the user presses Ctrl-C."""
    server.start()
    click.echo(f"Open {server.url} in a browser; Ctrl-C stops.")
    if os.environ.get("SSH_CONNECTION"):
        port = server.port
        click.echo(
            f"From your own machine first: ssh -L {port}:localhost:{port} and this machine's name. If {port} "
            "is taken there, write another number before the colon, and in the address."
        )
    try:
        server.io_loop.start()
    except KeyboardInterrupt:
        server.stop()


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
@_PORT
def look(source: Path, run: str | None, port: int | None) -> None:
    """Serve an interactive page of a cube.

    It shows maps, series, spectra, camera images and waves. The page can be opened from this machine only.
    While a run writes the cube, the page shows new steps as they come. With a catalog, name the RUN if
    several of its runs have a cube.
    """
    from wavefield.explorer.record import LookSession
    from wavefield.explorer.server import session_server

    session = LookSession(find_cube(source, run))
    record = session.record
    if record.steps_done < record.layout.steps and hasattr(os, "nice"):  # Windows has no niceness
        os.nice(19)  # the lowest priority, so that the page does not slow the run
    server = session_server(session, port)
    session.load()
    serve(server)


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
def follow(experiment: Path, rig: Path | None, port: int | None) -> None:
    """Monitor cameras while they record: newest map, status lights.

    Measures the newest complete set of frames as often as it can, and shows how many sets it skips. Lights
    rate brightness, saturation, seeding, focus, synchronisation, consistency and coverage; most of them do
    not need a rig. Writes nothing.
    """
    from wavefield.explorer.follow import follow_server
    from wavefield.explorer.live import Follower
    from wavefield.series import Experiment

    follower = Follower(Experiment.load(experiment), rig)
    server = follow_server(follower, port)
    follower.start()
    serve(server)
    follower.stop()
