"""The verdict: what the wheels do, why, and what to type next."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from failstop.api import steps, verdict
from failstop.api.snapshot import Block, Client, Device, Source
from failstop.api.steps import Purpose
from failstop.messages import box
from failstop.policy import causes, kinematics
from failstop.policy.settings import Settings
from failstop.procs.gate.core import GateCore
from failstop.procs.gate.sources import Command
from tests.support.states import STILL, driving, latched, process, state, stop

LOST = Device("/dev/ttyACM0", "lost", "unproven")
DEAF = Device("/dev/ttyACM0", "open", "deaf")
UNPROVEN = Device("/dev/ttyACM0", "open", "unproven")
UNASKED = Device("/dev/ttyACM0", "open", "unasked")
NEVER = "unproven: the board has never answered"
STANDING = {"body_vel": (0.0, 0.0, 0.0), "wheels_radps": (0.0, 0.0, 0.0, 0.0), "turning": STILL}
SWITCH = "turn the robot's POWER SWITCH off and on"
PLUG = "plug the board in (/dev/ttyACM0)"
DRIVE = "`failstop drive 0.1 0 0`, or commands by your program"

TABLE: tuple[tuple[Any, str, list[str]], ...] = (
    (state(), verdict.STOPPED, ["`failstop enable`"]),
    (latched(), verdict.STOPPED, ["`failstop reset`", "`failstop enable`"]),
    (driving(), verdict.DRIVING, []),
    (driving(**STANDING), verdict.STANDING, [DRIVE]),
    (driving(blocked="cmd timeout", **STANDING), verdict.STOPPED, [DRIVE]),
    (
        driving(blocked="no scan", **STANDING),
        verdict.STOPPED,
        [
            "start the obstacle sensor and the program that calls robot.sensed(); without an obstacle sensor, set "
            'scan.gate = "off" and restart the service'
        ],
    ),
    (state(waiting_for="gate"), verdict.STOPPED, ["wait for gate", "`failstop enable`"]),
    (
        latched(causes.DEVICE_LOST(), device=LOST, waiting_for="the port"),
        verdict.MAY_TURN,
        [PLUG, "`failstop reset`", "`failstop enable`"],
    ),
    (state(device=LOST, waiting_for="the port"), verdict.MAY_TURN, [PLUG, "`failstop enable`"]),
    (latched(causes.DEAF(), device=DEAF), verdict.MAY_TURN, [SWITCH, "`failstop reset`", "`failstop enable`"]),
    (latched(causes.UNSTILL()), verdict.STOPPED, ["`failstop reset`", "`failstop enable`"]),
    (state(device=UNPROVEN), verdict.STOPPED, ["`failstop enable`"]),
    (
        latched(causes.DIED("gate"), waiting_for="gate", processes={"gate": process(pid=0, state="down")}),
        verdict.STOPPED,
        ["wait for the gate", "`failstop reset`", "`failstop enable`"],
    ),
    (
        latched(causes.DIED("stopper"), waiting_for="stopper", processes={"stopper": process(pid=0, state="down")}),
        verdict.STOPPED,
        ["`failstop reset`", "`failstop enable`"],
    ),
)


@pytest.mark.parametrize(("found", "word", "typed"), TABLE)
def test_the_word_and_the_steps(found: Any, word: str, typed: list[str]) -> None:
    assert verdict.word(found) == word
    assert steps.typed(found) == typed


@pytest.mark.parametrize(("found", "word", "typed"), TABLE)
def test_the_page_begins_with_the_step_that_a_terminal_begins_with(found: Any, word: str, typed: list[str]) -> None:
    todo = steps.todo(found)
    assert [step.typed for step in todo if step.purpose is not Purpose.HEED] == typed
    assert steps.pressed(found) == (todo[0].pressed if todo else "")
    assert "`" not in steps.pressed(found)


def test_what_an_enable_would_be_refused_without_comes_before_it() -> None:
    unmet = state(unmet="the arm is not folded")
    assert steps.typed(unmet) == ["satisfy the interlock (the arm is not folded)", "`failstop enable`"]
    assert steps.pressed(unmet) == "Satisfy the interlock (the arm is not folded)."
    nobody = state(attended_by=(), unmet="the arm is not folded")
    assert [step.purpose for step in steps.todo(nobody)] == [Purpose.ALLOW, Purpose.ALLOW, Purpose.ENABLE]
    assert steps.typed(driving(unmet="the arm is not folded")) == []


@pytest.mark.parametrize(
    ("found", "goal", "begins"),
    [
        (state(), Purpose.ENABLE, ""),  # whatever refused it, the state does not show it: nobody is sent in a circle
        (state(unmet="no"), Purpose.ENABLE, "satisfy that interlock, then `failstop enable`"),
        (state(attended_by=()), Purpose.ENABLE, "have somebody attend"),
        (state(waiting_for="gate"), Purpose.ENABLE, "wait for gate, then"),
        (latched(), Purpose.ENABLE, "`failstop reset`, then `failstop enable`"),
        (latched(), Purpose.RESET, ""),
        (latched(waiting_for="stopper"), Purpose.RESET, ""),
        (latched(causes.DEAF(), device=DEAF), Purpose.RESET, ""),  # a board that was switched off and on needs one
        (latched(device=LOST), Purpose.RESET, "plug the board in"),
    ],
)
def test_a_refusal_names_what_stands_in_its_way_alone(found: Any, goal: Purpose, begins: str) -> None:
    told = steps.after_refusal(found, goal, known=bool(found.unmet))
    assert told.startswith(begins)
    assert bool(told) == bool(begins)


@pytest.mark.parametrize(
    ("found", "told", "large"),
    [
        (state(), "STOPPED", "STOPPED"),
        (state(device=UNPROVEN), f"STOPPED, {NEVER}", "STOPPED, UNPROVEN"),
        (driving(device=UNPROVEN), f"DRIVING, {NEVER}", "MOVING, UNPROVEN"),
        (driving(device=UNPROVEN, **STANDING), f"STANDING, {NEVER}", "CAN MOVE, UNPROVEN"),
        (latched(causes.UNSTILL(), device=UNPROVEN), f"STOPPED, {NEVER}", "STOPPED, UNPROVEN"),
        (state(device=LOST), "MAY TURN", "WHEELS MAY TURN"),
        (state(device=UNASKED), "STOPPED", "STOPPED"),
    ],
)
def test_what_nothing_proves_is_said_to_be_unproven(found: Any, told: str, large: str) -> None:
    assert verdict.proven_word(found) == told
    assert verdict.large_word(found) == large


def test_commands_name_the_robot_where_there_are_several() -> None:
    other: dict[str, Any] = {"name": "left-arm"}
    assert steps.line(latched()) == "`failstop reset`, then `failstop enable`"
    assert steps.line(latched(**other)) == ("`failstop reset --name left-arm`, then `failstop enable --name left-arm`")
    assert steps.line(state(**other)) == "`failstop enable --name left-arm`"


def _gate_reasons() -> dict[str, str]:
    settings = Settings()
    core = GateCore(settings, kinematics.from_settings(settings), 0)
    found = {"disabled": core.blocked(1)}
    core.enable(1, "", 1)
    found["no command"] = core.blocked(1)
    core.accept(Command(7, "nav (pid 42)", 1, (0.1, 0.0, 0.0)), 1)
    found["no sensor"] = core.blocked(1)
    core.disable()
    core.enable(1, "", 1)
    found["held"] = core.blocked(1)
    core.accept(Command(7, "nav (pid 42)", 1, (0.0, 0.0, 0.0)), 1)
    core.scan.deliver(1, 1)
    found["nothing"] = core.blocked(1)
    core.stop(causes.KEY(1), 1)
    found["latched"] = core.blocked(1)
    return found


def test_every_block_reason_of_the_gate_has_its_row() -> None:
    found = _gate_reasons()
    assert found.pop("nothing") == ""
    for reason in found.values():
        assert reason.startswith(box.EVERY_BLOCK)
    assert [Block.of(found[key]) for key in ("latched", "disabled", "held", "no command", "no sensor")] == list(Block)
    assert len(set(found.values())) == len(Block) == len(box.EVERY_BLOCK)


def test_a_stop_that_was_not_written_at_first_is_doubted_only_while_the_port_is_gone() -> None:
    unwritten = stop(causes.DEVICE_LOST(), written_s=None, acknowledged_s=None, observed_s=None)
    assert verdict.doubt(latched(causes.DEVICE_LOST(), last_stop=unwritten, device=LOST))
    assert verdict.doubt(latched(causes.DEVICE_LOST(), last_stop=unwritten)) == ""


GUARDED = Client(0, "driver.py", 42, driving=False, sees="uses the guard port /run/port")
WHO = "driver.py (pid 42)"
OR_END = ", or end it, `failstop enable`, and start it again"


@pytest.mark.parametrize(
    ("changed", "typed"),
    [
        pytest.param(
            {"blocked": "let go first", "sources": (Source("cmd_vel", 0, WHO, "held"),)},
            [f"have {WHO} send zero or pause{OR_END}"],
            id="it repeats a speed since before the enable",
        ),
        pytest.param(
            {"blocked": "let go first", "sources": (Source("gamepad", 101, "gamepad", "held"),)},
            ["have gamepad send zero or pause"],
            id="a gamepad has no end",
        ),
        pytest.param(
            {"blocked": "cmd timeout", "clients": (dataclasses.replace(GUARDED, wrong="it has written no speed"),)},
            [f"fix what is wrong with driver.py{OR_END}"],
            id="it is suspended",
        ),
        pytest.param(
            {
                "blocked": "cmd timeout",
                "sources": (Source("cmd_vel", 0, WHO, "silent"),),
                "clients": (dataclasses.replace(GUARDED, wrong="it has written no speed"),),
            },
            [f"look at {WHO}, or `failstop disable` to keep the robot still if it resumes"],
            id="it was suspended while it drove",
        ),
        pytest.param(
            {"blocked": "cmd timeout", "clients": (Client(0, "eyes", 42, driving=False, wrong="it is dark"),)},
            ["fix what eyes reports", DRIVE],
            id="a program that reports about itself",
        ),
    ],
)
def test_the_steps_for_a_driver_that_drives_nothing(changed: dict[str, Any], typed: list[str]) -> None:
    found = driving(**{"sources": (), "clients": (), **STANDING, **changed})
    assert steps.typed(found) == typed
    assert "`" not in steps.pressed(found)
