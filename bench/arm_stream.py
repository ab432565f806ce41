"""The arm's stream: how even it is at the board, and which hop makes it uneven; the speed that a goal reaches."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

from bench import stats
from bench.carriers import Carriers
from bench.stats import Row
from failstop.api.client import attach
from failstop.board.rrc.framing import BUS_SERVO
from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.board.servos import SERVO_MOVE
from failstop.messages import box, layout, records
from failstop_lab.faults.arm import ArmTrial

PERIOD_NS = 40_000_000
LOOK_EVERY_S = 0.1
JITTER_P99_MS = 5.0
FOLLOW_RADPS = 0.3
FOLLOW_S = 4.0

Timed = tuple[int, bytes]
"""When, and a move's data: sub-command, duration, count, and (servo, position) each."""


@dataclasses.dataclass
class Hops:
    """The moves of a stream as the gate made them (the time of its wake-up), as the port owner had written them, and as
    they arrived at the board."""

    made: list[Timed]
    written: list[Timed]
    arrived: list[Timed]

    def rows(self) -> list[Row]:
        """Off the period at the board, and what of it comes from where."""
        off = [abs(gap_ns - PERIOD_NS) for gap_ns in _gaps(self.arrived)]
        late = [abs((gap_ns + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2) for gap_ns in _gaps(self.made)]
        unwritten, written = _hop(self.made, self.written)
        lost, arrived = _hop(self.written, self.arrived)
        return [
            stats.timing(
                "streaming jitter at 25 Hz, six joints: off the period, at the board",
                off,
                p50_ms=None,
                p99_ms=JITTER_P99_MS,
            ),
            stats.timing("of it the gate: its wake-ups off the period", late, p50_ms=None, p99_ms=None),
            stats.timing("of it gate to port owner: wake-up -> written", written, p50_ms=None, p99_ms=None),
            stats.timing("of it the pty: written -> arrived", arrived, p50_ms=None, p99_ms=None),
            stats.count("moves of the gate that did not arrive", unwritten + lost, len(self.made)),
        ]


def _gaps(moves: Sequence[Timed]) -> list[int]:
    """Between two moves of the same servos."""
    times: dict[int, list[int]] = {}
    for t_ns, data in moves:
        times.setdefault(data[4], []).append(t_ns)
    return [b - a for found in times.values() for a, b in pairwise(found)]


def _hop(before: Sequence[Timed], after: Sequence[Timed]) -> tuple[int, list[int]]:
    """(how many moves were lost, how long the others took). A move that is not among the next few was lost; at the ends
    one side was looked at for longer."""
    at = lost = 0
    took: list[int] = []
    for t_ns, data in before:
        found = next((index for index in range(at, min(at + 8, len(after))) if after[index][1] == data), None)
        if found is None:
            lost += bool(took) and at < len(after)
        else:
            took.append(after[found][0] - t_ns)
            at = found + 1
    return lost, took


def _is_move(frame: bytes) -> bool:
    return len(frame) > 5 and frame[2] == BUS_SERVO and frame[4] == SERVO_MOVE


def watch(trial: ArmTrial, seconds: float, carriers: Carriers) -> Hops:
    """Look at every hop while a program moves all joints."""
    views = {which: attach(trial.name, which) for which in (layout.GATE, layout.PORT_OWNER)}
    frames, wire = views[layout.GATE].ring_reader("frames"), views[layout.PORT_OWNER].ring_reader("box")
    hops = Hops([], [], [])
    mark = trial.board.info()["executed"]
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        carriers.first()
        time.sleep(LOOK_EVERY_S)
        while entry := frames.next():
            if _is_move(frame := records.FRAME.unpack(entry[2])[2]):
                hops.made.append((entry[1], frame[4:-1]))
        while entry := wire.next():
            _, _, taken, frame = box.WIRE.unpack(entry[2])
            if taken and _is_move(frame):
                hops.written.append((entry[1], frame[4:-1]))
    events = [event for event in trial.board.events(mark) if event.func == BUS_SERVO and event.data[0] == SERVO_MOVE]
    hops.arrived += [(event.arrival_ns, event.data) for event in events]
    return hops


def measure(trial: ArmTrial, seconds: float, carriers: Carriers, say: Callable[[str], None]) -> list[Row]:
    """All of it; the trial is settled again."""
    say("the stream")
    trial.follow(0.5)
    rows = watch(trial, seconds, carriers).rows()
    trial.settle()
    say("follow")
    rows.append(_reached(trial))
    trial.settle()
    return rows


def _reached(trial: ArmTrial) -> Row:
    """A goal that moves at a steady rate, in steps of a fraction of a pulse."""
    trial.robot.arm.move({"base": 0.8})
    begun_s = time.monotonic()
    legs = trial.board.joint_legs()
    while (t_s := time.monotonic() - begun_s) < FOLLOW_S:
        trial.robot.arm.follow({"base": 0.8 - FOLLOW_RADPS * t_s})
        time.sleep(0.02)
    track = [leg for leg in trial.board.joint_track(legs) if leg.servo == 1 and leg.end_ns > leg.begin_ns]
    first, last = track[len(track) // 4], track[-2]
    reached = (first.begin - last.begin) / PULSES_PER_RAD / ((last.begin_ns - first.begin_ns) * 1e-9)
    off = reached / FOLLOW_RADPS - 1
    told = f"{reached:.4f} rad/s ({off:+.1%})"
    return Row("follow at 0.3 rad/s: reached speed", told, "within 2 %", abs(off) <= 0.02, {"radps": reached})
