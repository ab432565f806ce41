"""Sockets: the page's two websockets. One shows the state and carries the requests of paired devices. The other one
carries only STOP."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from typing import Any

from tornado.iostream import StreamClosedError
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from failstop.web import hold, lease, messages, stopping
from failstop.web.handlers import Guarded

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.page import Page

MOST_VIEWERS = 64
MOST_ASKED = 8
STUCK_S = 10.0
"""How long sending one message to a viewer may take, s. If it takes longer, the viewer's connection is closed."""
MOST_EPOCH = 1 << 62
HELD_VERBS = ("reset", "enable", "limit")


class Socket(Guarded, WebSocketHandler):
    """The base of both websockets."""

    def check_origin(self, origin: str) -> bool:
        """Return True, because the guard has already checked the origin."""
        return True

    def open(self, *_: str, **__: str) -> None:
        """Tell the server that this connection is now a websocket, so that it no longer counts toward the server's
        limit."""
        if self.ws_connection and self.ws_connection.stream:
            self.page.let_in(self.ws_connection.stream)

    def later(self, message: dict[str, Any]) -> asyncio.Future[None] | None:
        """Start sending a message, without waiting until it is sent. Returns None if the connection is closed."""
        try:
            return asyncio.ensure_future(_quiet(self.write_message(message)))
        except WebSocketClosedError:
            return None


class StopSocket(Socket):
    """Carries STOP from anyone who can open the page. Nothing else uses this connection, so a STOP waits for
    nothing."""

    def open(self, *_: str, **__: str) -> None:
        """Add this connection to the page. Open the stop pipe, so that a later STOP need not wait for this."""
        super().open()
        self.page.stops.add(self, str(self.request.remote_ip))
        self.page.stop_pipe.prepare()

    def on_close(self) -> None:
        """Remove this connection from the page."""
        self.page.stops.leave(self)

    def initialize(self, page: Page) -> None:
        """`page`: the page that this websocket belongs to."""
        super().initialize(page)
        self._asked: set[asyncio.Task[None]] = set()

    def on_message(self, message: str | bytes) -> None:
        """Request the stop in the message, before doing anything else. While MOST_ASKED stops of this connection wait
        for their answers, a further stop gets no answer, but is requested too."""
        if identity := messages.read(message).get("stop"):
            request = self.page.asked.ask(self.who(), identity)  # by its present name: it may be revoked since
            if len(self._asked) < MOST_ASKED:
                asked = asyncio.ensure_future(self._answer(identity, request))
                self._asked.add(asked)
                asked.add_done_callback(self._asked.discard)

    async def _answer(self, identity: object, request: stopping.Request) -> None:
        _, found = await self.page.stopped(request)
        self.later({"id": identity, **found})


class Live(Socket):
    """Sends the state to one viewer, ten times per second, and receives the requests of a paired device."""

    def initialize(self, page: Page) -> None:
        """`page`: the page that this websocket belongs to."""
        super().initialize(page)
        self._number = -1
        self._sending: asyncio.Future[None] | None = None
        self._sent_s = 0.0
        self._hold: hold.Hold | None = None
        self._asked: set[asyncio.Task[None]] = set()
        self._heard: tuple[int, float] | None = None
        """The newest time that the page has sent, by the page's clock, and when it arrived (time.monotonic())."""

    def prepare(self) -> None:
        """Let the guard check the request. If the page already has MOST_VIEWERS viewers, the new viewer is refused. But
        a paired viewer takes the place of a viewer that is not paired, if there is one."""
        super().prepare()
        if not self._finished and len(self.page.viewers) >= MOST_VIEWERS:
            strangers = [viewer for viewer in self.page.viewers if viewer.device() is None]
            if self.device() is None or not strangers:
                self.refuse(503, "too many viewers")
            else:
                strangers[0].close(1013, "a paired device needs this connection")
                self.page.leave(strangers[0])

    def open(self, *_: str, **__: str) -> None:
        """Add this viewer to the page."""
        super().open()
        self.page.join(self)

    def on_close(self) -> None:
        """Remove this viewer from the page."""
        self._hold = None
        self.page.leave(self)

    def on_message(self, message: str | bytes) -> None:
        """Handle a message of the page. A message says that the operator begins or ends attending, holds a button, or
        lets go of the stick. Or it answers a nonce, or has the page's time. Other messages are ignored."""
        found = messages.read(message)
        if (asked := messages.whole(found.get("asked"), MOST_EPOCH)) is not None:
            self._heard = asked, time.monotonic()
        elif found.get("attend") is True:
            self._attend()
        elif found.get("attend") is False:
            self.page.attending.end(self)
        elif verb := found.get("hold"):
            self._begin(str(verb), found)
        elif self._hold and any(found.get(word) == self._hold.identity for word in ("held", "sure", "released")):
            self._go_on(self._hold, found)
        elif found.get("drive") is False:
            self.page.driving.release(self)
        elif held := self.page.attending.of(self):
            self._answer(held, str(found.get("nonce")), str(found.get("answer")), str(found.get("drive") or ""))

    def _answer(self, held: lease.Lease, nonce: str, answer: str, drive: str) -> None:
        """Handle the device's answer to a nonce. A right answer proves that the device was present. The answer may
        contain a driving command. If it contains none, the viewer counts as having let go of the stick. If the proof
        can't be reported, for example because the service was restarted, the viewer no longer attends: then the
        operator must press ATTEND and choose the speed limit again."""
        if not held.accept(nonce, answer, drive):
            return
        if self.device() is None:  # revoked since
            self.page.attending.end(self)
            return
        if wrong := self.page.attending.proven(self):
            self.page.attending.end(self)
            self.send({"attend": wrong})
        elif not drive:
            self.page.driving.release(self)
        elif wrong := self.page.driving.command(self, drive, held.proven_ns, self.page.watcher.state):
            self.send({"drive": wrong})

    def _attend(self) -> None:
        device = self.device()
        if device is None:
            self.send({"attend": "this device is not paired"})
        else:
            self.page.attending.begin(self, device.name, lease.key_of(self.token()))

    def _begin(self, verb: str, found: dict[str, Any]) -> None:
        now_s, identity = time.monotonic(), str(found.get("id"))[: stopping.MOST_OF_AN_ID]
        epoch, percent = messages.whole(found.get("epoch"), MOST_EPOCH), messages.whole(found.get("percent"), 100)
        self._hold = None
        if self.device() is None:
            self._end(identity, "this device is not paired")
        elif verb not in HELD_VERBS or epoch is None:
            self._end(identity, "this page is of another version: load it again")
        elif not self.page.verb_limit.spend(verb, now_s):
            self._end(identity, "too many requests: wait a second")
        else:
            self._hold = hold.Hold(verb, identity, epoch, percent, now_s, now_s)

    def _go_on(self, held: hold.Hold, found: dict[str, Any]) -> None:
        now_s = time.monotonic()
        if "released" in found:
            self._hold = None
        elif "sure" in found:
            self._hold = None
            if held.sure(now_s):
                asked = asyncio.ensure_future(self._ask(held))
                self._asked.add(asked)
                asked.add_done_callback(self._asked.discard)
            else:
                self._end(held.identity, hold.LATE)
        elif not held.held(now_s):
            self._hold = None
            self._end(held.identity, hold.LATE)
        elif held.enough(now_s):
            self.send({"hold": held.identity, "enough": True})

    async def _ask(self, held: hold.Hold) -> None:
        """Make the request for which the button was held. The request is refused if the robot was stopped again since
        the hold began, because the person may not have seen that stop."""
        if self.device() is None:  # revoked since
            done, said = False, "this device is not paired"
        elif self.page.newest_stop() != held.epoch:
            done, said = False, hold.NEWER_STOP
        else:
            run = self.page.driving.run()
            done, said = await self.page.workers.ask(held.verb, self.who(), held.percent, held.epoch)
            if done and held.verb == "limit" and (device := self.device()):
                self.page.driving.chose(device.id, run)
        self._end(held.identity, said, done=done)

    def _end(self, identity: str, said: str, *, done: bool = False) -> None:
        self.send({"hold": identity, "done": done, "said": said})

    def show(self, now_s: float, unix_s: float) -> None:
        """Send the newest values, unless the last message is still being sent. If sending takes longer than STUCK_S,
        close the connection. Never waits."""
        if self._sending is not None and not self._sending.done():
            connection = self.ws_connection
            if now_s - self._sent_s > STUCK_S and connection and connection.stream:
                connection.stream.close()
            return
        watcher = self.page.watcher
        message: dict[str, Any] = {"t": unix_s, "live": watcher.values}
        if self._heard:
            asked, at_s = self._heard
            message["asked"] = asked, int(max(0.0, now_s - at_s) * 1e3)
        if held := self.page.attending.of(self):
            message["counted"] = self.page.counts(held)
            message["nonce"] = held.ask(secrets.token_bytes(lease.NONCE_BYTES), time.monotonic_ns())
            message["chosen"] = self.page.driving.has_chosen(self.device())
        if self._number != watcher.number:
            self._number = watcher.number
            message["view"] = watcher.shown
        self._sending = self.send(message)
        self._sent_s = now_s

    def send(self, message: dict[str, Any]) -> asyncio.Future[None] | None:
        """Start sending a message. If the connection is closed already, the viewer is removed from the page."""
        sending = self.later(message if "t" in message else {"t": time.time(), **message})
        if sending is None:
            self.page.leave(self)
        return sending


async def _quiet(sent: asyncio.Future[None]) -> None:
    with contextlib.suppress(WebSocketClosedError, StreamClosedError):
        await sent
