"""Latencies of the living service: stop request, command, start."""

from __future__ import annotations

import random
import time
from collections.abc import Callable

from bench import stats
from failstop_lab.faults.crowd import Nobody
from failstop_lab.sim.client import Event
from failstop_lab.trial import LOG_CHARACTERS, Trial, TrialError


def _until(trial: Trial, since_ns: int, answers: Callable[[Event], bool]) -> int:
    """Time in ns from `since_ns` to the arrival of the first frame after it that answers. Raises TrialError, with what
    the service tells of itself."""
    try:
        event = trial.board.wait_for(lambda found: found.arrival_ns >= since_ns and answers(found), 5.0)
    except TimeoutError as error:
        state = trial.robot.state
        told = (
            f"enabled: {state.enabled}, estop: {state.estop}, blocked: {state.blocked}, waits for: {state.waiting_for}"
        )
        raise TrialError(f"{error}\n{told}\n{trial.service.said()[-LOG_CHARACTERS:]}") from None
    return event.arrival_ns - since_ns


def stop_requests(trial: Trial, count: int, seed: int, progress: Callable[[str], None]) -> stats.Row:
    """A stop request by an unprivileged client, from the call to the board."""
    chance = random.Random(seed)
    samples = []
    nobody = Nobody(trial.name, "bench")
    try:
        for turn in range(count):
            progress(f"stop requests, {turn + 1} of {count}")
            trial.enable()
            trial.drive(chance.uniform(0.06, 0.12))
            trial.board.events()
            samples.append(_until(trial, nobody.ask(), lambda event: event.is_stop))
            time.sleep(0.15)
    finally:
        nobody.end()
    return stats.timing("stop request by an unprivileged client -> stop frame", samples, p50_ms=0.5, p99_ms=2.0)


def first_commands(trial: Trial, count: int, seed: int, progress: Callable[[str], None]) -> stats.Row:
    """drive() after a pause to the first motor frame that moves a wheel."""
    chance = random.Random(seed)
    samples = []
    trial.enable()
    for turn in range(count):
        progress(f"first commands, {turn + 1} of {count}")
        time.sleep(chance.uniform(0.36, 0.40))
        trial.board.events()
        trial.robot.sensed()
        commanded_ns = time.monotonic_ns()
        trial.robot.drive(0.1, 0.0, 0.0)
        samples.append(_until(trial, commanded_ns, lambda event: event.is_motion))
    return stats.timing("drive() -> motor frame, first command", samples, p50_ms=0.5, p99_ms=2.0)


def direction_changes(trial: Trial, count: int, seed: int, progress: Callable[[str], None]) -> stats.Row:
    """drive() the other way to the first motor frame that is slower."""
    chance = random.Random(seed)
    samples = []
    trial.enable()
    for turn in range(count):
        progress(f"changes of direction, {turn + 1} of {count}")
        trial.drive(chance.uniform(0.18, 0.22), (0.05, 0.0, 0.0))
        before = trial.board.wheels()[0]
        trial.board.events()
        commanded_ns = time.monotonic_ns()
        trial.robot.drive(-0.05, 0.0, 0.0)
        samples.append(_until(trial, commanded_ns, lambda event, was=before: event.is_motor and event.speeds[0] < was))  # type: ignore[misc]
        trial.drive(0.1, (0.0, 0.0, 0.0))
    trial.robot.disable()
    return stats.timing("drive() -> motor frame, change of direction", samples, p50_ms=0.5, p99_ms=2.0)


def starts(trial: Trial, count: int, progress: Callable[[str], None]) -> stats.Row:
    """exec of `failstop run` to the first stop frame on the wire."""
    samples = []
    for turn in range(count):
        progress(f"starts, {turn + 1} of {count}")
        trial.leave()
        trial.service.end()
        trial.board.events()
        trial.service.start()
        since = trial.service.started_ns
        event = next(e for e in trial.board.events() if e.is_stop and e.arrival_ns >= since)
        samples.append(event.arrival_ns - since)
    row = stats.timing("exec of `failstop run` -> first stop frame", samples, p50_ms=None, p99_ms=None)
    row.bar, row.met = "max < 150 ms", row.numbers["max_ms"] < 150
    return row


def command_timeouts(trial: Trial, count: int, seed: int, progress: Callable[[str], None]) -> stats.Row:
    """The last drive() to the frame that stops the wheels: the deadman."""
    chance = random.Random(seed)
    samples = []
    trial.enable()
    for turn in range(count):
        progress(f"command timeouts, {turn + 1} of {count}")
        trial.drive(chance.uniform(0.05, 0.08))
        trial.robot.sensed()
        trial.board.events()
        commanded_ns = time.monotonic_ns()
        trial.robot.drive(0.1, 0.0, 0.0)
        samples.append(_until(trial, commanded_ns, lambda event: event.is_motor and not any(event.speeds)))
    trial.robot.disable()
    return timeout_row(samples)


def timeout_row(samples: list[int]) -> stats.Row:
    """Row of the command timeout: as long as it should be, and little longer."""
    row = stats.timing("last drive() -> zero frame (command timeout 0.3 s)", samples, p50_ms=None, p99_ms=None)
    row.numbers["min_ms"] = min(samples, default=0) / 1e6
    row.result = f"min {row.numbers['min_ms']:.1f}  {row.result}"
    row.bar = "300 to 320 ms"
    row.met = row.numbers["min_ms"] >= 300 and row.numbers["max_ms"] <= 320
    return row
