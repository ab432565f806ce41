"""Calls: what a program may do with a robot that takes no time; the same for Robot and AsyncRobot."""

from __future__ import annotations

import time
from math import isfinite

from failstop.api.arm import Arm
from failstop.api.attend import Attendance
from failstop.api.client import send_stop
from failstop.api.driving import Answer, Blocked, judge, settled
from failstop.api.events import EventLog
from failstop.api.samples import Sample, SampleReader
from failstop.api.session import Session
from failstop.api.snapshot import Block
from failstop.api.waiting import POLL_S
from failstop.procs.gate.sources import DEFAULT as DEFAULT_SOURCE
from failstop.shm.records import cut

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.why import Why

MOST_OF_A_NAME = 64
"""Bytes of an operator's name; the rest is left out."""
TAKEN_S = 0.01
"""How long drive() waits for a gate that has not taken this command yet, or may decide otherwise for it; the gate needs
0.3 ms on a machine that is idle."""


class Calls(Session):
    """Drive, assert, look: the base of both."""

    _arm: Arm | None = None
    _samples: SampleReader | None = None

    def drive(self, vx: float, vy: float, wz: float, *, manual: bool = False, source: str = DEFAULT_SOURCE) -> Answer:
        """Command a velocity: m/s forward, m/s left, rad/s counter-clockwise. It holds for its source's timeout (0.3
        s unless the settings say otherwise, 2 s at most), so repeat it. Values past the limits are clamped. After a
        restart of the service nothing moves before somebody enables motion again.

        Returns what becomes of it: Driving, Preempted by whom, or Blocked by what; only Driving is true in a condition.
        It takes no time while the wheels turn, and 10 ms at most while they do not.

        A command by a person (`manual`) is exempt from the scan gate. `source` is a name of the settings' [sources].
        Raises ValueError for a value that is not finite, Undeclared (a ValueError too) for a source that the settings
        do not name, NoService when no service runs.
        """
        self.command(vx, vy, wz, manual=manual, source=source)
        until_s = time.monotonic() + TAKEN_S
        while (answer := self._answer(source)) is None or not settled(answer):
            if time.monotonic() > until_s:
                return Blocked(Block.NO_COMMAND, "the gate has not taken the command yet") if answer is None else answer
            time.sleep(POLL_S)
        return answer

    def command(self, vx: float, vy: float, wz: float, *, manual: bool = False, source: str = DEFAULT_SOURCE) -> None:
        """As drive(), without its answer: it never waits. For a program that has much else to hear."""
        if not (isfinite(vx) and isfinite(vy) and isfinite(wz)):
            raise ValueError(f"drive({vx}, {vy}, {wz}): every value must be finite")
        with self._lock:
            run = self._current()
            run.check_source(source)
            self._slot(run).command(vx, vy, wz, manual=manual, source=source)

    def _answer(self, source: str) -> Answer | None:
        with self._lock:
            decided, cause = self._reader.decided()
        return judge(decided, decided["sources"], source, str(cause or ""))

    def sensed(self) -> None:
        """The obstacle sensor delivered just now. Software commands move the wheels only while somebody says so at
        least every 0.5 s (setting scan.timeout_s); else they are blocked with `no scan`. Raises NoService when no
        service runs."""
        with self._lock:
            self._client().sensed()

    def hold(self, *interlocks: str) -> None:
        """These interlocks hold now (names of the settings' [interlocks]); repeat it within their timeout.

        Enabling needs every declared one, and losing one disables motion. What an earlier call named and this one does
        not is no longer asserted, and ends with its timeout. Raises Undeclared for one that the settings do not name,
        and then asserts none; NoService when no service runs.
        """
        with self._lock:
            run = self._current()
            run.check_interlocks(interlocks)
            self._slot(run).hold(list(interlocks))

    def attend(self, who: str) -> Attendance:
        """An operator attends, once the attendance that comes back is renewed, and for as long as it is (see there).
        Where the setting attend.required is "on", motion needs somebody who attends; elsewhere it changes nothing."""
        return Attendance(self, cut(" ".join(who.split()), MOST_OF_A_NAME).decode() or "somebody")

    def say(self, sees: str, wrong: str = "") -> None:
        """Tell people in a line what this program sees, and what is wrong, if anything is: `status`, `why`, `doctor`
        and the events show it under the program's name, the newest words only. At most 190 bytes each; say it again
        every few seconds, as old words are shown with their age."""
        with self._lock:
            self._client().say(sees, wrong)

    def estop(self, reason: str = "") -> None:
        """Latched protective stop (a stop by software, category 2; not an emergency stop in the sense of ISO 13850).
        Motion stays off until reset() and enable(). Anyone may, with a service of any version, and with a Robot that is
        closed; raises NoService when nothing is there to stop. The latch's reason is `stop request: REASON (CLIENT, pid
        N)`; of a reason of more than 180 bytes the rest is left out."""
        send_stop(self.name, reason, self.client_name)

    def why(self) -> Why:
        """What holds the wheels, what proof there is that they stand, and what to do. `str` of it is the three lines
        that `failstop why` prints. Raises NoService, FailstopError."""
        from failstop.api.why import explain  # nobody who drives needs its words

        return explain(self.state, EventLog(self.name).read(), time.time())

    def samples(self) -> list[Sample]:
        """What the board reported since the last call, each sample once with its time: ImuSample, BatterySample,
        PadSample, OdometrySample of failstop.api.samples. The first call begins it, and the first of a new run begins
        again. Raises NoService, FailstopError."""
        with self._lock:
            run = self._current()
            if self._samples is None or self._samples.run is not run:
                self._samples = SampleReader(self.name, run)
            return self._samples.read()

    @property
    def arm(self) -> Arm:
        """The robot's arm. Its calls wait: in an event loop, `await asyncio.to_thread(robot.arm.pose, "drive")`. Raises
        FailstopError where the settings name none."""
        if self._arm is None:
            self._arm = Arm(self)
        return self._arm
