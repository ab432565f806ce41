"""Handlers: answer the page's HTTP requests, after the guard has accepted them. The websockets are in sockets.py."""

from __future__ import annotations

import logging
import time
import traceback
from typing import Any

from tornado.web import HTTPError, RequestHandler

from failstop.api.errors import FailstopError
from failstop.api.words import ON_PAGE
from failstop.files.instance import DEFAULT_NAME
from failstop.web import assets, devices, guard, lease, messages

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.devices import Device
    from failstop.web.page import Page

YEAR_S = 365 * 86400
NOT_YET = 202
LINES_OF_A_DEFECT = 6


class Guarded(RequestHandler):
    """The base of all handlers. It lets the guard check each request."""

    SUPPORTED_METHODS = ("GET", "HEAD", "POST")

    def initialize(self, page: Page) -> None:
        """`page`: the page that this handler belongs to."""
        self.page = page

    def set_default_headers(self) -> None:
        """Set the headers that every response has, including refusals."""
        self.clear_header("Server")
        for name, value in guard.HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse the request if the guard does not accept it."""
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
            path=self.request.path,
            mode=given("Sec-Fetch-Mode", ""),
            dest=given("Sec-Fetch-Dest", ""),
            upgrade=given("Upgrade", "").lower() == "websocket",
        )

    def refuse(self, status: int, why: str) -> None:
        """Refuse the request, with this status and reason."""
        self.set_status(status)
        self.finish({"error": why})

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer after a bug or a malformed request. The answer contains no details."""
        self.finish({"error": self._reason})

    def log_exception(self, typ: Any, value: BaseException | None, tb: Any) -> None:
        """Log a bug in a few lines. Repeated bugs of one kind are logged rarely, because strangers must not be able to
        fill the journal."""
        if not isinstance(value, HTTPError) and self.page.defect_limit.spend(str(typ), time.monotonic()):
            told = "".join(traceback.format_exception(typ, value, tb)).splitlines()[-LINES_OF_A_DEFECT:]
            logging.getLogger("tornado.application").error("a defect of the page: %s", "; ".join(told))

    def body(self) -> dict[str, Any]:
        """Return the JSON object in the request's body, or an empty object if there is none."""
        return messages.read(self.request.body)

    @property
    def scheme(self) -> str:
        """The scheme that the browser has used, http or https. A proxy may use another scheme toward this process."""
        return self.page.scheme or self.request.protocol

    @property
    def cookie(self) -> str:
        """The name of the cookie with the device's token. The prefix __Host- makes browsers accept the cookie only over
        HTTPS, and only from the robot itself. Over plain HTTP the name has no prefix. The pages of several services on
        one computer get each other's cookies, because browsers ignore the port, so the name contains the service."""
        own = "failstop" if self.page.name == DEFAULT_NAME else f"failstop-{self.page.name}"
        return f"__Host-{own}" if self.scheme == "https" else own

    def token(self) -> str:
        """Return the device's token from the cookie. Empty if the browser sent none."""
        return self.get_cookie(self.cookie) or ""

    def device(self) -> Device | None:
        """Return the paired device that sent the request. None if the request comes from a device that is not paired,
        which may only watch and stop."""
        return self.page.devices.of(self.token())

    def who(self) -> str:
        """Return a name for the sender of the request, to show to people."""
        device = self.device()
        return f"page at {self.request.remote_ip}" if device is None else f"{device.name} {ON_PAGE}"

    def paired(self) -> Device | None:
        """Return the paired device that sent the request. If the sender is not paired, refuse the request and return
        None."""
        if (device := self.device()) is None:
            self.refuse(401, "this device is not paired")
        return device


class Asset(Guarded):
    """Serves the page's files."""

    def get(self, path: str) -> None:
        """Answer with a file. All files are in memory."""
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
    """Serves the robot's state, for a page whose websocket does not work."""

    def get(self) -> None:
        """Answer with all values of the present state."""
        self.page.look()
        self.finish({"t": time.time(), "live": self.page.watcher.values, "view": self.page.watcher.shown})


class StopHandler(Guarded):
    """Stops the robot. Anyone who can open the page may do this."""

    async def post(self) -> None:
        """Request the stop, and answer when the stop is written to the board, or after 0.3 s. If the stop is not
        written, the answer says so, and the page sends its request again."""
        status, found = await self.page.stopped(self.page.asked.ask(self.who(), self.body().get("id")))
        self.set_status(status)
        self.finish(found)


class Check(Guarded):
    """Answers a test request, which passes the same checks as STOP but does not stop the robot. When a page is opened,
    this request shows whether the robot accepts requests of this page."""

    def post(self) -> None:
        """Answer that the request was accepted."""
        self.finish({"ok": True})


class Me(Guarded):
    """Tells the page what this device may do."""

    def get(self) -> None:
        """Answer with the name of this device (null if it is not paired), whether the device may drive, the reason if
        driving is on but nobody can drive, and whether pairing is on."""
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
    """Pairs a device that sends the right code."""

    async def post(self) -> None:
        """Pair the device. Its token goes into a cookie that scripts can't read. Scripts get only the key that proves
        the operator's presence."""
        if not self.page.pairing_on:
            self.refuse(403, "pairing is off on this robot")
            return
        address = str(self.request.remote_ip)
        if not self.page.pair_limit.spend(address, time.monotonic()):
            self.refuse(429, "too many tries: wait a few seconds")
            return
        given = self.body()
        try:
            token = await self.page.pair(str(given.get("code", "")), str(given.get("name", "")))
        except (devices.NotPaired, FailstopError) as error:
            self.refuse(403, str(error))
            return
        # Many phones in one room may share this address, so a correct code must not use up the limit.
        self.page.pair_limit.give_back(address)
        secure = self.scheme == "https"
        # max_age counts by the phone's clock. A robot without a clock of its own may start years behind it.
        self.set_cookie(
            self.cookie,
            token,
            max_age=YEAR_S,
            httponly=True,
            secure=secure,
            samesite="Strict",
            path="/",
        )
        found = self.page.devices.of(token)
        self.finish({"device": found.name if found else "", "key": lease.key_of(token).hex()})


class Forget(Guarded):
    """Unpairs this device."""

    async def post(self) -> None:
        """Remove the device from the paired devices."""
        if device := self.paired():
            try:
                await self.page.revoke(device.id)
            except FailstopError as error:
                self.refuse(500, str(error))
                return
            self.clear_cookie(self.cookie, path="/")
            self.finish({"device": None})


class Verb(Guarded):
    """Disables motion or lowers the speed limit, for paired devices. Requests that need a held button, for example
    enable, come through the websocket."""

    async def post(self, verb: str) -> None:
        """Answer with the gate's decision about `verb`."""
        if (device := self.paired()) is None:
            return
        if not self.page.verb_limit.spend(verb, time.monotonic()):
            self.refuse(429, "too many requests: wait a second")
            return
        percent = messages.whole(self.body().get("percent"), 100)
        if verb == "limit" and percent is not None and percent > self.page.limit():
            self.refuse(409, "to raise the limit, hold its button on the page")
            return
        run = self.page.driving.run()
        done, said = await self.page.workers.ask(verb, self.who(), percent)
        if done:
            if verb == "limit":
                self.page.driving.chose(device.id, run)
            self.finish({"said": said})
        else:
            self.refuse(409, said)


class Cards(Guarded):
    """Serves the list of saved incidents."""

    async def get(self) -> None:
        """Answer with the newest incidents, the newest first."""
        self.finish({"incidents": await self.page.incidents.cards()})


class Story(Guarded):
    """Serves the story and the picture of an incident. If they are not ready yet, the answer says so, and the page asks
    again later."""

    async def get(self, identity: str, what: str) -> None:
        """Answer with the picture as PNG, or with the story as a list of lines."""
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
            self.refuse(404, "no picture, because the robot lacks matplotlib or room on its disk")
        else:
            self.set_header("Content-Type", "image/png")
            self.set_header("Cache-Control", "private, max-age=86400, immutable")
            self.finish(content)
