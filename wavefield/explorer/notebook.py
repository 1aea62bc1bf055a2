"""Looking at a cube in a notebook."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wavefield.explorer.server import Served


def look(cube: Any, *, waves: str | Path | None = None, port: int | None = 0) -> "Served":
    """Look at a cube in a notebook: maps, the surface, series, spectra, camera images, waves.

    Parameters
    ----------
    cube : path or Dataset
        Store written by `run`, finished or not, or what `open_cube` gave.
    waves : path, optional
        Its wave store; by default where `wavefield analyze` writes it.
    port : int, optional
        Where the page is served, on the loopback only; by default any that is free.

    Returns
    -------
    Served
        Shows itself in a notebook; ``.url`` opens in a browser, ``.stop()`` closes it.

    Raises
    ------
    StoreError
        If it is not there or is not a cube.

    Examples
    --------
    >>> from wavefield.explorer.notebook import look
    >>> look("not/there.zarr")
    Traceback (most recent call last):
        ...
    wavefield.errors.StoreError: ...: no such store; make one with `wavefield run`
    """
    from wavefield.errors import StoreError
    from wavefield.explorer.context import find_context
    from wavefield.explorer.cube_record import CubeRecord
    from wavefield.explorer.look_page import LookSession
    from wavefield.explorer.server import Served, session_server

    path = cube if isinstance(cube, str | Path) else getattr(cube, "encoding", {}).get("source")
    if path is None:
        raise StoreError("only cubes in a store can be looked at: give its path, or what open_cube gave")
    record = CubeRecord(path)
    session = LookSession(record, find_context(record, waves))
    session.load()
    return Served(lambda: session_server(session, port))
