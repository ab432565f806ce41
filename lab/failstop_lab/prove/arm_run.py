"""One stop path while the arm moves: a joint swings, the stop is brought about, and where it is read back says when it
stood: how far it is from where it was told to be at the cause, by the rate of its swing.

While it moves no servo is asked (it would hold the board's receiver), and after the stop it stands: so the time is read
from the place. A servo that lags behind its goal stands earlier by that lag: what is judged is what it went on.

Where the arm may move beside the wheels, the program that swings it drives too: the wheels have to come to rest, and
the arm to stand with its torque on.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable

from failstop.api.client import send_stop
from failstop.api.errors import FailstopError, Refused
from failstop.messages.layout import SUPERVISOR
from failstop.policy.settings import FIRST_SOURCE
from failstop_lab.faults import arm_table as table
from failstop_lab.prove import swing
from failstop_lab.prove.others import STRIKE
from failstop_lab.prove.run import (
    MOST_S,
    NS,
    STEADY_S,
    WHOLE_S,
    Result,
    judge_latch,
    judge_written,
    speed_up_s,
    start_over,
)
from failstop_lab.prove.sight import Sight
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.swing import Swing
from failstop_lab.prove.table import Path, Turning
from failstop_lab.trial import TrialError

SWUNG_S = 10.0
AFTER_S = 0.4
"""Watched after a stop should have been, for one that comes late and for its answer."""
STAYS_S = 0.4
BEHIND_S = 0.4
"""A joint that stands so much behind where it was told to be did not follow before."""
STAYS = 6
"""Pulses by which it may be read elsewhere later."""
LET_GO = "joint {} has let go: its torque is off"


class ArmRun:
    """From the middle of the swing to a whole service with nothing latched."""

    def __init__(
        self,
        stand: ProveStand,
        path: Path,
        velocity: Turning,
        sight: Sight | None = None,
        request: Callable[[str, str], None] = send_stop,
    ) -> None:
        """`sight`: of the wheels, which are to turn too at this velocity; None: they stand. `request`: what asks the
        service of this name for a stop."""
        assert path.arm
        self.stand = stand
        self.path = path
        self.fault = path.arm
        self._sight = sight if any(velocity.command) else None
        self._request = request
        self.result = Result(path, velocity, stand.board is not None)
        self._swing: Swing | None = None
        self._way = 1
        self._program: subprocess.Popen[bytes] | None = None
        self._struck = 0
        self._cause_ns = 0

    def perform(self) -> Result:
        """Do it. What can't be done, and what must not happen, is in the result."""
        driver, result = self.stand.driver, self.result
        driver.commands = driver.senses = driver.holds = False
        begun = self.stand.held.mark()
        self.stand.others.begin(self.path.latched)
        try:
            self._begin()
            self._strike()
            self.stand.run(self.path.reaction_bar_ms(simulated=result.simulated) / 1000 + AFTER_S, self._seen)
            self._judge_stop()
            if self._sight:
                self._judge_wheels(self._sight)
            if not result.runaway:
                self._recover()
                self._read_back()
        except (TrialError, FailstopError, OSError) as error:
            result.doubt(f"{type(error).__name__}: {error}")
            self._start_over()
        finally:
            self._end_program()
        result.starved = result.starved or self.stand.held.starved(begun)
        return result

    def _begin(self) -> None:
        """To a joint in mid-swing."""
        stand = self.stand
        stand.watch.forget()
        self._reset()
        stand.driver.robot.disable()
        found = self._swing = stand.swing = stand.swing or swing.choose(
            stand.driver.robot.arm, int(stand.settings["arm.base_servo"])
        )
        stand.driver.robot.arm.move({found.joint.name: found.middle_rad})
        if self._sight:
            stand.driver.velocity = (0.0, 0.0, 0.0)
            stand.driver.enable()
            stand.driver.commands = False
            stand.run(float(stand.settings.named["sources"][FIRST_SOURCE]["timeout_s"]))
        if stand.board:
            stand.board.events()
        self._program = found.begin(stand.name, self.result.velocity.command)
        if self._sight:
            stand.run(SWUNG_S, lambda: stand.driver.robot.state.moving)
            stand.run(speed_up_s(stand, self.result.velocity) + STEADY_S)
        if not stand.run(SWUNG_S, lambda: found.struck_now(stand.watch.moves)):
            raise TrialError(f"joint {found.joint.name} did not swing within {SWUNG_S:g} s")

    def _strike(self) -> None:
        fault, stand, program = self.fault, self.stand, self._program
        assert program
        pids = stand.service.pids()
        number = signal.SIGKILL if fault.what in (table.KILL, table.CLIENT_KILL) else signal.SIGSTOP
        self._cause_ns = time.monotonic_ns()
        if fault.what == table.STOP_REQUEST:
            self._request(stand.name, STRIKE)
        else:
            os.kill(pids[fault.process] if fault.process else program.pid, number)
        self._struck = pids.get(fault.process, 0)

    def _seen(self) -> bool:
        """A service that has gone leaves the port to us, which asks the board; nothing ends this before its time."""
        if self.fault.process == SUPERVISOR and self.fault.what == table.KILL and self.stand.service.gone():
            self.stand.watch.tap_port()
        return False

    def _judge_stop(self) -> None:
        found, watch, result = self._swing, self.stand.watch, self.result
        assert found
        result.arm = {"joint": found.joint.name, "rate_radps": round(found.rate_radps, 4)}
        result.arm["told"], self._way = found.at(watch.moves, self._cause_ns)
        judge_written(result, watch, self._cause_ns)
        if result.written_ms is not None:
            # A program that is held up moves the joint less, and then it stands nearer however late the stop comes.
            result.arm["stopped"] = found.at(watch.moves, self._cause_ns + round(result.written_ms * 1e6))[0]
        if self.stand.board:
            after = [event for event in self.stand.board.events() if event.arrival_ns >= self._cause_ns]
            stop = next((event for event in after if event.is_stop), None)
            result.board_ms = None if stop is None else (stop.arrival_ns - self._cause_ns) / 1e6
            if stop and (motion := sum(event.is_motion for event in after if event.index > stop.index)):
                result.wrong.append(f"{motion} motion frames after the stop")
            if found.joint.servo in self.stand.board.limp():
                result.wrong.append(LET_GO.format(found.joint.name))

    def _judge_wheels(self, sight: Sight) -> None:
        """They turned until the cause, and come to rest."""
        result, samples = self.result, self.stand.watch.samples
        verdict = sight.verdict(self._cause_ns)
        self.stand.run(MOST_S, lambda: self._seen() or verdict.still(samples))
        before = [sample for sample in samples if -0.55 * NS < sample[0] - self._cause_ns < 0]
        if not sight.turning(before):
            result.doubt("the wheels were not seen turning before the stop")
        after = [sample for sample in samples if sample[0] >= self._cause_ns]
        rest_ns = sight.rest_ns(before + after, result.velocity.name)
        if not verdict.still(samples):
            result.wrong.append("THE WHEELS DID NOT COME TO REST" if after else f"the {sight.source} is silent")
            result.runaway = True
        elif rest_ns is None:
            result.doubt(f"the samples of the {sight.source} show no moment of rest")
        else:
            assert result.arm is not None
            rest_s = result.arm["wheels_rest_s"] = round(max(0, rest_ns - self._cause_ns) / NS, 3)
            if rest_s > (bar_s := sight.rest_bar_s(self.path, result.velocity)):
                result.doubt(f"the wheels at rest after {rest_s:.2f} s, the bar is {bar_s:.2f}")

    def _recover(self) -> None:
        """To a service that is whole; the program that moved the arm is gone by then."""
        stand = self.stand
        if self.fault.what == table.HANG:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._struck, signal.SIGCONT)
        if self._sight and self.fault.what == table.CLIENT_HANG:
            stand.driver.robot.disable()  # else the end of the program that hangs would be a driver's death
        self._end_program()
        if self.fault.process == SUPERVISOR:
            stand.bury()
            stand.start()
        stand.driver.until("the service to be whole again", stand.whole, WHOLE_S)
        judge_latch(self.result, stand.driver.robot.state, self.path.latched)
        self._reset()

    def _reset(self) -> None:
        robot = self.stand.driver.robot

        def reset() -> bool:
            if robot.state.estop:
                with contextlib.suppress(Refused):
                    robot.reset()
            return robot.state.estop is None

        self.stand.driver.until("a reset", reset)

    def _read_back(self) -> None:
        """Where it stands, and that it stays there."""
        result, found = self.result, self._swing
        assert found
        places = []
        for wait_s in (0.0, STAYS_S):
            self.stand.run(wait_s)
            begun_ns = time.monotonic_ns()
            self.stand.driver.robot.arm.read()
            self.stand.look()
            if (place := found.read(self.stand.watch.readings, begun_ns)) is None:
                result.wrong.append(f"joint {found.joint.name}: where it is can't be read")
                return
            places.append(place)
        assert result.arm is not None
        result.arm["read"] = places[0]
        state = self.stand.driver.robot.state.arm
        if state and state.joints[found.joint.name].torque is False:
            result.wrong.append(LET_GO.format(found.joint.name))
        result.rest_s = (places[0] - result.arm["told"]) * self._way / found.joint.speed
        bar_s = self.path.rest_bar_s(result.velocity)
        if result.rest_s > bar_s:
            result.doubt(f"at rest after {result.rest_s:.2f} s, the bar is {bar_s:.2f}")
        elif result.rest_s < -BEHIND_S:
            result.doubt(f"it stands {-result.rest_s:.2f} s behind its goal: it did not follow before the stop")
        if abs(places[1] - places[0]) > STAYS:
            result.wrong.append(f"it stood at {places[0]:g}, and later at {places[1]:g}")

    def _end_program(self) -> None:
        if self._program:
            self._program.kill()
            self._program.wait()
            self._program = None

    def _start_over(self) -> None:
        """Everything stopped by every means, then again. An arm stands by itself when its last move ends."""
        self._end_program()
        start_over(self.stand, self._sight, self.result)
