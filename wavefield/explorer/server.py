"""Serve the pages: reachable from this machine only, at a secret address, with no file from the internet."""

import asyncio
import errno
import hmac
import re
import secrets
import socket
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPMessageDelegate, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.web import RequestHandler

from wavefield.errors import StoreError, WavefieldError
from wavefield.explorer.page import LookPage
from wavefield.explorer.parts import Place
from wavefield.explorer.record import CubeRecord, LookSession

DEFAULT_PORTS = range(5006, 5026)
_HOSTS = ("localhost", "127.0.0.1")


def middle_node(record: CubeRecord, step: int) -> tuple[float, float]:
    """Return x, y, metres, of the measured node nearest to the middle of the grid at a step.
    If no node is measured at this step, return the position of the middle node."""
    x, y = np.meshgrid(record.x - record.x.mean(), record.y - record.y.mean())
    distance = np.hypot(x, y)
    with suppress(StoreError):  # the map reports a damaged step
        measured = np.isfinite(record.field(record.stored[0], step))
        distance = np.where(measured, distance, np.inf if measured.any() else distance)
    j, i = np.unravel_index(np.argmin(distance), distance.shape)
    return float(record.x[i]), float(record.y[j])


class Refused(RequestHandler):
    """Answers a request that lacks the secret token, or that comes from another machine or website."""

    def prepare(self) -> None:
        """Answer with status 403 (forbidden) and a sentence on how to open the page."""
        self.set_status(403)
        self.finish(
            "Open the whole address that the program printed: it holds a token, and works for localhost."
        )


class GuardedTornado(BokehTornado):  # type: ignore[misc]  # Bokeh's server has no types
    """Bokeh's web application, with a secret token at the start of all addresses, such as ``/TOKEN/ws``.
    `make_page` fills the Bokeh document of each browser tab."""

    # A cookie would not do: browsers send it to the servers of other users of this machine as well, and do
    # not send it when a notebook of another site shows the page in a frame.

    def __init__(self, make_page: Callable[[Document], None]) -> None:
        self.token = secrets.token_urlsafe(32)
        super().__init__(
            {"/": Application(FunctionHandler(make_page))},
            prefix=self.token,
            extra_websocket_origins=list(_HOSTS),
            check_unused_sessions_milliseconds=5000,
            unused_session_lifetime_milliseconds=60_000,
        )

    def find_handler(self, request: HTTPServerRequest, **more: Any) -> HTTPMessageDelegate:
        """Return Bokeh's handler of a request, or `Refused` if the request is not allowed."""
        allowed = self._allows(request)
        found: HTTPMessageDelegate = (
            super().find_handler(request, **more) if allowed else self.get_handler_delegate(request, Refused)
        )
        return found

    def _allows(self, request: HTTPServerRequest) -> bool:
        """Return whether a request has the token, is addressed to this machine, and is from these pages."""
        given = request.path.split("/")[1] if request.path.startswith("/") else ""
        host = request.headers.get("Host", "")
        own = re.sub(r":\d{1,5}$", "", host) in _HOSTS  # any port, because an SSH tunnel may use another
        origin = request.headers.get("Origin")
        same = origin is None or origin == f"http://{host}"
        return hmac.compare_digest(given.encode(), self.token.encode()) and own and same


class PageServer(BaseServer):  # type: ignore[misc]
    """HTTP server of the pages of one cube or experiment."""

    _tornado: GuardedTornado

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://localhost:{self.port}/{self._tornado.token}/"


def make_server(make_page: Callable[[Document], None], port: int | None) -> PageServer:
    """Return a server of pages that only this machine can open. `port` 0 means any free port, and None the
    first free one of `DEFAULT_PORTS`. `make_page` fills the Bokeh document of each browser tab.
    Raises WavefieldError if no port is free."""
    ports = DEFAULT_PORTS if port is None else range(port, port + 1)
    for number in ports:
        try:
            listening = socket.create_server(("127.0.0.1", number), backlog=128)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
            continue
        listening.setblocking(False)
        application = GuardedTornado(make_page)
        http = HTTPServer(application)
        http.add_sockets([listening])
        return PageServer(IOLoop.current(), application, http)
    raise WavefieldError(
        f"port {port} is taken; choose another with --port"
        if port is not None
        else f"the ports {ports[0]} to {ports[-1]} are all taken; name a free one with --port"
    )


def session_server(session: LookSession, port: int | None = None) -> PageServer:
    """Return a web server of the page of a cube; `port` 0: any free port, None: the first free one from 5006.
    Each browser tab opens in the state (step, variable, ...) that its link contains."""
    record = session.record

    def make_page(document: Document) -> None:
        arguments = document.session_context.request.arguments or {}
        query = {key: values[0].decode(errors="replace") for key, values in arguments.items()}
        place = Place.read(query, record.names, record.layout.steps, record.first_step())
        if place.node is None:
            place = replace(place, node=middle_node(session.record, place.step))
        LookPage(session, place).attach(document)

    return make_server(make_page, port)


class ServedPage:
    """A page that a notebook shows in a frame, with its own server.
    `make` returns the server; it is called in a new thread, in which the server then runs."""

    def __init__(self, make: Callable[[], PageServer]) -> None:
        self._ready = threading.Event()
        self._error: BaseException | None = None
        self._server: PageServer | None = None
        self._thread = threading.Thread(target=self._run, args=(make,), daemon=True, name="wavefield-look")
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error

    def _run(self, make: Callable[[], PageServer]) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        try:
            self._server = make()
            self._server.start()
        except BaseException as error:
            self._error = error
            return
        finally:
            self._ready.set()
        self._server.io_loop.start()
        self._server.io_loop.close(all_fds=True)  # the pages show that the connection is lost

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        assert self._server is not None
        return self._server.url

    def stop(self) -> None:
        """Stop the server; the page shows that it is no longer connected."""
        server = self._server
        if server is None or not self._thread.is_alive():
            return

        def close() -> None:
            server.stop()
            server.io_loop.stop()

        server.io_loop.add_callback(close)
        self._thread.join(10)

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="900" style="border: 0"></iframe>'

    def __repr__(self) -> str:
        return f"a page at {self.url}; `.stop()` closes it"


def look(cube: str | Path, *, port: int | None = 0) -> ServedPage:
    """Look at a cube in a notebook: maps, series, spectra, camera images, waves.

    Parameters
    ----------
    cube : path
        Store written by `run`, finished or not.
    port : int, optional
        Port of the page, which only this machine can open; by default any free one. None: the first free one
        from 5006 on.

    Returns
    -------
    ServedPage
        Shows itself in a notebook; ``.url`` opens in a browser, ``.stop()`` closes it.

    Raises
    ------
    StoreError
        If there is no such store, or it is not a cube.

    Examples
    --------
    >>> from wavefield.explorer.server import look
    >>> look("not/there.zarr")
    Traceback (most recent call last):
        ...
    wavefield.errors.StoreError: ...: no such store; make one with `wavefield run`
    """
    session = LookSession(Path(str(cube).removeprefix("file://")))
    loading = session.load()
    page = ServedPage(lambda: session_server(session, port))
    weakref.finalize(page, loading.join)
    return page
