"""`python -m tests.web`: the operator's page, measured with a real browser and a simulated board.

Needs Debian's chromium (`make web` installs it). The board takes the times of the stops, the browser that of a touch;
both read CLOCK_MONOTONIC, the browser's by an offset that is found at the start.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable

import psutil

from bench import report, stats
from bench.report import end, progress
from failstop.api.errors import Refused
from failstop.setup.ending import interruptible
from failstop_lab.trial import Trial, judge, wait_for
from tests.web.bare import Bare
from tests.web.browser import Browser, Tab
from tests.web.cut import Cut
from tests.web.parts import Web, driven
from tests.web.viewer import Viewer

LEASE_S = 0.3
PAGE_LATE_NS = 20_000_000
SETTINGS = '[web]\npairing = "on"\n'
ATTENDED = f'[attend]\nrequired = "on"\nlease_s = {LEASE_S}\n' + SETTINGS
LATENCY_MS, DOWN, UP = 562.5, 180_000, 84_375
"""Slow 4G, as the browser's own profile of that name: bytes a second."""
SLOWER = 4
"""A phone's processor beside this one, likewise."""
VIEWERS = 3
SHOWN = "document.getElementById('word').textContent !== 'CONNECTING'"
BACKLOG_S = 5.0
TURN = 25
"""Touches of one page before it is the other's turn: a host that is slow for a minute is so for both."""
SPREAD_S = 0.0618
"""Between the moments of two touches, in a second: no two alike."""


def moving(trial: Trial) -> None:
    """Reset, enable, and wait until the wheels turn; once more where another stop came before they did."""

    def turns() -> bool:
        if not trial.robot.state.enabled:
            with contextlib.suppress(Refused):
                trial.enable()
        return trial.turning()

    wait_for("motion", turns)
    trial.board.events()


def clock(tab: Tab) -> float:
    """CLOCK_MONOTONIC, s, when the page's own clock was 0: of many looks the one that took the least."""
    found = []
    for _ in range(50):
        before_s = time.monotonic()
        there_s = tab.run("performance.now()") / 1e3
        after_s = time.monotonic()
        found.append((after_s - before_s, (before_s + after_s) / 2 - there_s))
    return min(found)[1]


def taps(trial: Trial, web: Web, cases: int) -> list[stats.Row]:
    """A finger on STOP, to the stop frame at the board; the floor is a finger on a bare page, in turns with it."""
    found: list[int] = []
    bare: list[int] = []
    missed = 0
    with Browser() as browser, driven(trial), Bare() as server:
        for begun in range(0, cases, TURN):
            turn = range(begun, min(begun + TURN, cases))
            with contextlib.closing(browser.tab(web.url)) as tab:
                tab.until(SHOWN)
                missed += _page_taps(trial, tab, turn, found)
            with contextlib.closing(browser.tab(server.url)) as tab:
                tab.until("window.ready")
                _bare_taps(trial, tab, server, turn, bare)
    return [
        stats.timing("touch on STOP -> stop frame, over loopback", found, p50_ms=5, p99_ms=25),
        stats.timing("touch on a bare page -> a bare server (the floor)", bare, p50_ms=None, p99_ms=None),
        stats.count("stops missed, or motion after them", missed, cases),
    ]


def _page_taps(trial: Trial, tab: Tab, turn: range, found: list[int]) -> int:
    """Fingers on the robot's page: adds the ns to each stop frame to `found`; returns how many stops were missed."""
    missed = 0
    tab.run("addEventListener('pointerdown', (event) => { window.touched = event.timeStamp; }, true)")
    zero_s = clock(tab)
    for case in turn:
        progress(f"tap {case + 1}")
        moving(trial)
        time.sleep(SPREAD_S * case % 1)  # a finger comes at any moment, and not with the enabling
        trial.board.events()
        before_ns = time.monotonic_ns()
        tab.tap("#stop")
        wait_for("the latch", lambda: trial.robot.state.estop)
        seen = judge(trial.board.events(), before_ns, was_turning=True)
        touched_ns = round((zero_s + tab.run("window.touched") / 1e3) * 1e9)
        missed += seen.stop_ns is None or seen.motion_after > 0
        if seen.stop_ns is not None:
            found.append(before_ns + seen.stop_ns - touched_ns)
    return missed


def _bare_taps(trial: Trial, tab: Tab, server: Bare, turn: range, found: list[int]) -> None:
    """Fingers in the same browser beside the same robot, on a page that does nothing but send; adds to `found`."""
    zero_s = clock(tab)
    for case in turn:
        progress(f"bare tap {case + 1}")
        moving(trial)
        time.sleep(SPREAD_S * case % 1)
        tab.tap("#stop")
        came_ns = server.came_ns()
        found.append(came_ns - round((zero_s + tab.run("window.touched") / 1e3) * 1e9))
        trial.robot.estop("a bare tap")
        wait_for("the latch", lambda: trial.robot.state.estop)


def paired(browser: Browser, web: Web, url: str, device: str = "") -> Tab:
    """A page of a device that is paired, under that name."""
    tab = browser.tab(f"{url}#{web.code()}")
    tab.until(SHOWN)
    tab.until("document.getElementById('code').value !== '' && !document.getElementById('pair').hidden")
    tab.run(f"document.getElementById('device-name').value = {json.dumps(device)}")
    tab.tap("#pair button")
    tab.until("!document.getElementById('attendance').hidden")
    return tab


def attends(trial: Trial, tab: Tab) -> None:
    """Press ATTEND until the robot knows of it."""
    trial.robot.disable()
    button = "document.getElementById('attend')"
    tab.until(
        "!document.getElementById('attendance').hidden && document.getElementById('head').dataset.role !== 'lost'"
    )
    if tab.run(f"{button}.getAttribute('aria-pressed')") != "true":
        tab.tap("#attend")
    wait_for("the operator", lambda: trial.robot.state.attended_by)


Fault = Callable[[], None]


def ends(trial: Trial, tab: Tab, begin: Fault, mend: Fault) -> tuple[int | None, int]:
    """One end of an operator: (ns from the fault to the stop frame, motion frames after it)."""
    attends(trial, tab)
    moving(trial)
    fault_ns = time.monotonic_ns()
    begin()
    with contextlib.suppress(Exception):
        wait_for("the stop", lambda: trial.robot.state.estop, 5)
    time.sleep(0.1)
    seen = judge(trial.board.events(), fault_ns, was_turning=True)
    mend()
    return seen.stop_ns, seen.motion_after


def leases(trial: Trial, web: Web, cases: int, kills: int) -> list[stats.Row]:
    """The network cut, the browser suspended, the browser killed, while a page attends and the robot drives."""
    results: dict[str, list[tuple[int | None, int]]] = {"cut": [], "suspended": [], "killed": []}
    with driven(trial), Cut(web.port) as network:
        url = f"{web.scheme}://localhost:{network.port}/"
        with Browser() as browser:
            tab = paired(browser, web, url)
            for case in range(cases):
                progress(f"network cut {case + 1} of {cases}")
                results["cut"].append(ends(trial, tab, network.cut, network.mend))
                progress(f"browser suspended {case + 1} of {cases}")
                stop, go_on = (lambda n=n: browser.signal(n) for n in (signal.SIGSTOP, signal.SIGCONT))
                results["suspended"].append(ends(trial, tab, stop, go_on))
        for case in range(kills):
            progress(f"browser killed {case + 1} of {kills}")
            with Browser() as browser:
                tab = paired(browser, web, url)
                kill = lambda browser=browser: browser.signal(signal.SIGKILL)  # noqa: E731
                results["killed"].append(ends(trial, tab, kill, lambda: None))
            for row in web.command("devices").stdout.splitlines()[1:]:
                web.command("revoke", row.split()[0])
    rows = []
    late = 0
    for name, found in results.items():
        times = [stop_ns for stop_ns, _ in found if stop_ns is not None]
        if times:
            rows.append(
                stats.timing(
                    f"operator gone, {name} -> stop frame (lease {LEASE_S:g} s)", times, p50_ms=None, p99_ms=None
                )
            )
        late += sum(stop_ns is None or after > 0 or stop_ns > LEASE_S * 1e9 + PAGE_LATE_NS for stop_ns, after in found)
    every = sum(map(len, results.values()))
    rows.append(stats.count("of all these, later than lease + 20 ms, missed, or motion after it", late, every))
    return rows


def backlog(trial: Trial, web: Web) -> stats.Row:
    """Right answers to the nonces of 5 s, all at once: how many of them renew the lease, but for the newest two."""
    headers = web.pair("backlog")
    renewed = 0
    with Viewer(web, headers) as viewer:
        viewer.attend()
        held_back: list[str] = []
        until_s = time.monotonic() + BACKLOG_S
        while time.monotonic() < until_s:
            progress("a backlog of 5 s")
            if nonce := viewer.next().get("nonce"):
                held_back.append(nonce)
        for nonce in held_back[:-2]:
            viewer.answer(nonce)
            renewed += bool(trial.robot.state.attended_by)
        time.sleep(0.2)
        renewed += bool(trial.robot.state.attended_by)
    return stats.count("answers of a backlog of 5 s that renew the lease", renewed, len(held_back) - 2)


def cost(trial: Trial, web: Web, seconds: float) -> list[stats.Row]:
    """Processor and memory with three viewers, while the robot drives."""
    ended = threading.Event()

    def view() -> None:
        with Viewer(web) as viewer:
            while not ended.is_set():
                viewer.next()

    process = psutil.Process(web.process.pid)
    threads = [threading.Thread(target=view) for _ in range(VIEWERS)]
    for thread in threads:
        thread.start()
    try:
        with driven(trial):
            time.sleep(2)
            before, since_s = process.cpu_times(), time.monotonic()
            progress(f"three viewers for {seconds:g} s")
            time.sleep(seconds)
            after, took_s = process.cpu_times(), time.monotonic() - since_s
            pss = process.memory_full_info().pss / 1e6
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    share = 100 * (after.user + after.system - before.user - before.system) / took_s
    return [
        stats.limit(f"the page's process, {VIEWERS} viewers", share, 4, "% of a core", ""),
        stats.limit("its memory (PSS)", pss, 45, "MB", ""),
    ]


def paint(web: Web) -> list[stats.Row]:
    """The page on a throttled phone: its network alone, and a slower processor than this one too."""
    found = {slower: [_painted(web.url, slower) for _ in range(3)] for slower in (1, SLOWER)}
    times = {slower: sorted(ms for ms, _ in each)[1] for slower, each in found.items()}
    with Bare() as bare:
        floor_ms = sorted(_painted(bare.url, 1, "window.ready")[0] for _ in range(3))[1]
    return [
        stats.limit("first paint, Slow 4G", times[1], 1000, "ms", f"a bare page: {floor_ms:.0f} ms"),
        stats.limit(f"first paint, Slow 4G, a processor {SLOWER} times slower", times[SLOWER], 1000, "ms", ""),
        stats.limit(
            "all that is fetched", max(size for each in found.values() for _, size in each) / 1e3, 150, "kB", ""
        ),
    ]


def _painted(url: str, slower: int, shown: str = SHOWN) -> tuple[float, int]:
    """When a new browser shows the first of the page, in ms, and how many bytes it has fetched in all."""
    with Browser() as browser:
        tab = browser.tab()
        tab.network(latency_ms=LATENCY_MS, down=DOWN, up=UP)
        tab.call("Network.setCacheDisabled", cacheDisabled=True)
        tab.call("Emulation.setCPUThrottlingRate", rate=slower)
        tab.open(url)
        painted = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
        ms = float(tab.until(painted, "the first paint", 30))
        tab.until(shown, timeout_s=30)
        size = tab.run(
            "performance.getEntriesByType('resource').concat(performance.getEntriesByType('navigation'))"
            ".reduce((sum, entry) => sum + entry.transferSize, 0)"
        )
        return ms, int(size)


@interruptible()
def main(words: list[str]) -> int:
    """Run all, or some."""
    parser = argparse.ArgumentParser(prog="python -m tests.web", description=__doc__)
    parser.add_argument("--taps", type=int, default=200, help="touches on STOP (default: 200)")
    parser.add_argument("--ends", type=int, default=140, help="cuts, and as many suspensions (default: 140)")
    parser.add_argument("--kills", type=int, default=20, help="killed browsers (default: 20)")
    parser.add_argument("--seconds", type=float, default=30.0, help="of three viewers (default: 30)")
    parser.add_argument("--out", metavar="FILE", help="the rows, as JSON")
    given = parser.parse_args(words)
    rows: list[stats.Row] = []
    with tempfile.TemporaryDirectory(prefix="failstop-bench-web-") as folder:
        for number, text in enumerate((SETTINGS, ATTENDED)):
            path = os.path.join(folder, f"{number}.toml")
            with open(path, "w", encoding="utf-8") as file:
                file.write(text)
            with (
                Trial(f"benchweb-{number}-{os.getpid()}", ("--config", path)) as trial,
                Web(trial.name, "--config", path, state=trial.state) as web,
            ):
                if number == 0:
                    parts = [lambda: paint(web), lambda: cost(trial, web, given.seconds)]
                    parts += [lambda: taps(trial, web, given.taps)] if given.taps else []
                else:
                    parts = [lambda: [backlog(trial, web)], lambda: leases(trial, web, given.ends, given.kills)]
                for part in parts:
                    rows += report.whole(part)
    return end(rows, given.out)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
