"""A cube's interactive page in a notebook."""

import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

    from wavefield.explorer.server import ServedPage


def look(
    cube: "str | Path | xr.Dataset", *, waves: str | Path | None = None, port: int | None = 0
) -> "ServedPage":
    """Look at a cube in a notebook: maps, the surface, series, spectra, camera images, waves.

    Parameters
    ----------
    cube : path or Dataset
        Store written by `run`, finished or not, the Dataset that `open_cube` returns, or any other cube with
        z, z_t, u, v, w (`wavefield.cube`; cropped, filtered), of which a copy is kept while it is shown.
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
    from wavefield.explorer.server import ServedPage, session_server
    from wavefield.explorer.session import LookSession
    from wavefield.pipeline.foreign_cube import stored_cube

    with ExitStack() as stack:
        path = stack.enter_context(stored_cube(cube))
        session = LookSession(path, waves)
        stack.callback(session.load().join)
        page = ServedPage(lambda: session_server(session, port))
        weakref.finalize(page, stack.pop_all().close)
    return page
