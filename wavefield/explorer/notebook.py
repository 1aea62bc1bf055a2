"""A cube's interactive page in a notebook."""

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
        Store written by `run`, finished or not, or the Dataset that `open_cube` returns.
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
    from wavefield.errors import StoreError
    from wavefield.explorer.server import ServedPage, session_server
    from wavefield.explorer.session import LookSession

    path = cube if isinstance(cube, str | Path) else cube.encoding.get("source")
    if path is None:
        raise StoreError("only cubes in a store can be shown: give its path, or the result of open_cube")
    session = LookSession.open(path, waves)
    session.load()
    return ServedPage(lambda: session_server(session, port))
