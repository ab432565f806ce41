"""The arm's replies to the letter, the gamepad's part of it, and its state."""

from __future__ import annotations

from itertools import pairwise

import pytest

from failstop.board.rrc.servos import PULSES_PER_RAD
from failstop.messages import records
from failstop.procs.gate.arm.shell import LONGEST_S
from tests.support.arm_settings import DRIVE, JOINTS, SERVOS
from tests.support.gate_scene import SESSION, Scene
from tests.support.stage import MS

from .arm_bench import Make

NO_JOINTS = "a trajectory for joints that the arm does not have"
TIMES = f"a trajectory's times go up from more than 0 to {LONGEST_S:g} s"
ANGLE = "joint base to 3 rad: allowed is -2.094 to 2.094"


A_TENTH = [(0.0, [0.1])]
REFUSED = [
    *(([(0.0, [0.1, 0.1])], servos, 1.0, NO_JOINTS) for servos in ([1, 7], [1, 1])),
    *((A_TENTH, [1], share, NO_JOINTS) for share in (0.0, 1.01)),
    *(([(t_s, [0.1])], [1], 1.0, TIMES) for t_s in (-0.1, LONGEST_S + 0.1)),
    ([*A_TENTH, (1.0, [0.2])], [1], 1.0, TIMES),
    ([(1.0, [0.1]), (1.0, [0.1])], [1], 1.0, "the times do not go up: 1 s, then 1 s"),
    ([(1.0, [3.0])], [1], 1.0, ANGLE),
    ([(1.0, [0.1]), (2.0, [3.0])], [1], 1.0, f"{ANGLE} (at 2 s)"),
]


def test_trajectory_that_can_not_be_gone_is_refused(scene: Scene) -> None:
    assert scene.result(records.ARM_MOVE) == (records.REFUSED, "no trajectory came with the request")
    for rows, servos, share, told in REFUSED:
        scene.go(share, servos, rows)
        assert scene.finish() == (records.REFUSED, told)
    assert scene.moves == []


def test_trajectory_may_take_the_longest_time_and_a_newer_preempts_it(scene: Scene) -> None:
    for rows in ([(LONGEST_S, [0.0])], [(0.5, [0.1]), (LONGEST_S, [0.0])]):
        scene.go(1.0, [1], rows)
        scene.run(0.5)
        done, text = scene.answered()
        assert (done, text.partition(", ")[2][:12]) == (records.UNDER_WAY, "move: on its")
        assert LONGEST_S - 0.5 <= float(text.split()[-3]) <= LONGEST_S
    scene.execute({1: -0.2})
    assert scene.finish() == (records.DONE, "arm is there")
    assert scene.at(1) == pytest.approx(500 - 0.2 * PULSES_PER_RAD, abs=3)


def test_way_without_a_time_takes_the_share_of_its_speed(scene: Scene) -> None:
    scene.go(0.25, [1, 2], [(0.0, [0.5, -0.1])])
    assert scene.finish() == (records.DONE, "arm is there")
    assert scene.at(1) == pytest.approx(500 + 0.5 * PULSES_PER_RAD, abs=1)
    assert scene.at(2) == pytest.approx(500 - 0.1 * PULSES_PER_RAD, abs=1)
    assert (scene.moves[-1][0] - scene.moves[0][0]) * 1e-9 == pytest.approx(2.0, abs=0.35)


def test_progress_is_told_five_times_a_second(scene: Scene) -> None:
    reply = scene.own.latest_reader("reply.0")
    scene.go(1.0, [1], [(2.0, [0.5])])
    told: dict[int, int] = {}
    texts = []
    while (answer := scene.answered())[0] == records.UNDER_WAY:
        texts.append(answer[1])
        scene.wake()
        if entry := reply.read():
            told.setdefault(entry[0], scene.clock())
    gaps = [after - before for before, after in pairwise(told.values())][1:-1]
    assert len(gaps) > 8
    assert 200 * MS <= min(gaps) <= max(gaps) <= 220 * MS
    left = sorted({float(text.split()[-3]) for text in texts if text.endswith("s left")})
    assert left[0] <= 0.2
    assert 1.8 <= left[-1] <= 2.0


def test_client_that_leaves_gives_up_what_it_waits_for(scene: Scene) -> None:
    scene.ask_for(records.ENABLE)
    scene.run(0.8)
    assert scene.state()["moving"]
    scene.clients[1].segment.wipe()
    scene.run(0.1)
    assert scene.state()["moving"], "another one's leaving is nothing to it"
    scene.clients[0].segment.wipe()
    scene.run(0.02)
    stood = scene.at(2)
    scene.run(3.0)
    assert scene.at(2) == stood
    assert not scene.gate.core.enabled


def test_reply_is_not_for_who_has_the_slot_next(scene: Scene) -> None:
    scene.execute({1: 0.2})
    scene.run(0.2)
    scene.clients[0].hello(SESSION + 5, "heir")
    scene.run(2.0)
    assert scene.answered()[0] == records.UNDER_WAY


def test_a_successor_refuses_the_request_that_a_gate_left_under_way(scene: Scene) -> None:
    scene.execute({1: 0.2})
    scene.run(0.2)
    assert scene.answered()[0] == records.UNDER_WAY
    scene.stop("gate died")
    scene.clock.now_ns += 80 * MS
    scene.start_gate()
    scene.turn()
    text = "asked before the last stop (gate died): deal with that stop, then ask again"
    assert scene.answered() == (records.REFUSED, text)


@pytest.mark.parametrize(
    ("verb", "client", "done"),
    [
        *((records.ARM_HOLD, client, "arm held") for client in (0, 1)),
        (records.ARM_RELEASE, 0, "arm released: its torque is off"),
    ],
)
def test_hold_and_release_are_done_at_once_and_told_to_the_mover(
    scene: Scene, verb: int, client: int, done: str
) -> None:
    scene.execute({1: 1.0})
    scene.run(0.5)
    scene.ask_for(verb, client)
    scene.run(0.02)
    assert scene.answered(client) == (records.DONE, done)
    assert client == 0 or scene.answered() == (records.REFUSED, "held by other (pid 0)")
    assert (scene.state()["moving"], scene.state()["released"]) == (False, verb == records.ARM_RELEASE)


def test_hold_ends_a_release_and_read_tells_where_each_joint_is(scene: Scene) -> None:
    scene.servos.change(4, scene.clock(), position=320.0)
    scene.ask_for(records.ARM_READ)
    scene.run(0.02)
    assert scene.answered()[1] == "arm, read: finding out where it is"
    assert scene.finish() == (records.DONE, "arm is there")
    assert {row[0]: row[3] for row in scene.state()["joints"]}["wrist"] == pytest.approx(320, abs=3)
    scene.execute({1: 0.1, 2: 0.1})
    scene.finish()
    assert scene.ask(records.ARM_RELEASE)[0] == records.DONE
    scene.run(0.006)
    assert scene.ask(records.ARM_HOLD)[0] == records.DONE
    scene.run(0.5)
    assert [scene.servos.by_id[servo].limp() for servo in (1, 2)] == [True, False]


def test_pose_that_the_settings_do_not_have_is_refused(arm_with: Make) -> None:
    scene = arm_with(**{f"joints__{name}__tuck": -1 for name in JOINTS})
    assert scene.result(records.ARM_TUCK) == (records.REFUSED, "the settings have no tuck pose")
    assert scene.result(records.ARM_DRIVE) == (records.DONE, "arm is there")
    assert scene.state()["pose"] == "drive"


def test_hint_at_an_absent_arm_only_where_no_joint_of_the_pose_answers(arm_with: Make) -> None:
    scene = arm_with(joints__elbow__drive=0, joints__base__drive=-1)
    for servo in set(SERVOS) - {1, 3}:
        scene.servos.change(servo, scene.clock(), silent=True)
    done, text = scene.result(records.ENABLE)
    assert done == records.REFUSED
    assert text.startswith("arm is not in the drive pose: joints shoulder")
    assert "arm.absent" not in text
    scene.servos.change(3, scene.clock(), silent=True)
    assert scene.result(records.ENABLE)[1].endswith('; without the arm: arm.absent = "ignore"')


def test_gamepad_turns_by_its_share_of_the_joint_s_speed_until_let_go(scene: Scene) -> None:
    def hold(joint: int, times: int) -> None:
        for _ in range(times):
            scene.pad(joint, -0.5)
            scene.run(0.05)

    hold(len(JOINTS), 20)
    assert scene.state()["mode"] == "", "no joint that is none"
    hold(len(JOINTS) - 1, 10)
    assert scene.state()["pad_joint"] == "gripper"
    assert (scene.state()["mode"], scene.state()["by"]) == ("jog", "gamepad")
    begun_ns, begin = scene.clock(), scene.at(10)
    hold(len(JOINTS) - 1, 20)
    speed = (scene.at(10) - begin) / (scene.clock() - begun_ns) * 1e9
    assert speed == pytest.approx(-0.5 * PULSES_PER_RAD, rel=0.05)
    scene.pad(len(JOINTS) - 1, 0.0)
    scene.run(0.02)
    stood = scene.at(10)
    scene.run(0.3)
    assert scene.at(10) == pytest.approx(stood, abs=1)
    assert scene.state()["pad_joint"] is None


def test_state_says_what_the_arm_does_and_for_whom(scene: Scene) -> None:
    state = scene.state()
    assert [state[key] for key in ("mode", "phase", "by", "refused", "closed")] == [""] * 5
    assert [state[key] for key in ("moving", "released")] == [False] * 2
    joints = {row[0]: row for row in state["joints"]}
    assert list(joints) == list(JOINTS)
    assert joints["gripper"][1] == 10
    scene.execute({1: 0.5})
    phases: list[str] = []
    while scene.answered()[0] == records.UNDER_WAY:
        scene.wake()
        if (state := scene.state())["phase"] not in phases[-1:]:
            phases.append(state["phase"])
    ways = ["finding out where it is", "switching its torque on", "on its way", "settling", "reading back where it is"]
    assert phases == [*ways, ""]
    scene.ask_for(records.ARM_DRIVE, client=1)
    scene.run(0.6)
    state = scene.state()
    assert (state["mode"], state["moving"], state["by"]) == ("trajectory", True, "other (pid 0)")
    assert scene.answered(client=1)[1].startswith("arm, drive: on its way, ")
    assert scene.finish(client=1) == (records.DONE, "arm is there")
    assert scene.state()["pose"] == "drive"
    assert [scene.at(servo) for servo in SERVOS[1:]] == pytest.approx(DRIVE[1:], abs=2)
    scene.result(records.ENABLE)
    scene.run(0.3)
    assert scene.state()["closed"] == "wheels enabled"
