"""In the guest: the trials with the board on vhci_hcd, one after the other. Prints a line of JSON for each round.

    python -m tests.vm.inside NAME...

As root, with the interpreter of /srv/venv. The client commands all the while, whatever is done to the service.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

from failstop.policy import causes
from failstop_lab.trial import wait_for
from tests.vm import distribution, first_hour, floor
from tests.vm.scene import (
    FAILSTOP,
    HAND_S,
    LINK,
    SETTINGS,
    UNIT,
    Scene,
    beside,
    hurry_transfers,
    sh,
    shown,
    wrong_unless,
)
from tests.vm.table import KILLED, TRIAL_BY_NAME, Result

# Installing.


def install(scene: Scene) -> Iterator[Result]:
    """The board is plugged in; nothing of failstop is there yet."""
    found = Result("install")
    node = scene.node()
    code, said, _ = sh(sys.executable, "packaging/deb/build.py", "--out", "/srv", timeout_s=400.0)
    # The robot's package is the first that it names; before it may stand why there is none of the C library.
    packages = [line for line in said.splitlines() if line.endswith(".deb")]
    code, said, took_s = (code, said, 0.0) if code else sh("dpkg", "--install", packages[0], timeout_s=400.0)
    mode = os.stat(node)
    wrong_unless(
        found,
        install_failed=code == 0,
        no_link=os.path.realpath(LINK) == node,
        rights=mode.st_mode & 0o777 == 0o660,
        settings_name_another_port=f'path = "{LINK}"' in Path(SETTINGS).read_text() if code == 0 else False,
        ModemManager_may_open_it="ID_MM_PORT_IGNORE=1" in sh("udevadm", "info", node)[1],
        not_ready=shown("ActiveState")["ActiveState"] == "active",
        not_at_the_first_try=shown("NRestarts")["NRestarts"] == "0",
        the_wheels_turn=not any(scene.board.wheels()),
    )
    if code:
        found.wrong.append(said[-300:])
    found.note = f"{took_s:.0f} s of the guest's time"
    yield found


def plug(scene: Scene) -> Iterator[Result]:
    """The service is stopped, the board away; then it is plugged in, its wheels turning."""
    scene.moving()
    scene.board.unplug()
    sh("systemctl", "stop", UNIT)
    time.sleep(HAND_S)
    scene.board.events()
    with watched(scene) as seen:
        scene.board.replug()
        found = scene.judged("plug", seen.allowed_ns(), 60.0)
    scene.whole()
    ready_us = int(shown("ActiveEnterTimestampMonotonic")["ActiveEnterTimestampMonotonic"])
    found.note = f"ready {ready_us / 1e6 - seen.node_ns / 1e9:.1f} s after the node"
    yield found


# The floor, and the kills.


def least(scene: Scene) -> Iterator[Result]:
    """The floor, beside the service that stands."""
    scene.whole()
    for since_ns in floor.rounds():
        event = scene.board.wait_for(lambda one, ns=since_ns: one.arrival_ns >= ns and floor.is_of_floor(one), 5.0)  # type: ignore[misc]
        scene.board.events()
        yield Result("floor", ms=(event.arrival_ns - since_ns) / 1e6)


def kill_one(name: str) -> Callable[[Scene], Iterator[Result]]:
    """The trial of one process."""

    def trial(scene: Scene) -> Iterator[Result]:
        yield _killed(scene, f"kill_{name}", name, signal.SIGKILL)

    return trial


def crash(scene: Scene) -> Iterator[Result]:
    """As where systemd-coredump or apport is: they read all of the dying process before it is gone."""
    pattern = Path("/proc/sys/kernel/core_pattern")
    before = pattern.read_text()
    pattern.write_text("|/usr/bin/md5sum")
    try:
        yield _killed(scene, "crash", "gate", signal.SIGSEGV)
    finally:
        pattern.write_text(before)


def _killed(scene: Scene, trial: str, name: str, number: int) -> Result:
    scene.moving()
    victim = scene.pid(name)
    since_ns = time.monotonic_ns()
    os.kill(victim, number)
    return scene.judged(trial, since_ns)


def kill_all(scene: Scene) -> Iterator[Result]:
    """Nobody is left: systemd runs the stop tool."""
    scene.moving()
    group = shown("ControlGroup")["ControlGroup"]
    since_ns = time.monotonic_ns()
    Path(f"/sys/fs/cgroup{group}/cgroup.kill").write_text("1")
    yield scene.judged("kill_all", since_ns)


def systemctl(verb: str) -> Callable[[Scene], Iterator[Result]]:
    """The trial of one verb."""

    def trial(scene: Scene) -> Iterator[Result]:
        scene.moving()
        since_ns = time.monotonic_ns()
        code, said, _ = beside(scene, "systemctl", verb, UNIT)
        found = scene.judged(verb, since_ns)
        if code:
            found.wrong.append(said)
        if verb == "stop":
            sh("systemctl", "start", UNIT)
        yield found

    return trial


# The plug.


@dataclasses.dataclass
class Watched:
    """When a node was there, and when udev gave it to its group."""

    node_ns: int = 0
    rights_ns: int = 0
    node: str = ""
    _ended: threading.Event = dataclasses.field(default_factory=threading.Event)

    def look(self) -> None:
        """Look until all is seen."""
        before = {path: os.stat(path).st_ctime_ns for path in _nodes()}
        while not self._ended.is_set() and not self.rights_ns:
            for path in _nodes():
                with contextlib.suppress(OSError):
                    found = os.stat(path)
                    if found.st_ctime_ns != before.get(path):
                        self.node, self.node_ns = path, self.node_ns or time.monotonic_ns()
                        if found.st_mode & 0o060 == 0o060:
                            # When they were changed, not when this thread came to see it.
                            since_ns = time.time_ns() - found.st_ctime_ns
                            self.rights_ns = max(self.node_ns, time.monotonic_ns() - since_ns)
            time.sleep(0.001)

    def allowed_ns(self) -> int:
        """Wait for the rights."""
        wait_for("udev's rights on the node", lambda: bool(self.rights_ns), 30.0)
        return self.rights_ns


def _nodes() -> list[str]:
    return [str(path) for path in Path("/dev").glob("ttyACM*")]


@contextlib.contextmanager
def watched(scene: Scene) -> Iterator[Watched]:
    """See a node come, while something else is done; the transfers' new threads are hurried meanwhile."""
    seen = Watched()

    def look() -> None:
        seen.look()

    def hurry() -> None:
        while not seen.rights_ns and not seen._ended.is_set():
            hurry_transfers()
            time.sleep(0.1)

    threads = [threading.Thread(target=work, daemon=True) for work in (look, hurry)]
    for thread in threads:
        thread.start()
    try:
        yield seen
    finally:
        seen._ended.set()
        for thread in threads:
            thread.join()


def replugged(name: str, away_s: float) -> Callable[[Scene], Iterator[Result]]:
    """The trial of one time away."""

    def trial(scene: Scene) -> Iterator[Result]:
        scene.moving()
        found = _replug(scene, name, away_s)
        yield found

    return trial


def _replug(scene: Scene, name: str, away_s: float, node: str = "") -> Result:
    """Unplug, plug after a while, and judge from the rights on. The time from the node is told."""
    before = node or scene.node()
    scene.board.unplug()
    plug_s = time.monotonic() + away_s
    while time.monotonic() < plug_s:
        scene.run(min(0.02, away_s))
    scene.board.events()
    with watched(scene) as seen:
        scene.board.replug()
        scene.until("the new node's rights", lambda: bool(seen.rights_ns), 20.0)
        found = scene.judged(name, seen.node_ns)
    if found.ms is not None:
        from_node_ms = found.ms
        found.ms -= (seen.rights_ns - seen.node_ns) / 1e6
        found.note = f"{from_node_ms:.0f} ms after the node"
    same = seen.node == before
    if same is bool(node):
        found.wrong.append(f"the node was {before}, and is {seen.node}")
    return found


def renumber(scene: Scene) -> Iterator[Result]:
    """The old number is taken, so the board gets another."""
    scene.moving()
    node = scene.node()
    fd = os.open(node, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        yield _replug(scene, "renumber", 1.0, node)
    finally:
        os.close(fd)


# The board that does not drain.


def _stall(scene: Scene, seconds: float) -> None:
    scene.moving()
    scene.board.stop_draining()
    scene.run(seconds)
    scene.board.events()


def _again(scene: Scene, name: str) -> Result:
    since_ns = time.monotonic_ns()
    scene.board.drain()
    return scene.judged(name, since_ns)


def drain(scene: Scene) -> Iterator[Result]:
    """It is noticed and latched; the first bytes that are taken again may be the motion that was under way."""
    _stall(scene, 2.0)
    latched = scene.driver.robot.state.cause
    found = _again(scene, "drain")
    if latched is None or latched.kind is not causes.STUCK:
        found.wrong.append(f"latched: {latched or 'nothing'}")
    said = sh("journalctl", "--boot", f"--unit={UNIT}", "--lines=30", "--output=cat")[1]
    told = [line for line in said.splitlines() if "STOP latched" in line]
    wrong_unless(found, the_journal_says_that_it_was_sent=bool(told) and "NOT sent" in told[-1])
    yield found


def drain_kill(scene: Scene) -> Iterator[Result]:
    """The writers die meanwhile."""
    _stall(scene, 0.5)
    os.kill(scene.pid("port_owner"), signal.SIGKILL)
    scene.run(1.0)
    yield _again(scene, "drain_kill")


def drain_tool(scene: Scene) -> Iterator[Result]:
    """The stop tool says what it could not do, in its time."""
    _stall(scene, 0.5)
    code, said, took_s = beside(scene, FAILSTOP, "stop", "--device", LINK, "--wait", "2")
    found = _again(scene, "drain_tool")
    found.note = f"ended after {took_s:.1f} s"
    if took_s > 5.0:
        found.wrong.append(f"took {took_s:.1f} s: {code}, {said[-200:]}")
    yield found


def drain_stop(scene: Scene) -> Iterator[Result]:
    """The service ends in its time, and somebody stops the board when it takes bytes again."""
    _stall(scene, 0.5)
    code, said, took_s = beside(scene, "systemctl", "stop", UNIT, timeout_s=120.0)
    found = _again(scene, "drain_stop")
    found.note = f"ended after {took_s:.1f} s, {shown('Result')['Result']}"
    if took_s > 5.0:
        found.wrong.append(f"took {took_s:.1f} s: {code} {said[-200:]}")
    sh("systemctl", "start", UNIT)
    yield found


# Time.


def clock(scene: Scene) -> Iterator[Result]:
    """Nothing is to be stopped."""
    scene.moving()
    found = Result("clock")
    for step in ("+1 hour", "-2 hours", "+1 hour"):
        sh("date", "--set", step)
        scene.run(0.7)
        events = scene.board.events()
        stops = sum(event.is_stop for event in events)
        if stops or not any(scene.board.wheels()) or not any(event.is_motion for event in events):
            found.wrong.append(f"{step}: {stops} stops, wheels {scene.board.wheels()[0]:+.2f}")
    found.note = "drives on"
    yield found


DO: dict[str, Callable[[Scene], Iterator[Result]]] = {
    "install": install,
    "floor": least,
    "plug": plug,
    **{f"kill_{name}": kill_one(name) for name in KILLED},
    "crash": crash,
    "kill_all": kill_all,
    "stop": systemctl("stop"),
    "restart": systemctl("restart"),
    "replug": replugged("replug", 1.5),
    "replug_100": replugged("replug_100", 0.1),
    "replug_20": replugged("replug_20", 0.02),
    "renumber": renumber,
    "drain": drain,
    "drain_kill": drain_kill,
    "drain_tool": drain_tool,
    "drain_stop": drain_stop,
    "clock": clock,
    **distribution.DO,
    **first_hour.DO,
}


def run(scene: Scene, name: str) -> None:
    """All rounds of one trial; one that breaks is a result too."""
    for _ in range(TRIAL_BY_NAME[name].times):
        # So many starts in so short a time are a crash loop otherwise.
        sh("systemctl", "reset-failed", UNIT)
        try:
            for found in DO[name](scene):
                print(json.dumps(dataclasses.asdict(found)), flush=True)
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            text = f"{type(error).__name__} in {at.name}: {error}"
            print(json.dumps(dataclasses.asdict(Result(name, wrong=[text]))), flush=True)


def main() -> None:
    """Run the trials that are named, in the order of the table."""
    scene = Scene()
    with scene.board:
        scene.node()
        for name in sys.argv[1:]:
            start_s = time.monotonic()
            run(scene, name)
            print(f"{name}: {time.monotonic() - start_s:.1f} s of the guest's time", flush=True)
        print(json.dumps({"board": scene.board.info()}), flush=True)


if __name__ == "__main__":
    main()
