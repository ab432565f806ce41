"""Wheels that turn although they are told to stop: no screen of the service says that they are stopped, whatever
happened before, on every board that reports its wheels and on one whose IMU feels them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import pytest

from failstop.board.feetech import codec as feetech
from failstop.fleet import message
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import BY_KEY
from failstop_lab.boards.feetech import SPEED_AT
from tests.support.simulated import Simulated

AFTER_S = float(BY_KEY["still.after_s"].default)
LATER_S = 0.5
"""More than still.after_s: from then on no screen may say that they are stopped."""
IMU_S = 0.75
"""An IMU takes so much longer to tell a movement from noise."""
CLAIMS = re.compile(r"\b(STOPPED|STANDING)\b")
RUNS_RPS = 0.8


class RunsAway:
    """A board whose wheels turn by themselves, and whose reports, or IMU, say so."""

    def __init__(self, simulated: Simulated) -> None:
        self._model: Any = simulated.lab.board.model
        self._own = getattr(self._model, "receiver", None).__class__

    def on(self) -> None:
        model = self._model
        if not hasattr(model, "receiver"):
            model.wheels, model.refuse_stop = (RUNS_RPS,) * len(model.wheels), True
            return
        receiver = model.receiver
        raw = RUNS_RPS * model._per_rps
        if hasattr(receiver, "memory"):
            receiver.turns = False
            for wheel in feetech.WHEELS:
                receiver.memory[wheel][SPEED_AT : SPEED_AT + 2] = round(raw).to_bytes(2, "little")
            return
        turning = tuple(raw for _ in receiver.wheels)
        receiver.__class__ = type("Runaway", (self._own,), {"wheels": property(lambda _: turning)})

    def off(self) -> None:
        model = self._model
        if not hasattr(model, "receiver"):
            model.wheels, model.refuse_stop = (0.0,) * len(model.wheels), False
        elif hasattr(model.receiver, "memory"):
            model.receiver.turns = True
        else:
            model.receiver.__class__ = self._own


def fleet(body: dict[str, Any]) -> str:
    return f"{body['word']}\n{body['why']}\n{body['next']}\n{body['wheels']['text']}\n"


def screens(simulated: Simulated) -> dict[str, str]:
    """What a person or a program reads at this moment."""
    state = simulated.robot.state
    load = simulated.load
    shown = load("failstop.web.view").view(state, [], 0.0)
    told = load("failstop.fleet.metrics").collect(state)
    return {
        "status": simulated.command("status")[1],
        "why": simulated.command("why")[1],
        "page": f"{shown['word']}. {shown['why']}",
        "metrics": " ".join(f"{row.name} {value:g}" for row, found in told for _, value in found),
        "fleet": fleet(message.body(state)),
        "diagnostics": json.dumps(load("failstop.ros2.diagnostics").statuses("node", state, "", [], [])),
        "ros": json.dumps(load("failstop.ros2.report").as_json(state, [], [])),
    }


def disabled(simulated: Simulated) -> None:
    simulated.enable()
    simulated.robot.disable()


def idle(simulated: Simulated) -> None:
    simulated.enable()


def latched(simulated: Simulated) -> None:
    simulated.set_off()
    simulated.robot.estop("enough")


def once_still(simulated: Simulated) -> None:
    latched(simulated)
    simulated.wait_for(
        "the wheels at rest",
        lambda: simulated.robot.state.last_stop and simulated.robot.state.last_stop.observed_s is not None,
    )
    simulated.wait(1.0)
    simulated.reset()


def port_came_back(simulated: Simulated) -> None:
    simulated.set_off()
    simulated.board.unplug()
    simulated.wait(1.0)
    simulated.board.replug()
    simulated.wait_for("the port", lambda: simulated.robot.state.device.state == "open")
    simulated.wait(1.0)


def gate_down(simulated: Simulated) -> None:
    def down() -> bool:
        return bool(simulated.robot.state.processes["gate"].state == "down")

    def die() -> bool:
        if simulated.robot.state.processes["gate"].pid:
            simulated.die("gate")
            simulated.wait(0.05)
        return down()

    simulated.wait_for("the gate to be given up", die, 60.0)


STATES: dict[str, Callable[[Simulated], None]] = {
    "disabled": disabled,
    "enabled and idle": idle,
    "latched": latched,
    "once seen still": once_still,
    "the port came back": port_came_back,
    "the gate is down": gate_down,
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("kind", BOARDS)
def test_no_screen_says_stopped_of_wheels_that_turn(kind: str, state: str) -> None:
    simulated = Simulated(kind=kind, imu_hz=110.0)
    STATES[state](simulated)
    away = RunsAway(simulated)
    away.on()
    simulated.wait(AFTER_S + LATER_S)
    for screen, text in screens(simulated).items():
        assert not CLAIMS.search(text), (screen, text)
    simulated.wait(IMU_S)
    seen = simulated.robot.state.turning
    assert (seen.does, seen.by) == ("turning", "wheels" if kind != BOARDS[0] else "IMU")
    word, large = ("TURNING", "WHEELS TURN") if seen.by == "wheels" else ("MOVED", "ROBOT MOVES")
    told = {
        "status": f"wheels    {word}",
        "why": f"THE {large}",
        "page": f"{large}. ",
        "metrics": "failstop_wheels_unexpected 1",
        "fleet": f"{word}\n",
        "diagnostics": f'"message": "{word}: ',
        "ros": f'"wheels": {{"word": "{word}"',
    }
    for screen, text in screens(simulated).items():
        assert told[screen] in text, (screen, text)
        assert not CLAIMS.search(text), (screen, text)


@pytest.mark.parametrize("kind", BOARDS)
def test_it_is_over_when_they_are_seen_still(kind: str) -> None:
    simulated = Simulated(kind=kind, imu_hz=110.0)
    away = RunsAway(simulated)
    away.on()
    simulated.wait(AFTER_S + LATER_S)
    assert "MOVE" in screens(simulated)["page"].upper() or "TURN" in screens(simulated)["page"]
    away.off()
    simulated.wait(1.5)
    assert "wheels    STOPPED" in simulated.command("status")[1]


@pytest.mark.parametrize("kind", BOARDS)
def test_a_stop_of_turning_wheels_is_stopping_before_it_is_stopped(kind: str) -> None:
    simulated = Simulated(kind=kind, imu_hz=110.0)
    simulated.set_off()
    simulated.drive(1.0)
    away = RunsAway(simulated)
    away.on()
    simulated.robot.estop("enough")
    simulated.wait(0.3)
    assert simulated.command("status")[1].startswith("wheels    STOPPING")
    away.off()
    simulated.wait(1.5)
    assert simulated.command("status")[1].startswith("wheels    STOPPED")


def test_reports_that_end_leave_the_wheels_unknown() -> None:
    simulated = Simulated(kind="hoverboard")
    simulated.wait(1.0)
    model: Any = simulated.lab.board.model
    receiver = model.receiver
    receiver.__class__ = type("Silent", (receiver.__class__,), {"said": property(lambda _: [])})
    simulated.wait(2.0)
    for screen, text in screens(simulated).items():
        assert not CLAIMS.search(text), (screen, text)
    assert "not known (last read 2.0 s ago)" in simulated.command("status")[1]
