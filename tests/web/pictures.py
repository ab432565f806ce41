"""`python -m tests.web.pictures`: takes the pictures of the page that README and docs/operator.md show."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from failstop.setup.ending import interruptible
from failstop_lab.trial import Trial, wait_for
from tests.web.__main__ import ATTENDED, SHOWN, paired
from tests.web.browser import Browser, Tab
from tests.web.parts import Web, driven

PICTURES = Path(__file__).parents[2] / "docs/pictures"
NAME = "rover"
WIDE, GAP = 312, 15
HOLD_S, DRIVE_S = 1.3, 4.0
"""For how long ENABLE is held in its picture; how long the robot has moved in its own."""


class Strip:
    """Pictures of a phone, side by side."""

    def __init__(self, folder: str) -> None:
        self._path = os.path.join(folder, "page.png")
        self._found: list[Image.Image] = []

    def add(self, tab: Tab) -> None:
        """A picture of its top."""
        tab.run("scrollTo(0, 0)")  # a tap brings its button into view
        tab.picture(self._path)
        with Image.open(self._path) as found:
            high = round(found.height * WIDE / found.width)
            self._found.append(found.convert("RGB").resize((WIDE, high), Image.Resampling.LANCZOS))

    def save(self, path: Path) -> None:
        """All of them as one."""
        whole = Image.new("RGB", (len(self._found) * (WIDE + GAP) - GAP, self._found[0].height), "white")
        for number, each in enumerate(self._found):
            whole.paste(each, (number * (WIDE + GAP), 0))
        whole.quantize(256).save(path, optimize=True)


def phone(trial: Trial, web: Web, browser: Browser, strip: Strip) -> None:
    """ENABLE held, moving, stopped by a touch, and the same in the light."""
    tab = paired(browser, web, web.url.replace("127.0.0.1", "localhost"), "Anna's phone")
    with driven(trial):
        tab.tap("#attend")
        wait_for("the operator", lambda: trial.robot.state.attended_by)
        tab.until("document.getElementById('enable').getAttribute('aria-disabled') === 'false'")
        lift = tab.press("#enable")
        time.sleep(HOLD_S)
        strip.add(tab)
        wait_for("motion", lambda: trial.robot.state.enabled)
        lift()
        time.sleep(DRIVE_S)
        strip.add(tab)
        tab.tap("#stop")
        tab.until("document.getElementById('stop-said').textContent.includes('observed')")
        strip.add(tab)
    light = browser.tab(web.url.replace("127.0.0.1", "localhost"), dark=False)
    light.until(SHOWN)
    time.sleep(1)
    strip.add(light)


def desk(web: Web, browser: Browser, path: Path) -> None:
    """The newest incident, opened, beside STOP."""
    tab = browser.tab(web.url.replace("127.0.0.1", "localhost"), wide=1280, high=800, dark=False, touch=False)
    card = "document.querySelector('#incidents details')"
    tab.until(f"{card} !== null", timeout_s=30)  # its file is written some seconds after the stop
    tab.run(f"{card}.open = true")
    tab.until(f"({card}.querySelector('img') || {{}}).naturalWidth", timeout_s=60)
    tab.run(f"{card}.scrollIntoView()")
    tab.picture(path)
    with Image.open(path) as found:
        found.convert("RGB").quantize(256).save(path, optimize=True)


@interruptible()
def main() -> int:
    """Take both."""
    with tempfile.TemporaryDirectory(prefix="failstop-pictures-") as folder:
        settings = os.path.join(folder, "failstop.toml")
        Path(settings).write_text(ATTENDED, encoding="utf-8")
        with (
            Trial(NAME, ("--config", settings)) as trial,
            Web(NAME, "--config", settings, state=trial.state) as web,
            Browser() as browser,
        ):
            strip = Strip(folder)
            phone(trial, web, browser, strip)
            strip.save(PICTURES / "operator-phone.png")
            desk(web, browser, PICTURES / "operator-desk.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
