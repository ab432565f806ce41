"""Server: the page of one service, as a process."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
import time

from tornado.ioloop import PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import Application

from failstop.web import assets, guard, handlers
from failstop.web.door import Door
from failstop.web.watcher import PERIOD_S, Watcher

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.settings import Settings

PING_S = 5.0


class Page:
    """What the handlers share."""

    def __init__(self, name: str, settings: Settings) -> None:
        self.name = name
        self.assets = assets.load()
        self.names = guard.names(socket.gethostname(), settings.text("web.hosts"))
        self.watcher = Watcher(name)
        self.viewers: list[handlers.Live] = []
        self._timer = PeriodicCallback(self._tick, PERIOD_S * 1e3)

    def application(self) -> Application:
        """Every address that is answered."""
        rows = [
            ("/api/state", handlers.State),
            ("/api/stop", handlers.Stop),
            ("/api/live", handlers.Live),
            ("/(.*)", handlers.Asset),
        ]
        return Application(
            [(path, handler, {"page": self}) for path, handler in rows],
            websocket_ping_interval=PING_S,
            websocket_ping_timeout=PING_S,
            websocket_max_message_size=4096,
            log_function=lambda handler: None,
        )

    def look(self) -> None:
        """Read the state now, for one request."""
        self.watcher.look(time.monotonic(), time.time())

    def join(self, viewer: handlers.Live) -> None:
        """Somebody looks: from now on the state is read."""
        self.viewers.append(viewer)
        if not self._timer.is_running():
            self._timer.start()
        self.look()
        viewer.show(time.monotonic(), time.time())

    def leave(self, viewer: handlers.Live) -> None:
        """The last one ends it."""
        if viewer in self.viewers:
            self.viewers.remove(viewer)
        if not self.viewers:
            self._timer.stop()

    def _tick(self) -> None:
        now_s, unix_s = time.monotonic(), time.time()
        self.watcher.look(now_s, unix_s)
        for viewer in tuple(self.viewers):
            viewer.show(now_s, unix_s)


async def serve(name: str, settings: Settings) -> None:
    """Serve until SIGTERM or SIGINT. Raises OSError where the address can't be had."""
    page = Page(name, settings)
    address, port = settings.text("web.address"), int(settings["web.port"])
    sockets = bind_sockets(port, address)
    door = Door(page.application())
    door.add_sockets(sockets)
    ended = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    shown = f"[{address}]" if ":" in address else address
    print(f"http://{shown}:{sockets[0].getsockname()[1]}/", flush=True)
    await ended.wait()
    door.stop()
    for viewer in tuple(page.viewers):
        viewer.close(1001, "the page is stopping")
    await door.close_all_connections()
    sys.stdout.flush()
