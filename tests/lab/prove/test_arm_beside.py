"""An arm beside the wheels on the stand: both have to stop, and the arm to hold."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from failstop.api.errors import FailstopError
from failstop.policy.settings import Settings
from failstop_lab.prove.arm_run import ArmRun
from failstop_lab.prove.session import until_valid
from failstop_lab.prove.table import BESIDE_PATHS, TURNINGS, plan, within
from tests.lab.prove.judged import firm
from tests.lab.prove.kiwi import Kiwi, beside, standing


@pytest.fixture(scope="module")
def kiwi(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kiwi]:
    """A stand that every test leaves whole."""
    with standing(tmp_path_factory.mktemp("kiwi")) as made:
        yield made


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm-client-killed", "arm-kill-gate", "arm-stop-request"])
def test_beside_the_wheels_both_are_judged(kiwi: Kiwi, name: str) -> None:
    result = until_valid(lambda: beside(kiwi, name).perform(), lambda _: None)
    assert firm(result.wrong) == []
    assert result.arm is not None
    assert result.arm["wheels_rest_s"] >= 0.0
    assert result.velocity == within(kiwi[0].settings)[0]


@pytest.mark.slow
def test_a_servo_that_lets_go_fails(kiwi: Kiwi, monkeypatch: pytest.MonkeyPatch) -> None:
    run = beside(kiwi, "arm-stop-request")
    board = run.stand.board
    assert board
    monkeypatch.setattr(board, "limp", lambda: [1])
    assert firm(run.perform().wrong) == ["joint base has let go: its torque is off"]


@pytest.mark.slow
def test_wheels_that_do_not_stop_beside_the_arm_fail(kiwi: Kiwi) -> None:
    stand, sight = kiwi
    ((path, velocity),) = plan(
        quick=True, only=("arm-stop-request",), has_arm=True, beside=True, settings=stand.settings
    )
    result = ArmRun(stand, path, velocity, sight, lambda *_: None).perform()
    assert result.verdict == "FAIL"
    assert result.runaway
    # Nothing comes between this and the alarm: it is not waited for the service, and nothing is reset or read back.
    assert firm(result.wrong) == ["NO STOP written", "THE WHEELS DID NOT COME TO REST"]


@pytest.mark.slow
def test_wheels_that_nobody_sees_at_rest_after_a_failed_run_end_the_test(kiwi: Kiwi) -> None:
    stand, sight = kiwi
    board = stand.board
    assert board

    def fails(*_: str) -> None:
        board.silent(True)
        raise FailstopError("nobody is asked")

    ((path, velocity),) = plan(
        quick=True, only=("arm-stop-request",), has_arm=True, beside=True, settings=stand.settings
    )
    try:
        result = ArmRun(stand, path, velocity, sight, fails).perform()
    finally:
        board.silent(False)
        stand.safe()
        stand.start()
    assert result.runaway
    assert "the wheels were not seen at rest after that" in result.wrong


def test_an_arm_beside_the_wheels_is_proved_with_them() -> None:
    whole = [
        (path, velocity)
        for path, velocity in plan(quick=False, has_arm=True, beside=True, settings=Settings())
        if path.arm
    ]
    assert [path for path, _ in whole] == list(BESIDE_PATHS)
    assert {velocity for _, velocity in whole} == {TURNINGS[0]}
