"""Server: the page of one service, as a process."""

from __future__ import annotations

import asyncio
import logging
import os
import secrets
import signal
import socket
import time
from typing import Any

from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import Application

from failstop.api.errors import FailstopError
from failstop.web import assets, control, devices, guard, handlers, kept, sockets, stopping, whereabouts
from failstop.web.attending import Attending
from failstop.web.door import Door, Places
from failstop.web.driving import Driving
from failstop.web.hands import TOUCHED, Hands
from failstop.web.incidents import Incidents
from failstop.web.limits import Limit
from failstop.web.watcher import PERIOD_S, Watcher

TYPE_CHECKING = False
if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable

    from tornado.iostream import IOStream

    from failstop.policy.settings import Settings

PING_S = 5.0
ID_BYTES = 4


class Page:
    """The state that the handlers share."""

    def __init__(self, name: str, settings: Settings) -> None:
        """Raises FailstopError."""
        self.name = name
        self.address = settings.text("web.address")
        self.port = int(settings["web.port"])
        self.assets = assets.load()
        self.origin = guard.origin_of(settings.text("web.origin"))
        self.scheme = self.origin.partition(":")[0]
        self.names = guard.names(socket.gethostname(), settings.text("web.hosts"), self.origin)
        self.watcher = Watcher(name)
        self.viewers: list[sockets.Live] = []
        self.stops: Places[sockets.StopSocket] = Places(sockets.MOST_STOPS)
        self.let_in: Callable[[IOStream], None] = lambda stream: None
        self.pairing_on = settings.on("web.pairing")
        self.pairing = devices.Pairing()
        self.pair_limit = Limit(0.2, 5)
        self.verb_limit = Limit(2.0, 6)
        self.story_limit = Limit(10.0, 60)
        self.defect_limit = Limit(1 / 60, 2)
        self.asked = stopping.Asked()
        self.hands = Hands(name)
        self.driving = Driving(name, settings)
        self.attending = Attending(name, self.driving.end)
        self.incidents = Incidents(name)
        self._kept = kept.Kept(kept.folder(name, os.environ))
        self.devices = self._kept.devices() if self.pairing_on else devices.Devices()
        self.tls = self._tls(settings.text("web.tls"))
        self.fingerprint = self._kept.fingerprint() if self.tls else ""
        self.control_path = self._kept.path(kept.CONTROL)
        self._timer = PeriodicCallback(self._tick, PERIOD_S * 1e3)

    def _tls(self, wanted: str) -> ssl.SSLContext | None:
        if wanted == "off" or (wanted == "auto" and guard.only_here(self.address)):
            return None
        return self._kept.tls(sorted(self.names))

    def application(self) -> Application:
        """Every address that is answered."""
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
            [(path, handler, {"page": self}) for path, handler in rows],
            websocket_ping_interval=PING_S,
            websocket_ping_timeout=PING_S,
            websocket_max_message_size=4096,
            log_function=lambda handler: None,
        )

    def whereabouts(self) -> dict[str, Any]:
        """Where it listens, for whoever is to find it."""
        scheme = "https" if self.tls else "http"
        where = {"scheme": scheme, "address": self.address, "port": self.port, "fingerprint": self.fingerprint}
        return {**where, "origin": self.origin}

    def look(self) -> None:
        """Read the state now, for one request."""
        self.watcher.look(time.monotonic(), time.time())

    def newest_stop(self) -> int:
        """The epoch that is in force now; 0: no service runs."""
        self.look()
        return self.watcher.state.epoch if self.watcher.state else 0

    def limit(self) -> int:
        """The speed limit that is in force now, in percent of the settings' speeds."""
        self.look()
        return round(100 * self.watcher.state.speed_limit) if self.watcher.state else 0

    def pair(self, code: str, name: str) -> str:
        """A new device's token. Raises NotPaired, FailstopError."""
        self.pairing.take(code, time.monotonic())
        token = secrets.token_urlsafe(devices.TOKEN_BYTES)
        made = devices.Device(
            secrets.token_hex(ID_BYTES), self.devices.free_name(name), devices.digest_of(token), round(time.time())
        )
        self.devices.add(made)
        try:
            self._kept.keep(self.devices)
        except Exception:
            self.devices.revoke(made.id)
            raise
        return token

    def revoke(self, identity: str) -> str:
        """The name of the device that may nothing any more; empty when there is none of that id. Raises FailstopError
        when it may until the page ends only."""
        found = self.devices.revoke(identity)
        if found is None:
            return ""
        for viewer in tuple(self.viewers):
            if viewer.device() is None:
                self.attending.end(viewer)
        try:
            self._kept.keep_fewer(self.devices)
        except FailstopError as error:
            raise FailstopError(f"{found.name} is revoked, and back after a restart of the page: {error}") from None
        return found.name

    def join(self, viewer: sockets.Live) -> None:
        """Somebody looks: from now on the state is read."""
        self.viewers.append(viewer)
        if not self._timer.is_running():
            self._timer.start()
        self.look()
        viewer.show(time.monotonic(), time.time())

    def leave(self, viewer: sockets.Live) -> None:
        """End a viewer, and its operator's attendance. The last one ends the reading."""
        self.attending.end(viewer)
        if viewer in self.viewers:
            self.viewers.remove(viewer)
        if not self.viewers:
            self._timer.stop()

    def _tick(self) -> None:
        now_s, unix_s = time.monotonic(), time.time()
        self.watcher.look(now_s, unix_s)
        for viewer in tuple(self.viewers):
            viewer.show(now_s, unix_s)

    def close(self) -> None:
        """Give everything back."""
        self._timer.stop()
        self.attending.close()
        self.driving.close()
        self.hands.close()
        self.incidents.close()
        control.remove(self.control_path)


async def serve(name: str, settings: Settings) -> None:
    """Serve until SIGTERM or SIGINT. Raises FailstopError, and OSError where the address can't be had."""
    logging.getLogger("tornado.general").setLevel(logging.ERROR)  # garbage from outside must not fill the journal
    # tornado's timers go by the wall clock: set back by an hour, it would be an hour until the next look at the state.
    IOLoop.current().time = time.monotonic  # type: ignore[method-assign]
    page = Page(name, settings)
    listening = bind_sockets(page.port, page.address)
    page.port = listening[0].getsockname()[1]
    door = Door(page.application(), ssl_options=page.tls, names=page.names)
    page.let_in = door.let_in
    door.add_sockets(listening)
    commands = control.listen(page, page.control_path)
    ended = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    print("\n".join(whereabouts.listening(page.whereabouts())), flush=True)
    await ended.wait()
    door.stop()
    commands.stop()
    page.close()
    for socket_ in (*page.viewers, *page.stops.all()):
        socket_.close(1001, "the page is stopping")
    await door.close_all_connections()
