"""Injectors: the USB connection and the board."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import time
from collections.abc import Callable

from failstop.messages.layout import SUPERVISOR
from failstop_lab.faults.fault import Fault
from failstop_lab.faults.inject import ASKED_MEANWHILE, AskedMeanwhile, Injector
from failstop_lab.faults.scene import Scene
from failstop_lab.trial import TrialError

GONE_S = (0.01, 0.15)
WATCHDOG_S = 1.0
"""WatchdogSec of the systemd units, s."""
GARBLED = 0.01
IDLE_KEY = 2
PRESSED = 0x01
FLOOD = 100
LATCH_S = 3.0
LEARNED_S = 4.0
FAST = (0.2, 0.0, 0.0)
STRAIGHT = (0.1, 0.0, 0.0)
UP_TO_SPEED_S = 0.5
FAR_S = 2.0
STARTS_S = 0.62, 0.66
"""How long the board takes to start: longer than a busy computer makes its reports pause (`silent_ns` of the boards),
and not so long that it counts as silent."""
BLOCK = 256
IDLE_FILLS = 3
RUNS_AWAY = 5.0
"""Times as fast as it is told."""
SETTLED_S = 0.01


def _open_beside(scene: Scene) -> int:
    """The port, opened beside its owner. Raises OSError: only root passes TIOCEXCL."""
    return os.open(scene.trial.link, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)


def _passes_every_permission() -> bool:
    with tempfile.NamedTemporaryFile() as file:
        os.chmod(file.name, 0)
        return os.access(file.name, os.R_OK | os.W_OK, effective_ids=True)


class UsbDrop(Injector):
    """Unplugged, and plugged in again a little later."""

    def strike(self, scene: Scene) -> int:
        scene.board.unplug()
        scene.driver.run(scene.chance.uniform(*GONE_S))
        back_ns = time.monotonic_ns()
        scene.board.replug()
        return back_ns

    def heal(self, scene: Scene) -> None:
        if scene.board.info()["node"] is None:
            scene.board.replug()


class UsbDropMidFrame(UsbDrop):
    """The board's receiver is left in the middle of a frame, where the next bytes are data to it."""

    def strike(self, scene: Scene) -> int:
        stop = scene.traits.language.stop
        cut = scene.chance.randrange(1, len(stop))
        try:
            fd = _open_beside(scene)
        except OSError:
            scene.board.cut(cut)
        else:
            os.write(fd, stop[:cut])
            os.close(fd)
        return super().strike(scene)


class UsbDropRenamed(UsbDrop):
    """Something else has taken the name meanwhile."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._taken: list[int] = []

    def strike(self, scene: Scene) -> int:
        node = scene.board.info()["node"]
        scene.board.unplug()
        scene.driver.run(scene.chance.uniform(*GONE_S))
        while not self._taken or os.path.exists(node) is False:
            self._taken += os.openpty()
            if len(self._taken) > 20:
                raise TrialError(f"{node} was not given out again")
        back_ns = time.monotonic_ns()
        scene.board.replug()
        if scene.board.info()["node"] == node:
            raise TrialError(f"the board came back as {node}")
        return back_ns

    def heal(self, scene: Scene) -> None:
        super().heal(scene)
        for fd in self._taken:
            os.close(fd)


class UsbDropPermission(UsbDrop):
    """The device is there before it may be opened, as before udev has given it to its group."""

    def unfit(self) -> str:
        if not _passes_every_permission():
            return ""
        return "passes every permission (CAP_DAC_OVERRIDE): without it, setpriv --bounding-set -dac_override"

    def strike(self, scene: Scene) -> int:
        super().strike(scene)
        node = scene.board.info()["node"]
        mode = os.stat(node).st_mode & 0o777
        os.chmod(node, 0)
        scene.driver.run(scene.chance.uniform(*GONE_S))
        now_ns = time.monotonic_ns()
        os.chmod(node, mode)
        return now_ns


class UsbDropUnwatched(UsbDrop):
    """The supervisor, which alone opens a port, hangs before the board is back: systemd's watchdog kills it."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._supervisor = 0

    def prepare(self, scene: Scene) -> None:
        self._supervisor = scene.service.pids()[SUPERVISOR]

    def strike(self, scene: Scene) -> int:
        scene.board.unplug()
        os.kill(self._supervisor, signal.SIGSTOP)
        until_s = time.monotonic() + WATCHDOG_S
        scene.driver.run(scene.chance.uniform(*GONE_S))
        back_ns = time.monotonic_ns()
        scene.board.replug()
        scene.driver.run(max(0.0, until_s - time.monotonic()))
        os.kill(self._supervisor, signal.SIGKILL)
        scene.start_stop_tool()
        return back_ns


def _fill(fd: int) -> int:
    """Write zeros, which the board's receiver passes over, until none are taken; returns how many were."""
    taken = 0
    with contextlib.suppress(BlockingIOError):
        while True:
            taken += os.write(fd, bytes(BLOCK))
    return taken


class NotDraining(Injector):
    """The port is full: no byte gets through until the board takes them again."""

    def unfit(self) -> str:
        return "" if os.getuid() == 0 else "only root may fill the port beside its owner"

    def strike(self, scene: Scene) -> int:
        scene.board.stop_draining()
        fd = _open_beside(scene)
        idle = 0
        while idle < IDLE_FILLS:
            # The kernel moves what it took on, and then has room again.
            idle = 0 if _fill(fd) else idle + 1
            scene.driver.run(SETTLED_S)
        os.close(fd)
        _see_latch(scene)
        now_ns = time.monotonic_ns()
        scene.board.drain()
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.drain()


class Deaf(Injector):
    """It is heard to be deaf, latched, and stopped once it hears."""

    def prepare(self, scene: Scene) -> None:
        # A board that has never answered is not deaf but unproven.
        heard = ("alive", "unasked")
        scene.driver.until("the link to be alive", lambda: scene.driver.robot.state.device.link in heard, LATCH_S)

    def strike(self, scene: Scene) -> int:
        scene.board.deaf(True)
        _see_latch(scene)
        now_ns = time.monotonic_ns()
        scene.board.deaf(False)
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.deaf(False)


class BoardRestarts(Injector):
    """It starts again while it drives, and for a while it hears and reports nothing."""

    def prepare(self, scene: Scene) -> None:
        # Counters that are near zero can't fall.
        scene.driver.run(FAR_S)

    def strike(self, scene: Scene) -> int:
        deaf_s = scene.chance.uniform(*STARTS_S)
        scene.board.restart(deaf_s)
        scene.driver.run(deaf_s)
        return time.monotonic_ns()


class Silent(Injector):
    """Nothing comes from it any more."""

    def prepare(self, scene: Scene) -> None:
        if not scene.traits.language.reports.every_ns:
            scene.driver.run(LEARNED_S)  # how often it reports is seen first

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        scene.board.silent(True)
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.silent(False)
        scene.driver.until("it to be heard", lambda: scene.driver.robot.state.device.link != "silent", LATCH_S)


class Unwired(Silent):
    """It is latched as silent, and stopped once it hears."""

    def strike(self, scene: Scene) -> int:
        scene.board.deaf(True)
        scene.board.silent(True)
        _see_latch(scene)
        now_ns = time.monotonic_ns()
        scene.board.deaf(False)
        return now_ns


def _see_latch(scene: Scene) -> None:
    """Command until it is latched; a service that does not notice is judged by what follows."""
    with contextlib.suppress(TrialError):
        scene.driver.until("the latch", lambda: scene.driver.robot.state.estop is not None, LATCH_S)


class Unproven(Injector):
    """No whole frame has ever come from the board: a new run on a board that garbles everything."""

    def prepare(self, scene: Scene) -> None:
        scene.service.pids()
        scene.board.garble(up=1.0)
        scene.restart()
        scene.driver.enable()

    def strike(self, scene: Scene) -> int:
        return time.monotonic_ns()

    def heal(self, scene: Scene) -> None:
        scene.board.garble()


class GarblesUp(Injector):
    """Bits flip on the way from the board."""

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        scene.board.garble(up=GARBLED)
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.garble()


class GarblesDown(AskedMeanwhile):
    """Bits flip on the way to the board."""

    def trouble(self, scene: Scene) -> None:
        scene.board.garble(down=GARBLED)

    def heal(self, scene: Scene) -> None:
        scene.board.garble()


class Floods(AskedMeanwhile):
    """Key events of a key that means nothing, as fast as the wire takes them."""

    def trouble(self, scene: Scene) -> None:
        self.during(scene)

    def during(self, scene: Scene) -> None:
        for _ in range(FLOOD):
            scene.board.key(IDLE_KEY, PRESSED)


class Refuses(Injector):
    """The set point is zero and the wheels turn on, as with a dead encoder."""

    def prepare(self, scene: Scene) -> None:
        # Below about 0.2 m/s an IMU does not tell turning wheels from the still.
        scene.driver.velocity = FAST
        scene.driver.run(UP_TO_SPEED_S)

    def strike(self, scene: Scene) -> int:
        scene.board.refuse_stop(True)
        now_ns = time.monotonic_ns()
        scene.ask(ASKED_MEANWHILE)
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.refuse_stop(False)


class RunsAway(Injector):
    """One wheel is out of control, as with a shorted transistor."""

    def prepare(self, scene: Scene) -> None:
        # In a narrow curve that wheel may be told next to nothing, and five times of that is within its margin.
        scene.driver.velocity = STRAIGHT
        scene.driver.run(UP_TO_SPEED_S)

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        scene.board.roll(faster=RUNS_AWAY)
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.roll()


class MotorUnplugged(Injector):
    """One motor hears nothing: it turns on until its own watchdog acts. The others are stopped for it."""

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        scene.board.disconnect_motor(True)
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.disconnect_motor(False)
        scene.driver.until("the motor to answer", lambda: not scene.driver.robot.state.servos_wrong, LATCH_S)


INJECTORS: dict[str, Callable[[Fault], Injector]] = {
    "usb-drop": UsbDrop,
    "usb-drop-mid-frame": UsbDropMidFrame,
    "usb-drop-renamed": UsbDropRenamed,
    "usb-drop-permission": UsbDropPermission,
    "usb-drop-unwatched": UsbDropUnwatched,
    "board-not-draining": NotDraining,
    "board-deaf": Deaf,
    "board-restarts": BoardRestarts,
    "board-silent": Silent,
    "board-unwired": Unwired,
    "board-unproven": Unproven,
    "board-garbles-up": GarblesUp,
    "board-garbles-down": GarblesDown,
    "board-floods": Floods,
    "board-refuses": Refuses,
    "board-wheel-runs-away": RunsAway,
    "board-motor-unplugged": MotorUnplugged,
}
