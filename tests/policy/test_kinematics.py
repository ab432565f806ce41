"""Kinematics: published numbers, published formulas both ways, and zeros that are the stop frame to the byte."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations, product
from math import copysign, cos, pi, radians, sin, tan

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.board.kinds import board_of
from failstop.board.rrc import codec
from failstop.policy.kinematics import Chassis, Velocity, from_settings, of_wheels
from failstop.policy.layouts import LAYOUTS, WHEEL_NAMES
from failstop.policy.settings import Settings, mounted_wheels

DIAMETER_M, WHEELBASE_M, TRACK_M = 0.08, 0.17706, 0.17165
RIM_M = pi * DIAMETER_M


def base(layout: str, board: str = "rrc", changed: Mapping[str, object] | None = None) -> Chassis:
    return from_settings(Settings({"board.kind": board, "wheels.layout": layout, **(changed or {})}))


ROBOT, TWO_SIDED, TWO_SPEEDS = "mecanum", "two sides", "two speeds"
LEKIWI, OMNI, STEERED = "LeKiwi", "omni wheels", "steered"
BASES = {
    ROBOT: ("mecanum", "rrc"),
    TWO_SIDED: ("differential", "rrc"),
    TWO_SPEEDS: ("differential", "ugv"),
    LEKIWI: ("omni3", "/own"),
    OMNI: ("omni3", "rrc"),
    STEERED: ("ackermann", "rrc"),
}


def known(name: str) -> Chassis:
    """Made anew in each test: so a changed function makes it (tests/mutation/README.md)."""
    return base(*BASES[name])


speed = st.floats(-10, 10)
EVERY = [("rrc", layout) for layout in LAYOUTS] + [("ugv", "differential"), ("/own", "omni3")]
every_base = pytest.mark.parametrize(("board", "layout"), EVERY)


@pytest.mark.parametrize(
    ("robot", "velocity", "printed"),
    [
        (ROBOT, (0.2, 0.0, 0.0), ["0.796", "0.796", "-0.796", "-0.796"]),
        (ROBOT, (-0.2, 0.0, 0.0), ["-0.796", "-0.796", "0.796", "0.796"]),
        (ROBOT, (0.0, 0.2, 0.0), ["-0.796", "0.796", "-0.796", "0.796"]),
        (ROBOT, (0.0, 0.0, 1.0), ["-0.694", "-0.694", "-0.694", "-0.694"]),
        (ROBOT, (0.0, 0.0, -1.0), ["0.694", "0.694", "0.694", "0.694"]),
        (TWO_SIDED, (0.2, 0.0, 0.0), ["0.796", "0.796", "-0.796", "-0.796"]),
        (TWO_SIDED, (0.0, 0.0, 1.0), ["-0.341", "-0.341", "-0.341", "-0.341"]),
        (TWO_SPEEDS, (0.2, 0.0, 0.0), ["0.796", "0.796"]),
        (TWO_SPEEDS, (0.0, 0.0, 1.0), ["-0.341", "0.341"]),
        # lerobot's lekiwi.py makes 1129 and -1129 steps of 4096 a turn of 0.1 m/s forward: 0.2756 turns a second.
        (LEKIWI, (0.1, 0.0, 0.0), ["-0.276", "0.000", "0.276"]),
        (LEKIWI, (0.0, 0.1, 0.0), ["0.159", "-0.318", "0.159"]),
        (LEKIWI, (0.0, 0.0, 1.0), ["0.398", "0.398", "0.398"]),
        (OMNI, (0.1, 0.0, 0.0), ["-0.276", "0.000", "0.276", "0.000"]),
    ],
)
def test_published_numbers(robot: str, velocity: Velocity, printed: list[str]) -> None:
    assert [f"{rps:.3f}" for rps in known(robot).wheels_rps(*velocity)] == printed


@given(speed, speed, speed)
def test_published_formulas(vx: float, vy: float, wz: float) -> None:
    k = (WHEELBASE_M + TRACK_M) / 2
    left, right = vx - wz * TRACK_M / 2, vx + wz * TRACK_M / 2
    ways = [radians(degrees - 90) for degrees in (240, 0, 120)]
    for robot, around_m, rim_mps in (
        (ROBOT, RIM_M, (vx - vy - wz * k, vx + vy - wz * k, -(vx + vy + wz * k), -(vx - vy + wz * k))),
        (TWO_SIDED, RIM_M, (left, left, -right, -right)),
        (TWO_SPEEDS, RIM_M, (left, right)),
        (LEKIWI, 0.1 * pi, [vx * cos(way) + vy * sin(way) + wz * 0.125 for way in ways]),
    ):
        expected = [mps / around_m for mps in rim_mps]
        assert known(robot).wheels_rps(vx, vy, wz) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def body(robot: str, rps: tuple[float, ...]) -> Velocity:
    """The velocity of a base whose wheels turn so: the means of what each of them says."""
    if robot == LEKIWI:
        rim = [0.1 * pi * each for each in rps]
        ways = (radians(150), radians(-90), radians(30))
        vx, vy = (2 / 3 * sum(way(a) * mps for a, mps in zip(ways, rim, strict=True)) for way in (cos, sin))
        return vx, vy, sum(rim) / 3 / 0.125
    if robot == TWO_SPEEDS:
        left, right = (RIM_M * each for each in rps)
        return (left + right) / 2, 0.0, (right - left) / TRACK_M
    a, b, c, d = (RIM_M * each * sign for each, sign in zip(rps, (1, 1, -1, -1), strict=True))
    sideways, lever = (1, WHEELBASE_M + TRACK_M) if robot == ROBOT else (0, TRACK_M)
    return (a + b + c + d) / 4, sideways * (b - a + c - d) / 4, (c + d - a - b) / 2 / lever


EVERY_BASE = [ROBOT, TWO_SIDED, TWO_SPEEDS, LEKIWI, OMNI, STEERED]


@given(speed, speed, speed)
@pytest.mark.parametrize("robot", EVERY_BASE)
def test_the_way_back_is_the_inverse_of_the_gate_s(robot: str, vx: float, vy: float, wz: float) -> None:
    chassis = known(robot)
    ahead, aside, around = chassis.axes
    velocity = chassis.reach((ahead * vx, aside * vy, around * wz))
    rps = chassis.wheels_rps(*velocity)
    # A steered base has its angle behind the wheels, which map() leaves out.
    assert chassis.velocity(rps) == pytest.approx(velocity, rel=1e-9, abs=1e-9)
    if robot not in (OMNI, STEERED):
        assert chassis.velocity(rps) == pytest.approx(body(robot, rps), rel=1e-9, abs=1e-9)


@given(st.lists(speed, min_size=4, max_size=4))
def test_mecanum_wheels_are_projected_on_what_can_roll(speeds: list[float]) -> None:
    """What is left over is the one pattern that moves nothing: the front wheels against the rear ones."""
    chassis = known(ROBOT)
    velocity = chassis.velocity(speeds)
    rolled = chassis.wheels_rps(*velocity)
    assert chassis.velocity(rolled) == pytest.approx(velocity, abs=1e-9), "a projection changes nothing again"
    rest = [sign * (asked - got) for sign, asked, got in zip((1, 1, -1, -1), speeds, rolled, strict=True)]
    front_left, rear_left, front_right, rear_right = rest
    assert (front_right, rear_left, rear_right) == pytest.approx((front_left, -front_left, -front_left), abs=1e-9)


@given(st.lists(speed, min_size=4, max_size=4), st.floats(-0.5, 0.5))
@pytest.mark.parametrize("robot", EVERY_BASE)
def test_wheel_speeds_become_a_velocity_and_the_same_wheel_speeds(
    robot: str, drawn: list[float], steering_rad: float
) -> None:
    """For a differential base, three omni wheels, and a steered base whose wheels fit a curve that it can drive."""
    layout, board = BASES[robot]
    settings = Settings({"board.kind": board, "wheels.layout": layout})
    chassis, mounted = known(robot), mounted_wheels(settings.values)
    asked = drawn[: len(mounted)]
    if robot in (ROBOT, TWO_SIDED):  # one speed more than it has ways to go
        vx, wz = drawn[0] / 10, drawn[1] / 10
        rps = chassis.wheels_rps(vx, drawn[2] / 10, wz)
        asked = [sign * 2 * pi * rps[id_] for id_, sign in mounted]
    if robot == STEERED:
        turn = tan(steering_rad) / WHEELBASE_M * TRACK_M / 2
        asked = [drawn[0] * (1 - turn), drawn[0] * (1 + turn)]
    velocity = of_wheels(chassis, mounted, asked)
    rps = chassis.wheels_rps(*velocity)
    assert [sign * 2 * pi * rps[id_] for id_, sign in mounted] == pytest.approx(asked, rel=1e-9, abs=1e-9)
    if robot == STEERED:
        assert of_wheels(chassis, mounted, asked, steering_rad) == pytest.approx(velocity, rel=1e-9, abs=1e-9)
        if abs(drawn[0]) > 1e-9:  # less is rounded
            assert rps[-1] == pytest.approx(steering_rad, abs=1e-9)


def test_an_angle_is_for_a_base_that_is_steered_and_no_more_than_it_steers() -> None:
    wheels = mounted_wheels(Settings({"wheels.layout": "ackermann"}).values)
    found = [of_wheels(known(STEERED), wheels, (2.0, 2.0), angle) for angle in (radians(34.0), 1.5)]
    assert found[0] == pytest.approx(found[1]), "its steering makes no narrower curve"
    with pytest.raises(ValueError, match=r"^this base is not steered$"):
        of_wheels(known(ROBOT), mounted_wheels(Settings().values), (1.0,) * 4, 0.1)


def test_wheels_that_all_roll_the_same_way_say_nothing_of_the_base() -> None:
    same = base("omni3", changed={f"wheels.angle_{number}_deg": 30.0 for number in (1, 2, 3)})
    with pytest.raises(ValueError, match="tell the directions"):
        same.velocity((1.0, 1.0, 1.0, 0.0))
    assert any(same.wheels_rps(0.1, 0.0, 0.0)), "the gate drives them all the same"


@pytest.mark.parametrize("scale", [1e-7, 1.0, 1e7])
@pytest.mark.parametrize("third_deg", [30.0, 30.0 + 1e-9])
def test_wheels_are_told_apart_by_their_angles_and_not_by_their_size(scale: float, third_deg: float) -> None:
    """A difference that only rounding has made tells nothing, on a base of any size."""
    ways = [(cos(radians(deg)), sin(radians(deg)), 0.2) for deg in (30.0, 30.0, third_deg)]
    mounted = [(0, 1), (1, 1), (2, 1)]
    with pytest.raises(ValueError, match="tell the directions"):
        Chassis((1.0, 1.0, 1.0), ways, scale, mounted, 3).rolled()
    ways = [(cos(radians(deg)), sin(radians(deg)), 0.2) for deg in (30.0, 150.0, 270.0)]
    velocity = Chassis((1.0, 1.0, 1.0), ways, scale, mounted, 3).velocity((1.0, 1.0, 1.0))
    assert velocity == pytest.approx((0.0, 0.0, pi * scale / 0.2), abs=1e-9 * scale)


def test_wheels_that_roll_by_nothing_say_nothing_of_the_base() -> None:
    with pytest.raises(ValueError, match="tell the directions"):
        Chassis((1.0, 0.0, 1.0), [(0.0, 0.0, 0.0)] * 2, DIAMETER_M, [(0, 1), (1, 1)], 2).rolled()


@pytest.mark.parametrize("wz", [0.3, 100.0], ids=["as asked", "tighter than it can steer"])
def test_no_wheel_of_a_steered_base_is_faster_than_its_outer_one_in_the_tightest_curve(wz: float) -> None:
    vx, shares = 0.4, [share / 10 for share in range(-10, 11)]
    speeds = [known(STEERED).wheels_rps(vx * ahead, 0.0, wz * turn)[:-1] for ahead in shares for turn in shares]
    fastest = max(abs(rps) for both in speeds for rps in both)
    assert known(STEERED).worst_rps(vx, 0.0, wz) == pytest.approx(fastest)
    assert fastest * STEERED_RIM_M > vx, "the outer wheel goes further than the base"


@pytest.mark.claim("LIMIT-1")
@given(speed, speed, speed, st.floats(0, 1))
@pytest.mark.parametrize("robot", [ROBOT, TWO_SIDED, TWO_SPEEDS, LEKIWI])
def test_wheels_move_the_base_as_asked_and_a_limit_scales_all_alike(
    robot: str, vx: float, vy: float, wz: float, share: float
) -> None:
    chassis = known(robot)
    asked = tuple(axis * value for axis, value in zip(chassis.axes, (vx, vy, wz), strict=True))
    rps = chassis.wheels_rps(vx, vy, wz)
    assert body(robot, rps) == pytest.approx(asked, rel=1e-9, abs=1e-9)
    limited = chassis.wheels_rps(*(share * value for value in (vx, vy, wz)))
    assert limited == pytest.approx([share * each for each in rps], rel=1e-9, abs=1e-9)


@given(st.floats(0, 10), st.floats(0, 10), st.floats(0, 10))
@pytest.mark.parametrize("robot", [ROBOT, TWO_SIDED, TWO_SPEEDS, LEKIWI, OMNI])
def test_no_wheel_turns_faster_within_limits_than_the_worst_and_one_does_as_fast(
    robot: str, vx: float, vy: float, wz: float
) -> None:
    corners = [(vx * a, vy * b, wz * c) for a, b, c in product((1, -1), repeat=3)]
    fastest = max(max(map(abs, known(robot).wheels_rps(*corner))) for corner in corners)
    assert known(robot).worst_rps(vx, vy, wz) == pytest.approx(fastest)


STEERED_RIM_M, STEEREST = pi * 0.085, radians(34)


@given(speed, speed)
@example(5e-324, 1.0)
def test_a_steered_base_goes_along_the_curve_that_its_wheels_make(vx: float, wz: float) -> None:
    """The rear wheels and the angle in front each say how it turns."""
    asked = known(STEERED).reach((vx, 1.0, wz))
    _, left, _, right, angle = known(STEERED).wheels_rps(vx, 1.0, wz)
    left_mps, right_mps = STEERED_RIM_M * left, -STEERED_RIM_M * right
    turns = (right_mps - left_mps) / TRACK_M
    assert ((left_mps + right_mps) / 2, 0.0, turns) == pytest.approx(asked, rel=1e-9, abs=1e-9)
    assert vx * tan(angle) / WHEELBASE_M == pytest.approx(turns, rel=1e-9, abs=1e-9)
    assert abs(angle) <= STEEREST * (1 + 1e-12)
    if abs(wz) * WHEELBASE_M < abs(vx) * tan(STEEREST):
        assert asked == (vx, 0.0, wz), "a wider curve than its narrowest"


def test_a_steered_base_does_not_turn_on_the_spot() -> None:
    steered = known(STEERED)
    assert steered.wheels_rps(0.0, 0.0, 1.0) == steered.rest
    assert steered.wheels_rps(1.0, 0.0, 0.0)[-1] == steered.wheels_rps(0.0, 0.0, 0.0)[-1] == 0.0
    assert steered.reach((0.0, 0.0, 1.0)) == (0.0, 0.0, 0.0)
    assert steered.wheels_rps(-0.1, 0.0, 0.1)[-1] < 0, "backward to the left it is steered to the right"


@given(speed, speed)
def test_cancelling_speeds_leave_a_wheel_at_the_bytes_of_zero(vx: float, wz: float) -> None:
    frame = codec.motor_speeds(known(ROBOT).wheels_rps(vx, vx, 0.0), 1000.0)
    assert frame[7:11] == bytes(4), "wire id 0 stands when forward and left cancel"
    assert codec.check_motion(codec.motor_speeds(known(ROBOT).wheels_rps(vx, -vx, wz), 1000.0), 1000.0) == ""


@pytest.mark.parametrize(("degrees", "velocity"), [(180, (0.0, 0.1, 0.0)), (90, (0.1, 0.0, 0.0))])
def test_an_omni_wheel_across_the_way_stands(degrees: float, velocity: Velocity) -> None:
    rps = base("omni3", "/own", {"wheels.angle_1_deg": degrees}).wheels_rps(*velocity)
    assert rps[0] == 0.0
    assert any(rps[1:])


def test_a_differential_base_has_its_settings_and_goes_nowhere_sideways() -> None:
    chosen = base("differential", "rrc", {"wheels.diameter_m": 0.1, "wheels.track_m": 0.4})
    assert chosen.axes == (1.0, 0.0, 1.0)
    right_rps = -0.4 / (pi * 0.1)
    for vy in (0.0, 5.0):
        found = chosen.wheels_rps(0.2, vy, 1.0)
        assert found == pytest.approx((0.0, 0.0, right_rps, right_rps)), "about its left wheels"
        assert known(TWO_SIDED).worst_rps(0.2, vy, 1.0) == known(TWO_SIDED).worst_rps(0.2, 0.0, 1.0)


def test_a_layout_without_kinematics_is_refused_by_name() -> None:
    class Tracks(Settings):
        def text(self, key: str) -> str:
            return "tracks"

    with pytest.raises(ValueError, match=r"wheels\.layout = 'tracks'"):
        from_settings(Tracks())


@pytest.mark.parametrize("layout", LAYOUTS)
def test_zero_is_the_stop_frame_in_every_mounting(layout: str) -> None:
    """Zeros of either sign."""
    settings = Settings({"wheels.layout": layout})
    count, board = len(mounted_wheels(settings.values)), board_of(*settings.board())
    for signs in product((1, -1), repeat=count):
        mounting = {f"wheels.sign_{number}": sign for number, sign in enumerate(signs, 1)}
        mounting |= {f"wheels.id_{number}": wire_id for number, wire_id in enumerate((3, 1, 0, 2)[:count], 1)}
        robot = base(layout, "rrc", mounting)
        for velocity in product((0.0, -0.0), repeat=3):
            speeds = robot.wheels_rps(*velocity)
            assert speeds == robot.rest
            assert [copysign(1.0, rps) for rps in speeds] == [1.0] * len(speeds)
            assert board.motor_speeds(speeds, 0.0) == board.stop


@every_base
def test_a_sign_turns_one_wheel_and_each_goes_to_its_wire_id(board: str, layout: str) -> None:
    settings = Settings({"board.kind": board, "wheels.layout": layout})
    default = from_settings(settings).wheels_rps(0.2, 0.1, 0.5)
    wheels = mounted_wheels(settings.values)
    assert len(wheels) in WHEEL_NAMES
    for wheel, (wire_id, sign) in enumerate(wheels, 1):
        now = base(layout, board, {f"wheels.sign_{wheel}": -sign}).wheels_rps(0.2, 0.1, 0.5)
        assert now == tuple(-old if at == wire_id else old for at, old in enumerate(default))
        assert default[wire_id] != 0.0
    for ids in permutations(range(settings.speeds), len(wheels)):
        changed = {f"wheels.id_{wheel}": wire_id for wheel, wire_id in enumerate(ids, 1)}
        by_id = base(layout, board, changed).wheels_rps(0.2, 0.1, 0.5)
        assert [by_id[wire_id] for wire_id in ids] == [default[wire_id] for wire_id, _ in wheels]
        assert not any(by_id[wire_id] for wire_id in range(settings.speeds) if wire_id not in ids), "no wheel is there"
