"""Layouts: how many wheels a robot has, their names, and their settings. Pure. The board determines how many speeds are
in a frame. The layout determines how many wheels the robot has. Speeds without a wheel are zero."""

from __future__ import annotations

from math import radians

from failstop.board.kinds import ALL_KINDS, facts_of
from failstop.policy import robots
from failstop.policy.setting import Setting, SettingError, all_differ

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    Values = Mapping[str, float | str]

BOARDS = ALL_KINDS
"""The kinds of boards. Each is a folder in failstop/board."""
ACKERMANN = "ackermann"
LAYOUTS: dict[str, tuple[int, ...]] = {"mecanum": (4,), "differential": (2, 4), "omni3": (3,), ACKERMANN: (1, 2)}
"""The numbers of wheels that a base with each layout may have. With a board that a user has described, the smallest of
these numbers is used. With any other board, it is the largest number for which a frame of the board has enough
speeds."""
SERVOS = ("pwm", "bus")
"""The kinds of servos that can steer."""
WHEEL_NAMES = {
    1: ("rear",),
    2: ("left", "right"),
    3: ("left", "rear", "right"),
    4: ("front left", "rear left", "front right", "rear right"),
}
"""The names of the wheels in the order of their numbers, for each number of wheels."""
NUMBERS = (1, 2, 3, 4)
OF_THE_BASE = (
    Setting(
        "wheels.layout",
        "mecanum",
        "",
        None,
        None,
        "what kind of base the robot has. failstop uses it to turn the robot's velocity into wheel speeds",
        tuple(LAYOUTS),
    ),
    Setting(
        "wheels.diameter_m",
        0.08,
        "m",
        0.02,
        1.0,
        "wheel diameter. If the robot goes further than commanded, the true diameter is larger than this",
    ),
    Setting("wheels.wheelbase_m", 0.17706, "m", 0.01, 3.0, "distance between the front and the rear axle"),
    Setting("wheels.track_m", 0.17165, "m", 0.01, 3.0, "distance between the left and the right wheels"),
    Setting("wheels.lever_m", 0.125, "m", 0.01, 3.0, "distance of each wheel from the middle of the robot (omni3)"),
    *(
        Setting(
            f"wheels.angle_{number}_deg",
            way,
            "degrees",
            0.0,
            360.0,
            f"the direction in which wheel {number} rolls, counter-clockwise from forward (omni3)",
        )
        for number, way in zip(NUMBERS, (150.0, 270.0, 30.0), strict=False)
    ),
    *(
        Setting(
            f"wheels.sign_{number}",
            sign,
            "",
            None,
            None,
            f"-1 if wheel {number} turns backward when it should turn forward. `failstop setup` finds it",
            (1, -1),
        )
        for number, sign in zip(NUMBERS, (1, 1, -1, -1), strict=True)
    ),
    *(
        Setting(
            f"wheels.id_{number}",
            number - 1,
            "",
            0,
            3,
            f"the id of the motor that turns wheel {number}. No two wheels may have the same; `failstop setup` "
            "finds it",
        )
        for number in NUMBERS
    ),
    Setting(
        "steering.kind",
        "pwm",
        "",
        None,
        None,
        "what kind of servo steers. A pulse of a pwm servo is 1 us, and one of a bus servo is 0.24 degrees",
        SERVOS,
    ),
    Setting("steering.servo", 3, "", 1, 253, "the id of the servo that steers. A pwm servo has 1 to 4"),
    Setting("steering.centre", 1500, "", 1, 2500, "the steering servo's position for straight ahead, in pulses"),
    Setting(
        "steering.per_rad",
        636.62,
        "",
        1.0,
        2000.0,
        "by how many pulses the steering servo moves to steer by one radian",
    ),
    Setting("steering.sign", -1, "", None, None, "-1 if more pulses steer to the right", (1, -1)),
    Setting("steering.most_deg", 34.0, "degrees", 1.0, 60.0, "the largest angle to which the wheels may be steered"),
)
DEFAULTS: dict[str, dict[str, float | str]] = {
    "omni3": {"wheels.diameter_m": 0.1, "wheels.sign_3": 1},
    ACKERMANN: {"wheels.id_1": 1, "wheels.id_2": 3, "wheels.sign_2": -1},
}
"""Defaults that depend on the layout. The defaults for omni3 are those of the robot LeKiwi (lerobot's lekiwi.py), and
the defaults for ackermann are those of ROSOrin. A board may replace them with its own (Facts.defaults,
Facts.steered_defaults)."""
_FIRST_LAYOUT = {2: "differential", 3: "omni3"}
"""The layout of a robot whose settings name none. The keys are numbers of speeds in a frame of the board. For every
other number, the default of wheels.layout is used."""
_GEOMETRY: dict[str, tuple[str, ...]] = {
    "wheels.wheelbase_m": ("mecanum", "differential", ACKERMANN),
    "wheels.track_m": ("mecanum", "differential", ACKERMANN),
    "wheels.lever_m": ("omni3",),
    **{f"wheels.angle_{number}_deg": ("omni3",) for number in NUMBERS[:3]},
    **{f"steering.{key}": (ACKERMANN,) for key in ("kind", "servo", "centre", "per_rad", "sign", "most_deg")},
}
"""The settings that exist only for some of the layouts, each with those layouts."""


def speeds_of(kind: str, layout: str = "") -> int | None:
    """How many speeds are in a frame for this kind of board and this layout. None for a board that a user has
    described, because it takes as many speeds as the layout has wheels."""
    facts = facts_of(kind)
    return facts.layouts.get(layout, facts.speeds) if facts else None


def steers(kind: str) -> bool:
    """True if this kind of board can turn the steering servo of a steered base."""
    facts = facts_of(kind)
    return bool(facts and facts.steers)


def drivable(kind: str, speeds: int) -> list[str]:
    """The layouts that this kind of board can drive. `speeds`: how many speeds are in a frame, used only for a board
    that a user has described."""
    return [
        name
        for name, counts in LAYOUTS.items()
        if counts[0] <= (speeds_of(kind, name) or speeds) and (name != ACKERMANN or steers(kind))
    ]


def wheel_count(kind: str, layout: str) -> int:
    """The number of driven wheels. Raises SettingError if this kind of board can't drive the layout."""
    if layout == ACKERMANN and not steers(kind):
        raise SettingError(f'wheels.layout = "{layout}": board.kind {kind} can\'t move a servo that steers')
    if (speeds := speeds_of(kind, layout)) is None:
        return LAYOUTS[layout][0]
    if fitting := [count for count in LAYOUTS[layout] if count <= speeds]:
        return fitting[-1]
    others = " or ".join(f'"{name}"' for name in drivable(kind, speeds) if name != ACKERMANN)
    has = f"such a base has {LAYOUTS[layout][0]} wheels, but board.kind {kind} drives {speeds}"
    raise SettingError(f'wheels.layout = "{layout}": {has}; use {others}')


def wheel_ids(given: Mapping[str, str]) -> list[int]:
    """The id on the wire of each wheel's motor. `given`: settings as texts. A setting that is not given has its
    default."""
    found = {**{setting.key: str(setting.default) for setting in OF_THE_BASE}, "board.kind": BOARDS[0], **given}
    numbers = NUMBERS[: wheel_count(found["board.kind"], found["wheels.layout"])]
    return [int(found[f"wheels.id_{number}"]) for number in numbers]


def fill_base(values: dict[str, float | str], changed: Collection[str]) -> None:
    """Fill in the defaults that depend on the layout, and remove settings that this robot does not have. `changed`: the
    keys that the user has set. Raises SettingError if the user has set a setting that the robot does not have."""
    kind = str(values["board.kind"])
    facts = facts_of(kind)
    if facts and not facts.imu:
        values["board.imu"] = "off"
    if "wheels.layout" not in changed:
        values["wheels.layout"] = _FIRST_LAYOUT.get(facts.speeds if facts else 2, values["wheels.layout"])
        if kind == BOARDS[0]:
            values["wheels.layout"] = robots.LAYOUT_OF.get(str(values["board.robot"]), values["wheels.layout"])
    layout = str(values["wheels.layout"])
    steered = facts.steered_defaults if facts and layout == ACKERMANN else {}
    for own in (DEFAULTS.get(layout, {}), facts.defaults if facts else {}, steered):
        values |= {key: value for key, value in own.items() if key not in changed}
    absent = _absent(layout, wheel_count(kind, layout))
    if not (facts and facts.can):
        absent["board.can_id"] = f"board.kind {kind} has no motor on CAN"
    elif speeds_of(kind, layout) == 1:
        absent["board.can_id"] = f'with wheels.layout "{layout}" there is only one motor'
    if kind != BOARDS[0]:
        absent["board.robot"] = f"it is only for robots with the board {BOARDS[0]}, but board.kind is {kind}"
    for key, why in absent.items():
        if key in changed:
            raise SettingError(f"{key}: {why}, so remove it")
        del values[key]
    if "board.robot" in values:
        robots.fill_figures(values, changed)
    elif "odometry.sideways_scale" not in changed:
        values["odometry.sideways_scale"] = 1.0  # the default is how much the rollers of ROSOrin's mecanum wheels slip


def _absent(layout: str, count: int) -> dict[str, str]:
    """The settings that a robot with this layout and number of wheels does not have, each with the reason."""
    named = ", ".join(f"{number} {name}" for number, name in zip(NUMBERS, WHEEL_NAMES[count], strict=False))
    beyond = f"this robot has {count} wheels ({named})"
    found = {f"wheels.{what}_{number}": beyond for what in ("sign", "id") for number in NUMBERS[count:]}
    return found | {
        key: f'a base with wheels.layout "{layout}" has none' for key, of in _GEOMETRY.items() if layout not in of
    }


def check_base(values: Values) -> None:
    """Check the ids of the motors, and the steering servo. Two motors must not have the same id, and the board must
    know every id. The steering servo must be one that the board can move, and must reach the largest steering angle.
    Raises SettingError."""
    ids = {key: value for key, value in values.items() if key.startswith("wheels.id_")}
    all_differ(ids)
    kind = str(values["board.kind"])
    facts = facts_of(kind)
    most = ((facts and facts.most) or speeds_of(kind, str(values["wheels.layout"])) or len(ids)) - 1
    for key, value in ids.items():
        if int(value) > most:
            raise SettingError(f"{key} = {value}: on board.kind {kind}, ids go from 0 to {most}")
    if "steering.servo" in values:
        steered, servo = str(values["steering.kind"]), int(values["steering.servo"])
        if not facts or steered not in facts.steers:
            has = ", ".join(facts.steers) if facts else ""
            raise SettingError(f'steering.kind = "{steered}": on board.kind {kind} it must be {has}')
        least, most, highest = facts.steers[steered]
        centre, per_rad, angle = (float(values[f"steering.{key}"]) for key in ("centre", "per_rad", "most_deg"))
        far = per_rad * radians(angle)
        if servo > highest:
            raise SettingError(f"steering.servo = {servo}: the id of a {steered} servo is 1 to {highest}")
        if far > min(centre - least, most - centre):
            reach = f"steering.most_deg = {angle:g} is {far:.0f} pulses to each side of steering.centre = {centre:g}"
            raise SettingError(f"{reach}, but a {steered} servo goes only from {least} to {most}")
