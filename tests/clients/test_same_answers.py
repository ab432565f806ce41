"""The same calls in the same order, from C and from Python: the same answers, the same refusals, the same state."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from failstop import Blocked, Driving, Preempted, Refused, Robot
from failstop.api.snapshot import Block
from failstop.policy.settings import FIRST_SOURCE
from failstop.supervisor import status
from failstop_lab.trial import Trial, wait_for, write_settings
from tests.clients.scene import BLOCKED, DRIVING, REFUSED
from tests.support.amounts import amount
from tests.support.c_client import Driver
from tests.support.shared_trial import IMU_HZ

CALLS = ("enable", "disable", "reset", "reset an earlier stop", "stop", "drive", "rest")
BLOCKS = {1: Block.LATCHED, 2: Block.DISABLED, 3: Block.HELD, 4: Block.NO_COMMAND, 5: Block.NO_SCAN}
SETTLED_S = 0.2
Call = Callable[[str], object]


def at_rest(trial: Trial) -> None:
    """Nothing latched, motion disabled, nobody commands."""
    with Robot(trial.name, client="between") as robot:
        if robot.state.cause:
            wait_for("a reset to be taken", trial.reset)
        robot.disable()
        wait_for("no command to count", lambda: not robot.state.sources)
    trial.leave()


def latched(trial: Trial, before: int) -> None:
    wait_for("the stop to be latched", lambda: trial.robot.state.epoch > before and trial.robot.state.cause)


def taken(trial: Trial) -> None:
    """Wait until the gate has heard every command until now: it answers this request at the end of the turn in which
    it has. A command and an enable that come in one turn are heard in the other order."""
    trial.robot.limit_speed(1.0)


def of_python(trial: Trial) -> list[Call]:
    robot = Robot(trial.name, client="same", disable_on_exit=False)

    def asked(ask: Callable[[], object]) -> object:
        try:
            ask()
        except Refused as refused:
            return refused.reason.partition(" (")[0]
        return "done"

    def call(name: str) -> object:
        if name == "stop":
            before = robot.state.epoch
            robot.estop("same")
            latched(trial, before)
            return "done"
        if name in ("drive", "rest"):
            robot.sensed()
            answer = robot.drive(0.2 if name == "drive" else 0.0, 0.0, 0.0, wait_s=SETTLED_S)
            taken(trial)
            match answer:
                case Driving():
                    return "drives"
                case Preempted(by=who):
                    return who
                case Blocked(block=block):
                    return block
        seen = robot.state.epoch - 1 if "earlier" in name else None
        asks = {"enable": robot.enable, "disable": robot.disable}
        return asked(asks.get(name) or (lambda: robot.reset(seen=seen)))

    def state(_: str) -> object:
        found = robot.state
        return found.enabled, found.cause and found.cause.kind.number, found.block is Block.LATCHED

    return [call, state, lambda _: robot.close()]


def of_c(trial: Trial, driver: Driver) -> list[Call]:
    driver.connect(trial.name)
    driver.do("keep")

    def call(name: str) -> object:
        if name == "stop":
            before = int(driver.state()["epoch"])
            driver.do("stop same")
            latched(trial, before)
            return "done"
        if name in ("drive", "rest"):
            driver.do("sensed")
            driver.do(f"drive {0.2 if name == 'drive' else 0.0} 0 0")
            until_s = time.monotonic() + SETTLED_S
            while True:
                state = driver.state()
                settled = state["answer"] != BLOCKED or state["answer_block"] in (1, 2)
                if settled or time.monotonic() > until_s:
                    taken(trial)
                    return "drives" if state["answer"] == DRIVING else BLOCKS[int(state["answer_block"])]
        seen = int(driver.state()["epoch"]) - 1 if "earlier" in name else 0
        result = driver.do({"enable": "enable -1", "disable": "disable -1"}.get(name, f"reset {seen}"))
        return driver.text("error").partition(" (")[0] if result == REFUSED else "done" if result == 0 else result

    def state(_: str) -> object:
        found = driver.state()
        return found["enabled"] == 1, int(found["cause"]) or None, found["block"] == 1

    return [call, state, lambda _: driver.do("close")]


def said(made: list[Call], order: list[str]) -> list[tuple[object, ...]]:
    call, state, close = made
    try:
        return [(name, call(name), state(name)) for name in order]
    finally:
        close("")


@pytest.fixture(scope="module")
def lasting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    """A service whose commands and sensor count for long, so that no answer depends on how fast this machine is."""
    path = tmp_path_factory.mktemp("lasting") / "settings.toml"
    values = {f"sources.{FIRST_SOURCE}.timeout_s": 2.0, "scan.timeout_s": 2.0, status.LEASE: status.LEASE_WITHOUT_S}
    write_settings(str(path), values)
    with Trial(f"same-{os.getpid()}", ("--config", str(path)), imu_hz=IMU_HZ) as running:
        # So that there is an earlier stop: before the first, its number would be 0, which means that it is not known.
        before = running.robot.state.epoch
        running.robot.estop("the first")
        latched(running, before)
        yield running


@pytest.mark.slow
def test_the_same_calls_have_the_same_answers(lasting: Trial, driver: Driver) -> None:
    @settings(max_examples=amount(12, 500), database=None)
    @given(st.lists(st.sampled_from(CALLS), min_size=1, max_size=7))
    @example(["reset an earlier stop", "stop"])
    def tried(order: list[str]) -> None:
        found = []
        for made in (of_python, lambda of: of_c(of, driver)):
            at_rest(lasting)
            found.append(said(made(lasting), order))
        assert found[0] == found[1]

    tried()


def test_an_order_by_hand_has_every_answer(lasting: Trial, driver: Driver) -> None:
    """One order by hand, so that each answer is seen in every run."""
    order = ["drive", "enable", "drive", "rest", "drive", "stop", "drive", "enable", "reset", "enable"]
    found = []
    for made in (of_python, lambda of: of_c(of, driver)):
        at_rest(lasting)
        found.append(said(made(lasting), order))
    assert found[0] == found[1]
    assert {answer for _, answer, _ in found[0]} >= {Block.DISABLED, Block.HELD, "drives", Block.LATCHED, "done"}
