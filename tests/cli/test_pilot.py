"""Keys and what they do to the robot, by a robot that writes down what it is asked."""

from __future__ import annotations

import dataclasses
import threading
from typing import Any, cast

import pytest

from failstop.api.errors import NoAnswer, NoService, Refused
from failstop.api.robot import Robot
from failstop.api.snapshot import Device
from failstop.cli import style
from failstop.cli.commands.teleop import Pilot
from failstop.cli.screen.keys import ENDS_S, SPACE
from failstop.cli.style import FAIL, WARN
from failstop.policy.joints import from_settings
from failstop.policy.settings import Settings
from tests.support.states import arm, driving, latched, process, state

ENABLED = driving(sources=(), body_vel=(0.0, 0.0, 0.0), wheels_radps=(0.0, 0.0, 0.0, 0.0), blocked="cmd timeout")
RIVAL = driving()
FULL = (0.2, 0.2, 1.0)
ZERO = (0.0, 0.0, 0.0, "cmd_vel")


class Scribe:
    """A stand-in for the robot."""

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.answer: Exception | None = None
        self.state: Any = ENABLED

    def drive(self, vx: float, vy: float, wz: float, *, manual: bool, source: str) -> None:
        assert manual
        self.asked.append((round(vx, 3), round(vy, 3), round(wz, 3), source))

    def estop(self, reason: str) -> None:
        self.asked.append("estop")

    def enable(self, progress: Any = None) -> str:
        return self._ask("enable")

    def disable(self) -> str:
        return self._ask("disable")

    def reset(self) -> str:
        return self._ask("reset")

    def _ask(self, what: str) -> str:
        self.asked.append(what)
        if self.answer:
            raise self.answer
        return f"{what} done"


@pytest.fixture
def scribe() -> Scribe:
    return Scribe()


@pytest.fixture
def pilot(scribe: Scribe) -> Pilot:
    return Pilot(cast("Robot", scribe), "cmd_vel", FULL)


def press(pilot: Pilot, *names: str, late: bool = False, now_s: float = 1.0, seen: Any = ENABLED) -> None:
    pilot.keys(list(names), seen, now_s, late=late)


def test_the_screen_shows_keys_command_and_state(pilot: Pilot) -> None:
    press(pilot, "w")
    pilot.note = ("a note", "")
    said = shown(pilot.lines(latched(), 1.1, 80))
    parts = ("w s  \u2191 \u2193", "STOP, latched", "keys      held", "0.10 m/s forward", "50 %", "STOPPED", "12.00 V")
    assert [part for part in (*parts, "a note", "a tap drives") if part not in said] == []


@pytest.mark.parametrize("slides", [True, False])
def test_the_screen_offers_no_key_that_the_base_can_not_obey(scribe: Scribe, slides: bool) -> None:
    pilot = Pilot(cast("Robot", scribe), "cmd_vel", (FULL[0], FULL[1] * slides, FULL[2]))
    said = shown(pilot.lines(ENABLED, 1.0, 80))
    assert ("slide left, right" in said) is slides
    assert "r      reset a latched stop" in said


def test_the_screen_says_what_helps_against_a_jerk(pilot: Pilot) -> None:
    for now_s in (1.0, 1.5, 1.53):
        assert "kbdrate" not in shown(pilot.lines(ENABLED, now_s, 80))
        press(pilot, "w", now_s=now_s)
    said = " ".join(shown(pilot.lines(ENABLED, 1.54, 80)).split())
    assert "`xset r rate 200 30`" in said
    assert "`sudo kbdrate -d 250 -r 30`" in said


def test_the_screen_shows_an_arm_only_where_there_is_one(pilot: Pilot) -> None:
    found = arm("base", "wrist", mode="jog", by="failstop teleop")
    for name, told in (("base", {"commanded_rad": 0.5}), ("wrist", {"angle_rad": None, "commanded_rad": None})):
        found.joints[name] = dataclasses.replace(found.joints[name], **told)  # type: ignore[arg-type]

    def screen(joint: int, **changed: Any) -> str:
        pilot.joint = joint
        return shown(pilot.lines(state(**changed), 1.0, 80))

    said = screen(0, arm=found)
    for part in ("turn the chosen joint", "1 - 2", "jog for failstop teleop", "1 base: +0.50 rad"):
        assert part in said
    assert "2 wrist: not read yet" in screen(1, arm=found)
    assert "wheels enabled" in screen(1, arm=dataclasses.replace(found, closed="wheels enabled"))
    assert "joint" not in screen(0)


def shown(lines: list[style.Line]) -> str:
    assert len(lines) <= 23
    assert all(style.cells(style.plain(line)) <= 80 for line in lines)
    return "\n".join(map(style.plain, lines))


def test_speeds_are_parts_of_the_full_ones(pilot: Pilot, scribe: Scribe) -> None:
    press(pilot, "w")
    press(pilot, "+", "a")
    assert scribe.asked == [(0.1, 0.0, 0.0, "cmd_vel"), (0.0, 0.0, 0.6, "cmd_vel")]
    assert "60 %: 0.12 m/s, 0.60 rad/s" in shown(pilot.lines(ENABLED, 1.2, 80))
    assert "command   0.60 rad/s turning left" in shown(pilot.lines(ENABLED, 1.2, 80))
    assert "command   none" in shown(pilot.lines(ENABLED, 1.5, 80))


@pytest.mark.parametrize(
    ("names", "late", "asked"),
    [
        (("w", "e", SPACE), False, ["estop"]),
        (("w", SPACE), True, ["estop"]),
        (("e", "w", "r", "+"), True, [ZERO]),
        (("q",), True, [ZERO]),
        (("x",), False, [ZERO]),
    ],
)
def test_the_stop_goes_first_and_of_what_is_late_only_what_stops_counts(
    pilot: Pilot, scribe: Scribe, names: tuple[str, ...], late: bool, asked: list[Any]
) -> None:
    press(pilot, "w")
    scribe.asked.clear()
    press(pilot, *names, late=late)
    assert (scribe.asked, pilot.leaving, pilot.hold.active) == (asked, names == ("q",), False)


@pytest.mark.parametrize("text", ["screwdriver", "er", "wr", "e\r"])
def test_a_word_that_comes_at_once_resets_enables_and_drives_nothing(pilot: Pilot, scribe: Scribe, text: str) -> None:
    """Pasted, at a terminal that does not mark what is pasted."""
    press(pilot, *text, seen=latched())
    assert scribe.asked == []
    assert "several keys came at once" in pilot.note[0]
    press(pilot, "r", seen=latched())
    assert scribe.asked == [ZERO, "reset"] or scribe.asked == ["reset"]
    press(pilot, *text, SPACE)
    assert scribe.asked[-1] == "estop"
    press(pilot, *text, "q")
    assert pilot.leaving


def test_beside_another_publisher_not_even_a_zero_goes_out(pilot: Pilot, scribe: Scribe) -> None:
    press(pilot, "w")
    scribe.asked.clear()
    press(pilot, now_s=1.0 + ENDS_S, seen=RIVAL)
    press(pilot, "w", now_s=1.5, seen=RIVAL)
    assert scribe.asked == []
    assert pilot.note == ("nav (pid 42) drives as cmd_vel: end it, or use --source with another one", WARN)
    press(pilot, "w", now_s=2.0)
    assert scribe.asked == [(0.1, 0.0, 0.0, "cmd_vel")]
    assert pilot.note[0] == ""


def test_another_source_is_no_rival(scribe: Scribe) -> None:
    pilot = Pilot(cast("Robot", scribe), "teleop", FULL)
    press(pilot, "w", seen=RIVAL)
    assert scribe.asked == [(0.1, 0.0, 0.0, "teleop")]


@pytest.mark.parametrize(("seen", "said"), [(state(), "e enables it"), (latched(), "r resets it")])
def test_nothing_is_commanded_while_it_could_not_move(pilot: Pilot, scribe: Scribe, seen: Any, said: str) -> None:
    press(pilot, "w", seen=seen)
    assert scribe.asked == []
    assert said in pilot.note[0]


def test_what_was_held_through_a_stop_drives_nothing_after_it(pilot: Pilot, scribe: Scribe) -> None:
    press(pilot, "w")
    scribe.asked.clear()
    press(pilot, now_s=1.1, seen=state())
    press(pilot, now_s=1.2)
    assert scribe.asked == [ZERO]


def test_a_refusal_is_a_note_and_a_service_that_has_gone_is_the_end(pilot: Pilot, scribe: Scribe) -> None:
    scribe.answer = Refused("arm is not in the drive pose")
    press(pilot, "e", seen=state())
    assert pilot.note == ("refused: arm is not in the drive pose", FAIL)
    scribe.answer = NoService("gone")
    with pytest.raises(NoService):
        press(pilot, "e", seen=state())


def told(pilot: Pilot, seen: Any) -> str:
    press(pilot, seen=seen)
    *_, line, _how = pilot.lines(seen, 1.0, 200)
    return style.plain(line)


DIED = "the service has died: if a wheel turns, use the POWER SWITCH; q leaves"
LATCHED = "a stop is latched: {}r resets it, then e enables motion"


def down(*names: str) -> Any:
    base = state()
    return {name: process(state="down" if name in names else "running", pid=0) for name in base.processes}


@pytest.mark.parametrize(
    ("seen", "line"),
    [
        (state(), "motion is disabled: e enables it"),
        (state(waiting_for="the port"), "motion is disabled: wait for the port, then e enables it"),
        (ENABLED, ""),
        (RIVAL, ""),
        (latched(), LATCHED.format("")),
        (latched(processes=down("gate"), waiting_for="gate"), LATCHED.format("wait for gate, then ")),
        (latched(processes=down("telemetry"), waiting_for="telemetry"), LATCHED.format("")),
        (latched(device=Device("/dev/ttyACM0", "lost", "alive")), LATCHED.format("plug the board in, then ")),
        (latched(processes={"supervisor": process(state="dead")}), DIED),
    ],
)
def test_the_line_says_what_holds_the_wheels_now(pilot: Pilot, seen: Any, line: str) -> None:
    assert told(pilot, seen) == line


def test_what_came_of_a_key_is_told_until_the_state_changes(pilot: Pilot) -> None:
    assert "e enables it" in told(pilot, state())
    press(pilot, "e", seen=state())
    assert told(pilot, ENABLED) == "enable done"
    assert told(pilot, ENABLED) == "enable done"
    assert told(pilot, state()) == "motion is disabled: e enables it"
    assert told(pilot, ENABLED) == ""


def test_motion_that_it_enabled_is_disabled_at_the_end(pilot: Pilot, scribe: Scribe) -> None:
    press(pilot, "e", seen=state())
    press(pilot, "q")
    assert pilot.leave() == "disable done"
    assert scribe.asked == ["enable", "disable"]
    scribe.answer = NoService("gone")
    assert pilot.leave() == "the service can't be told (gone); the command timeout stops the wheels"


def test_motion_that_somebody_else_enabled_stays_enabled(pilot: Pilot, scribe: Scribe) -> None:
    press(pilot, "e")
    assert pilot.note[0] == "motion is enabled already"
    press(pilot, "w")
    press(pilot, "q")
    assert pilot.leave() == STAYS
    assert scribe.asked == [(0.1, 0.0, 0.0, "cmd_vel"), ZERO]
    scribe.state = state()
    assert pilot.leave() == "motion is disabled"


STAYS = "motion stays enabled, as it was before"


@pytest.mark.parametrize(
    ("answer", "seen", "told"),
    [
        (None, (ENABLED, latched(), ENABLED), STAYS),  # somebody else enabled it after that stop
        (Refused("arm is not in the drive pose"), (ENABLED,), STAYS),
        (NoAnswer("the gate did not answer"), (), "disable done"),
    ],
)
def test_an_enable_is_taken_back_where_motion_may_be_its_own(
    pilot: Pilot, scribe: Scribe, answer: Exception | None, seen: tuple[Any, ...], told: str
) -> None:
    scribe.answer = answer
    press(pilot, "e", seen=state())
    scribe.answer = None
    for found in seen:
        press(pilot, seen=found)
    assert (pilot.leave(), scribe.asked[0]) == (told, "enable")


class WithArm(Scribe):
    """A robot with an arm; to enable it takes until it is let."""

    def __init__(self) -> None:
        super().__init__()
        self.arm = self
        self.joints = {joint.name: joint for joint in from_settings(Settings({"joints.base.servo": 1}))}
        self.state = arm("base")
        self.let = threading.Event()

    def jog(self, rates: dict[str, float]) -> None:
        self.asked.append({name: round(rate, 3) for name, rate in rates.items()})

    def enable(self, progress: Any = None) -> str:
        progress("on its way")
        self.let.wait(10)
        return self._ask("enable")

    def answer_enable(self, pilot: Pilot) -> None:
        self.let.set()
        assert pilot.enabling
        pilot.enabling.join(10)


ARM = state(arm=arm("base"))


@pytest.fixture
def armed() -> tuple[WithArm, Pilot]:
    scribe = WithArm()
    return scribe, Pilot(cast("Robot", scribe), "cmd_vel", FULL)


def test_digits_choose_a_joint_and_brackets_turn_it_while_they_are_held(armed: tuple[WithArm, Pilot]) -> None:
    scribe, pilot = armed
    press(pilot, "\u00b2", "1", "]", "[", seen=ARM)
    assert scribe.asked == [{"base": 0.5}, {"base": -0.5}]
    press(pilot, "]", seen=ARM, late=True)
    assert scribe.asked[2:] == [], "what was typed a while ago turns nothing"


def test_with_an_arm_the_space_key_stops_while_enabling_takes_its_time(armed: tuple[WithArm, Pilot]) -> None:
    scribe, pilot = armed
    press(pilot, "e", seen=ARM)
    press(pilot, SPACE, seen=ARM)
    assert scribe.asked == ["estop"]
    scribe.answer_enable(pilot)
    assert scribe.asked == ["estop", "enable"]


def test_with_an_arm_an_enable_that_is_under_way_is_given_up_at_the_end(armed: tuple[WithArm, Pilot]) -> None:
    scribe, pilot = armed
    press(pilot, "e", seen=ARM)
    for _ in range(3):
        press(pilot, seen=ARM)
    assert pilot.leave() == "disable done"
    scribe.answer_enable(pilot)


def test_with_an_arm_a_state_of_before_the_answer_takes_nothing_away(armed: tuple[WithArm, Pilot]) -> None:
    """The state was read before the thread heard that motion is enabled."""
    scribe, pilot = armed
    press(pilot, "e", seen=ARM)
    press(pilot, seen=ARM)
    scribe.answer_enable(pilot)
    press(pilot, seen=ARM)
    press(pilot)
    assert pilot.leave() == "disable done"
