"""The demo of the bridge: a node drives, a second one latches, the bridge is killed, each judged by the board."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

from failstop.ros2.stage import StageProcess, bridge, publisher
from failstop_lab.trial import Stopped, Trial, judge, wait_for

CONNECTED_S = 15.0
SEEN_S = 10.0
"""How long DDS may take to let a new node be seen: 0.3 to 3.5 s."""
MOVED_S = 0.3

Row = tuple[str, Stopped, float]
"""The fault, the board's view of it, and how many ms later it is too late."""


def rows(trial: Trial, said: Callable[[str, str], None]) -> Iterator[Row]:
    """The three of them; `said` is told of each step and its result. Raises TrialError."""
    with contextlib.ExitStack() as rest:
        found = rest.enter_context(bridge(trial.name))
        _connected(trial)
        rest.enter_context(publisher("lidar", "scan"))
        _enabled(trial)
        with publisher("nav", "0.2") as driver:
            _moving(trial)
            said("node /nav publishes cmd_vel", f"wheels {trial.board.wheels()[0]:+.2f} rps")
            trial.board.events()
            told_ns = time.monotonic_ns()
            driver.end()
            row = _judged(trial, told_ns)
        yield "cmd_vel node ends", row, 600.0
        _enabled(trial)
        with publisher("nav", "0.2"):
            _moving(trial)
            trial.board.events()
            with publisher("joystick", "-0.2", 100.0) as second:
                row = _second(trial, second)
                said("node /joystick does too", trial.robot.state.estop or "nothing is latched")
        yield "a second one joins", row, SEEN_S * 1000
        wait_for("both to leave", lambda: _sees(trial, "nobody publishes cmd_vel"), SEEN_S)
        _enabled(trial)
        with publisher("nav", "0.2"):
            _moving(trial)
            trial.board.events()
            killed_ns = time.monotonic_ns()
            found.kill()
            row = _judged(trial, killed_ns)
            said("kill -9 the bridge", "the wheels stand, motion is disabled")
        yield "the bridge is killed", row, 50.0


def _sees(trial: Trial, text: str) -> bool:
    return any(text in client.sees for client in trial.robot.state.clients)


def _connected(trial: Trial) -> None:
    wait_for("the bridge to connect", lambda: _sees(trial, "cmd_vel"), CONNECTED_S)


def _enabled(trial: Trial) -> None:
    """Motion is enabled while nobody commands: a node that commanded just now would be held."""
    wait_for("nobody to command", lambda: all(it.state == "silent" for it in trial.robot.state.sources), SEEN_S)
    trial.enable()


def _moving(trial: Trial) -> None:
    wait_for("the node to be seen", lambda: _sees(trial, "cmd_vel: /nav; scan: /lidar"), SEEN_S)
    wait_for("the wheels to turn", trial.turning, SEEN_S)
    time.sleep(MOVED_S)


def _second(trial: Trial, second: StageProcess) -> Stopped:
    joined_ns = int(second.line())
    wait_for("the latch", lambda: bool(trial.robot.state.estop), SEEN_S)
    return _judged(trial, joined_ns)


def _judged(trial: Trial, fault_ns: int) -> Stopped:
    """The board's view, once its wheels stand."""
    wait_for("the wheels to stand", lambda: not trial.turning(), SEEN_S)
    time.sleep(MOVED_S)
    return judge(trial.board.events(), fault_ns, was_turning=True)


__all__ = ["Row", "rows"]
