"""Telemetry's odometry from the bytes of a board: what rolled, and not what was told; and its successor's."""

from __future__ import annotations

import math

import pytest

from failstop.messages import records
from failstop.policy.settings import Settings
from failstop.procs.telemetry.odometry import Odometry
from failstop.procs.telemetry.wheels import Measured
from tests.support.stage import MS
from tests.support.telemetry_scene import Scene

RIM_M = math.pi * 0.08
COUNTS = 3436


def bridge() -> Scene:
    """Told to drive at 0.2 m/s all the time."""
    scene = Scene(**{"board.kind": "arduino"})
    scene.gate.update(enabled=True, body_vel=[0.2, 0.0, 0.0])
    scene.turn()
    return scene


def say(scene: Scene, *counts: tuple[int, int], every_ms: int = 100) -> None:
    """The board answers with its counters."""
    for left, right in counts:
        scene.wake(b"%d %d\r\n" % (left, right), elapsed_ns=every_ms * MS)


def pose(scene: Scene) -> tuple[float, float, float]:
    x_m, y_m, th_rad = scene.latest("odometry")[:3]
    return x_m, y_m, th_rad


def turns(scene: Scene) -> tuple[float, ...]:
    entry = scene.own.latest_reader("wheels").read()
    assert entry
    return tuple(records.WHEELS_SEEN.unpack(entry[2])[10:12])


def source(scene: Scene) -> str:
    return records.ODOMETRY_FROM[scene.latest("odometry")[8]]


def test_commands_count_until_the_board_has_reported_its_wheels_and_never_again() -> None:
    scene = bridge()
    scene.turn(elapsed_ns=40 * MS)
    assert source(scene) == "commands"
    assert scene.latest("odometry")[9] == records.POSE_VARIANCE
    say(scene, *[(5000, 7000)] * 20)
    assert source(scene) == "wheels"
    assert 0.0 < scene.latest("odometry")[9] < 0.1**2, "what it was told until then may have been done or not"
    at = pose(scene)
    say(scene, *[(5000, 7000)] * 20)
    assert pose(scene) == at, "told to drive, and held"
    scene.turn(elapsed_ns=900 * MS)
    assert pose(scene) == at
    assert source(scene) == "wheels"
    entry = scene.own.latest_reader("odometry").read()
    assert entry
    assert scene.clock() - entry[1] >= 900 * MS, "its time is that of the last report"


def test_the_way_is_what_the_wheels_have_rolled() -> None:
    scene = bridge()
    say(scene, (0, 0))
    began_m = pose(scene)[0]
    say(scene, *[(at * 172, at * 172) for at in range(1, 21)])
    assert pose(scene)[0] - began_m == pytest.approx(20 * 172 / COUNTS * RIM_M, abs=0.001)
    assert scene.latest("odometry")[3] == pytest.approx(172 / COUNTS * RIM_M / 0.1)
    say(scene, *[(3440 - at * 172, 3440 + at * 172) for at in range(1, 21)])
    assert pose(scene)[2] == pytest.approx(2 * 3440 / COUNTS * RIM_M / 0.17165, abs=0.01)


def test_garbage_a_reboot_and_a_gap_move_nothing() -> None:
    scene = bridge()
    say(scene, *[(9000 + at * 172, 9000 + at * 172) for at in range(11)])
    x_m = pose(scene)[0]
    for line in (b"1 2 3\r\n", b"nan nan\r\n", b"99999999999 1\r\n", b"\xff\xfe\r\n", b"2147483647 -2147483648\r\n"):
        scene.wake(line, elapsed_ns=20 * MS)
    assert pose(scene)[0] == pytest.approx(x_m)
    say(scene, (0, 0), (0, 0), (0, 0), every_ms=800)
    assert pose(scene)[0] == pytest.approx(x_m, abs=0.01)
    say(scene, *[(at * 172, at * 172) for at in range(1, 11)])
    assert pose(scene)[0] == pytest.approx(x_m + 1720 / COUNTS * RIM_M, abs=0.01)


def test_a_successor_goes_on_and_is_less_sure() -> None:
    scene = bridge()
    say(scene, *[(9000 + at * 344, 9000 + at * 344) for at in range(11)])
    scene.turn(elapsed_ns=20 * MS)
    before, sure = pose(scene), scene.latest("odometry")[9:]
    turned = turns(scene)
    scene.clock.now_ns += 100 * MS
    scene.start_telemetry()
    say(scene, (12_440, 12_440), (12_440, 12_440))
    scene.turn(elapsed_ns=20 * MS)
    assert pose(scene) == pytest.approx(before)
    assert source(scene) == "wheels"
    assert turns(scene) == pytest.approx(turned)
    now = scene.latest("odometry")[9:]
    assert now[0] - sure[0] == pytest.approx((0.22 * RIM_M) ** 2 / 2, rel=0.3), "0.2 s at a turn a second are not seen"
    assert now[5] > sure[5]
    say(scene, *[(12_440 + at * 344, 12_440 + at * 344) for at in range(1, 11)])
    assert pose(scene)[0] == pytest.approx(before[0] + 3440 / COUNTS * RIM_M, abs=0.03)


def test_the_covariance_stays_at_rest_and_grows_with_the_way() -> None:
    settings = Settings({"board.kind": "arduino"})
    measured, odometry = Measured(Scene(**{"board.kind": "arduino"}).telemetry._board.reports), Odometry(settings)
    found = []
    for at, count in enumerate([0, 0, 0, 3436, 6872, 6872, 6872]):
        measured.add((), (float(count),) * 2, (at + 1) * 1000 * MS)
        odometry.roll(measured)
        found.append(odometry.covariance)
    assert found[0] == found[2]
    assert found[2][5] < found[3][5] < found[4][5] == found[6][5]
    xx, xy, xt, yy, yt, tt = found[-1]
    assert xx > 0
    assert yy > xx, "a heading that is wrong carries it off to the side"
    assert yt > 0
    assert xx * (yy * tt - yt * yt) - xy * (xy * tt - yt * xt) + xt * (xy * yt - yy * xt) >= 0, "it is a covariance"
