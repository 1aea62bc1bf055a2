"""The server of the pages: on the loopback only, every file from this machine."""

import asyncio
import errno
import socket
import threading
from collections.abc import Callable
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.server.server import BaseServer as Server
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.web import HTTPError, RequestHandler

from wavefield.errors import WavefieldError
from wavefield.explorer.look_page import LookSession, Page
from wavefield.explorer.place import Place
from wavefield.explorer.save import FILES

PORT = 5006
_MORE_PORTS = 20
_HOSTS = ("localhost", "127.0.0.1")


class SaveHandler(RequestHandler):
    """Answers the links of the Save panel."""

    session: LookSession

    def initialize(self, session: LookSession) -> None:
        """Take what the pages look at."""
        self.session = session

    async def get(self, name: str) -> None:
        """Make a file of what is seen; a sentence where that cannot be."""
        if self.request.host_name not in _HOSTS:
            raise HTTPError(403)
        kind = FILES.get(name)
        if kind is None:
            raise HTTPError(404)
        record = self.session.record
        query = {key: self.get_query_argument(key) for key in self.request.query_arguments}
        place = Place.read(query, record.names, record.layout.steps, record.first_step())
        frames = int(query["frames"]) if query.get("frames", "").isdecimal() else 100
        try:
            loop = asyncio.get_running_loop()
            content = await loop.run_in_executor(None, kind[1], record, place, frames)
        except WavefieldError as error:
            self.set_status(409)
            self.finish(str(error))
            return
        self.set_header("Content-Type", kind[0])
        self.set_header("Content-Disposition", f'attachment; filename="{name}"')
        self.finish(content)


def make_server(
    make_page: Callable[[Any], None], port: int | None, routes: list[Any] | None = None
) -> Server:
    """A server on the loopback."""
    requested = range(PORT, PORT + _MORE_PORTS) if port is None else (port,)
    for number in requested:
        try:
            listening = _listen(number)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
            continue
        application = BokehTornado(
            {"/": Application(FunctionHandler(make_page))},
            extra_websocket_origins=list(_HOSTS),  # on any port: the near end of an ssh tunnel has its own
            extra_patterns=routes or [],
            check_unused_sessions_milliseconds=5000,
            unused_session_lifetime_milliseconds=60_000,
        )
        http = HTTPServer(application)
        http.add_sockets([listening])
        return Server(IOLoop.current(), application, http)
    raise WavefieldError(
        f"port {requested[0]} is taken; choose another with --port"
        if len(requested) == 1
        else f"the ports {requested[0]} to {requested[-1]} are all taken; name a free one with --port"
    )


def _listen(port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.setblocking(False)
        made.bind(("127.0.0.1", port))
        made.listen(128)
    except OSError:
        made.close()
        raise
    return made


def session_server(session: LookSession, port: int | None = None) -> Server:
    """A server of the page of a cube."""

    def make_page(document: Any) -> None:
        record = session.record
        query = {
            key: values[0].decode(errors="replace")
            for key, values in (document.session_context.request.arguments or {}).items()
        }
        first = record.first_step()
        Page(session, Place.read(query, record.names, record.layout.steps, first)).attach(document)

    return make_server(make_page, port, [(r"/save/([\w.]+)", SaveHandler, {"session": session})])


class Served:
    """A server in a thread of its own, for notebooks: shows itself as a frame of the page."""

    def __init__(self, make: Callable[[], Server]) -> None:
        self._ready = threading.Event()
        self._error: BaseException | None = None
        self._server: Server | None = None
        self._thread = threading.Thread(target=self._run, args=(make,), daemon=True, name="wavefield-look")
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error

    def _run(self, make: Callable[[], Server]) -> None:
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
        self._server.io_loop.close(all_fds=True)  # pages notice

    @property
    def url(self) -> str:
        """Address of the page."""
        assert self._server is not None
        return f"http://localhost:{self._server.port}/"

    def stop(self) -> None:
        """Close the page and its server."""
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
