"""Server: the process that serves the page of one service."""

from __future__ import annotations

import asyncio
import logging
import signal
import time

from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import Application

from failstop.api.errors import FailstopError
from failstop.web import addresses, control, handlers, sockets
from failstop.web.connections import BoundedServer
from failstop.web.page import Page
from failstop.web.workers import TOUCHED

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.settings import Settings
    from failstop.web.source import Source

PING_S = 5.0


def application(page: Page) -> Application:
    """Return the web application, with all paths that the page serves."""
    rows = [
        ("/api/state", handlers.State),
        ("/api/stop", handlers.StopHandler),
        ("/api/stop/live", sockets.StopSocket),
        ("/api/check", handlers.Check),
        ("/api/live", sockets.Live),
        ("/api/me", handlers.Me),
        ("/api/pair", handlers.Pair),
        ("/api/forget", handlers.Forget),
        (f"/api/({'|'.join(TOUCHED)})", handlers.Verb),
        ("/api/incidents", handlers.Cards),
        ("/api/incidents/([^/]+)/(story|picture)", handlers.Story),
        ("/(.*)", handlers.Asset),
    ]
    return Application(
        [(path, handler, {"page": page}) for path, handler in rows],
        websocket_ping_interval=PING_S,
        websocket_ping_timeout=PING_S,
        websocket_max_message_size=4096,
        log_function=lambda handler: None,
    )


async def serve(name: str, settings: Settings, source: Source) -> None:
    """Serve the page until SIGTERM or SIGINT. Raises FailstopError."""
    logging.getLogger("tornado.general").setLevel(logging.ERROR)  # malformed requests must not fill the journal
    # tornado's timers use the wall clock. If it were set back by an hour, the state would not be read for an hour.
    IOLoop.current().time = time.monotonic  # type: ignore[method-assign]
    page = Page(name, settings, source)
    try:
        listening = bind_sockets(page.port, page.address)
    except OSError as error:
        raise FailstopError(f"the page can't listen at {page.address}, port {page.port}: {error.strerror}") from None
    page.port = listening[0].getsockname()[1]
    bounded = BoundedServer(application(page), ssl_options=page.tls, names=page.names)
    page.let_in = bounded.let_in
    bounded.add_sockets(listening)
    commands = control.listen(page, page.control_path)
    ended = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    print("\n".join([*addresses.listening(page.addresses()), f"settings: {source.described()}"]), flush=True)
    await ended.wait()
    bounded.stop()
    commands.stop()
    control.remove(page.control_path)  # while the folder is locked: later it could be the socket of the next page
    page.close()
    for socket_ in (*page.viewers, *page.stops.all()):
        socket_.close(1001, "the page is stopping")
    await bounded.close_all_connections()
