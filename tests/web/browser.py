"""A real browser: Debian's chromium without a window, driven by its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from tornado.websocket import WebSocketClientConnection, websocket_connect

from bench import BenchError

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or ""
START_S = 30.0
LOOK_MS = 40
"""The time between two looks at where an element is."""
WAIT_S = 10.0
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-extensions", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage", "--mute-audio",
    "--remote-debugging-port=0", "--remote-allow-origins=*", "--ignore-certificate-errors",
)  # fmt: skip


class BrowserError(BenchError):
    """A wait was in vain; the message has the page's words instead."""


class Browser:
    """A context manager: one chromium of its own, with a profile that is gone afterwards."""

    def __init__(self, *options: str) -> None:
        self._profile = tempfile.TemporaryDirectory(prefix="failstop-chromium-", ignore_cleanup_errors=True)
        self._loop = asyncio.new_event_loop()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        command = [CHROMIUM, *OPTIONS, *options, f"--user-data-dir={self._profile.name}", "about:blank"]
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log, start_new_session=True
        )
        self.pages: list[Tab] = []

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Kill it, and all that it has started."""
        with contextlib.suppress(ProcessLookupError):
            self.signal(signal.SIGKILL)
        self.process.wait()
        for page in self.pages:
            page.hang_up()
        self._loop.close()
        self._log.close()
        self._profile.cleanup()

    def signal(self, number: int) -> None:
        """To every process of it."""
        os.killpg(self.process.pid, number)

    def _port(self) -> str:
        found = Path(self._profile.name) / "DevToolsActivePort"
        until_s = time.monotonic() + START_S
        while not (found.exists() and (words := found.read_text().split())):
            if time.monotonic() > until_s or self.process.poll() is not None:
                self._log.seek(0)
                raise BrowserError(f"chromium did not start: {self._log.read()[-2000:]!r}")
            time.sleep(0.05)
        return words[0]

    def tab(self, url: str = "", *, wide: int = 412, high: int = 915, dark: bool = True, touch: bool = True) -> Tab:
        """A new page of that size."""
        asked = urllib.request.Request(f"http://127.0.0.1:{self._port()}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(asked) as answer:
            target = json.load(answer)
        tab = Tab(self._loop, target["webSocketDebuggerUrl"])
        self.pages.append(tab)
        tab.call("Page.enable")
        tab.call("Runtime.enable")
        tab.size(wide, high, touch=touch)
        tab.scheme(dark=dark)
        if url:
            tab.open(url)
        return tab


class Tab:
    """One page of the browser."""

    def __init__(self, loop: asyncio.AbstractEventLoop, url: str) -> None:
        self._loop = loop
        self._number = 0
        self.errors: list[str] = []
        """Errors that scripts threw."""
        self.answer_s = START_S
        """The time in which the page must answer: a script of its own may keep it busy."""
        self.connection: WebSocketClientConnection = self._wait(
            lambda: websocket_connect(url, max_message_size=1 << 28), START_S
        )

    def _wait(self, begin: Callable[[], Any], timeout_s: float = WAIT_S) -> Any:
        async def wait() -> Any:
            return await asyncio.wait_for(begin(), timeout_s)

        return self._loop.run_until_complete(wait())

    def close(self) -> None:
        """End the page; the browser goes on."""
        self.tell("Page.close")
        self.hang_up()

    def hang_up(self) -> None:
        """End the connection to the page."""

        async def close() -> None:
            self.connection.close()

        self._loop.run_until_complete(close())

    def tell(self, method: str, **parameters: Any) -> None:
        """One method of the protocol, whose answer is not waited for: a browser that is held up has none yet."""
        self._number += 1
        asked = json.dumps({"id": self._number, "method": method, "params": parameters})
        self._wait(lambda: self.connection.write_message(asked))

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One method of the protocol. Raises BrowserError."""
        self.tell(method, **parameters)
        while True:
            text = self._wait(self.connection.read_message, self.answer_s)
            if text is None:
                raise BrowserError(f"{method}: the browser is gone")
            found = json.loads(text)
            if found.get("method") == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(found["params"]["exceptionDetails"].get("exception", {}))[:500])
            if found.get("id") == self._number:
                if "error" in found:
                    raise BrowserError(f"{method}: {found['error']}")
                return dict(found["result"])

    def size(self, wide: int, high: int, *, touch: bool = True) -> None:
        """As of a phone, or with touch=False of a desk."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=wide,
            height=high,
            deviceScaleFactor=2 if touch else 1,
            mobile=touch,
        )
        self.call("Emulation.setTouchEmulationEnabled", enabled=touch)

    def scheme(self, *, dark: bool) -> None:
        """Dark or light, as the device's owner likes it."""
        value = "dark" if dark else "light"
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": value}])

    def open(self, url: str) -> None:
        """Go there."""
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """A script's value; promises are awaited. Raises BrowserError for what it throws."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in found:
            raise BrowserError(f"{script}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def text(self, selector: str) -> str:
        """The text that stands there."""
        return str(self.run(f"document.querySelector({json.dumps(selector)})?.textContent ?? ''"))

    def until(self, script: str, what: str = "", timeout_s: float = WAIT_S) -> Any:
        """Wait until a script's value is true. Raises BrowserError with what the page shows."""
        until_s = time.monotonic() + timeout_s
        while True:
            with contextlib.suppress(BrowserError):  # while it goes from one page to another there is no script's place
                if found := self.run(script):
                    return found
            if time.monotonic() > until_s:
                shown = self.run("document.body ? document.body.innerText.slice(0, 800) : ''")
                raise BrowserError(
                    f"waited {timeout_s:g} s for {what or script}; the page shows: {shown}; {self.errors}"
                )
            time.sleep(0.02)

    def place(self, selector: str) -> tuple[float, float]:
        """The middle of an element, once it stands still: while the page fills, a finger would land beside it."""
        box = self.run(
            f"(async () => {{ const e = document.querySelector({json.dumps(selector)}); "
            "e.scrollIntoView({block: 'center'}); "
            "const at = () => { const b = e.getBoundingClientRect(); "
            "return [b.x + b.width / 2, b.y + b.height / 2]; }; "
            f"for (let was = at(), now; ; was = now) {{ await new Promise((next) => setTimeout(next, {LOOK_MS})); "
            "now = at(); if (String(now) === String(was)) return now; } })()"
        )
        return float(box[0]), float(box[1])

    def press(self, selector: str) -> Callable[[], None]:
        """A finger goes down; call what comes back to lift it."""
        x, y = self.place(selector)
        self.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])

        def lift() -> None:
            self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

        return lift

    def tap(self, selector: str) -> None:
        """Down and up."""
        self.press(selector)()

    def hold_key(self, key: str, code: str, number: int) -> Callable[[], None]:
        """A key goes down; call what comes back to lift it."""
        text = {"text": "\r" if key == "Enter" else key} if len(key) == 1 or key == "Enter" else {}
        given = {"key": key, "code": code, "windowsVirtualKeyCode": number}
        self.call("Input.dispatchKeyEvent", type="keyDown", **given, **text)

        def lift() -> None:
            self.call("Input.dispatchKeyEvent", type="keyUp", **given)

        return lift

    def key(self, key: str, code: str, number: int) -> None:
        """A key, down and up."""
        self.hold_key(key, code, number)()

    def network(self, *, offline: bool = False, latency_ms: float = 0, down: float = -1, up: float = -1) -> None:
        """The network as the page has it; bytes a second."""
        self.call("Network.enable")
        self.call(
            "Network.emulateNetworkConditions",
            offline=offline,
            latency=latency_ms,
            downloadThroughput=down,
            uploadThroughput=up,
        )

    def picture(self, path: str | Path, *, whole: bool = False) -> None:
        """A picture of it, as PNG."""
        self.call("Page.bringToFront")
        found = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        Path(path).write_bytes(base64.b64decode(found["data"]))
