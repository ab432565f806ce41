"""A viewer that is no browser: a websocket in the hands of the test, which answers what and when it wants to."""

from __future__ import annotations

import asyncio
import json
import time
from types import TracebackType
from typing import Any

from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from failstop.web import lease
from tests.web.parts import Web

WAIT_S = 10.0


class Viewer:
    """A context manager: connected on entry."""

    def __init__(self, web: Web, headers: dict[str, str] | None = None, path: str = "/api/live") -> None:
        """`path`: of the websocket, of which there are two."""
        self._web = web
        self._path = path
        self._headers = {"Origin": f"{web.scheme}://127.0.0.1:{web.port}", **(headers or {})}
        self.key = lease.key_of(self._headers.get("Cookie", "").partition("=")[2])
        self.loop = asyncio.new_event_loop()
        self.seen: list[dict[str, Any]] = []

    def __enter__(self) -> Viewer:
        scheme = "wss" if self._web.scheme == "https" else "ws"
        url = f"{scheme}://127.0.0.1:{self._web.port}{self._path}"

        async def connect() -> WebSocketClientConnection:
            return await websocket_connect(HTTPRequest(url, headers=self._headers, validate_cert=False))

        self.connection = self.loop.run_until_complete(connect())
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.hang_up()
        self.loop.close()

    def hang_up(self) -> None:
        """End the connection."""

        async def close() -> None:
            self.connection.close()
            await asyncio.sleep(0.05)

        self.loop.run_until_complete(close())

    def send(self, **message: Any) -> None:
        """One message."""

        async def send() -> None:
            await self.connection.write_message(json.dumps(message))

        self.loop.run_until_complete(send())

    def next(self) -> dict[str, Any]:
        """The next message. Raises asyncio.TimeoutError, ConnectionError."""

        async def read() -> Any:
            return await asyncio.wait_for(self.connection.read_message(), WAIT_S)

        text = self.loop.run_until_complete(read())
        if text is None:
            raise ConnectionError(self.connection.close_reason or "closed")
        found: dict[str, Any] = json.loads(text)
        self.seen.append(found)
        return found

    def answer(self, nonce: str, key: bytes | None = None, drive: str = "") -> None:
        """As the page does; with a command of the stick, if it is held."""
        self.send(nonce=nonce, answer=lease.answer_to(nonce + drive, self.key if key is None else key), drive=drive)

    def attend(self) -> None:
        """Ask for nonces, and wait for the first."""
        self.send(attend=True)
        until_s = time.monotonic() + WAIT_S
        while "nonce" not in (found := self.next()):
            assert "attend" not in found, found
            assert time.monotonic() < until_s
        self.answer(found["nonce"])

    def hold(self, verb: str, seconds: float = WAIT_S, *, epoch: int | None = None, **more: Any) -> dict[str, Any]:
        """Hold a button as the page does, for so long at most, with the epoch that it knew at the beginning; returns
        what the robot says at the end."""
        while epoch is None and not self.epoch():
            self.next()
        epoch = self.epoch() if epoch is None else epoch
        self.send(hold=verb, id=(identity := f"{time.monotonic_ns()}"), epoch=epoch, **more)
        until_s = time.monotonic() + seconds
        while True:
            found = self.next()
            if found.get("hold") == identity and "enough" not in found:
                return found
            if found.get("enough"):
                self.send(sure=identity)
            elif time.monotonic() < until_s:
                self.send(held=identity)
            else:
                self.send(released=identity)
                return {}

    def epoch(self) -> int:
        """The number in the newest view; 0: there was none yet."""
        return next((message["view"]["epoch"] for message in reversed(self.seen) if "view" in message), 0)

    def stay(self, seconds: float, drive: str = "") -> None:
        """Answer every nonce for so long, with that command if one is given."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            if nonce := self.next().get("nonce"):
                self.answer(nonce, drive=drive)
