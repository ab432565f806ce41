"""The trials whose board is out here, on the guest's xHCI by usbredir: it lives on when the guest sleeps or reboots."""

from __future__ import annotations

import bisect
import contextlib
import threading
import time
from collections.abc import Callable

from failstop_lab.sim.client import Event, SimBoard
from failstop_lab.trial import TrialError, judge
from tests.vm.client import ENABLE
from tests.vm.floor import is_of_floor
from tests.vm.guest import Guest, GuestError
from tests.vm.table import Result

PYTHON = "/srv/venv/bin/python"
UNIT = "failstop.service"
WAIT_S = 240.0
"""Of this machine's time, while it has a processor for the guest; the guest's is slower."""
IMU_HZ = 10.0
"""The board's second is several times shorter than the guest's, so that this is more in there."""
CLOCK_S = 60.0
ASLEEP_S = 3.0
LOOK_S = 0.1
JOURNAL_S = 60.0
"""For a line of the journal."""
BOOT_STOP_S = 10.0
"""From the node to the first word of a stop, the service's when it is ready: amid a boot that takes it 7 s there."""
NODE_S = "dmesg | sed -n 's/^\\[ *\\([0-9.]*\\)\\] cdc_acm .*ttyACM.*/\\1/p' | head -n 1"
STOP_TOLD = ("has told the wheels to stop", "the stop is written", "stop frame sent")
"""The words of the service when it is ready, and of its stop tool."""
STOP_S = (
    f"journalctl -b -u failstop -o short-monotonic --no-pager | grep -E '{'|'.join(STOP_TOLD)}' | "
    "sed -n 's/^\\[ *\\([0-9.]*\\)\\].*/\\1/p' | head -n 1"
)
"""When the kernel had the port, and when the service, or its stop tool, said first that a stop was written."""
SETTLE_S = 2.0
HIBERNATION = """set -e
fallocate --length 600M /swap
chmod 600 /swap
mkswap /swap
swapon /swap
mkdir -p /run/systemd/sleep.conf.d
printf '[Sleep]\\nHibernateMode=test_resume\\n' >/run/systemd/sleep.conf.d/vm.conf
"""
"""Where the image goes, and that the machine goes on at once."""
HIBERNATED = "Image saving done"


class Clock:
    """The guest's clock, as the client passes it on."""

    def __init__(self, machine: Guest) -> None:
        self._machine = machine
        self._connection = machine.dial("clock")
        self._ours: list[int] = []
        self._theirs: list[int] = []
        threading.Thread(target=self._follow, daemon=True).start()

    def _follow(self) -> None:
        waiting = b""
        while data := self._connection.recv(4096):
            now_ns = time.monotonic_ns()
            *lines, waiting = (waiting + data).split(b"\n")
            if lines and lines[-1].isdigit():
                self._theirs.append(int(lines[-1]))
                self._ours.append(now_ns)

    def passed(self, ours_ns: int) -> None:
        """Wait until a word of it has come after one of our times. Raises GuestError."""
        patience = self._machine.patience(CLOCK_S)
        while not self._ours or self._ours[-1] <= ours_ns:
            if patience.left_s() <= 0:
                raise GuestError(f"the guest's clock is not passed on: {patience.why()}")
            time.sleep(LOOK_S)

    def theirs(self, ours_ns: int) -> int:
        """The guest's time at one of ours, between the two nearest that are known. Raises GuestError."""
        self.passed(ours_ns)
        at = bisect.bisect(self._ours, ours_ns)
        if at == 0:
            raise GuestError("the guest's clock was not passed on before")
        before, after = self._ours[at - 1], self._ours[at]
        part = (ours_ns - before) / (after - before)
        return round(self._theirs[at - 1] + part * (self._theirs[at] - self._theirs[at - 1]))


class Scene:
    """The board, the guest, and what can be asked of both."""

    def __init__(self, machine: Guest, board: SimBoard) -> None:
        self.machine, self.board = machine, board
        self.clock = Clock(machine)

    def found(self) -> None:
        """Wait until the service has the board. Raises TrialError."""
        self.until("the board to be opened", lambda: self.board.info()["codings"] > 0)

    def command(self) -> None:
        """Start the client, beside everything that systemd ends."""
        words = f"cd /srv/trials; setsid {PYTHON} -m tests.vm.client >/run/vm-client.log 2>&1 &"
        self.machine.must("sh", "-c", words)
        self.clock.passed(time.monotonic_ns())

    def moving(self) -> None:
        """Have the wheels turn, and forget the events until then. Raises GuestError, TrialError."""
        self.machine.must("touch", ENABLE)
        self.until("the wheels to turn", lambda: any(self.board.wheels()))
        self.board.events()

    def until(self, what: str, check: Callable[[], bool], wait_s: float = WAIT_S) -> None:
        """Wait for it, and leave the guest its processor meanwhile. Raises TrialError."""
        patience = self.machine.patience(wait_s)
        while not check():
            if patience.left_s() <= 0:
                raise TrialError(f"waited {wait_s:g} s for {what}: {patience.why()}")
            time.sleep(LOOK_S)

    def shown(self, name: str) -> str:
        """A property of the unit."""
        return self.machine.must("systemctl", "show", UNIT, f"--property={name}", "--value")[0]

    def ready(self) -> None:
        """Wait until the unit is active, if it will be."""
        with contextlib.suppress(TrialError):
            self.until("the unit", lambda: self.shown("ActiveState") == "active")

    def resumed_s(self) -> float:
        """When the kernel let the processes run again after the last sleep, by the guest's clock."""
        return self.told_s("Restarting tasks")

    def told_s(self, words: str) -> float:
        """When the kernel said this last, by the guest's clock."""
        last = self.machine.must("sh", "-c", f"dmesg | grep '{words}' | tail -n 1")[0]
        return float(last[1 : last.index("]")])

    def first_s(self, what: str, command: str) -> float:
        """The time that a command in the guest prints, once it prints one: the journal writes a line some time after it
        was said. Raises TrialError."""
        found: list[str] = []

        def printed() -> bool:
            found[:] = self.machine.must("sh", "-c", command)
            return bool(found)

        self.until(what, printed, JOURNAL_S)
        return float(found[0])

    def status(self) -> str:
        """Whether the guest runs, in qemu's word."""
        return str(self.machine.qmp("query-status")["status"])


def floor_outside(scene: Scene) -> list[Result]:
    """The floor; the times are as exact as the clock is passed on, some milliseconds."""
    lines = scene.machine.must("env", "-C", "/srv/trials", PYTHON, "-m", "tests.vm.floor", timeout_s=60.0)
    time.sleep(SETTLE_S)
    arrived = [event.arrival_ns for event in scene.board.events() if is_of_floor(event)]
    killed = [int(line) for line in lines if line.isdigit()]
    if len(arrived) != len(killed):
        return [Result("floor_outside", wrong=[f"{len(killed)} kills, {len(arrived)} frames"])]
    pairs = zip(arrived, killed, strict=True)
    return [Result("floor_outside", ms=(scene.clock.theirs(ours) - theirs) / 1e6) for ours, theirs in pairs]


def _stopped(scene: Scene, found: list[Event], since_ns: int) -> None:
    def seen() -> bool:
        found.extend(scene.board.events())
        return any(event.is_stop and event.arrival_ns >= since_ns for event in found)

    scene.until("a stop", seen)


def _sleep(scene: Scene, name: str, words: tuple[str, ...], *, stands: bool) -> Result:
    """Sleep, wake up, and judge what comes after; `stands`: the wheels must be stopped before."""
    scene.moving()
    # The word's own end is known only when the machine is awake again.
    scene.machine.must("sh", "-c", f"(sleep 0.5; {' '.join(words)}) >/dev/null 2>&1 &")
    scene.until("the guest to sleep", lambda: scene.status() == "suspended")
    asleep = scene.board.events()
    turning = any(scene.board.wheels())
    time.sleep(ASLEEP_S)
    since_ns = time.monotonic_ns()
    scene.machine.qmp("system_wakeup")
    found: list[Event] = []
    result = Result(name)
    try:
        _stopped(scene, found, since_ns)
    except TrialError as error:
        result.wrong.append(str(error))
    time.sleep(SETTLE_S)
    found += scene.board.events()
    seen = judge(found, since_ns, was_turning=turning)
    result.missed, result.after = int(seen.stop_ns is None), seen.motion_after
    if seen.stop_ns is not None:
        result.ms = scene.clock.theirs(since_ns + seen.stop_ns) / 1e6 - scene.resumed_s() * 1e3
    if stands and (turning or not any(event.is_stop for event in asleep)):
        result.wrong.append("the wheels were not stopped before the sleep")
    if any(scene.board.wheels()):
        result.wrong.append("the wheels turn at the end")
    result.note = f"bus resets {scene.board.info()['bus_resets']}, noise {scene.board.info()['noise_bytes']} bytes"
    return result


def sleep(scene: Scene) -> Result:
    """As people do it: the sleep unit stops the wheels before; the chip keeps its power."""
    scene.board.keep_speed(True)
    try:
        return _sleep(scene, "sleep", ("systemctl", "suspend"), stands=True)
    finally:
        scene.board.keep_speed(False)


def sleep_lost(scene: Scene) -> Result:
    """Past systemd, so that the wheels turn over the sleep; the chip wakes at 9600 bit/s."""
    return _sleep(scene, "sleep_lost", ("echo mem > /sys/power/state",), stands=False)


def hibernate(scene: Scene) -> Result:
    """As people do it. The image is written to the disk, and the machine goes on from its memory."""
    scene.machine.must("sh", "-c", HIBERNATION)
    scene.moving()
    since_ns = _in_a_moment(scene, "systemctl", "hibernate")
    scene.until("the end of the sleep", lambda: scene.machine.run("sh", "-c", f"dmesg | grep '{HIBERNATED}'")[0] == 0)
    time.sleep(SETTLE_S)
    found = scene.board.events()
    began_s, resumed_s = scene.told_s("hibernation: hibernation entry"), scene.resumed_s()
    stops_s = [scene.clock.theirs(event.arrival_ns) / 1e9 for event in found if event.is_stop]
    woken_s = [at_s for at_s in stops_s if at_s > resumed_s]
    result = Result("hibernate", missed=int(not woken_s), after=judge(found, since_ns, was_turning=True).motion_after)
    if woken_s:
        result.ms = (woken_s[0] - resumed_s) * 1e3
    if not stops_s or stops_s[0] > began_s:
        result.wrong.append("the wheels were not stopped before the sleep")
    if any(scene.board.wheels()):
        result.wrong.append("the wheels turn at the end")
    return result


def _ended(scene: Scene, name: str, since_ns: int, found: list[Event]) -> Result:
    """Judge a guest that went away while its client commanded."""
    seen = judge(found, since_ns, was_turning=True)
    result = Result(name, missed=int(seen.stop_ns is None), after=seen.motion_after)
    if seen.stop_ns is not None:
        sent_ns = scene.clock.theirs(since_ns)
        result.ms = (scene.clock.theirs(since_ns + seen.stop_ns) - sent_ns) / 1e6
    if any(scene.board.wheels()):
        result.wrong.append("the wheels turn at the end")
    return result


def _in_a_moment(scene: Scene, *words: str) -> int:
    scene.machine.must("sh", "-c", f"({' '.join(words)}) >/dev/null 2>&1 &")
    return time.monotonic_ns()


def reboot(scene: Scene) -> Result:
    """From the command to the agent of the next boot; what that boot writes is looked at too."""
    scene.moving()
    since_ns = _in_a_moment(scene, "systemctl", "reboot")
    scene.machine.greeted()
    found = scene.board.events()
    scene.ready()
    found += scene.board.events()
    result = _ended(scene, "reboot", since_ns, found)
    result.note = _readiness(scene, result)
    return result


def boot(scene: Scene) -> Result:
    """The machine is reset, so nobody stops; the next boot finds the wheels turning."""
    scene.command()
    scene.moving()
    since_ns = time.monotonic_ns()
    scene.machine.qmp("system_reset")
    scene.machine.greeted()
    found = scene.board.events()
    _stopped(scene, found, since_ns)
    scene.ready()
    found += scene.board.events()
    seen = judge(found, since_ns, was_turning=True)
    result = Result("boot", missed=int(seen.stop_ns is None), after=seen.motion_after)
    if any(scene.board.wheels()):
        result.wrong.append("the wheels turn at the end")
    result.note = _readiness(scene, result)
    return result


def _readiness(scene: Scene, result: Result) -> str:
    if (state := scene.shown("ActiveState")) != "active":
        result.wrong.append(f"after the boot the unit is {state}")
    # The number of tries depends on what comes first, the board or the service.
    try:
        node = scene.first_s("the port in the kernel's log", NODE_S)
        stop = scene.first_s("the word of a stop in the journal", STOP_S)
    except TrialError as error:
        result.wrong.append(str(error))
        return ""
    ready = int(scene.shown("ActiveEnterTimestampMonotonic")) / 1e6
    if stop - node > BOOT_STOP_S:
        result.wrong.append(f"a stop was told of {stop - node:.1f} s after the node")
    tries = 1 + int(scene.shown("NRestarts"))
    return f"next boot: told of a stop {stop - node:.1f} s after the node, ready {ready - node:.1f} s, try {tries}"


def poweroff(scene: Scene) -> Result:
    """To qemu's end."""
    scene.command()
    scene.moving()
    since_ns = _in_a_moment(scene, "systemctl", "poweroff")
    ended = scene.machine.ended(WAIT_S)
    result = _ended(scene, "poweroff", since_ns, scene.board.events())
    if not ended:
        result.wrong.append("the guest did not power off")
    return result


DO: dict[str, Callable[[Scene], Result | list[Result]]] = {
    "floor_outside": floor_outside,
    "sleep": sleep,
    "sleep_lost": sleep_lost,
    "reboot": reboot,
    "boot": boot,
    "poweroff": poweroff,
    "hibernate": hibernate,
}


def journal(scene: Scene) -> list[str]:
    """The last lines of the service, for a trial that went wrong."""
    return scene.machine.run("journalctl", "-b", "-u", UNIT, "-o", "short-monotonic", "--no-pager", "-n", "25")[1]


__all__ = ["DO", "Scene", "journal"]
