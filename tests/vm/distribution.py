"""The trials of what a distribution does with a USB port beside failstop: saving power, and looking for modems."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from failstop.board.rrc.board import BOARD
from failstop.doctor.port import LEFT_ALONE
from tests.vm.scene import FAILSTOP, UNIT, Scene, sh, wrong_unless
from tests.vm.table import Result

VENDOR = BOARD.usb[0].partition(":")[0]
RULE = Path("/usr/lib/udev/rules.d/90-failstop.rules")
BOARDS = ("--subsystem-match=usb", f"--attr-match=idVendor={VENDOR}")
IDLE_S = 3.0
"""More than the kernel's autosuspend_delay_ms, 2 s."""
LOOK_S = 0.25
ASKED = Path("/run/udev/rules.d/10-modem.rules")
ASKED_RULE = (
    f'SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", ATTR{{idVendor}}=="{VENDOR}", ENV{{ID_MM_DEVICE_PROCESS}}="1"\n'
)
"""By itself ModemManager 1.20 does not open the board's port; the default policy of versions before 1.18 lets it."""
OPENED_S = 20.0
PATIENCE = 2.0
"""How much longer is waited with the rule than it took without."""


def _power(scene: Scene) -> Path:
    """Where the kernel shows and takes how the board's USB device saves power."""
    return Path("/sys/class/tty", os.path.basename(scene.node()), "device").resolve().parent / "power"


def _suspended_ms(power: Path) -> int:
    return int((power / "runtime_suspended_time").read_text())


def autosuspend(scene: Scene) -> Iterator[Result]:
    """A program that saves power has allowed the board to sleep when it is idle; then udev looks at it again."""
    found = Result("autosuspend")
    scene.moving()
    power = _power(scene)
    before_ms = _suspended_ms(power)
    (power / "control").write_text("auto")
    scene.run(IDLE_S)
    driving_ms = _suspended_ms(power)
    sh(FAILSTOP, "stop", "stand")
    scene.run(IDLE_S)
    standing_ms = _suspended_ms(power)
    sh("udevadm", "trigger", "--settle", *BOARDS)
    wrong_unless(
        found,
        slept_while_it_drove=driving_ms == before_ms,
        slept_while_it_stood=standing_ms == driving_ms,
        the_rule_lets_it_sleep=(power / "control").read_text().strip() == "on",
    )
    found.note = "never sleeps"
    yield found


def suspended(scene: Scene) -> Iterator[Result]:
    """The board may sleep at once, so between two frames it does: what waking it up costs a stop."""
    scene.moving()
    power = _power(scene)
    delay_ms = (power / "autosuspend_delay_ms").read_text()
    try:
        (power / "autosuspend_delay_ms").write_text("0")
        (power / "control").write_text("auto")
        scene.until("the board to sleep", lambda: (power / "runtime_status").read_text().strip() == "suspended")
        victim = scene.pid("gate")
        since_ns = time.monotonic_ns()
        os.kill(victim, signal.SIGKILL)
        yield scene.judged("suspended", since_ns)
    finally:
        (power / "control").write_text("on")
        (power / "autosuspend_delay_ms").write_text(delay_ms)


def _opened_s(scene: Scene, timeout_s: float) -> float | None:
    """Plug the board in; returns how long after its node somebody opens it, None if nobody does. Unplugs it again."""
    scene.board.replug()
    scene.node()
    start_s = time.monotonic()
    opened_s = None
    while opened_s is None and (passed_s := time.monotonic() - start_s) < timeout_s:
        opened_s = passed_s if scene.board.info()["opened"] else None
        time.sleep(LOOK_S)
    scene.board.unplug()
    return opened_s


def modem(scene: Scene) -> Iterator[Result]:
    """ModemManager is told to look at the board; the control is that it opens it without failstop's rule."""
    found = Result("modem")
    _, said, _ = sh(FAILSTOP, "doctor", "--quick")
    sh("systemctl", "disable", "--now", UNIT)
    scene.board.unplug()
    text = RULE.read_text()
    try:
        ASKED.parent.mkdir(parents=True, exist_ok=True)
        ASKED.write_text(ASKED_RULE)
        RULE.unlink()
        sh("udevadm", "control", "--reload")
        without_s = _opened_s(scene, OPENED_S)
        RULE.write_text(text)
        sh("udevadm", "control", "--reload")
        with_s = _opened_s(scene, PATIENCE * (without_s or OPENED_S))
        wrong_unless(
            found,
            not_opened_without_the_rule=without_s is not None,
            opened_with_it=with_s is None,
            doctor_misses_the_rule=LEFT_ALONE in " ".join(said.split()),
        )
        found.note = f"without it {without_s or 0.0:.1f} s after the node"
    finally:
        ASKED.unlink()
        RULE.write_text(text)
        sh("udevadm", "control", "--reload")
        scene.board.replug()
        sh("systemctl", "enable", "--now", UNIT)
    yield found


DO: dict[str, Callable[[Scene], Iterator[Result]]] = {
    "autosuspend": autosuspend,
    "suspended": suspended,
    "modem": modem,
}
