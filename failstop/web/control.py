"""Control: lets `failstop web pair`, `devices` and `revoke` talk to the running page, through a Unix socket in the
page's folder."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import secrets
import socket
import time
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_unix_socket
from tornado.web import Application, RequestHandler

from failstop.api.errors import FailstopError, Refused
from failstop.web import devices, storage

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.web.page import Page

TIMEOUT_S = 5.0
REFUSED = 409


class _Asked(RequestHandler):
    def initialize(self, page: Page) -> None:
        self.page = page

    def write_error(self, status_code: int, **given: Any) -> None:
        """Answer with the error's text, which the command that sent the request prints."""
        error = given.get("exc_info", (None, self._reason))[1]
        self.finish({"error": str(error) if isinstance(error, FailstopError) else f"a bug in the page: {error!r}"})

    def log_exception(self, typ: Any, value: BaseException | None, tb: Any) -> None:
        """Log only bugs. A FailstopError is not logged, because the command that sent the request prints it."""
        if not isinstance(value, FailstopError):
            super().log_exception(typ, value, tb)


class _Pair(_Asked):
    def post(self) -> None:
        if not self.page.pairing_on:
            self.set_status(REFUSED)
            source = self.page.source
            remedy = source.remedy('web.pairing = "on"')
            self.finish({"error": f"pairing is switched off ({source.described()}): {remedy}"})
            return
        code = devices.code_of(secrets.token_bytes(5))
        self.page.pairing.offer(code, time.monotonic())
        self.finish({"code": code, **self.page.addresses()})


class _Devices(_Asked):
    def get(self) -> None:
        found = [{"id": device.id, "name": device.name, "made": device.made} for device in self.page.devices.all()]
        self.finish({"devices": found})

    async def post(self) -> None:
        identity = json.loads(self.request.body)["id"]
        self.finish({"revoked": await self.page.revoke(str(identity))})


def listen(page: Page, path: str) -> HTTPServer:
    """Answer the requests of `failstop web pair`, `devices` and `revoke` at the Unix socket `path`. Only the page's own
    user and root can open the socket. Raises FailstopError."""
    rows = [("/pair", _Pair, {"page": page}), ("/devices", _Devices, {"page": page})]
    try:
        found = bind_unix_socket(path, mode=0o600)
    except (OSError, ValueError) as error:
        raise FailstopError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    server = HTTPServer(Application(rows, log_function=lambda handler: None))
    server.add_socket(found)
    return server


class _Connection(http.client.HTTPConnection):
    def __init__(self, path: str) -> None:
        super().__init__("localhost", timeout=TIMEOUT_S)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(TIMEOUT_S)
        self.sock.connect(self._path)


def ask(name: str, environ: Mapping[str, str], method: str, path: str, body: object = None) -> dict[str, Any]:
    """Send a request to the running page of this service, and return its answer. Raises Refused, FailstopError."""
    denied = ""
    for folder in storage.folders(name, environ):
        connection = _Connection(os.path.join(folder, storage.CONTROL))
        try:
            connection.request(method, path, json.dumps(body))
            answer = connection.getresponse()
            said = answer.read()
        except PermissionError:
            denied = f"{folder} belongs to another user, so use sudo: sudo failstop web ..."
            continue
        except (OSError, http.client.HTTPException):
            continue
        finally:
            connection.close()
        return _understood(answer.status, said)
    raise FailstopError(denied or f"the page of {name!r} is not running: start it with `failstop web`")


def _understood(status: int, said: bytes) -> dict[str, Any]:
    """Decode the page's answer. Raises Refused, FailstopError."""
    try:
        found: dict[str, Any] = json.loads(said)
    except ValueError:
        raise FailstopError(
            f"the page answered {status}, as another version of failstop would: restart `failstop web`"
        ) from None
    if status == REFUSED:
        raise Refused(str(found["error"]))
    if status != 200:
        raise FailstopError(str(found.get("error", status)))
    return found


def remove(path: str) -> None:
    """Remove the Unix socket. Call it when the page ends."""
    with contextlib.suppress(OSError):
        os.unlink(path)
