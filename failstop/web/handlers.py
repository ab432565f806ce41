"""Handlers: a request must pass the guard, and then does one thing. The websockets are in sockets.py."""

from __future__ import annotations

import logging
import time
import traceback
from typing import Any

from tornado.web import HTTPError, RequestHandler

from failstop.api.errors import FailstopError
from failstop.web import assets, devices, guard, lease, messages

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.devices import Device
    from failstop.web.page import Page

YEAR_DAYS = 365
NOT_YET = 202
LINES_OF_A_DEFECT = 6


class Guarded(RequestHandler):
    """What all handlers share."""

    SUPPORTED_METHODS = ("GET", "HEAD", "POST")

    def initialize(self, page: Page) -> None:
        """`page`: the page that this handler belongs to."""
        self.page = page

    def set_default_headers(self) -> None:
        """Set the headers that every answer has, refusals too."""
        self.clear_header("Server")
        for name, value in guard.HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse a request that the guard does not let in."""
        if found := guard.refusal(self._request(), self.page.names, self.page.origin):
            self.refuse(*found)

    def _request(self) -> guard.PageRequest:
        given = self.request.headers.get
        return guard.PageRequest(
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
        """Answer a defect, or a malformed request, without any details."""
        self.finish({"error": self._reason})

    def log_exception(self, typ: Any, value: BaseException | None, tb: Any) -> None:
        """Log a defect in a few lines, and only rarely if there are many, because strangers must not fill the
        journal."""
        if not isinstance(value, HTTPError) and self.page.defect_limit.spend(str(typ), time.monotonic()):
            told = "".join(traceback.format_exception(typ, value, tb)).splitlines()[-LINES_OF_A_DEFECT:]
            logging.getLogger("tornado.application").error("a defect of the page: %s", "; ".join(told))

    def body(self) -> dict[str, Any]:
        """The request's JSON object; an empty one if it has none."""
        return messages.read(self.request.body)

    @property
    def scheme(self) -> str:
        """http or https, as the browser has used it."""
        return self.page.scheme or self.request.protocol

    @property
    def cookie(self) -> str:
        """The name of the cookie. Over HTTPS it is a name that no other host name of the robot, and no plain HTTP
        answer, can set."""
        return "__Host-failstop" if self.scheme == "https" else "failstop"

    def token(self) -> str:
        """The device's token, as the browser sends it."""
        return self.get_cookie(self.cookie) or ""

    def device(self) -> Device | None:
        """The paired device that sends the request; None for anyone who may only watch and stop."""
        return self.page.devices.of(self.token())

    def who(self) -> str:
        """The sender of the request, for people."""
        device = self.device()
        return f"page at {self.request.remote_ip}" if device is None else f"{device.name} (page)"

    def paired(self) -> Device | None:
        """The paired device that sends the request. If it is not paired, send a refusal and return None."""
        if (device := self.device()) is None:
            self.refuse(401, "this device is not paired")
        return device


class Asset(Guarded):
    """Serves a file of the page."""

    def get(self, path: str) -> None:
        """Answer with the file, from memory."""
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
    """Serves the state, for a page whose websocket does not work."""

    def get(self) -> None:
        """Answer with everything at once."""
        self.page.look()
        self.finish({"t": time.time(), "live": self.page.watcher.values, "view": self.page.watcher.shown})


class StopHandler(Guarded):
    """Carries out a STOP, for everyone who can open the page."""

    async def post(self) -> None:
        """Answer when the stop is written, or after 0.3 s if it is not; then the page asks again."""
        status, found = await self.page.stopped(self.page.asked.ask(self.who(), self.body().get("id")))
        self.set_status(status)
        self.finish(found)


class Check(Guarded):
    """Answers a request that is like STOP but changes nothing. When the page opens, it finds out in this way whether
    its requests are let in."""

    def post(self) -> None:
        """Answer that they are."""
        self.finish({"ok": True})


class Me(Guarded):
    """Reports the rights of this device."""

    def get(self) -> None:
        """Answer with its name, if it is paired."""
        device = self.device()
        drives = device is not None and self.page.driving.on
        self.finish(
            {
                "pairing": self.page.pairing_on,
                "device": device.name if device else None,
                "drive": drives,
                "lacks": self.page.driving.lacks if device else "",
            }
        )


class Pair(Guarded):
    """Pairs this device, if it knows the code."""

    def post(self) -> None:
        """Put the token into the cookie, where the page can't read it. The page gets only the key that proves that the
        operator is present."""
        if not self.page.pairing_on:
            self.refuse(403, "pairing is off on this robot")
            return
        address = str(self.request.remote_ip)
        if not self.page.pair_limit.spend(address, time.monotonic()):
            self.refuse(429, "too many tries: wait a few seconds")
            return
        given = self.body()
        try:
            token = self.page.pair(str(given.get("code", "")), str(given.get("name", "")))
        except (devices.NotPaired, FailstopError) as error:
            self.refuse(403, str(error))
            return
        self.page.pair_limit.give_back(address)  # one address may be a room of phones that have the code
        secure = self.scheme == "https"
        self.set_cookie(
            self.cookie, token, expires_days=YEAR_DAYS, httponly=True, secure=secure, samesite="Strict", path="/"
        )
        found = self.page.devices.of(token)
        self.finish({"device": found.name if found else "", "key": lease.key_of(token).hex()})


class Forget(Guarded):
    """Ends the pairing of this device."""

    def post(self) -> None:
        """Remove the device, because it has asked for it."""
        if device := self.paired():
            try:
                self.page.revoke(device.id)
            except FailstopError as error:
                self.refuse(500, str(error))
                return
            self.clear_cookie(self.cookie, path="/")
            self.finish({"device": None})


class Verb(Guarded):
    """Disables motion or lowers the speed limit, for paired devices. Requests for which a button must be held come only
    through the websocket."""

    async def post(self, verb: str) -> None:
        """Answer with the gate's decision."""
        if (device := self.paired()) is None:
            return
        if not self.page.verb_limit.spend(verb, time.monotonic()):
            self.refuse(429, "too many requests: wait a second")
            return
        percent = messages.whole(self.body().get("percent"), 100)
        if verb == "limit" and percent is not None and percent > self.page.limit():
            self.refuse(409, "to raise the limit, hold its button on the page")
            return
        done, said = await self.page.workers.ask(verb, self.who(), percent)
        if done:
            if verb == "limit":
                self.page.driving.chose(device.id)
            self.finish({"said": said})
        else:
            self.refuse(409, said)


class Cards(Guarded):
    """Serves the list of saved incidents."""

    async def get(self) -> None:
        """Answer with the incidents, the newest first."""
        self.finish({"incidents": await self.page.incidents.cards()})


class Story(Guarded):
    """Serves an incident's story and picture. A request does not wait for them: if they are not made yet, the page asks
    again."""

    async def get(self, identity: str, what: str) -> None:
        """Answer with the picture as PNG, or with the story as lines."""
        if not self.page.story_limit.spend(str(self.request.remote_ip), time.monotonic()):
            self.refuse(429, "too many requests: wait a second")
        elif not await self.page.incidents.known(identity):
            self.refuse(404, "no such incident")
        elif what == "story":
            story, picture = self.page.incidents.story(identity)
            self.set_status(NOT_YET if story is None or picture is None else 200)
            self.finish({"story": story, "picture": picture})
        elif (content := self.page.incidents.picture(identity)) is None:
            self.refuse(NOT_YET, "not yet")
        elif not content:
            self.refuse(404, "no picture, because it needs matplotlib on the robot")
        else:
            self.set_header("Content-Type", "image/png")
            self.set_header("Cache-Control", "private, max-age=86400, immutable")
            self.finish(content)
