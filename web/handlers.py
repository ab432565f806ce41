"""Handlers: each request passes the guard, then does one thing."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from typing import Any

from tornado.iostream import StreamClosedError
from tornado.web import RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from failstop.api.errors import FailstopError, NoService
from failstop.web import assets, guard, stopping

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.server import Page

MOST_VIEWERS = 64
STUCK_S = 10.0
"""A viewer that takes nothing for this long is let go."""


class Guarded(RequestHandler):
    """What every answer has in common."""

    SUPPORTED_METHODS = ("GET", "HEAD", "POST")

    def initialize(self, page: Page) -> None:
        """`page`: what serves it."""
        self.page = page

    def set_default_headers(self) -> None:
        """Of every answer, refusals too."""
        self.clear_header("Server")
        for name, value in guard.HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse what the guard does not let in."""
        if found := guard.refusal(self._request(), self.page.names):
            self.refuse(*found)

    def _request(self) -> guard.Request:
        given = self.request.headers.get
        return guard.Request(
            method=self.request.method or "",
            scheme=self.request.protocol,
            host=given("Host", ""),
            origin=given("Origin", ""),
            header=given(guard.HEADER, ""),
            site=given("Sec-Fetch-Site", ""),
            upgrade=given("Upgrade", "").lower() == "websocket",
        )

    def refuse(self, status: int, why: str) -> None:
        """Answer with the reason."""
        self.set_status(status)
        self.finish({"error": why})

    def write_error(self, status_code: int, **_: Any) -> None:
        """A defect, or a request that is none: nothing of it is told."""
        self.finish({"error": self._reason})

    def body(self) -> dict[str, Any]:
        """What was sent: an object, or nothing."""
        try:
            found = json.loads(self.request.body or b"{}")
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    def who(self) -> str:
        """Whose request it is, for people."""
        return f"page at {self.request.remote_ip}"


class Asset(Guarded):
    """A file of the page."""

    def get(self, path: str) -> None:
        """From memory."""
        found = self.page.assets.get(f"/{path}")
        if found is None:
            self.refuse(404, "there is nothing here")
            return
        content, kind, more = found
        self.set_header("Content-Type", kind)
        if more:
            self.set_header("Content-Security-Policy", assets.policy(guard.HEADERS["Content-Security-Policy"], more))
        self.finish(content)

    head = get


class State(Guarded):
    """The state, for a page whose websocket does not come through."""

    def get(self) -> None:
        """Everything at once."""
        self.page.look()
        self.finish({"t": time.time(), "live": self.page.watcher.values, "face": self.page.watcher.shown})


class Stop(Guarded):
    """STOP, for everyone who can open the page."""

    async def post(self) -> None:
        """Answers when it is written, or was not within 0.3 s; then the page asks again."""
        asked = time.time()
        try:
            written = await stopping.stop(self.page.name, self.who(), self.page.watcher.epoch)
        except NoService as error:
            self.refuse(503, str(error))
            return
        except FailstopError as error:
            self.refuse(500, str(error))
            return
        self.page.look()
        self.finish({"asked": asked, "written": written, "face": self.page.watcher.shown})


class Live(Guarded, WebSocketHandler):
    """The state, ten times a second, to one viewer."""

    def initialize(self, page: Page) -> None:
        """`page`: what serves it."""
        super().initialize(page)
        self._number = -1
        self._sending: asyncio.Future[None] | None = None
        self._sent_s = 0.0

    def prepare(self) -> None:
        """The guard, and room for one more."""
        super().prepare()
        if not self._finished and len(self.page.viewers) >= MOST_VIEWERS:
            self.refuse(503, "too many viewers")

    def check_origin(self, origin: str) -> bool:
        """The guard has seen to it."""
        return True

    def open(self, *_: str, **__: str) -> None:
        """A viewer comes."""
        self.page.join(self)

    def on_close(self) -> None:
        """A viewer goes."""
        self.page.leave(self)

    def on_message(self, message: str | bytes) -> None:
        """Nothing is asked of a viewer."""

    def show(self, now_s: float, unix_s: float) -> None:
        """Send what is new. Nothing waits: a viewer that has not taken the last message misses this one."""
        if self._sending is not None and not self._sending.done():
            connection = self.ws_connection
            if now_s - self._sent_s > STUCK_S and connection and connection.stream:
                connection.stream.close()
            return
        watcher = self.page.watcher
        message: dict[str, Any] = {"t": unix_s, "live": watcher.values}
        if self._number != watcher.number:
            self._number = watcher.number
            message["face"] = watcher.shown
        self.send(message)
        self._sent_s = now_s

    def send(self, message: dict[str, Any]) -> None:
        """Hand a message over; a viewer that has just gone gets none."""
        try:
            self._sending = asyncio.ensure_future(_quiet(self.write_message(message)))
        except WebSocketClosedError:
            self.page.leave(self)


async def _quiet(sent: asyncio.Future[None]) -> None:
    with contextlib.suppress(WebSocketClosedError, StreamClosedError):
        await sent
