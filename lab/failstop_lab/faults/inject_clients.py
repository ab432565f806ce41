"""Injectors: clients, stop requests, the sensors that clients speak for."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import signal
import time
from collections.abc import Callable

from failstop.api.client import Client, run
from failstop.files import instance
from failstop.messages import segments
from failstop.messages.layout import GATE
from failstop.policy import causes
from failstop.policy.settings import FIRST_SOURCE, PAD_SOURCE
from failstop_lab.faults.crowd import CDriver, ChildDriver, Nobody, c_unfit
from failstop_lab.faults.fault import Fault
from failstop_lab.faults.inject import Injector
from failstop_lab.faults.scene import Scene

DRAINED_S = 0.1
KEY_STOPS = 1
PRESSED = 0x01
BUTTON_BIT = 0x0100
MODE = 0x2000
PRESS = (MODE, *(0,) * 20)
"""A press and its release, frame by frame."""
FORWARD = 127
"""A stick's way, all of it."""
AWAY = ".away"
LARGE_MB = 300
"""As a program with a neural network or a map has it. To take it down costs the kernel 25 to 60 ms."""


class OtherDrives(Injector):
    """A client of its own drives, and the campaign's only senses and holds."""

    MEGABYTES = 0

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self.child: ChildDriver | CDriver | None = None

    def prepare(self, scene: Scene) -> None:
        scene.driver.hand_over()
        self.child = ChildDriver(scene.name, scene.driver.velocity, self.MEGABYTES)

    def hang(self) -> int:
        """Stop the child; returns when it commanded last."""
        assert self.child
        self.child.signal(signal.SIGSTOP)
        return self.child.commanded_ns

    def heal(self, scene: Scene) -> None:
        if self.child:
            self.child.leave()
        scene.driver.commands = True


class ClientKilled(OtherDrives):
    """SIGKILL; at once another program commands, as one does that is started again."""

    SIGNAL = signal.SIGKILL

    def strike(self, scene: Scene) -> int:
        assert self.child
        now_ns = time.monotonic_ns()
        self.child.signal(self.SIGNAL)
        return now_ns

    def during(self, scene: Scene) -> None:
        scene.driver.commands = True


class ClientHungUp(ClientKilled):
    """The end of its terminal."""

    SIGNAL = signal.SIGHUP


class ClientFails(ClientKilled):
    """An exception that it does not handle."""

    SIGNAL = signal.SIGUSR1


class LargeClientKilled(ClientKilled):
    """SIGKILL of one whose memory takes long to take down."""

    MEGABYTES = LARGE_MB


class OtherDrivesInC(OtherDrives):
    """A C program drives."""

    FORKS = False

    def unfit(self) -> str:
        return c_unfit()

    def prepare(self, scene: Scene) -> None:
        scene.driver.hand_over()
        self.child = child = CDriver(scene.name, scene.driver.velocity, self.MEGABYTES, forks=self.FORKS)
        scene.driver.until("the C client to drive", lambda: child.commanded_ns > 0)


class CClientKilled(OtherDrivesInC, ClientKilled):
    """SIGKILL of a C program."""


class LargeCClientKilled(CClientKilled):
    """SIGKILL of one whose memory takes long to take down."""

    MEGABYTES = LARGE_MB


class CClientCrashes(CClientKilled):
    """A segmentation fault."""

    SIGNAL = signal.SIGSEGV


class CClientBecomesAnother(CClientKilled):
    """exec(): another program goes on under its number."""

    SIGNAL = signal.SIGUSR1


class ForkedCClientKilled(CClientKilled):
    """SIGKILL of one whose child lives on."""

    FORKS = True


class CClientHung(OtherDrivesInC):
    """SIGSTOP of a C program."""

    def strike(self, scene: Scene) -> int:
        return self.hang()


class ClientHung(OtherDrives):
    """SIGSTOP."""

    def strike(self, scene: Scene) -> int:
        return self.hang()


class SlotDamaged(OtherDrives):
    """The child's slot is damaged while it can't write it whole again."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._path = ""
        self._whole = b""

    def strike(self, scene: Scene) -> int:
        commanded_ns = self.hang()
        assert isinstance(self.child, ChildDriver)
        self._path = segments.path_of(run(scene.name)[0], f"client.{self.child.slot}")
        with open(self._path, "rb") as file:
            self._whole = file.read()
        self.during(scene)
        return commanded_ns

    def heal(self, scene: Scene) -> None:
        super().heal(scene)
        if self._whole:
            with open(self._path, "r+b") as file:
                file.write(self._whole)


class SlotScribbled(SlotDamaged):
    """Random bytes, again and again."""

    def during(self, scene: Scene) -> None:
        with open(self._path, "r+b", buffering=0) as file:
            file.write(scene.chance.randbytes(len(self._whole)))


class SlotTruncated(SlotDamaged):
    """Nothing is left of it."""

    def during(self, scene: Scene) -> None:
        os.truncate(self._path, 0)


class SlotUnlinked(SlotDamaged):
    """Its name is gone; the file lives as long as somebody has it open."""

    def strike(self, scene: Scene) -> int:
        assert isinstance(self.child, ChildDriver)
        self._path = segments.path_of(run(scene.name)[0], f"client.{self.child.slot}")
        now_ns = time.monotonic_ns()
        os.rename(self._path, self._path + AWAY)
        return now_ns

    def heal(self, scene: Scene) -> None:
        if self._path:
            os.rename(self._path + AWAY, self._path)
        super().heal(scene)


class SecondClient(Injector):
    """Another client publishes on the same source: whatever `velocity` says."""

    velocity = (0.1, 0.0, 0.0)
    source = FIRST_SOURCE

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._client: Client | None = None

    def prepare(self, scene: Scene) -> None:
        self._client = Client(scene.name, "second")

    def strike(self, scene: Scene) -> int:
        assert self._client
        now_ns = time.monotonic_ns()
        self._client.command(*self.velocity, manual=False, source=self.source)
        return now_ns

    def heal(self, scene: Scene) -> None:
        if self._client:
            self._client.close()


class ClientNan(SecondClient):
    """The library refuses such a command, so this one goes past it."""

    velocity = (0.0, math.nan, 0.0)


class ClientAsGamepad(SecondClient):
    """The gamepad goes before every source: whoever could stand in for it would have the wheels."""

    velocity = (0.0, 0.0, 0.0)
    source = PAD_SOURCE


class StopRequest(Injector):
    """From a process without rights."""

    words = "nobody says so"

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._nobody: Nobody | None = None

    def prepare(self, scene: Scene) -> None:
        self._nobody = Nobody(scene.name, self.words)

    def strike(self, scene: Scene) -> int:
        assert self._nobody
        return self._nobody.ask()

    def heal(self, scene: Scene) -> None:
        if self._nobody:
            self._nobody.end()


class StopRequestPosing(StopRequest):
    """In the words that the service has for a cause of its own."""

    words = str(causes.DIED(GATE))


class StopPipe(Injector):
    """Bytes in the stop FIFO."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self.fd = -1

    def prepare(self, scene: Scene) -> None:
        self.fd = os.open(instance.stop_path(instance.find(scene.name)), os.O_WRONLY | os.O_NONBLOCK)

    def heal(self, scene: Scene) -> None:
        if self.fd >= 0:
            os.close(self.fd)


class StopPipeGarbage(StopPipe):
    """Some random bytes."""

    def strike(self, scene: Scene) -> int:
        data = scene.chance.randbytes(scene.chance.choice((1, 7, 200, 4000)))
        now_ns = time.monotonic_ns()
        os.write(self.fd, data)
        return now_ns


class StopPipeFlood(StopPipe):
    """Full, and filled again."""

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        self.during(scene)
        return now_ns

    def during(self, scene: Scene) -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(100):
                os.write(self.fd, b"flood " * 600)

    def heal(self, scene: Scene) -> None:
        super().heal(scene)
        # A byte that waits in the pipe is a stop still, and would latch again after the reset.
        scene.driver.run(DRAINED_S)


class PadButton(Injector):
    """One frame with a button, as a tap is."""

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        scene.board.pad(BUTTON_BIT)
        return now_ns

    def heal(self, scene: Scene) -> None:
        scene.board.pad(0)


class PadSilent(Injector):
    """The gamepad drives, and is out of reach."""

    def _mode(self, scene: Scene, mode: str) -> None:
        """MODE, pressed again and again: a press within its lockout does nothing."""
        frames = itertools.cycle(PRESS)

        def reached() -> bool:
            if scene.driver.robot.state.pad_mode == mode:
                return True
            scene.board.pad(next(frames))
            return False

        scene.driver.until(f"the gamepad's mode {mode}", reached)

    def prepare(self, scene: Scene) -> None:
        self._mode(scene, "drive")
        scene.driver.leave()
        scene.driver.commands = False
        scene.board.pad(0, ly=FORWARD, hold=True)

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        scene.board.pad_silent()
        return now_ns

    def heal(self, scene: Scene) -> None:
        self._mode(scene, "locked")
        scene.driver.commands = True


class BoardKey(Injector):
    """The stop key, pressed."""

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        scene.board.key(KEY_STOPS, PRESSED)
        return now_ns


class ScanSilent(Injector):
    """Nobody says that the sensor delivers."""

    def strike(self, scene: Scene) -> int:
        scene.driver.senses = False
        return scene.driver.sensed_ns

    def heal(self, scene: Scene) -> None:
        scene.driver.senses = True


class InterlockLost(Injector):
    """Nobody says that the interlock holds."""

    def strike(self, scene: Scene) -> int:
        scene.driver.holds = False
        return scene.driver.held_ns

    def heal(self, scene: Scene) -> None:
        scene.driver.holds = True


class ServiceStopped(Injector):
    """As `systemctl stop` does."""

    def prepare(self, scene: Scene) -> None:
        scene.service.pids()

    def strike(self, scene: Scene) -> int:
        process = scene.service.process
        assert process
        now_ns = time.monotonic_ns()
        process.send_signal(signal.SIGTERM)
        return now_ns


INJECTORS: dict[str, Callable[[Fault], Injector]] = {
    "client-killed": ClientKilled,
    "client-killed-large": LargeClientKilled,
    "client-hung-up": ClientHungUp,
    "client-fails": ClientFails,
    "client-hung": ClientHung,
    "c-client-killed": CClientKilled,
    "c-client-killed-large": LargeCClientKilled,
    "c-client-crashes": CClientCrashes,
    "c-client-execs": CClientBecomesAnother,
    "c-client-killed-forked": ForkedCClientKilled,
    "c-client-hung": CClientHung,
    "client-nan": ClientNan,
    "client-second": SecondClient,
    "client-gamepad": ClientAsGamepad,
    "slot-scribbled": SlotScribbled,
    "slot-truncated": SlotTruncated,
    "slot-unlinked": SlotUnlinked,
    "pad-silent": PadSilent,
    "service-stopped": ServiceStopped,
    "stop-request": StopRequest,
    "stop-request-posing": StopRequestPosing,
    "stop-pipe-garbage": StopPipeGarbage,
    "stop-pipe-flood": StopPipeFlood,
    "pad-button": PadButton,
    "board-key": BoardKey,
    "scan-silent": ScanSilent,
    "interlock-lost": InterlockLost,
}
