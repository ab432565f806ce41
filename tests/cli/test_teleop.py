"""`failstop teleop` in a real terminal, the simulated board judging whether the wheels turn."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator

import pytest

from failstop.api.events import EventLog
from failstop.cli.screen.keys import COMMAND_S, ENDS_S
from failstop_lab.trial import Trial, wait_for
from tests.support.commands import FAILSTOP
from tests.support.typist import Typist

IMU_HZ = 110.0
"""The robot is seen still by the samples of a real board."""
REPEAT_S = 0.03
STILL_S = 0.3
"""Nothing moves for so long after a stop."""


@pytest.fixture
def pilot(trial: Trial) -> Iterator[Typist]:
    with Typist.failstop("teleop", "--name", trial.name) as typist:
        typist.wait("e enables it")
        yield typist


def enable(pilot: Typist, trial: Trial) -> None:
    pilot.type(b"e")
    pilot.wait("motion enabled")
    wait_for("motion to be enabled", lambda: trial.robot.state.enabled)
    trial.leave()


def hold(pilot: Typist, key: bytes, seconds: float) -> int:
    """A held key of a terminal that only repeats; returns when its last byte was typed."""
    until_s = time.monotonic() + seconds
    typed_ns = 0
    while time.monotonic() < until_s:
        typed_ns = pilot.type(key)
        pilot.look(REPEAT_S)
        time.sleep(REPEAT_S / 2)
    return typed_ns


def drive(pilot: Typist, trial: Trial) -> int:
    """Enable and hold w until the wheels turn; returns when its last byte was typed."""
    enable(pilot, trial)
    trial.board.events()
    hold(pilot, b"w", 0.3)
    trial.board.wait_for(lambda event: event.is_motion, 5.0)
    return hold(pilot, b"w", 0.1)


def stopped(trial: Trial, since_ns: int) -> None:
    """The wheels were told to stand after that, and stay so. How soon they are is shown in test_keys.py, and in the
    gate's tests."""
    stop = trial.board.wait_for(lambda event: event.is_motor and not any(event.speeds), 10.0)
    while stop.arrival_ns < since_ns:
        since = stop.index + 1
        stop = trial.board.wait_for(lambda event: event.is_motor and not any(event.speeds), 10.0, since)
    trial.board.events()
    time.sleep(STILL_S)
    assert not any(event.is_motion for event in trial.board.events())
    assert not trial.turning()


DIRECTIONS = {b"w": (1, 1, -1, -1), b"s": (-1, -1, 1, 1), b"a": (-1, -1, -1, -1), b"\x1b[C": (1, 1, 1, 1)}
DIRECTIONS |= {b"j": (-1, 1, -1, 1), b"L": (1, -1, 1, -1)}


def test_hold_to_run_and_leave(pilot: Typist, trial: Trial) -> None:
    """Nothing moves before e, a tap is a nudge, every key has its direction, a held one drives, q disables."""
    hold(pilot, b"w", 0.3)
    pilot.wait("motion is disabled: e enables it")
    assert not any(event.is_motion for event in trial.board.events())

    enable(pilot, trial)
    trial.board.events()
    typed_ns = pilot.type(b"\x1b[A")
    trial.board.wait_for(lambda event: event.is_motion, 5.0)
    stopped(trial, typed_ns)
    own = f"failstop teleop (pid {pilot.process.pid})"
    told = [event for event in EventLog(trial.name).read() if event.fields.get("who") == own]
    assert [event.text.partition(":")[0] for event in told if event.kind.startswith("driver")] == [f"{own} let go"]

    def turns(keys: bytes, signs: tuple[int, ...]) -> bool:
        hold(pilot, keys, REPEAT_S)
        moved = [event.speeds for event in trial.board.events() if event.is_motor]
        return any(tuple((speed > 0) - (speed < 0) for speed in speeds) == signs for speeds in moved)

    for keys, signs in DIRECTIONS.items():
        wait_for(f"the wheels to turn as {keys!r} says", lambda keys=keys, signs=signs: turns(keys, signs))  # type: ignore[misc]

    typed_ns = hold(pilot, b"w", 0.3)
    assert pilot.look()
    pilot.wait("0.10 m/s forward")
    stopped(trial, typed_ns)
    pilot.type(b"q")
    assert pilot.end() == 0
    assert "motion disabled" in pilot.raw
    assert pilot.restored()
    assert not trial.robot.state.enabled


def test_scrolling_drives_nothing_and_the_mouse_is_let_go_at_the_end(pilot: Typist, trial: Trial) -> None:
    """A terminal that reports the mouse sends no arrow keys for its wheel."""
    asked = pilot.raw.index("\x1b[?1000h"), pilot.raw.index("\x1b[?1006h")
    enable(pilot, trial)
    trial.board.events()
    for _ in range(10):
        pilot.type(b"\x1b[<64;87;69M")
        pilot.look(REPEAT_S)
    pilot.type(b"q")
    assert pilot.end() == 0
    assert not any(event.is_motion for event in trial.board.events())
    assert min(pilot.raw.index("\x1b[?1000l"), pilot.raw.index("\x1b[?1006l")) > max(asked)


def test_what_somebody_else_enabled_goes_on_when_it_leaves(trial: Trial) -> None:
    trial.enable()
    with Typist.failstop("teleop", "--name", trial.name) as pilot:
        pilot.wait("none held")
        assert "e enables it" not in pilot.screen()
        trial.board.events()
        typed_ns = hold(pilot, b"w", 0.3)
        trial.board.wait_for(lambda event: event.is_motion, 5.0)
        pilot.type(b"q")
        assert pilot.end() == 0
        stopped(trial, typed_ns)
        assert "motion stays enabled, as it was before" in pilot.raw
    assert trial.robot.state.enabled
    trial.drive(0.3)
    assert trial.turning(), "another program drives on"


def test_a_terminal_without_escapes_gets_none(trial: Trial) -> None:
    for words in (["teleop"], ["status", "-w"]):
        with Typist([*FAILSTOP, *words, "--name", trial.name], environ={"TERM": "dumb"}) as typist:
            assert typist.end() == 1
            assert "this command needs a terminal that can draw a screen, but TERM is 'dumb'" in " ".join(
                typist.raw.split()
            )
            assert "\x1b" not in typist.raw


def test_space_latches_at_once(pilot: Typist, trial: Trial) -> None:
    drive(pilot, trial)
    typed_ns = pilot.type(b" ")
    trial.board.wait_for(lambda event: event.is_stop and event.arrival_ns > typed_ns, 5.0)
    pilot.wait("STOPPED  stop latched: stop request: space key (says it is failstop")
    stopped(trial, typed_ns)
    hold(pilot, b"w", 0.2)
    pilot.type(b"e")
    pilot.wait("refused: a stop is latched")
    pilot.type(b"r")
    pilot.wait("latched stop cleared")
    assert not trial.turning()
    pilot.type(b"+")
    pilot.wait("60 %: 0.12 m/s, 0.60 rad/s")
    pilot.type(b"----------")
    pilot.wait("10 %: 0.02 m/s, 0.10 rad/s")


@pytest.mark.parametrize(("key", "end"), [(b"\x03", signal.SIGINT), (b"\x1a", signal.SIGTSTP), (b"", signal.SIGTERM)])
def test_ctrl_c_ctrl_z_and_sigterm_end_it(pilot: Typist, trial: Trial, key: bytes, end: signal.Signals) -> None:
    typed_ns = drive(pilot, trial)
    pilot.type(key) if key else pilot.process.send_signal(end)
    assert pilot.end() == 128 + end
    assert pilot.restored()
    stopped(trial, typed_ns)
    assert not trial.robot.state.enabled


def test_a_terminal_that_goes_away(pilot: Typist, trial: Trial) -> None:
    """The window is closed, the connection is gone: SIGHUP, and every write fails."""
    typed_ns = drive(pilot, trial)
    pilot.hang_up()
    stopped(trial, typed_ns)
    pilot.process.wait(15)
    assert not trial.robot.state.enabled


def test_sigkill(pilot: Typist, trial: Trial) -> None:
    drive(pilot, trial)
    killed_ns = time.monotonic_ns()
    pilot.process.kill()
    stopped(trial, killed_ns)
    assert "died after it had driven" in str(trial.robot.why())


def test_a_hang_stops_by_the_command_timeout_and_what_was_typed_meanwhile_is_old(pilot: Typist, trial: Trial) -> None:
    typed_ns = drive(pilot, trial)
    pilot.process.send_signal(signal.SIGSTOP)
    for _ in range(3):
        pilot.type(b"w")
    stopped(trial, typed_ns)
    trial.board.events()
    pilot.process.send_signal(signal.SIGCONT)

    def answers() -> bool:
        pilot.type(b"+")
        return "50 %" not in pilot.look(0.2)

    wait_for("an answer", answers)
    assert not any(event.is_motion for event in trial.board.events())


def test_another_program_that_drives_is_not_driven_over(pilot: Typist, trial: Trial) -> None:
    """A second publisher of one source would be a latched stop."""
    enable(pilot, trial)
    trial.drive(0.4)

    def press() -> None:
        pilot.type(b"w")
        pilot.look()

    trial.drive(1.0, each=press)
    pilot.wait("drives as cmd_vel: end it")
    assert trial.robot.state.estop is None


def test_refusals_are_said_before_the_screen_changes(trial: Trial) -> None:
    for words, code, said in (
        (["--name", "nobody-here"], 3, "no service named 'nobody-here'"),
        (["--name", trial.name, "--source", "nobody"], 1, "no source 'nobody'"),
    ):
        with Typist.failstop("teleop", *words) as typist:
            assert typist.end() == code
            assert said in typist.raw
            assert "\x1b[?1049h" not in typist.raw


def test_the_end_of_the_service(pilot: Typist, trial: Trial) -> None:
    trial.leave()
    trial.service.end()
    assert pilot.end() == 3
    assert pilot.restored()
    assert "no service named" in pilot.raw


def test_the_hold_ends_after_the_command_timeout() -> None:
    """A zero sent for the end of a hold would otherwise renew a command that still counts."""
    assert ENDS_S > COMMAND_S
