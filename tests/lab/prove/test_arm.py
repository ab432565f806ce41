"""The arm on the stand: when it stood, by where it is read to be; and what does not stand, or did not follow, fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.policy.joints import from_settings
from failstop.policy.settings import Settings
from failstop.supervisor import status
from failstop_lab.faults.arm_table import ROWS
from failstop_lab.faults.arm_table import SWINGING as SWUNG
from failstop_lab.prove import arm_run
from failstop_lab.prove.arm_run import ArmRun
from failstop_lab.prove.run import Result
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.swing import Swing
from failstop_lab.prove.table import ARM_PATHS, ARM_RESOLUTION_S, BY_ARM_PATH, SWINGING, plan
from failstop_lab.prove.watch import Move
from failstop_lab.sim.client import SimBoard
from tests.lab.prove.judged import firm
from tests.support.arm_settings import ARM
from tests.support.commands import failstop

MS = 1_000_000
PERIOD_NS = 40 * MS
BASE = from_settings(Settings(ARM))[0]
SWING = Swing(BASE, 0.0, 0.5)
SETTINGS = {**ARM, "interlocks.dock.timeout_s": 0.3, status.LEASE: status.LEASE_WITHOUT_S}
STEP = PULSES_PER_RAD * 0.04


@pytest.fixture(scope="module")
def enabled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ProveStand, float]]:
    """A stand that every test leaves whole, and how long it took to enable motion for the first time."""
    place = tmp_path_factory.mktemp("stand")
    with SimBoard(place / "board") as board, ProveStand(board.link, SETTINGS, str(place), board) as made:
        begun_s = time.monotonic()
        made.driver.enable()
        yield made, time.monotonic() - begun_s


@pytest.fixture
def stand(enabled: tuple[ProveStand, float]) -> ProveStand:
    return enabled[0]


def one(stand: ProveStand, name: str) -> Result:
    return ArmRun(stand, BY_ARM_PATH[name], SWINGING).perform()


def before_read_back(stand: ProveStand, wait_s: float, does: Callable[[], None]) -> Result:
    """The run of a requested stop: `does` is done when it waits for so long, in order to read where the joint is."""
    run = stand.run

    def waits(seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        if seconds == wait_s:
            does()
        return run(seconds, until)

    stand.run = waits  # type: ignore[method-assign]
    try:
        return one(stand, "arm-stop-request")
    finally:
        stand.run = run  # type: ignore[method-assign]


@pytest.mark.slow
def test_what_enabling_asks_for_is_asserted_all_the_way_to_the_drive_pose(enabled: tuple[ProveStand, float]) -> None:
    assert enabled[1] > 2 * SETTINGS["interlocks.dock.timeout_s"]  # type: ignore[operator]


@pytest.mark.slow
def test_what_is_read_back_is_when_it_stood(stand: ProveStand) -> None:
    """A stopper that hangs is fenced 0.15 to 0.25 s later, by when it last beat: until then the joint moves on."""
    stood_s = []
    for name in ("arm-stop-request", "arm-hang-stopper"):
        result = one(stand, name)
        assert firm(result.wrong) == []
        assert result.arm is not None
        assert (result.arm["joint"], result.arm["rate_radps"]) == ("base", 1.0)
        assert result.rest_s is not None
        assert result.written_ms is not None
        assert result.board_ms is not None
        gone_s = abs(result.arm["stopped"] - result.arm["told"]) / BASE.speed
        # What the stop took to the board, the joint went on.
        late_s = max(0.0, result.board_ms - result.written_ms) / 1000
        assert gone_s - ARM_RESOLUTION_S <= result.rest_s <= gone_s + late_s + ARM_RESOLUTION_S
        stood_s.append(result.rest_s)
    assert stood_s[0] < stood_s[1]
    assert stand.whole()
    assert not stand.driver.robot.state.estop


@pytest.mark.slow
def test_a_stop_that_is_not_made_fails(stand: ProveStand) -> None:
    result = ArmRun(stand, BY_ARM_PATH["arm-stop-request"], SWINGING, request=lambda *_: None).perform()
    assert result.verdict == "FAIL"
    assert result.rest_s is not None
    assert result.rest_s > 0.4
    assert "NO STOP written" in result.wrong
    assert any(wrong.startswith("at rest after 0.") for wrong in result.wrong)
    assert any(wrong.startswith("latched: None, not") for wrong in result.wrong)


@pytest.mark.slow
@pytest.mark.parametrize(("by_hand", "wrong"), [(1000, "at rest after"), (0, "it did not follow before the stop")])
def test_a_joint_that_stands_elsewhere_fails(stand: ProveStand, by_hand: int, wrong: str) -> None:

    def moved() -> None:
        assert stand.board
        assert stand.swing
        way = stand.swing.at(stand.watch.moves, time.monotonic_ns())[1]
        stand.board.servo(BASE.servo, position=by_hand if way > 0 else 1000 - by_hand)

    result = before_read_back(stand, 0.0, moved)
    assert [wrong in found for found in result.wrong] == [True], result.wrong


@pytest.mark.slow
def test_a_joint_that_goes_on_after_the_read_back_fails(stand: ProveStand) -> None:
    assert stand.board
    board = stand.board
    result = before_read_back(stand, arm_run.STAYS_S, lambda: board.servo(BASE.servo, position=400))
    assert any(found.startswith("it stood at ") for found in result.wrong), result.wrong


def test_a_robot_without_an_arm_has_no_such_paths() -> None:
    done = failstop("prove", "--sim", "--only", "arm-kill-gate")
    assert done.returncode == 1
    assert "the settings have no joints" in done.stderr


def test_plans() -> None:
    assert len(ARM_PATHS) == len(BY_ARM_PATH) == sum(row.what in SWUNG for row in ROWS)
    whole = [path for path, _ in plan(settings=Settings(), quick=False, has_arm=True) if path.arm]
    assert whole == list(ARM_PATHS)
    assert not [path for path, _ in plan(settings=Settings(), quick=False) if path.arm]
    assert not [path for path, _ in plan(settings=Settings(), quick=False, at=("0.2",), has_arm=True) if path.arm]
    assert plan(settings=Settings(), quick=True, only=("arm-kill-gate",), has_arm=True) == [
        (BY_ARM_PATH["arm-kill-gate"], SWINGING)
    ]
    assert [path.name for path, _ in plan(settings=Settings(), quick=True, has_arm=True) if path.arm] == [
        "arm-kill-gate",
        "arm-client-killed",
        "arm-stop-request",
    ]


def test_every_bar_is_its_row_s_and_what_reading_adds() -> None:
    for path in ARM_PATHS:
        assert path.arm
        assert path.arm.bar_ms
        assert 0 < path.reaction_bar_ms(simulated=False) < path.arm.bar_ms
        assert path.rest_bar_s(SWINGING) == pytest.approx(path.arm.bar_ms / 1000 + 0.03)


def track(*positions: float) -> list[Move]:
    return [
        (index * PERIOD_NS, servo, round(position), PERIOD_NS)
        for index, position in enumerate(positions)
        for servo in (BASE.servo, 2)
    ]


def test_a_servo_that_goes_at_once_is_there_at_once() -> None:
    assert SWING.at([(0, 1, 400, 1), (7, 1, 500, 1)], 8) == (500, 1)


def test_where_it_was_told_to_be_is_on_the_way_of_the_move_in_force() -> None:
    found = track(400, 410, 420)
    assert SWING.at(found, 2 * PERIOD_NS) == (410, 1)
    assert SWING.at(found, 2 * PERIOD_NS + PERIOD_NS // 4) == (412.5, 1)
    assert SWING.at(found, 9 * PERIOD_NS) == (420, 1)
    assert SWING.at(track(420, 410, 400), 2 * PERIOD_NS + PERIOD_NS // 2) == (405, -1)


@pytest.mark.parametrize(
    ("positions", "good"),
    [
        ([440 - STEP, 440, 440 + STEP], True),
        ([560 + STEP, 560, 560 - STEP], True),
        ([440, 440 + STEP], False),
        ([440, 445, 450], False),
        ([440, 440 + STEP, 440], False),
        ([540 - STEP, 540, 540 + STEP], False),
        ([385 - 2 * STEP, 385 - STEP, 385], False),
    ],
    ids=["up", "down", "too few", "not at speed", "turning", "past the middle", "just turned"],
)
def test_the_moment_is_one_of_steady_motion_with_a_way_ahead(positions: list[float], good: bool) -> None:
    assert SWING.struck_now(track(*positions)) is good


def test_a_place_is_two_readings_that_agree_since_then() -> None:
    assert SWING.read([(1, 1, 500), (2, 1, 502)], 1) == 501
    assert SWING.read([(1, 1, 500), (2, 2, 700), (3, 1, 502)], 1) == 501
    assert SWING.read([(1, 1, 500), (2, 1, 520)], 1) is None
    assert SWING.read([(1, 1, 500), (2, 1, 500)], 2) is None
