"""`failstop demo`: simulated board, service, a drive, then every process killed while driving, judged by the board."""

from __future__ import annotations

import os
import sys
import time
from argparse import ArgumentParser, Namespace

from failstop.shm import layout
from failstop.trial import Stopped, Trial

LATE_MS = 50.0
"""A stop later than this fails the demo: generous, for slow and busy machines; `make bench` has the real bars."""

ORDER = (layout.GATE, layout.PORT_OWNER, layout.TELEMETRY, layout.STOPPER, layout.SUPERVISOR)


EXAMPLES = """\
failstop demo                # exit code 1 if any stop was missing or late
failstop demo --rounds 5
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop demo`."""
    parser.add_argument("--rounds", type=int, default=1, help="how often each process is killed (default: 1)")


class Paint:
    """Colours where they are wanted: on a terminal, and NO_COLOR not set."""

    def __init__(self) -> None:
        self._on = sys.stdout.isatty() and "NO_COLOR" not in os.environ

    def __call__(self, code: str, text: str) -> str:
        return f"\x1b[{code}m{text}\x1b[0m" if self._on else text


class Row:
    """One kill as the table shows it."""

    def __init__(self, process: str, stopped: Stopped, restart_s: float) -> None:
        self.process = process
        self.stopped = stopped
        self.restart_s = restart_s

    def fault(self) -> str:
        """What went wrong; empty when the stop was in time and final."""
        found = self.stopped
        if not found.was_moving:
            return "the wheels were not turning"
        if found.stop_ns is None or found.still_ns is None:
            return "NO STOP"
        if found.stop_ns > LATE_MS * 1e6:
            return "LATE"
        return f"{found.motion_after} motion frames after the stop" if found.motion_after else ""


def main(arguments: Namespace) -> int:
    """Run the demo; exit code 1 when any stop was missing or late, or anything moved after it."""
    paint = Paint()
    print(paint("1", "failstop demo") + ": a simulated motor board that keeps its last wheel speed for ever\n")
    _step("board and service start")
    with Trial(f"demo-{os.getpid()}") as trial:
        first = next(event for event in trial.board.events() if event.is_stop)
        _done(f"first stop frame {(first.arrival_ns - trial.service.started_ns) / 1e6:.0f} ms after exec")
        _step("enable")
        _done(trial.robot.enable())
        _show_drive(trial, paint)
        rows = [_kill(trial, process, paint) for _ in range(arguments.rounds) for process in ORDER]
        _step("disable and stop the service")
        trial.enable()
        _done(trial.robot.disable())
        trial.leave()
        code = trial.service.end()
    faults = [fault for row in rows if (fault := row.fault())]
    if code:
        faults.append(f"the service ended with exit code {code}")
    _table(rows, paint)
    if faults:
        print(paint("1;31", "\nFAILED: ") + "; ".join(faults))
        return 1
    print(paint("1;32", "\nEvery kill was answered by a stop, and nothing moved again before the next enable."))
    return 0


def _step(what: str) -> None:
    sys.stdout.write(f"  {what} ".ljust(34, ".") + " ")
    sys.stdout.flush()


def _done(result: str) -> None:
    print(result)


def _show_drive(trial: Trial, paint: Paint) -> None:
    """Drive forward, sideways and turning, and show what the wheels do."""
    for what, velocity in (
        ("forward 0.2 m/s", (0.2, 0, 0)),
        ("left 0.2 m/s", (0, 0.2, 0)),
        ("turn 1 rad/s", (0, 0, 1)),
    ):
        _step(f"drive {what}")
        trial.drive(0.9, velocity)
        wheels = " ".join(f"{speed:+.2f}" for speed in trial.board.wheels())
        _done(paint("36", f"wheels {wheels} rps"))
        trial.drive(0.1, (0, 0, 0))


def _kill(trial: Trial, process: str, paint: Paint) -> Row:
    _step(f"drive, kill -9 {process}")
    trial.enable()
    pid = trial.service.pids()[process]
    # A fault at a random moment of the 20 ms tick, and fast enough that every wheel turns.
    stopped = trial.kill(process, 0.3 + time.monotonic_ns() % 20_000_000 / 1e9)
    row = Row(process, stopped, trial.recover(process, pid))
    if fault := row.fault():
        _done(paint("1;31", fault))
    else:
        _done(paint("32", f"stop frame after {(stopped.stop_ns or 0) / 1e6:.2f} ms") + f", {_why(trial)}")
    return row


def _why(trial: Trial) -> str:
    """The latch as the service tells it; a service that was itself restarted starts disabled, with nothing latched."""
    trial.leave()
    state = trial.robot.state
    return f"latched: {state.estop}" if state.estop else f"blocked: {state.blocked}"


def _table(rows: list[Row], paint: Paint) -> None:
    head = f"{'killed':<12} {'first stop frame':>17} {'last wheel at zero':>19} {'motion after':>13} {'restarted':>10}"
    print("\n" + paint("1", head))
    for row in rows:
        found = row.stopped
        print(
            f"{row.process:<12} {_ms(found.stop_ns):>17} {_ms(found.still_ns):>19} {found.motion_after:>13}"
            f" {row.restart_s:>8.2f} s"
        )
    print(
        "\nMilliseconds from the kill, on the board's side of the wire: arrival of the first stop frame that the board"
        "\nexecutes, and execution of the frame that stops the last wheel (the wire's own 0.6 ms included). The driver"
        "\nthat failstop replaces took 130 ms. A dead supervisor is started anew by the demo, as systemd would."
    )


def _ms(ns: int | None) -> str:
    return "never" if ns is None else f"{ns / 1e6:.2f} ms"
