"""The verdict: what the wheels do, why, and what to type next."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.api import verdict
from failstop.api.snapshot import Block, Device
from failstop.policy import causes, kinematics
from failstop.policy.settings import Settings
from failstop.procs.gate.core import GateCore
from failstop.procs.gate.sources import Command
from failstop.shm import blocks
from tests.support.states import driving, latched, process, state, stop

LOST = Device("/dev/ttyACM0", "lost", "unproven")
DEAF = Device("/dev/ttyACM0", "open", "deaf")
UNPROVEN = Device("/dev/ttyACM0", "open", "unproven")
STANDING = {"body_vel": (0.0, 0.0, 0.0), "wheels_radps": (0.0, 0.0, 0.0, 0.0)}
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
        ["start the obstacle sensor and the program that calls robot.sensed()"],
    ),
    (state(waiting_for="gate"), verdict.STOPPED, ["wait for gate", "`failstop enable`"]),
    (
        latched(causes.DEVICE_LOST(), device=LOST, waiting_for="the port"),
        verdict.MAY_TURN,
        ["plug the board in (/dev/ttyACM0)", "`failstop reset`", "`failstop enable`"],
    ),
    (
        state(device=LOST, waiting_for="the port"),
        verdict.MAY_TURN,
        ["plug the board in (/dev/ttyACM0)", "`failstop enable`"],
    ),
    (
        latched(causes.DEAF(), device=DEAF),
        verdict.MAY_TURN,
        ["turn the robot's POWER SWITCH off and on", "`failstop reset`", "`failstop enable`"],
    ),
    (
        latched(causes.UNSTILL()),
        verdict.MAY_TURN,
        ["turn the robot's POWER SWITCH off and on", "`failstop reset`", "`failstop enable`"],
    ),
    (state(device=UNPROVEN), verdict.STOPPED, ["`failstop enable`"]),
    (
        latched(causes.DIED("gate"), waiting_for="gate", processes={"gate": process(pid=0, state="down")}),
        verdict.STOPPED,
        ["wait for gate", "`failstop reset`", "`failstop enable`"],
    ),
    (
        latched(causes.DIED("stopper"), waiting_for="stopper", processes={"stopper": process(pid=0, state="down")}),
        verdict.STOPPED,
        ["`failstop reset`", "`failstop enable`"],
    ),
)


@pytest.mark.parametrize(("found", "word", "steps"), TABLE)
def test_the_word_and_the_steps(found: Any, word: str, steps: list[str]) -> None:
    assert verdict.word(found) == word
    assert verdict.steps(found) == steps


def test_commands_name_the_robot_where_there_are_several() -> None:
    other: dict[str, Any] = {"name": "left-arm"}
    assert verdict.next_step(latched()) == "`failstop reset`, then `failstop enable`"
    assert verdict.next_step(latched(**other)) == (
        "`failstop reset --name left-arm`, then `failstop enable --name left-arm`"
    )
    assert verdict.next_step(state(**other)) == "`failstop enable --name left-arm`"


def _gate_reasons() -> dict[str, str]:
    """Every block reason, as the gate itself gives it."""
    settings = Settings()
    core = GateCore(settings, kinematics.from_settings(settings), 0)
    found = {"disabled": core.blocked(1)}
    core.enable(1, "", 1)
    found["no command"] = core.blocked(1)
    core.take(Command(7, "nav (pid 42)", 1, (0.1, 0.0, 0.0)), 1)
    found["no sensor"] = core.blocked(1)
    core.scan.deliver(1, 1)
    found["nothing"] = core.blocked(1)
    core.stop(causes.KEY(1), 1)
    found["latched"] = core.blocked(1)
    return found


def test_every_block_reason_of_the_gate_has_its_row() -> None:
    found = _gate_reasons()
    assert found.pop("nothing") == ""
    for reason in found.values():
        assert reason.startswith(blocks.KINDS)
    assert [Block.of(found[key]) for key in ("latched", "disabled", "no command", "no sensor")] == list(Block)
    assert len(set(found.values())) == len(Block) == len(blocks.KINDS)


def test_a_stop_that_was_not_written_at_first_is_doubted_only_while_the_port_is_gone() -> None:
    unwritten = stop(causes.DEVICE_LOST(), written_s=None, acknowledged_s=None, observed_s=None)
    assert verdict.doubt(latched(causes.DEVICE_LOST(), last_stop=unwritten, device=LOST))
    assert verdict.doubt(latched(causes.DEVICE_LOST(), last_stop=unwritten)) == ""
