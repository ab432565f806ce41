"""Handlers: each request passes the guard, then does one thing."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import time
from typing import Any

from tornado.iostream import StreamClosedError
from tornado.web import RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from failstop.api.errors import FailstopError, NoService
from failstop.web import assets, devices, guard, lease, stopping

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.devices import Device
    from failstop.web.server import Page

YEAR_DAYS = 365
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

    @property
    def cookie(self) -> str:
        """The name of the cookie; over HTTPS one that no other name of the robot, and no plain answer, can set."""
        return "__Host-failstop" if self.request.protocol == "https" else "failstop"

    def token(self) -> str:
        """What the device says it is."""
        return self.get_cookie(self.cookie) or ""

    def device(self) -> Device | None:
        """The paired device that asks; None: somebody who sees and stops."""
        return self.page.devices.of(self.token())

    def who(self) -> str:
        """Whose request it is, for people."""
        device = self.device()
        return f"page at {self.request.remote_ip}" if device is None else f"{device.name} (page)"

    def paired(self) -> Device | None:
        """The paired device that asks; None, and the refusal is sent."""
        if (device := self.device()) is None:
            self.refuse(401, "this device is not paired")
        return device


class Asset(Guarded):
    """A file of the page."""

    def get(self, path: str) -> None:
        """From memory."""
        found = self.page.assets.get(f"/{path}")
        if found is None:
            self.refuse(404, "there is nothing here")
            return
        content, small, kind, more = found
        self.set_header("Vary", "Accept-Encoding")
        if "gzip" in self.request.headers.get("Accept-Encoding", ""):
            content = small
            self.set_header("Content-Encoding", "gzip")
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
            asked_ns = self.page.asked.ask(self.page.name, self.who(), self.body().get("id"))
            written = await stopping.written(self.page.name, asked_ns)
        except NoService as error:
            self.refuse(503, str(error))
            return
        except FailstopError as error:
            self.refuse(500, str(error))
            return
        self.page.look()
        self.finish({"asked": asked, "written": written, "face": self.page.watcher.shown})


class Me(Guarded):
    """What this device may."""

    def get(self) -> None:
        """Its name, if it is paired."""
        device = self.device()
        self.finish({"pairing": self.page.pairing_on, "device": device.name if device else None})


class Pair(Guarded):
    """A code makes this a paired device."""

    def post(self) -> None:
        """The token is the cookie's alone; the page gets the key that proves that the operator is there."""
        if not self.page.pairing_on:
            self.refuse(403, "pairing is off on this robot")
            return
        address = str(self.request.remote_ip)
        if not self.page.pair_limit.take(address, time.monotonic()):
            self.refuse(429, "too many tries: wait a few seconds")
            return
        given = self.body()
        try:
            token = self.page.pair(str(given.get("code", "")), str(given.get("name", "")))
        except (devices.NotPaired, FailstopError) as error:
            self.refuse(403, str(error))
            return
        self.page.pair_limit.give_back(address)  # who has the code does not guess: one address may be a room of phones
        secure = self.request.protocol == "https"
        self.set_cookie(
            self.cookie, token, expires_days=YEAR_DAYS, httponly=True, secure=secure, samesite="Strict", path="/"
        )
        found = self.page.devices.of(token)
        self.finish({"device": found.name if found else "", "key": lease.key_of(token).hex()})


class Forget(Guarded):
    """This device is paired no more."""

    def post(self) -> None:
        """By its own wish."""
        if device := self.paired():
            self.page.revoke(device.id)
            self.clear_cookie(self.cookie, path="/")
            self.finish({"device": None})


class Verb(Guarded):
    """Reset, enable, disable, limit the speed, for paired devices."""

    async def post(self, verb: str) -> None:
        """The gate decides."""
        if self.paired() is None:
            return
        if not self.page.verb_limit.take(verb, time.monotonic()):
            self.refuse(429, "too many requests: wait a second")
            return
        done, said = await self.page.hands.ask(verb, self.who(), self.body().get("percent"))
        if done:
            self.finish({"said": said})
        else:
            self.refuse(409, said)


class Cards(Guarded):
    """The incidents that are kept."""

    async def get(self) -> None:
        """The newest first."""
        self.finish({"incidents": await self.page.incidents.cards()})


class Story(Guarded):
    """What happened, and how it looked."""

    async def get(self, identity: str, what: str) -> None:
        """The picture as PNG, the story as lines."""
        if not self.page.story_limit.take(what, time.monotonic()):
            self.refuse(429, "too many requests: wait a second")
            return
        if what == "picture":
            picture = await self.page.incidents.picture(identity)
            if picture is None:
                self.refuse(404, "no picture: that needs matplotlib on the robot")
                return
            self.set_header("Content-Type", "image/png")
            self.set_header("Cache-Control", "private, max-age=86400, immutable")
            self.finish(picture)
            return
        story = await self.page.incidents.story(identity)
        if story is None:
            self.refuse(404, "no such incident")
        else:
            self.finish({"story": story})


class Live(Guarded, WebSocketHandler):
    """The state, ten times a second, to one viewer."""

    def initialize(self, page: Page) -> None:
        """`page`: what serves it."""
        super().initialize(page)
        self._number = -1
        self._sending: asyncio.Future[None] | None = None
        self._sent_s = 0.0

    def prepare(self) -> None:
        """The guard, and room for one more: a paired device takes somebody else's place."""
        super().prepare()
        if not self._finished and len(self.page.viewers) >= MOST_VIEWERS:
            strangers = [viewer for viewer in self.page.viewers if viewer.device() is None]
            if self.device() is None or not strangers:
                self.refuse(503, "too many viewers")
            else:
                strangers[0].close(1013, "a paired device takes this place")
                self.page.leave(strangers[0])

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
        """It attends, answers, or attends no more; anything else means nothing."""
        try:
            found = json.loads(message)
        except ValueError:
            return
        if not isinstance(found, dict):
            return
        if identity := found.get("stop"):
            with contextlib.suppress(FailstopError):  # the request that comes by the other way is answered
                self.page.asked.ask(self.page.name, self.who(), identity)
        elif found.get("attend") is True:
            self._attend()
        elif found.get("attend") is False:
            self.page.attending.end(self)
        elif (held := self.page.attending.of(self)) and held.take(str(found.get("nonce")), str(found.get("answer"))):
            if self.device() is None:  # revoked since
                self.page.attending.end(self)
            elif wrong := self.page.attending.proven(self):
                self.send({"attend": wrong})

    def _attend(self) -> None:
        device = self.device()
        if device is None:
            self.send({"attend": "this device is not paired"})
        else:
            self.page.attending.begin(self, device.name, lease.key_of(self.token()))

    def show(self, now_s: float, unix_s: float) -> None:
        """Send what is new. Nothing waits: a viewer that has not taken the last message misses this one."""
        if self._sending is not None and not self._sending.done():
            connection = self.ws_connection
            if now_s - self._sent_s > STUCK_S and connection and connection.stream:
                connection.stream.close()
            return
        watcher = self.page.watcher
        message: dict[str, Any] = {"t": unix_s, "live": watcher.values}
        if held := self.page.attending.of(self):
            message["nonce"] = held.ask(secrets.token_bytes(lease.NONCE_BYTES), time.monotonic_ns())
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
