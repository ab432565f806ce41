"""The page of a running service, and a client of it that is no browser."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import ssl
import subprocess
import sys
import threading
from collections.abc import Iterator
from types import TracebackType
from typing import IO, Any

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.api.snapshot import Block
from failstop.web import control
from failstop_lab.trial import Trial, TrialError, wait_for

HEADERS = {"X-Failstop": "1"}
TIMEOUT_S = 30.0
"""A picture takes seconds to draw on a busy machine."""


class Web:
    """A context manager: `failstop web` for the service of that name, on a port of its own."""

    def __init__(
        self,
        name: str,
        *options: str,
        state: str = "",
        program: tuple[str, ...] = ("-m", "failstop"),
        says: IO[bytes] | None = None,
    ) -> None:
        """`state`: where it keeps what it keeps, and finds the incidents of a trial; `program`: what Python runs;
        `says`: where to what it says goes, beside its address."""
        self.name = name
        self.environment = {**os.environ, **({"STATE_DIRECTORY": state} if state else {})}
        command = [sys.executable, *program, "web", "--name", name, "--port", "0", *options]
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=says, text=True, env=self.environment
        )
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        if not self.url:
            raise TrialError(f"`failstop web` ended with {self.process.wait()}")
        self.scheme, _, rest = self.url.partition("://")
        self.host = rest.strip("/")

    def __enter__(self) -> Web:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> int:
        """SIGTERM; returns the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.send_signal(signal.SIGCONT)
        assert self.process.stdout is not None
        self.process.stdout.close()
        try:
            return self.process.wait(5)
        finally:
            self.process.kill()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self.host.rpartition(":")[2])

    def connect(self) -> http.client.HTTPConnection:
        """A connection to it."""
        if self.scheme == "https":
            context = ssl.create_default_context()
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            return http.client.HTTPSConnection("127.0.0.1", self.port, timeout=TIMEOUT_S, context=context)
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=TIMEOUT_S)

    def ask(
        self,
        method: str,
        path: str,
        body: object = None,
        headers: dict[str, str] | None = None,
        *,
        raw: bytes | None = None,
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers (by their small names), content. `raw`: a body that is no JSON."""
        connection = self.connect()
        try:
            given = HEADERS if headers is None else headers
            connection.request(method, path, raw if body is None else json.dumps(body), given)
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    def get(self, path: str) -> Any:
        """The content, as an object. Raises AssertionError."""
        status, _, content = self.ask("GET", path)
        assert status == 200, (status, content)
        return json.loads(content)

    def post(self, path: str, body: object = None, headers: dict[str, str] | None = None) -> tuple[int, Any]:
        """Status and object of a request that changes something."""
        status, _, content = self.ask("POST", path, body, {**HEADERS, **(headers or {})})
        return status, json.loads(content)

    def command(self, *words: str) -> subprocess.CompletedProcess[str]:
        """`failstop web WORDS`, beside it."""
        command = [sys.executable, "-m", "failstop", "web", *words, "--name", self.name]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=self.environment)

    def code(self) -> str:
        """A new code, as `failstop web pair` asks for it."""
        return str(control.ask(self.name, self.environment, "POST", "/pair")["code"])

    def pair(self, name: str = "Anna's phone", code: str = "") -> dict[str, str]:
        """The headers of a device that is paired."""
        status, headers, content = self.ask("POST", "/api/pair", {"code": code or self.code(), "name": name})
        assert status == 200, content
        return {"Cookie": headers["set-cookie"].partition(";")[0]}

    def until(self, word: str) -> dict[str, Any]:
        """Wait until the page shows this word; returns what it shows."""
        wait_for(f"{word} on the page", lambda: self.get("/api/state")["view"]["word"] == word)
        found: dict[str, Any] = self.get("/api/state")["view"]
        return found


@contextlib.contextmanager
def driven(trial: Trial) -> Iterator[None]:
    """Somebody commands all the time: zero until motion is enabled, since an enable holds who commands a velocity, and
    zero again after an enable that came between two looks at the state."""
    ended = threading.Event()

    def drive() -> None:
        with Robot(trial.name, client="driver") as robot:
            while not ended.wait(0.02):
                with contextlib.suppress(FailstopError):
                    robot.sensed()
                    state = robot.state
                    robot.drive(0.2 if state.enabled and state.block is not Block.HELD else 0.0, 0.0, 0.0)

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
