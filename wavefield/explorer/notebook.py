"""A cube's interactive page in a notebook."""

import weakref
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wavefield.explorer.server import ServedPage


def look(cube: str | Path, *, waves: str | Path | None = None, port: int | None = 0) -> "ServedPage":
    """Look at a cube in a notebook: maps, the surface, series, spectra, camera images, waves.

    Parameters
    ----------
    cube : path
        Store written by `run`, finished or not.
    waves : path, optional
        Its wave store; by default where `wavefield analyze` writes it.
    port : int, optional
        Where the page is served, on the loopback only; by default any that is free.

    Returns
    -------
    ServedPage
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
    from wavefield.explorer.record import LookSession
    from wavefield.explorer.server import ServedPage, session_server

    session = LookSession(Path(str(cube).removeprefix("file://")), waves)
    loading = session.load()
    page = ServedPage(lambda: session_server(session, port))
    weakref.finalize(page, loading.join)
    return page
