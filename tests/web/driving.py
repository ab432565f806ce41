"""`python -m tests.web.driving`: how long a thumb on the page's stick drives the robot after its page is gone, as the
network is cut, or the browser is suspended or killed; and whether commands of a backlog move anything."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from bench import report, stats
from bench.report import end, progress
from failstop.api.errors import Refused
from failstop.setup.ending import interruptible
from failstop_lab.trial import Trial, TrialError, judge, wait_for
from tests.web.__main__ import attends, paired
from tests.web.browser import Browser, Tab
from tests.web.cut import Cut
from tests.web.parts import Web
from tests.web.viewer import Viewer

COMMAND_S, LATE_S, LEASE_S = 0.3, 0.02, 1.0
SETTINGS = f'[attend]\nrequired = "on"\nlease_s = {LEASE_S}\n[web]\npairing = "on"\ndrive = "on"\n'
FORWARD = "1.00 0.00"
BACKLOG_S = 5.0
TRIES = 5
SPREAD_S = 0.0618
"""Between the moments of two faults, in a command's period: no two alike."""


def enable(trial: Trial) -> None:
    """As soon as somebody attends."""

    def enabled() -> bool:
        with contextlib.suppress(Refused):
            trial.enable()
            return True
        return False

    wait_for("motion to be enabled", enabled)


def limited(trial: Trial, tab: Tab) -> bool:
    """Choose half the speed; again where what the robot says has moved the button from under the finger."""
    tab.tap("#limit [data-percent='50']")
    with contextlib.suppress(TrialError):
        wait_for("the limit", lambda: trial.robot.state.speed_limit == 0.5, 2)
    return trial.robot.state.speed_limit == 0.5


def holds(trial: Trial, tab: Tab) -> None:
    """Drive with a thumb; again where the machine was so slow that the operator was gone before the wheels turned."""
    for left in reversed(range(TRIES)):
        try:
            _hold(trial, tab)
        except TrialError:
            tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
            if not left:
                raise
        else:
            return


def _hold(trial: Trial, tab: Tab) -> None:
    """Attend, choose the limit, enable, and put a thumb on the stick until the wheels turn."""
    trial.robot.limit_speed(1.0)
    attends(trial, tab)
    wait_for("the limit", lambda: limited(trial, tab))
    enable(trial)
    tab.until("document.getElementById('word').textContent === 'CAN MOVE'")
    x, y = tab.place("#stick")
    high = tab.run("document.getElementById('stick').clientHeight")
    tab.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y - 0.45 * high}])
    wait_for("motion", trial.turning, 3)


def ends(
    trial: Trial, tab: Tab, case: int, begin: Callable[[], None], mend: Callable[[], None]
) -> tuple[int | None, int]:
    """One end of a page that drives: (ns until the wheels are told zero, motion frames after that). The time counts
    from when the fault is complete: a browser has many processes."""
    holds(trial, tab)
    time.sleep(SPREAD_S * case % 0.1)
    trial.board.events()
    begun_ns = time.monotonic_ns()
    begin()
    fault_ns = time.monotonic_ns()
    with contextlib.suppress(TrialError):
        wait_for("the operator to be gone", lambda: trial.robot.state.estop, LEASE_S + 4)
    time.sleep(0.1)
    seen = judge(trial.board.events(), begun_ns, was_turning=True)
    mend()
    with contextlib.suppress(Exception):
        tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    return None if seen.stop_ns is None else begun_ns + seen.stop_ns - fault_ns, seen.motion_after


def pages(trial: Trial, web: Web, cases: int, kills: int) -> list[stats.Row]:
    """Each way in which a page that drives may go."""
    results: dict[str, list[tuple[int | None, int]]] = {"cut": [], "suspended": [], "killed": []}
    with Cut(web.port) as network:
        url = f"{web.scheme}://localhost:{network.port}/"
        with Browser() as browser:
            tab = paired(browser, web, url, "Anna")
            for case in range(cases):
                progress(f"network cut {case + 1} of {cases}")
                results["cut"].append(ends(trial, tab, case, network.cut, network.mend))
                progress(f"browser suspended {case + 1} of {cases}")
                stop, go_on = (lambda n=n: browser.signal(n) for n in (signal.SIGSTOP, signal.SIGCONT))
                results["suspended"].append(ends(trial, tab, case, stop, go_on))
        for case in range(kills):
            progress(f"browser killed {case + 1} of {kills}")
            with Browser() as browser:
                tab = paired(browser, web, url, "Anna")
                kill = lambda browser=browser: browser.signal(signal.SIGKILL)  # noqa: E731
                results["killed"].append(ends(trial, tab, case, kill, lambda: None))
            for row in web.command("devices").stdout.splitlines()[1:]:
                web.command("revoke", row.split()[0])
    rows, late = [], 0
    for name, found in results.items():
        if times := [stop_ns for stop_ns, _ in found if stop_ns is not None]:
            rows.append(stats.timing(f"page gone, {name} -> wheels told zero", times, p50_ms=None, p99_ms=None))
        bound_ns = (COMMAND_S + LATE_S) * 1e9
        late += sum(stop_ns is None or after > 0 or stop_ns > bound_ns for stop_ns, after in found)
    every = sum(map(len, results.values()))
    return [*rows, stats.count("of all these, later than 320 ms, missed, or motion after it", late, every)]


def backlog(trial: Trial, web: Web) -> stats.Row:
    """Right commands to the nonces of 5 s, all at once: how many of them move the wheels, but for the newest two."""
    headers, moved = web.pair("backlog"), 0
    with Viewer(web, headers) as viewer:
        viewer.attend()
        web.post("/api/limit", {"percent": 100}, headers)
        trial.robot.attend("another operator")
        enable(trial)
        held_back: list[str] = []
        until_s = time.monotonic() + BACKLOG_S
        while time.monotonic() < until_s:
            progress("a backlog of 5 s")
            trial.robot.attend("another operator")
            if nonce := viewer.next().get("nonce"):
                held_back.append(nonce)
        trial.board.events()
        for nonce in held_back[:-2]:
            viewer.answer(nonce, drive=FORWARD)
        time.sleep(0.5)
        if not trial.robot.state.enabled:
            raise TrialError("motion was not enabled any more when the backlog came")
        moved += sum(event.is_motion for event in trial.board.events())
    return stats.count("commands of a backlog of 5 s that move the wheels", moved, len(held_back) - 2)


@interruptible()
def main(words: list[str]) -> int:
    """Run all, or some."""
    parser = argparse.ArgumentParser(prog="python -m tests.web.driving", description=__doc__)
    parser.add_argument("--ends", type=int, default=140, help="cuts, and as many suspensions (default: 140)")
    parser.add_argument("--kills", type=int, default=20, help="killed browsers (default: 20)")
    parser.add_argument("--out", metavar="FILE", help="the rows, as JSON")
    given = parser.parse_args(words)
    rows: list[stats.Row] = []
    with tempfile.TemporaryDirectory(prefix="failstop-bench-driving-") as folder:
        path = Path(folder) / "driving.toml"
        path.write_text(SETTINGS, encoding="utf-8")
        with (
            Trial(f"benchdrive-{os.getpid()}", ("--config", str(path))) as trial,
            Web(trial.name, "--config", str(path), state=trial.state) as web,
        ):
            rows += report.whole(lambda: [backlog(trial, web)])
            rows += report.whole(lambda: pages(trial, web, given.ends, given.kills))
    return end(rows, given.out)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
