"""Settings: every setting, declared once with its default, unit, range and meaning.

`failstop run` reads and checks them once (failstop/config.py); the processes get them as `key=value` lines. Command
sources, interlocks and an arm's joints are tables that the user names: [sources.NAME], [interlocks.NAME],
[joints.NAME]. One source always exists: cmd_vel.
"""

from __future__ import annotations

from math import radians

from failstop.board.facts import USUAL_CAN_ID, SteeringServo
from failstop.board.kinds import facts_of
from failstop.policy import layouts, robots
from failstop.policy.layouts import BOARDS, NUMBERS
from failstop.policy.setting import Setting, SettingError, all_differ, shown

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.facts import ArmFacts

SETTINGS_VARIABLE = "FAILSTOP_SETTINGS"
"""The environment variable in which a process finds them."""


def _word(key: str, default: float | str, doc: str, allowed: tuple[int, ...] | tuple[str, ...] = ()) -> Setting:
    """A setting with a few allowed words, or any text."""
    return Setting(key, default, "", None, None, doc, allowed)


SWITCH = ("on", "off")
BAUDS = (0, 57600, 115200, 230400, 460800, 500000, 921600, 1000000)
DEATHS = ("disable", "latch", "stay")
ANSWERS_TO_SILENCE = ("wait", "disable", "latch")
TURNS = ("none", "yaw", "pitch", "roll")
WEB_TLS = ("auto", "on", "off")

DECLARED = (
    _word("device.path", "/dev/ttyACM0", "the motor board's port"),
    Setting("board.kind", BOARDS[0], "", None, None, "the motor board", BOARDS, or_folder=True),
    _word(
        "board.robot",
        robots.USUAL_ROBOT,
        f"the robot, of those with the board {BOARDS[0]}: its sizes",
        tuple(robots.EVERY_ROBOT),
    ),
    _word("board.baud", 0, "the baud rate that its firmware is built with; 0: as usual for this board", BAUDS),
    Setting(
        "board.can_id",
        USUAL_CAN_ID,
        "",
        0,
        253,
        "the CAN id of the second motor's controller, where a board has it on a CAN",
    ),
    Setting("board.per_rps", 0.0, "", 0.0, 100000.0, "a wheel's turn a second in the board's own unit; 0: as usual"),
    Setting(
        "board.per_rps_confirmed",
        0.0,
        "",
        0.0,
        100000.0,
        "the board.per_rps that a turn of a wheel has confirmed, so speeds are not capped; setup writes it; 0: none",
    ),
    _word("board.imu", "on", "off for a robot without an IMU, as a board that has none sets it by itself", SWITCH),
    Setting("gate.period_s", 0.02, "s", 0.005, 0.05, "time between two decisions of the gate"),
    Setting("gate.command_timeout_s", 0.3, "s", 0.05, 2.0, "an older command moves nothing; a source can have its own"),
    Setting("gate.refresh_s", 0.2, "s", 0.02, 1.0, "while enabled, resend the motor frame at least this often"),
    Setting("gate.lease_s", 0.06, "s", 0.04, 1.0, "longest silence of a process; unset, 0.2 without real-time rights"),
    _word("gate.driver_death", "disable", "answer to the death of a program that has driven", DEATHS),
    _word(
        "gate.driver_silence",
        "wait",
        "what to do when a program stops sending commands while it drives: wait for its next one, disable, or latch",
        ANSWERS_TO_SILENCE,
    ),
    Setting("limits.vx_mps", 0.2, "m/s", 0.01, 3.0, "fastest forward and backward"),
    Setting("limits.vy_mps", 0.2, "m/s", 0.01, 3.0, "fastest sideways"),
    Setting("limits.wz_radps", 1.0, "rad/s", 0.01, 10.0, "fastest turn"),
    Setting("limits.acceleration_mps2", 0.5, "m/s2", 0.01, 20.0, "ramp of vx and vy"),
    Setting("limits.acceleration_radps2", 2.0, "rad/s2", 0.01, 100.0, "ramp of wz"),
    Setting("limits.braking_mps2", 1.0, "m/s2", 0.05, 20.0, "how the base slows down when it is told zero; measure it"),
    *layouts.OF_THE_BASE,
    _word("scan.gate", "on", "software commands move nothing while the sensor is silent", SWITCH),
    Setting("scan.timeout_s", 0.5, "s", 0.05, 10.0, "an obstacle sensor silent for this long blocks (no scan)"),
    _word("attend.required", "off", "motion needs an operator who keeps confirming that he is there", SWITCH),
    Setting("attend.lease_s", 1.0, "s", 0.3, 10.0, "an operator who is not heard for this long is gone: stop, latched"),
    Setting("imu.offset_x_g", 0.0, "g", -1.0, 1.0, "subtracted from the raw acceleration along x"),
    Setting("imu.offset_y_g", 0.0, "g", -1.0, 1.0, "subtracted from the raw acceleration along y"),
    Setting("imu.offset_z_g", 0.0, "g", -1.0, 1.0, "subtracted from the raw acceleration along z"),
    Setting("imu.scale_x", 1.0, "", 0.5, 2.0, "factor of the acceleration along x, less its offset"),
    Setting("imu.scale_y", 1.0, "", 0.5, 2.0, "factor of the acceleration along y, less its offset"),
    Setting("imu.scale_z", 1.0, "", 0.5, 2.0, "factor of the acceleration along z, less its offset"),
    Setting("imu.calibration_s", 3.0, "s", 0.1, 60.0, "the gyro's bias at the start: its mean over this long"),
    Setting("imu.calibration_std_dps", 0.3, "deg/s", 0.01, 10.0, "an axis that spreads more was not at rest: no bias"),
    _word("imu.tracking", "on", "tracking: the gyro's bias follows the reading at rest", SWITCH),
    Setting("imu.tracking_rest_s", 1.0, "s", 0.1, 60.0, "tracking begins after zero commanded for this long"),
    Setting("imu.tracking_band_dps", 0.5, "deg/s", 0.01, 10.0, "tracking takes readings this close to the bias only"),
    Setting("imu.tracking_tau_s", 20.0, "s", 0.1, 3600.0, "time constant of tracking"),
    Setting("odometry.forward_scale", 1.0, "", 0.1, 2.0, "way made per way that wheels roll, forward (odometry)"),
    Setting("odometry.sideways_scale", 0.765, "", 0.1, 2.0, "way made per way that wheels roll, sideways (odometry)"),
    Setting("odometry.twist_std_mps", 0.05, "m/s", 0.0, 10.0, "standard deviation of the odometry's speeds"),
    Setting("odometry.twist_std_radps", 0.2, "rad/s", 0.0, 10.0, "standard deviation of the odometry's turn rate"),
    Setting("battery.step_mv", 190, "mV", 10, 5000, "a step of this much is the charger plugged in or pulled out"),
    Setting("battery.stop_mv", -1, "mV", -1, 60000, "stop, latched, when the voltage stays below this; -1: never"),
    _word("battery.log", "on", "write the battery's voltage to a file a day", SWITCH),
    Setting("battery.log_s", 10.0, "s", 1.0, 3600.0, "time between two lines of the battery's log"),
    _word("battery.directory", "", "directory of the battery's log; empty: the state directory"),
    Setting("pad.mode_button", 0x2000, "", 1, 0x8000, "the gamepad's MODE button, which alone is no stop; one bit"),
    Setting("pad.dead_zone", 0.1, "", 0.01, 0.9, "a stick this close to its middle (of 1) commands nothing"),
    Setting("pad.mode_lockout_s", 0.6, "s", 0.1, 5.0, "MODE does not change the mode again for this long"),
    Setting("pad.reset_hold_s", 2.0, "s", 0.5, 30.0, "MODE held for this long while latched is a reset"),
    Setting(
        "pad.frozen_s", 15.0, "s", 3.0, 600.0, "a pushed stick that has not changed for this long locks the gamepad"
    ),
    Setting("link.ping_s", 0.5, "s", 0.1, 0.5, "time between two pings, which the board answers"),
    Setting("link.deaf_s", 1.0, "s", 1.0, 60.0, "a board that has answered before and is silent for this long is deaf"),
    Setting("still.std_radps", 0.0035, "rad/s", 0.0001, 1.0, "gyro x and y vary less than this: the wheels are still"),
    Setting(
        "still.after_s",
        1.5,
        "s",
        0.2,
        60.0,
        "wheels that turn so long after they were told zero are stopped again",
    ),
    _word("still.command", "", "command to run when wheels are not still after a stop; empty: none"),
    Setting("stop.wait_s", 30.0, "s", 0.0, 3600.0, "`failstop stop` tries to have the port for this long"),
    Setting("key.stop", 1, "", 1, 255, "the board key that stops"),
    Setting("arm.period_s", 0.04, "s", 0.02, 0.055, "a joint that moves is sent one move of this length after another"),
    Setting("arm.goal_timeout_s", 0.5, "s", 0.1, 5.0, "a goal that is not renewed for this long holds the arm"),
    Setting(
        "arm.unwatched_s", 3.0, "s", 0.1, 30.0, "longest goal of ROS's topic arm/goal, whose sender can die unseen"
    ),
    Setting("arm.pose_speed", 0.5, "", 0.05, 1.0, "share of each joint's speed on the way to a pose"),
    Setting("arm.drive_tolerance", 30, "", 1, 200, "pulses that a joint may be off the drive pose to enable motion"),
    Setting("arm.drive_pan", -1, "", -1, 4095, "where the base joint is for driving; -1: wherever it is"),
    Setting("arm.base_servo", 1, "", 1, 100, "the servo of the joint that arm.drive_pan is for"),
    _word("arm.absent", "refuse", "enabling motion while no servo of the arm answers", ("refuse", "ignore")),
    _word("arm.auto_tuck", "on", "an arm that is left alone goes to its tuck pose", SWITCH),
    Setting("arm.auto_tuck_s", 120.0, "s", 1.0, 86400.0, "an arm left alone for this long is tucked (arm.auto_tuck)"),
    Setting("arm.tuck_notice_s", 5.0, "s", 0.1, 60.0, "time from the tone that announces a tuck to the tuck"),
    _word("arm.collision", "off", "refuse a move that would hit the arm, the chassis or the floor", SWITCH),
    Setting("arm.mount_x_m", 0.0, "m", -1.0, 1.0, "place of the arm's mount, forward of the chassis' middle"),
    Setting("arm.mount_z_m", 0.1, "m", 0.0, 2.0, "height of the arm's mount above the floor"),
    Setting("arm.chassis_length_m", 0.3, "m", 0.0, 3.0, "length of the chassis' capsule, along the robot"),
    Setting("arm.chassis_radius_m", 0.08, "m", 0.0, 1.0, "radius of the chassis' capsule"),
    Setting("arm.chassis_z_m", 0.08, "m", 0.0, 1.0, "height of the chassis' middle above the floor"),
    Setting("arm.hot_c", 70, "degrees Celsius", 30, 84, "warn of a servo as hot as this: at 85 it lets go"),
    Setting("arm.low_mv", 6000, "mV", 1000, 30000, "warn of a servo with less supply than this: it lets go below"),
    _word("buzzer.tones", "off", "the board sounds on a stop and on a change of the pad's mode", SWITCH),
    _word("incidents.save", "on", "keep the black box in a file after each latched stop", SWITCH),
    Setting("incidents.keep", 50, "", 1, 10000, "most files of incidents; the oldest go first"),
    Setting("incidents.max_mb", 100, "MB", 1, 100000, "most room of all incidents; the newest stays in any case"),
    _word("web.address", "127.0.0.1", "address at which the operator's page (`failstop web`) listens"),
    Setting("web.port", 8477, "", 0, 65535, "port of the operator's page; 0: any that is free"),
    _word("web.hosts", "", "names that the page answers to, with blanks between; its own always"),
    _word("web.origin", "", "the page's address in a browser where a proxy ends TLS: https://robot.example"),
    _word("web.tls", "auto", "HTTPS; auto: unless only this machine is listened to", WEB_TLS),
    _word("web.pairing", "off", "paired devices may reset and enable; others see and stop", SWITCH),
    _word("web.drive", "off", "paired devices that attend (attend.required) may drive with a thumb stick", SWITCH),
    _word("guard.path", "", "where a driver opens the guard port; empty: `port` in the runtime directory"),
    Setting(
        "guard.timeout_s",
        0.3,
        "s",
        0.05,
        2.5,
        "how long the last motion of a driver at the guard port counts; raise it for one that writes a speed and waits",
    ),
    Setting("guard.openers", 0, "", 0, 4, "programs that may have the guard port open; 0: as the usual driver has it"),
    _word("guard.hang_up", "off", "on: hang up on a driver that wants to move while motion is not enabled", SWITCH),
    _word("guard.pins", "", 'pins that a driver may set, on a board that has pins, with blanks between: "4 11"'),
    Setting("restart.deaths", 5, "", 1, 100000, "deaths of a process in the window: then down until a reset"),
    Setting("restart.window_s", 60.0, "s", 1.0, 3600.0, "window in which deaths of a process are counted"),
    Setting("restart.backoff_s", 0.1, "s", 0.001, 2.0, "wait before the second restart in the window; then doubled"),
)

# Tables that the user names: [sources.NAME] and [interlocks.NAME].
FAMILIES = {
    "sources": (
        Setting("priority", 0, "", 0, 100, "a source of a higher priority takes over at once"),
        Setting("timeout_s", 0.3, "s", 0.05, 2.0, "silence after which a source is out; unset: gate.command_timeout_s"),
    ),
    "interlocks": (
        Setting("timeout_s", 0.5, "s", 0.05, 10.0, "an interlock not asserted for this long is not satisfied"),
        _word("refusal", "", "what a refused enable is told; empty: interlock NAME is not satisfied"),
    ),
    "joints": (
        Setting("servo", 0, "", 1, 100, "the id of the joint's bus servo; every joint has one of its own"),
        Setting(
            "zero", 500, "", 0, 4095, "pulses (0.24 degrees each, LeKiwi's 0.088) at which the joint's angle is zero"
        ),
        _word("sign", 1, "-1: more pulses are a smaller angle", (1, -1)),
        Setting("low", 0, "", 0, 4094, "a joint is sent below so many pulses only on its way back up"),
        Setting("high", 1000, "", 1, 4095, "a joint is sent above so many pulses only on its way back down"),
        Setting("offset", 0, "", -2047, 2047, "homing offset of LeRobot's calibration, for its host at the guard port"),
        Setting("speed_radps", 1.0, "rad/s", 0.01, 6.0, "fastest turn of the joint"),
        Setting("acceleration_radps2", 4.0, "rad/s2", 0.05, 50.0, "ramp of the joint"),
        Setting("tuck", -1, "", -1, 4095, "pulses in the tuck pose; -1: the joint is no part of it"),
        Setting("drive", -1, "", -1, 4095, "pulses in the drive pose; -1: the joint is no part of it"),
        _word("turns", "none", "axis on which the joint turns the links after it: vertical, across, their own", TURNS),
        Setting("length_m", 0.0, "m", 0.0, 2.0, "from this joint to the next one"),
        Setting("radius_m", 0.03, "m", 0.0, 0.5, "radius of the link from this joint to the next one"),
        _word("judged", "on", "enabling motion asks whether the joint is in the drive pose", SWITCH),
    ),
}
MOST_OF_A_FAMILY = 8
LONGEST_NAME = 16
NAME_CHARACTERS = frozenset("abcdefghijklmnopqrstuvwxyz0123456789_-")
FIRST_SOURCE = "cmd_vel"
PAD_SOURCE = "gamepad"

BY_KEY = {setting.key: setting for setting in DECLARED}
MOST_TOLD = 8
"""How many wrong settings one message lists."""


def mounted_wheels(values: dict[str, float | str]) -> list[tuple[int, int]]:
    """The id on the wire and the sign of each wheel's motor, in the order of the wheels' numbers. `values`: all
    settings, by key."""
    numbers = [number for number in NUMBERS if f"wheels.id_{number}" in values]
    return [(int(values[f"wheels.id_{number}"]), int(values[f"wheels.sign_{number}"])) for number in numbers]


UNATTENDED_DRIVE = 'web.drive = "on" needs attend.required = "on"'
"""Why nobody can drive from the page by settings that say otherwise."""


class Settings:
    """A complete, checked set of values."""

    __slots__ = ("named", "values")

    def __init__(self, changed: dict[str, object] | None = None) -> None:
        """Raises SettingError for unknown keys, wrong types and values out of range (all at once), or for values that
        contradict each other.

        An empty dict as a value is an empty table: for a source or an interlock, one with every default.
        """
        self.values: dict[str, float | str] = {setting.key: setting.default for setting in DECLARED}
        # Family, name, key: every value of every named table.
        self.named: dict[str, dict[str, dict[str, float | str]]] = {family: {} for family in FAMILIES}
        self.named["sources"][FIRST_SOURCE] = {}
        wrong = []
        for key, value in (changed or {}).items():
            try:
                self._set(key, value)
            except SettingError as error:
                wrong.append(str(error))
        if wrong:
            more = f"; and {len(wrong) - MOST_TOLD} more" if len(wrong) > MOST_TOLD else ""
            raise SettingError("; ".join(wrong[:MOST_TOLD]) + more)
        layouts.fill_base(self.values, changed or {})
        self._fill_named()
        self._cross_check()

    def _set(self, key: str, value: object) -> None:
        if key in BY_KEY:
            self.values[key] = BY_KEY[key].check(value)
        elif key.partition(".")[0] in FAMILIES:
            self._set_named(key, value)
        elif not (value == {} and any(known.startswith(f"{key}.") for known in BY_KEY)):
            raise _unknown(key)

    def _set_named(self, key: str, value: object) -> None:
        family, _, rest = key.partition(".")
        name, _, last = rest.partition(".")
        if value == {} and not rest:
            return
        if not name or not (last or value == {}):
            raise SettingError(f"{key} = {shown(value)}: a table is expected, [{family}.NAME]")
        if len(name) > LONGEST_NAME or not NAME_CHARACTERS.issuperset(name):
            raise SettingError(f"{family}.{name!r}: allowed as a name is 1 to {LONGEST_NAME} of a-z 0-9 _ -")
        if family == "sources" and name == PAD_SOURCE:
            raise SettingError(f"{key}: the board's gamepad is a source above all others, with no settings")
        table = self.named[family].setdefault(name, {})
        if len(self.named[family]) > MOST_OF_A_FAMILY:
            most = f"at most {MOST_OF_A_FAMILY} {family} are allowed"
            hint = f" ({FIRST_SOURCE} is one)" if family == "sources" else ""
            raise SettingError(f"{family}.{name}: one too many, {most}{hint}")
        if last:
            table[last] = declaration(key).check(value, key)

    def _fill_named(self) -> None:
        """Fill in the defaults, in the order of the declarations."""
        facts = facts_of(self.text("board.kind"))
        joints = facts.arm.joint if facts and facts.arm else {}
        for family, tables in self.named.items():
            of_board = joints if family == "joints" else {}
            for name, given in tables.items():
                defaults = {**{setting.key: setting.default for setting in FAMILIES[family]}, **of_board}
                table = {key: given.get(key, default) for key, default in defaults.items()}
                if family == "sources" and "timeout_s" not in given:
                    table["timeout_s"] = self["gate.command_timeout_s"]
                tables[name] = table

    def _cross_check(self) -> None:
        """Check rules over several settings that are each in their own range."""
        every = {key: value for key, value in self.flat().items() if not isinstance(value, str)}
        timeouts = ["gate.command_timeout_s", *(f"sources.{name}.timeout_s" for name in self.named["sources"])]
        longer_than = [
            ("gate.lease_s", "gate.period_s"),
            *((timeout, "gate.lease_s") for timeout in timeouts),
            ("restart.window_s", "restart.backoff_s"),
        ]

        def said(key: str) -> str:
            return f"{key} = {every[key]:g} s"

        for longer, shorter in longer_than:
            if every[longer] <= every[shorter]:
                raise SettingError(f"{said(longer)} must be longer than {said(shorter)}")
        if every["gate.refresh_s"] < every["gate.period_s"]:
            raise SettingError(f"{said('gate.refresh_s')} must not be shorter than {said('gate.period_s')}")
        layouts.check_base(self.values)
        all_differ({f"sources.{name}.priority": table["priority"] for name, table in self.named["sources"].items()})
        self._check_servos()

    def _check_servos(self) -> None:
        """Check that each joint, and the steering of a steered base, has its own servo on the board."""
        kind = self.text("board.kind")
        facts = facts_of(kind)
        joints = {f"joints.{name}": table for name, table in self.named["joints"].items()}
        if joints and not (facts and facts.arm):
            raise SettingError(f"{next(iter(joints))}: board.kind {kind} has no servos")
        servos = {f"{key}.servo": table["servo"] for key, table in joints.items()}
        all_differ(servos)
        if self.values.get("steering.kind") == "bus":
            all_differ({"steering.servo": self.values["steering.servo"], **servos})
        if facts and facts.arm:
            for key, table in joints.items():
                _check_joint(key, table, kind, facts.arm)

    def __getitem__(self, key: str) -> float:
        """A number, in the unit that its name ends in."""
        value = self.values[key]
        if isinstance(value, str):
            raise TypeError(f"{key} is a text")
        return value

    def text(self, key: str) -> str:
        """A text, or one of the words that are allowed."""
        return str(self.values[key])

    def on(self, key: str) -> bool:
        """A switch: "on" is True."""
        return self.values[key] == "on"

    def ns(self, key: str) -> int:
        """A time in seconds, as nanoseconds."""
        return round(self[key] * 1e9)

    def sources(self) -> dict[str, tuple[int, int]]:
        """The command sources by name, the highest priority first: (priority, timeout_ns)."""
        found = {
            name: (int(table["priority"]), round(float(table["timeout_s"]) * 1e9))
            for name, table in self.named["sources"].items()
        }
        return dict(sorted(found.items(), key=lambda source: -source[1][0]))

    def interlocks(self) -> dict[str, tuple[int, str]]:
        """The interlocks by name: (timeout_ns, the text of a refused enable)."""
        return {
            name: (round(float(own["timeout_s"]) * 1e9), str(own["refusal"]) or f"interlock {name} is not satisfied")
            for name, own in self.named["interlocks"].items()
        }

    def board(self) -> tuple[str, float, float, SteeringServo | None, float, int, int]:
        """What board_of() of failstop/board/kinds.py takes: the kind of the board, the wheels' diameter in m, a wheel's
        turn a second in the board's own unit (0: as usual), the servo of a steered base, the turn a second that a turn
        of a wheel has confirmed (0: none), the baud rate (0: as usual), and the CAN id of the second motor."""
        steering = None
        if self.text("wheels.layout") == layouts.ACKERMANN:
            steering = SteeringServo(
                kind=self.text("steering.kind"),
                id=int(self["steering.servo"]),
                centre=int(self["steering.centre"]),
                per_rad=self["steering.sign"] * self["steering.per_rad"],
                most_rad=radians(self["steering.most_deg"]),
            )
        scale = self["board.per_rps"], self["board.per_rps_confirmed"]
        baud, can_id = int(self["board.baud"]), int(self.values.get("board.can_id", 0))
        return self.text("board.kind"), self["wheels.diameter_m"], scale[0], steering, scale[1], baud, can_id

    @property
    def speeds(self) -> int:
        """How many speeds a frame for the board has, one for each id on the wire."""
        layout = str(self.values["wheels.layout"])
        return layouts.speeds_of(self.text("board.kind"), layout) or len(mounted_wheels(self.values))

    def servos(self) -> tuple[int, ...]:
        """The ids of the arm's servos, in the order of its joints; empty on a robot without an arm."""
        return tuple(int(table["servo"]) for table in self.named["joints"].values())

    def flat(self) -> dict[str, float | str]:
        """Every value by its full key, including those of the named tables."""
        found = dict(self.values)
        for family, tables in self.named.items():
            for name, table in tables.items():
                found.update({f"{family}.{name}.{key}": value for key, value in table.items()})
        return found

    def lines(self) -> str:
        """The values as `key=value` lines, for from_lines."""
        return "\n".join(f"{key}={value}" for key, value in self.flat().items())

    @classmethod
    def from_lines(cls, text: str) -> Settings:
        """The inverse of lines()."""
        changed: dict[str, object] = {}
        for line in text.splitlines():
            key, value = line.split("=", 1)
            changed[key] = type(declaration(key).default)(value)
        return cls(changed)


def _check_joint(key: str, table: dict[str, float | str], kind: str, arm: ArmFacts) -> None:
    servo, low, high = (int(table[name]) for name in ("servo", "low", "high"))
    if not servo:
        raise SettingError(f"{key}.servo is missing: every joint has the id of its servo, 1 to 100")
    if servo in arm.wheels:
        raise SettingError(f"{key}.servo = {servo}: that is a wheel's on board.kind {kind}")
    for name in ("zero", "low", "high", "tuck", "drive"):
        if int(table[name]) > arm.highest:
            raise SettingError(f"{key}.{name} = {table[name]:g}: board.kind {kind} has the pulses 0 to {arm.highest}")
    if low >= high:
        raise SettingError(f"{key}.low = {low} must be less than {key}.high = {high}")
    for name in ("tuck", "drive"):
        if (at := int(table[name])) >= 0 and not low <= at <= high:
            raise SettingError(f"{key}.{name} = {at}: allowed is {low} to {high}, or -1")


def declaration(key: str) -> Setting:
    """The declaration of a key, also in a named table. Raises SettingError if there is none."""
    if key in BY_KEY:
        return BY_KEY[key]
    family, _, rest = key.partition(".")
    found = [setting for setting in FAMILIES.get(family, ()) if setting.key == rest.partition(".")[2]]
    if not found:
        raise _unknown(key)
    return found[0]


def is_setting(key: str) -> bool:
    """Whether there is a setting of this whole key, a named table's too."""
    family, _, rest = key.partition(".")
    return key in BY_KEY or any(setting.key == rest.partition(".")[2] for setting in FAMILIES.get(family, ()))


def _unknown(key: str) -> SettingError:
    # Imported only after a mistake, because it costs more than this file.
    from difflib import get_close_matches

    name = key.split(".")[1] if key.count(".") > 1 else "NAME"
    named = [f"{family}.{name}.{setting.key}" for family, declared in FAMILIES.items() for setting in declared]
    nearest = get_close_matches(key, [*BY_KEY, *named], 1, 0.5)
    advice = f"did you mean {nearest[0]}?" if nearest else "`failstop config` lists them all"
    return SettingError(f"{key}: no such setting; {advice}")
