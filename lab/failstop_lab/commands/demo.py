"""`failstop demo`: simulated board, service, a drive, then a program and every process killed while driving, judged by
the board."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace

from failstop import helpers
from failstop.cli import style
from failstop.cli.style import FAIL, OK, PLAIN, STRONG, paint
from failstop.messages import layout
from failstop.policy.settings import Settings
from failstop.ros2.command import find_rclpy
from failstop.setup.ending import interruptible
from failstop_lab.boards.traits import traits_of
from failstop_lab.sim.options import add_board
from failstop_lab.trial import AFTERMATH_S, LOG_CHARACTERS, Stopped, Trial, judge, wait_for

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.cli.style import Span

LATE_MS = 50.0
"""A stop that takes longer than this fails the demo. The bar is generous, because machines may be slow and busy;
`make bench` has the real bars."""

STRIKES = 3
"""How often a kill is tried at most, because one that found the wheels at rest shows nothing."""
STEP_COLUMNS = 28
MEANING = (
    "All times are counted from the kill and measured on the board's side of the wire: when the first stop frame "
    "arrived, and when the board had set the last wheel to zero. The ROS driver that failstop replaces took 130 ms. "
    "The demo restarts a dead supervisor, as systemd does on a robot."
)
PROGRAM = "your program"
PROGRAM_S = 60
"""How long it would drive if nobody killed it."""

SETTINGS = {"incidents.save": "off"}
"""An incident is still being saved two seconds after its stop, and the demo kills the next process within one: its
times are those of a service that has nothing else to do, as a robot's has at nearly every moment."""
ORDER = (layout.GATE, layout.PORT_OWNER, layout.TELEMETRY, layout.STOPPER, layout.SUPERVISOR)


EXAMPLES = f"""\
failstop demo                # exit code 1: a stop came after {LATE_MS:g} ms or never
failstop demo --rounds 5
failstop demo --board hoverboard
failstop demo --ros2         # also with ROS 2 nodes; needs rclpy
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop demo`."""
    parser.add_argument("--ros2", action="store_true", help="also let ROS 2 nodes drive, and kill their bridge")
    add_board(parser)
    parser.add_argument(
        "--rounds", type=int, default=1, metavar="N", help="how often to kill each process (default: 1)"
    )


class Row:
    """One kill as the table shows it."""

    def __init__(
        self, process: str, stopped: Stopped, restart_s: float | None = None, late_ms: float = LATE_MS
    ) -> None:
        self.process = process
        self.stopped = stopped
        self.restart_s = restart_s
        self.late_ms = late_ms

    def fault(self) -> str:
        """The fault; empty when the stop was in time and final."""
        found = self.stopped
        if not found.was_turning:
            return "the wheels were not turning"
        if found.stop_ns is None or found.still_ns is None:
            return "NO STOP"
        if found.stop_ns > self.late_ms * 1e6:
            return "LATE"
        return f"{found.motion_after} motion frames after the stop" if found.motion_after else ""


def main(arguments: Namespace) -> int:
    """Run the demo; exit code 1 when any stop was missing or late, or anything moved after it."""
    if arguments.ros2:
        find_rclpy()
    print(paint("failstop demo", STRONG) + ": a simulated motor board, which keeps its last wheel speed forever\n")
    _step("board and service start")
    with interruptible(), Trial(f"demo-{os.getpid()}", kind=arguments.board, settings=SETTINGS) as trial:
        first = next(event for event in trial.board.events() if event.is_stop)
        _done(f"first stop frame {(first.arrival_ns - trial.service.started_ns) / 1e6:.0f} ms after exec")
        _step("enable")
        _done(trial.robot.enable())
        limits = Settings(traits_of(arguments.board).settings)
        _show_drive(trial, *(limits[f"limits.{axis}"] for axis in ("vx_mps", "vy_mps", "wz_radps")))
        fast = limits["limits.vx_mps"]
        rows = [_kill(trial, process, fast) for _ in range(arguments.rounds) for process in (PROGRAM, *ORDER)]
        rows += _ros2(trial) if arguments.ros2 else []
        _step("disable, end the service")
        trial.enable()
        _done(trial.robot.disable())
        trial.leave()
        code = trial.service.end()
        said = trial.service.said()
    return judged(rows, code, said)


def judged(rows: list[Row], code: int, said: str) -> int:
    """Show the table, and what was wrong; returns the exit code. `code`, `said`: the service's own, and its words."""
    faults = [fault for row in rows if (fault := row.fault())]
    if code:
        faults.append(f"the service ended with exit code {code}; its last output:")
    _table(rows)
    if faults:
        _paragraph(("FAILED: ", FAIL), ("; ".join(faults), PLAIN))
        if code:
            print(said[-LOG_CHARACTERS:].strip())
        return 1
    _paragraph(("Every kill led to a stop, and nothing moved again until the next enable.", OK))
    return 0


def _ros2(trial: Trial) -> list[Row]:
    """ROS 2 nodes drive by the bridge, and what happens to them."""
    from failstop_lab import ros2_demo as demo

    trial.leave()

    def said(what: str, result: str) -> None:
        _step(what)
        _done(result)

    return [Row(what, stopped, None, late_ms) for what, stopped, late_ms in demo.rows(trial, said)]


def _step(what: str) -> None:
    sys.stdout.write(f"  {what} ".ljust(STEP_COLUMNS, ".") + " ")
    sys.stdout.flush()


def _done(result: str) -> None:
    print(result)


def _paragraph(*spans: Span) -> None:
    print()
    style.show(style.wrap(list(spans), style.width(), 0))


def _show_drive(trial: Trial, vx_mps: float, vy_mps: float, wz_radps: float) -> None:
    """Drive forward, sideways and turning, as fast as the settings allow, and show what the wheels do."""
    for what, velocity in (
        (f"forward {vx_mps:g} m/s", (vx_mps, 0, 0)),
        (f"left {vy_mps:g} m/s", (0, vy_mps, 0)),
        (f"turn {wz_radps:g} rad/s", (0, 0, wz_radps)),
    ):
        _step(f"drive {what}")
        trial.drive(0.9, velocity)
        wheels = " ".join(f"{speed:+.2f}" for speed in trial.board.wheels())
        _done(f"wheels {wheels} rps")
        trial.drive(0.1, (0, 0, 0))


def _kill(trial: Trial, process: str, vx_mps: float) -> Row:
    """Kill it while the wheels turn. A stop may come before the kill on a busy machine: then it is done again."""
    for _ in range(STRIKES):
        _step(f"kill -9 {process}")
        row = _killed_program(trial, vx_mps) if process == PROGRAM else _killed(trial, process)
        if row.stopped.was_turning:
            break
        _done(f"the wheels were not turning ({_why(trial)}), so this kill shows nothing")
    if fault := row.fault():
        _done(paint(fault, FAIL))
    else:
        _done(paint(f"stop frame after {(row.stopped.stop_ns or 0) / 1e6:.2f} ms", OK) + f", {_why(trial)}")
    return row


def _killed(trial: Trial, process: str) -> Row:
    trial.enable()
    pid = trial.service.pids()[process]
    # A fault at a random moment of the 20 ms tick, and fast enough that every wheel turns.
    stopped = trial.kill(process, 0.3 + time.monotonic_ns() % 20_000_000 / 1e9)
    return Row(process, stopped, trial.recover(process, pid))


def _killed_program(trial: Trial, vx_mps: float) -> Row:
    """The program that drives is a process of its own; once it is dead, the trial's client commands in its place."""
    trial.enable()
    trial.leave()
    drive = helpers.python("failstop", "drive", "--name", trial.name, f"{vx_mps}", "0", "0", "--for", f"{PROGRAM_S}")
    program = subprocess.Popen(drive, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for("the program to drive", trial.turning)
        time.sleep(0.3 + time.monotonic_ns() % 20_000_000 / 1e9)
        trial.board.events()
        was_turning, fault_ns = trial.turning(), time.monotonic_ns()
        program.send_signal(signal.SIGKILL)
        trial.drive(AFTERMATH_S)
    finally:
        program.kill()
        program.wait()
    return Row(PROGRAM, judge(trial.board.events(), fault_ns, was_turning))


def _why(trial: Trial) -> str:
    """The latch as the service tells it; a service that was itself restarted starts disabled, with nothing latched."""
    trial.leave()
    state = trial.robot.state
    return f"latched: {state.estop}" if state.estop else f"blocked: {state.blocked}"


def _table(rows: list[Row]) -> None:
    columns = max(12, *(len(row.process) for row in rows))
    head = f"{'killed':<{columns}} {'first stop frame':>17} {'last wheel at zero':>19} {'motion after':>13}"
    head += f" {'restarted':>10}"
    print("\n" + paint(head, STRONG))
    for row in rows:
        found = row.stopped
        print(
            f"{row.process:<{columns}} {_ms(found.stop_ns):>17} {_ms(found.still_ns):>19} {found.motion_after:>13}"
            f" {'-' if row.restart_s is None else f'{row.restart_s:.2f} s':>10}"
        )
    _paragraph((MEANING, PLAIN))


def _ms(ns: int | None) -> str:
    return "never" if ns is None else f"{ns / 1e6:.2f} ms"
