"""Settings: declares every setting with its default, unit, range and meaning.

`failstop run` reads and checks the settings once (failstop/config.py), and gives them to the processes as `key=value`
lines. Three kinds of tables have names that the user chooses: command sources [sources.NAME], interlocks
[interlocks.NAME], and an arm's joints [joints.NAME]. The source cmd_vel always exists.
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
"""The environment variable in which a process of the service finds the settings."""


def _word(key: str, default: float | str, doc: str, allowed: tuple[int, ...] | tuple[str, ...] = ()) -> Setting:
    """Declare a setting that has no range. `allowed`: the allowed values; empty to allow any text."""
    return Setting(key, default, "", None, None, doc, allowed)


SWITCH = ("on", "off")
BAUDS = (0, 57600, 115200, 230400, 460800, 500000, 921600, 1000000)
DEATHS = ("disable", "latch", "stay")
ANSWERS_TO_SILENCE = ("wait", "disable", "latch")
TURNS = ("none", "yaw", "pitch", "roll")
WEB_TLS = ("auto", "on", "off")

# A setting keeps its numbers on one line, so that its text can be long.
# fmt: off
DECLARED = (
    _word("device.path", "/dev/ttyACM0",
        "the motor board's serial port. Prefer a path below /dev/serial/by-id/ if it has one: it stays the same when "
        "other devices are plugged in"),
    Setting("board.kind", BOARDS[0], "", None, None, "which motor board the robot has, or the folder that "
                                                     "describes your own", BOARDS,
        or_folder=True),
    _word("board.robot", robots.USUAL_ROBOT,
        f"which robot you have, if its board is {BOARDS[0]}. The robot's sizes become the defaults",
        tuple(robots.EVERY_ROBOT)),
    _word("board.baud", 0,
        "the serial port's baud rate. Set it if your board's firmware was built with an unusual one. 0: the board's "
        "usual rate", BAUDS),
    Setting(
        "board.can_id",
        USUAL_CAN_ID,
        "",
        0,
        253,
        "the CAN id of the second motor's controller, for a board that reaches its second motor by CAN",
    ),
    Setting("board.per_rps", 0.0, "", 0.0, 100000.0,
        "the board's own unit of speed: how much of it is one turn of a wheel per second. `failstop setup` "
        "measures it. "
        "0: as such boards usually have it"),
    Setting(
        "board.per_rps_confirmed",
        0.0,
        "",
        0.0,
        100000.0,
        "the value of board.per_rps that somebody confirmed by turning a wheel; then speeds are not capped. "
        "`failstop setup` writes it. 0: not confirmed",
    ),
    _word("board.imu", "on",
        "whether the robot has an IMU. Turn it off if yours has none; for a board that can't have one it is always "
        "off", SWITCH),
    Setting("gate.period_s", 0.02, "s", 0.005, 0.05,
        "how often the gate decides what the wheels do. A shorter period takes more processor time"),
    Setting("gate.command_timeout_s", 0.3, "s", 0.05, 2.0,
        "how long a command counts. If no newer one comes in this time, the wheels stop. Raise it for a program that "
        "sends commands less often; each source can have its own"),
    Setting("gate.refresh_s", 0.2, "s", 0.02, 1.0,
        "while motion is enabled, the speeds are sent to the board at least this often, even if they have not "
        "changed. It may be at most half of the time after which the board's own watchdog stops the wheels; lower it "
        "if yours stops them sooner"),
    Setting("gate.lease_s", 0.06, "s", 0.04, 1.0,
        "how long the gate or the supervisor may be silent before failstop stops the robot. If you don't set it, it "
        "is up to 0.2 s without real-time rights, because a busy computer then runs the processes later"),
    _word("gate.driver_death", "disable",
        "what happens when a program that has driven crashes or is killed. disable: motion must be enabled again; "
        "latch: somebody must also reset; stay: motion stays enabled, so the program drives again as soon as it is "
        "restarted", DEATHS),
    _word("gate.driver_silence", "wait",
        "what happens when a program stops sending commands while it drives. The wheels stop in any case. wait: they "
        "turn again with its next command; disable: motion must be enabled again; latch: somebody must also reset",
        ANSWERS_TO_SILENCE),
    Setting("limits.vx_mps", 0.2, "m/s", 0.01, 3.0,
        "highest speed forward and backward. Faster commands are cut to it. `failstop config --within 0.1` says how "
        "fast you may drive to stop within 0.1 m"),
    Setting("limits.vy_mps", 0.2, "m/s", 0.01, 3.0, "highest speed sideways"),
    Setting("limits.wz_radps", 1.0, "rad/s", 0.01, 10.0, "highest turn rate"),
    Setting("limits.acceleration_mps2", 0.5, "m/s2", 0.01, 20.0,
        "how fast commanded speeds forward and sideways may change, so that the robot starts gently. Stops are not "
        "slowed by it"),
    Setting("limits.acceleration_radps2", 2.0, "rad/s2", 0.01, 100.0,
        "how fast the commanded turn rate may change. Stops are not slowed by it"),
    Setting("limits.braking_mps2", 1.0, "m/s2", 0.05, 20.0,
        "how hard your robot brakes when its wheels are told to stop. It changes nothing about how it drives: "
        "failstop computes stopping distances with it, and how long a wheel may take to slow down. Measure it on "
        "your floor"),
    *layouts.OF_THE_BASE,
    _word("scan.gate", "on",
        "programs can't move the wheels while the obstacle sensor is silent, but a person who drives by hand still can "
        "(gamepad, teleop, page). Turn it off if the robot has no such sensor, or if none reports to failstop",
        SWITCH),
    Setting("scan.timeout_s", 0.5, "s", 0.05, 10.0,
        "how long the obstacle sensor may be silent before programs can't move the wheels (`no scan`). Keep it above "
        "the time between two scans"),
    _word("attend.required", "off",
        "nothing moves unless an operator is present and keeps confirming it, by the page, `failstop attend` or your "
        "own program", SWITCH),
    Setting("attend.lease_s", 1.0, "s", 0.3, 10.0,
        "how long an operator may go unheard before failstop latches a stop. Raise it for a poor radio link"),
    Setting("imu.offset_x_g", 0.0, "g", -1.0, 1.0,
        "subtracted from the raw acceleration along x, so that it reads right"),
    Setting("imu.offset_y_g", 0.0, "g", -1.0, 1.0,
        "subtracted from the raw acceleration along y, so that it reads right"),
    Setting("imu.offset_z_g", 0.0, "g", -1.0, 1.0,
        "subtracted from the raw acceleration along z, so that it reads right"),
    Setting("imu.scale_x", 1.0, "", 0.5, 2.0,
        "the acceleration along x is multiplied by this, after its offset was subtracted"),
    Setting("imu.scale_y", 1.0, "", 0.5, 2.0,
        "the acceleration along y is multiplied by this, after its offset was subtracted"),
    Setting("imu.scale_z", 1.0, "", 0.5, 2.0,
        "the acceleration along z is multiplied by this, after its offset was subtracted"),
    Setting("imu.calibration_s", 3.0, "s", 0.1, 60.0,
        "at the start, the gyro's bias is measured for this long. The robot must be at rest meanwhile"),
    Setting("imu.calibration_std_dps", 0.3, "deg/s", 0.01, 10.0,
        "if the gyro varies by more than this during the calibration (standard deviation of any axis), the robot was "
        "not at rest and the calibration is given up. Raise it for a noisy gyro"),
    _word("imu.tracking", "on",
        "keep correcting the gyro's bias while the robot is at rest, because it drifts with temperature", SWITCH),
    Setting("imu.tracking_rest_s", 1.0, "s", 0.1, 60.0,
        "tracking starts once the commanded speed has been zero for this long"),
    Setting("imu.tracking_band_dps", 0.5, "deg/s", 0.01, 10.0,
        "tracking ignores readings that differ from the bias by more than this, because then the robot is being "
        "turned"),
    Setting("imu.tracking_tau_s", 20.0, "s", 0.1, 3600.0,
        "time constant of the tracking. Longer: a steadier bias that follows changes more slowly"),
    Setting("odometry.forward_scale", 1.0, "", 0.1, 2.0,
        "how far the robot goes for each metre that its wheels roll, forward and backward. Measure it: drive some "
        "metres, and divide the true distance by the reported one"),
    Setting("odometry.sideways_scale", 0.765, "", 0.1, 2.0,
        "how far the robot goes for each metre that its wheels roll sideways. Less than 1 where they slip, as "
        f"mecanum wheels do. The default is ROSOrin's; with a board other than {BOARDS[0]} it is 1"),
    Setting("odometry.twist_std_mps", 0.05, "m/s", 0.0, 10.0,
        "standard deviation of the odometry's speeds, which ROS 2 gets as their covariance"),
    Setting("odometry.twist_std_radps", 0.2, "rad/s", 0.0, 10.0,
        "standard deviation of the odometry's turn rate, which ROS 2 gets as its covariance"),
    Setting("battery.step_mv", 190, "mV", 10, 5000,
        "if the voltage jumps by this much while motion is disabled, the charger was plugged in (up) or pulled out "
        "(down)"),
    Setting("battery.stop_mv", -1, "mV", 1000, 60000,
        "latch a stop when the voltage stays below this for 5 s (and at least 5 readings). The next such stop comes "
        "only after the battery was charged, so that it was 10 % above this for a minute, or was away for 5 s "
        "(longer if the board reports it seldom). -1: never", off=-1),
    _word("battery.log", "on", "write the battery's voltage to a file, a new one each day (UTC)", SWITCH),
    Setting("battery.log_s", 10.0, "s", 1.0, 3600.0, "time between two lines of the battery log"),
    _word("battery.directory", "", "where the battery log is kept. Empty: the service's state directory"),
    Setting("pad.mode_button", 0x2000, "", 1, 0x8000,
        "the gamepad's MODE button, as one bit of its button bits. Every other button stops the robot, and MODE "
        "alone doesn't"),
    Setting("pad.dead_zone", 0.1, "", 0.01, 0.9,
        "a stick closer to its middle than this commands nothing (1 is all the way). Raise it for a worn gamepad "
        "that drifts"),
    Setting("pad.mode_lockout_s", 0.6, "s", 0.1, 5.0,
        "after MODE has changed the mode, it does nothing for this long, so that a bouncing button doesn't change it "
        "twice"),
    Setting("pad.reset_hold_s", 2.0, "s", 0.5, 30.0, "hold MODE for this long while a stop is latched to reset it"),
    Setting("pad.frozen_s", 15.0, "s", 3.0, 600.0,
        "if a stick is pushed and nothing at the gamepad has changed for this long, the gamepad may be out of reach, "
        "so it is locked. Press MODE to drive again"),
    Setting("link.ping_s", 0.5, "s", 0.1, 0.5,
        "time between two pings to the board, if it can answer any. A board may need them more often"),
    Setting("link.deaf_s", 1.0, "s", 1.0, 60.0,
        "if a board that has answered pings answers none for this long, it counts as deaf: failstop latches a stop if "
        "motion is enabled, and refuses to enable it again until the board answers"),
    Setting("still.std_radps", 0.0035, "rad/s", 0.0001, 1.0,
        "the wheels count as still while the gyro's x and y each vary less than this (standard deviation). Raise it "
        "if a robot at rest counts as moving, for example because a fan shakes it"),
    Setting("still.after_s", 1.5, "s", 0.2, 60.0,
        "if the wheels still turn this long after they were told to stop, failstop reports it. If the board itself "
        "reports the turning, failstop also disables motion, or sends the stop again"),
    _word("still.command", "",
        "a shell command that the service runs when the wheels are not still after a stop, for example one that "
        "switches off the motors' power. Empty: none"),
    Setting("stop.wait_s", 30.0, "s", 0.0, 3600.0,
        "how long `failstop stop` keeps trying to open the board's port when no service answers it"),
    Setting("key.stop", 1, "", 1, 255, "which key on the board stops the robot, by its number"),
    Setting("arm.period_s", 0.04, "s", 0.02, 0.055,
        "a moving joint gets a new move this often, and each move lasts this long"),
    Setting("arm.goal_timeout_s", 0.5, "s", 0.1, 5.0,
        "how long a goal counts if a program streams goals to the arm. If no newer one comes in this time, the arm "
        "stops and holds where it is"),
    Setting("arm.unwatched_s", 3.0, "s", 0.1, 30.0,
        "the longest path that ROS 2's topic arm/goal may ask for. Its sender can crash without anybody noticing, so "
        "use the action for a longer path"),
    Setting("arm.pose_speed", 0.5, "", 0.05, 1.0, "how fast the arm goes to a pose, as a share of each joint's speed"),
    Setting("arm.drive_tolerance", 30, "", 1, 200,
        "how many pulses a joint may be off the drive pose for motion to be enabled. Raise it for servos that sag "
        "under their load"),
    Setting("arm.drive_pan", -1, "", -1, 4095,
        "where the base joint (arm.base_servo) must be for driving, in pulses; it replaces that joint's `drive`. -1: "
        "anywhere"),
    Setting("arm.base_servo", 1, "", 1, 100, "the servo of the arm's base joint, which arm.drive_pan is about"),
    _word("arm.absent", "refuse",
        "whether motion can be enabled while none of the servos of the drive pose answers. ignore: yes, for a robot "
        "whose arm is sometimes taken off", ("refuse", "ignore")),
    _word("arm.auto_tuck", "on", "an arm that is left alone goes to its tuck pose, if it has one", SWITCH),
    Setting("arm.auto_tuck_s", 120.0, "s", 1.0, 86400.0,
        "how long an arm must be left alone before it goes to its tuck pose (arm.auto_tuck)"),
    Setting("arm.tuck_notice_s", 5.0, "s", 0.1, 60.0,
        "how long before it tucks itself the arm announces it, by a tone (buzzer.tones) and an event"),
    _word("arm.collision", "off",
        "refuse moves in which the arm would hit itself, the chassis or the floor. It needs the lengths and radii of "
        "the links and the chassis' size", SWITCH),
    Setting("arm.mount_x_m", 0.0, "m", -1.0, 1.0,
        "where the arm is mounted: distance forward of the middle of the chassis"),
    Setting("arm.mount_z_m", 0.1, "m", 0.0, 2.0, "where the arm is mounted: height above the floor"),
    Setting("arm.chassis_length_m", 0.3, "m", 0.0, 3.0,
        "length of the capsule that stands for the chassis, along the robot"),
    Setting("arm.chassis_radius_m", 0.08, "m", 0.0, 1.0, "radius of the capsule that stands for the chassis"),
    Setting("arm.chassis_z_m", 0.08, "m", 0.0, 1.0, "height of the middle of the chassis above the floor"),
    Setting("arm.hot_c", 70, "degrees Celsius", 30, 84,
        "warn when a servo is this hot. At 85 degrees it switches off its torque, so the joint falls"),
    Setting("arm.low_mv", 6000, "mV", 1000, 30000,
        "warn when a servo's supply is below this. With much less it switches off its torque, so the joint falls"),
    _word("buzzer.tones", "off",
        "the board's buzzer sounds when a stop is latched, when the gamepad's mode changes, and before the arm tucks "
        "itself", SWITCH),
    _word("incidents.save", "on",
        "keep a file of the last minute after each latched stop (`failstop incident`)", SWITCH),
    Setting("incidents.keep", 50, "", 1, 10000, "how many incidents are kept; the oldest are deleted first"),
    Setting("incidents.max_mb", 100, "MB", 1, 100000,
        "how much disk space all incidents may take together. The oldest are deleted first; the newest is always "
        "kept"),
    _word("web.address", "127.0.0.1",
        "the address at which the operator's page (`failstop web`) listens. 127.0.0.1: only this computer can open "
        "it; 0.0.0.0: the network can"),
    Setting("web.port", 8477, "", 0, 65535, "the port of the operator's page. 0: any free one"),
    _word("web.hosts", "",
        "further host names under which people open the page, separated by blanks. It always answers to the robot's "
        "own name and addresses"),
    _word("web.origin", "",
        "the page's address as browsers see it, if a proxy is in between and handles HTTPS, for example "
        "https://robot.example. Empty: no proxy"),
    _word("web.tls", "auto",
        "whether the page uses HTTPS. auto: yes, unless it listens on this computer only", WEB_TLS),
    _word("web.pairing", "off",
        "let paired devices reset and enable (`failstop web pair`). Everybody else can watch and stop", SWITCH),
    _word("web.drive", "off",
        "let a paired device whose operator is present (attend.required) drive with a thumb stick", SWITCH),
    _word("guard.path", "", "where your driver opens the guard port. Empty: `port` in the service's runtime directory"),
    Setting("guard.timeout_s", 0.3, "s", 0.05, 2.5,
        "how long the last speed from a driver at the guard port counts. Raise it for a driver that writes a speed "
        "once and then waits"),
    Setting("guard.openers", 0, "", 0, 4,
        "how many programs may have the guard port open at once. If there are more, none of them drives. 0: as many "
        "as the board's usual driver needs"),
    _word("guard.hang_up", "off",
        "close the guard port when its driver wants to move while motion is not enabled. For drivers that report an "
        "error only when their port goes away", SWITCH),
    _word("guard.pins", "",
        "the board's pins that a driver may set, separated by blanks, for example \"11 16\". Empty: none"),
    Setting("restart.deaths", 5, "", 1, 100000,
        "if a failstop process dies this many times within the window, it stays down until you reset. Before that, "
        "it is restarted each time"),
    Setting("restart.window_s", 60.0, "s", 1.0, 3600.0, "the window in which a process's deaths are counted"),
    Setting("restart.backoff_s", 0.1, "s", 0.001, 2.0,
        "the first restart in the window is immediate, and the second waits this long. Each further one waits twice "
        "as long, 2 s at most"),
)

# Tables that the user names: [sources.NAME], [interlocks.NAME] and [joints.NAME].
FAMILIES = {
    "sources": (
        Setting("priority", 0, "", 0, 100,
            "the source with the highest priority drives; it takes over at once when it begins to send commands"),
        Setting("timeout_s", 0.3, "s", 0.05, 2.0,
            "how long a command of this source counts. If you don't set it: gate.command_timeout_s"),
    ),
    "interlocks": (
        Setting("timeout_s", 0.5, "s", 0.05, 10.0,
            "how long an interlock counts as satisfied after it was last asserted"),
        _word("refusal", "",
            "the reason that people get when this interlock refuses an enable. Empty: interlock NAME is not "
            "satisfied"),
    ),
    "joints": (
        Setting("servo", 0, "", 1, 100,
            "the id of this joint's bus servo. You must set it, and no two joints may have the same"),
        Setting("zero", 500, "", 0, 4095,
            "where the joint's angle is zero, in pulses. A pulse is 0.24 degrees; on LeKiwi's servos, 0.088 degrees"),
        _word("sign", 1, "-1 if the joint's angle gets smaller when the pulses get larger", (1, -1)),
        Setting("low", 0, "", 0, 4094,
            "the lowest position the joint may be sent to, in pulses. A joint that was pushed below it is brought "
            "back at its own speed"),
        Setting("high", 1000, "", 1, 4095,
            "the highest position the joint may be sent to, in pulses. A joint that was pushed above it is brought "
            "back at its own speed"),
        Setting("offset", 0, "", -2047, 2047,
            "the joint's homing offset from LeRobot's calibration. Only LeRobot's host at the guard port needs it"),
        Setting("speed_radps", 1.0, "rad/s", 0.01, 6.0, "the joint's highest speed"),
        Setting("acceleration_radps2", 4.0, "rad/s2", 0.05, 50.0, "how fast the joint's speed may change"),
        Setting("tuck", -1, "", -1, 4095,
            "where the joint is in the tuck pose, in pulses. -1: the pose leaves this joint where it is"),
        Setting("drive", -1, "", -1, 4095,
            "where the joint is in the drive pose, in pulses. -1: the pose leaves this joint where it is. For the "
            "base joint, arm.drive_pan replaces it"),
        _word("turns", "none",
            "the axis about which the joint turns the rest of the arm, for arm.collision. yaw: vertical; pitch: "
            "across; roll: along the link; none: it doesn't, as a gripper", TURNS),
        Setting("length_m", 0.0, "m", 0.0, 2.0,
            "distance from this joint to the next one, for arm.collision. 0: the link is not checked"),
        Setting("radius_m", 0.03, "m", 0.0, 0.5,
            "radius of the link from this joint to the next one, for arm.collision"),
        _word("judged", "on",
            "whether this joint must be in the drive pose for motion to be enabled. Turn it off for a gripper. For "
            "the base joint, arm.drive_pan replaces it", SWITCH),
    ),
}
# fmt: on
MOST_OF_A_FAMILY = 8
LONGEST_NAME = 16
NAME_CHARACTERS = frozenset("abcdefghijklmnopqrstuvwxyz0123456789_-")
FIRST_SOURCE = "cmd_vel"
"""The source of every command for which the program names no source."""
PAD_SOURCE = "gamepad"

BY_KEY = {setting.key: setting for setting in DECLARED}
MOST_TOLD = 8
"""The most mistakes in settings that one message lists."""


def mounted_wheels(values: dict[str, float | str]) -> list[tuple[int, int]]:
    """The id on the wire and the sign of each wheel's motor, in the order of the wheels' numbers. `values`: all
    settings, by key."""
    numbers = [number for number in NUMBERS if f"wheels.id_{number}" in values]
    return [(int(values[f"wheels.id_{number}"]), int(values[f"wheels.sign_{number}"])) for number in numbers]


UNATTENDED_DRIVE = 'web.drive = "on" needs attend.required = "on"'
"""The reason why nobody can drive from the web page although the setting web.drive is "on"."""


class Settings:
    """A complete and checked set of values for all settings."""

    __slots__ = ("named", "values")

    def __init__(self, changed: dict[str, object] | None = None) -> None:
        """Check the values in `changed`, and fill in the defaults of all other settings. Raises SettingError. Its
        message lists at most MOST_TOLD unknown keys, wrong types and values out of range. If there are no such
        mistakes, the message names values that contradict each other.

        `changed` has the values by key. An empty dict as a value declares a table without settings of its own, for
        example a source with only the defaults.
        """
        self.values: dict[str, float | str] = {setting.key: setting.default for setting in DECLARED}
        # family, name and key of each value in the named tables
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
            raise SettingError(f"{key} = {shown(value)}: it must be a table, [{family}.NAME]")
        if len(name) > LONGEST_NAME or not NAME_CHARACTERS.issuperset(name):
            raise SettingError(f"{family}.{name!r}: a name has 1 to {LONGEST_NAME} characters, of a-z 0-9 _ -")
        if family == "sources" and name == PAD_SOURCE:
            raise SettingError(f"{key}: the board's gamepad always has the highest priority, so it has no settings")
        table = self.named[family].setdefault(name, {})
        if len(self.named[family]) > MOST_OF_A_FAMILY:
            most = f"at most {MOST_OF_A_FAMILY} {family} are allowed"
            hint = f" ({FIRST_SOURCE} is one)" if family == "sources" else ""
            raise SettingError(f"{family}.{name}: {most}{hint}")
        if last:
            table[last] = declaration(key).check(value, key)

    def _fill_named(self) -> None:
        """Fill in the defaults in the named tables, and put the settings of each table in the order of their
        declarations."""
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
        """Check that the values fit together. Each value alone is already checked."""
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
        """Check that each joint, and a steering servo on the bus, has its own servo that the board can move."""
        kind = self.text("board.kind")
        facts = facts_of(kind)
        joints = {f"joints.{name}": table for name, table in self.named["joints"].items()}
        if joints and not (facts and facts.arm):
            raise SettingError(f"{next(iter(joints))}: board.kind {kind} can't move servos")
        servos = {f"{key}.servo": table["servo"] for key, table in joints.items()}
        all_differ(servos)
        if self.values.get("steering.kind") == "bus":
            all_differ({"steering.servo": self.values["steering.servo"], **servos})
        if facts and facts.arm:
            for key, table in joints.items():
                _check_joint(key, table, kind, facts.arm)

    def __getitem__(self, key: str) -> float:
        """The value of a setting that is a number, in the unit at the end of its key."""
        value = self.values[key]
        if isinstance(value, str):
            raise TypeError(f"{key} is a text")
        return value

    def text(self, key: str) -> str:
        """The value of a setting that is a text."""
        return str(self.values[key])

    def on(self, key: str) -> bool:
        """True if a setting that is a switch is on."""
        return self.values[key] == "on"

    def ns(self, key: str) -> int:
        """The value of a setting that is a time, in nanoseconds."""
        return round(self[key] * 1e9)

    def sources(self) -> dict[str, tuple[int, int]]:
        """The command sources by name, with their (priority, timeout_ns). The source with the highest priority comes
        first."""
        found = {
            name: (int(table["priority"]), round(float(table["timeout_s"]) * 1e9))
            for name, table in self.named["sources"].items()
        }
        return dict(sorted(found.items(), key=lambda source: -source[1][0]))

    def interlocks(self) -> dict[str, tuple[int, str]]:
        """The interlocks by name, each with its timeout in ns and its refusal. The refusal is the text that people get
        if they can't enable motion because of this interlock."""
        return {
            name: (round(float(own["timeout_s"]) * 1e9), str(own["refusal"]) or f"interlock {name} is not satisfied")
            for name, own in self.named["interlocks"].items()
        }

    def board(self) -> tuple[str, float, float, SteeringServo | None, float, int, int, int]:
        """The arguments of board_of() in failstop/board/kinds.py: the kind of board, the wheel diameter (m),
        board.per_rps (0 for the board's usual value), the servo of a steered base, board.per_rps_confirmed (0 if nobody
        has confirmed it), the baud rate (0 for the usual one), the CAN id of the second motor, and the number of speeds
        in a frame."""
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
        kind, diameter_m = self.text("board.kind"), self["wheels.diameter_m"]
        return kind, diameter_m, scale[0], steering, scale[1], baud, can_id, self.speeds

    @property
    def speeds(self) -> int:
        """How many speeds are in a frame for the board, one for each id on the wire."""
        ids = [id_ for id_, _ in mounted_wheels(self.values)]
        found = layouts.speeds_of(self.text("board.kind"), self.text("wheels.layout"))
        return max(found, max(ids) + 1) if found else len(ids)

    def servos(self) -> tuple[int, ...]:
        """The ids of the arm's servos, in the order of its joints. Empty if the robot has no arm."""
        return tuple(int(table["servo"]) for table in self.named["joints"].values())

    def flat(self) -> dict[str, float | str]:
        """Every value by its full key, including the values in named tables."""
        found = dict(self.values)
        for family, tables in self.named.items():
            for name, table in tables.items():
                found.update({f"{family}.{name}.{key}": value for key, value in table.items()})
        return found

    def lines(self) -> str:
        """The values as `key=value` lines, which from_lines() reads."""
        return "\n".join(f"{key}={value}" for key, value in self.flat().items())

    @classmethod
    def from_lines(cls, text: str) -> Settings:
        """Make Settings from lines that lines() has made."""
        changed: dict[str, object] = {}
        for line in text.splitlines():
            key, value = line.split("=", 1)
            changed[key] = type(declaration(key).default)(value)
        return cls(changed)


def _check_joint(key: str, table: dict[str, float | str], kind: str, arm: ArmFacts) -> None:
    servo, low, high = (int(table[name]) for name in ("servo", "low", "high"))
    if not servo:
        raise SettingError(f"{key}.servo is missing: set it to the id of the joint's servo, 1 to 100")
    if servo in arm.wheels:
        raise SettingError(f"{key}.servo = {servo}: on board.kind {kind}, that is the id of a wheel")
    for name in ("zero", "low", "high", "tuck", "drive"):
        if int(table[name]) > arm.highest:
            raise SettingError(
                f"{key}.{name} = {table[name]:g}: on board.kind {kind}, pulses go from 0 to {arm.highest}"
            )
    if low >= high:
        raise SettingError(f"{key}.low = {low} must be less than {key}.high = {high}")
    for name in ("tuck", "drive"):
        if (at := int(table[name])) >= 0 and not low <= at <= high:
            raise SettingError(f"{key}.{name} = {at}: allowed is {low} to {high}, or -1")


def declaration(key: str) -> Setting:
    """The declaration of the setting with this key. It may be in a named table, such as sources.NAME.priority. Raises
    SettingError if no such setting exists."""
    if key in BY_KEY:
        return BY_KEY[key]
    family, _, rest = key.partition(".")
    found = [setting for setting in FAMILIES.get(family, ()) if setting.key == rest.partition(".")[2]]
    if not found:
        raise _unknown(key)
    return found[0]


def is_setting(key: str) -> bool:
    """True if a setting with this full key exists. It may be in a named table, such as sources.NAME.priority."""
    family, _, rest = key.partition(".")
    return key in BY_KEY or any(setting.key == rest.partition(".")[2] for setting in FAMILIES.get(family, ()))


def _unknown(key: str) -> SettingError:
    # imported only after a mistake, because it takes longer to load than this file
    from difflib import get_close_matches

    name = key.split(".")[1] if key.count(".") > 1 else "NAME"
    named = [f"{family}.{name}.{setting.key}" for family, declared in FAMILIES.items() for setting in declared]
    nearest = get_close_matches(key, [*BY_KEY, *named], 1, 0.5)
    advice = f"did you mean {nearest[0]}?" if nearest else "`failstop config` lists them all"
    return SettingError(f"{key} is not a setting; {advice}")
