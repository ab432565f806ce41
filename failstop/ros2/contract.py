"""The contract: every topic and service of the bridge, declared once. The shell makes them from these tables, and
docs/ros2.md shows them. Names are relative to the node's namespace, those with ~ to the node. Pure."""

from __future__ import annotations

from typing import NamedTuple

NODE = "rosorin_board_driver"
"""The node's name: that of the driver which the robot's launch files know."""
CLIENT = "ros2"
"""The name under which the service knows the bridge, and that of its interlock."""


class Qos(NamedTuple):
    """Quality of service; history is always "keep last"."""

    depth: int
    reliable: bool = True
    transient_local: bool = False

    def words(self) -> str:
        """As people write it."""
        reliability = "reliable" if self.reliable else "best effort"
        durability = ", transient local" if self.transient_local else ""
        return f"{reliability}{durability}, depth {self.depth}"


PLAIN = Qos(10)
SENSOR = Qos(5, reliable=False)
LOSSY = Qos(10, reliable=False)
LASTING = Qos(10, transient_local=True)


class Topic(NamedTuple):
    """One topic. `hz`: how often it is published; 0: whenever there is something."""

    name: str
    type: str
    qos: Qos
    hz: int
    text: str


class Service(NamedTuple):
    """One service."""

    name: str
    type: str
    text: str


TWIST = "geometry_msgs/msg/Twist"
STAMPED = "geometry_msgs/msg/TwistStamped"
COMMAND_TYPES = {"auto": (TWIST, STAMPED), "twist": (TWIST,), "stamped": (STAMPED,)}
"""Parameter cmd_vel_type: what may be published on cmd_vel."""

CMD_VEL = Topic(
    "cmd_vel",
    TWIST,
    PLAIN,
    0,
    "the velocity command; TwistStamped too, as `cmd_vel_type` says (auto: what the publisher offers). A stamp older "
    "than the command timeout is refused, a zero stamp counts as now. So is a command that comes so much later than "
    "others of its publisher, as what DDS sends again does. A zero command always counts. A value that is not finite, "
    "in any of the six fields, latches a stop",
)
SCAN = Topic(
    "scan",
    "sensor_msgs/msg/LaserScan",
    SENSOR,
    0,
    "the obstacle sensor: each arrival counts, whatever it holds; without one for 0.5 s nothing moves (`no scan`)",
)
ESTOP = Topic(
    "estop",
    "std_msgs/msg/Bool",
    PLAIN,
    0,
    "true latches a stop (`estop topic`); false does nothing. A best-effort publisher is heard too",
)
ESTOP_LOSSY = ESTOP._replace(qos=LOSSY)
"""A second subscription: a reliable one hears no best-effort publisher, and a best-effort one alone may lose what a
reliable publisher sends."""
INWARD = (CMD_VEL, SCAN, ESTOP)

IMU = Topic(
    "imu/data_raw",
    "sensor_msgs/msg/Imu",
    PLAIN,
    110,
    "every sample, with the time of its arrival, less the gyro's bias; two are published at once; no orientation "
    "(`orientation_covariance[0]` is -1)",
)
BATTERY = Topic(
    "battery",
    "sensor_msgs/msg/BatteryState",
    PLAIN,
    1,
    "the voltage, and whether it is charged, as far as that is known; percentage, current and charge are NaN",
)
ODOMETRY = Topic(
    "wheel/odom",
    "nav_msgs/msg/Odometry",
    PLAIN,
    50,
    "from the wheels where the board reports them, as often as it does (10 times a second or more), with a covariance "
    "that grows; else from what was commanded, with a variance of 1000. The transform only with `publish_tf`",
)
GAMEPAD = Topic(
    "gamepad", "sensor_msgs/msg/Joy", PLAIN, 20, "each frame: axes lx, ly, rx, ry / 127 and the hat; 16 buttons"
)
JOINT_STATES = Topic(
    "joint_states",
    "sensor_msgs/msg/JointState",
    PLAIN,
    10,
    "the wheels: position and velocity as the board reports them (a velocity is NaN while its report is older than "
    "0.5 s), else integrated from what was commanded; of a steered base `steering`, the angle that was commanded last, "
    "positive to the left",
)
STATE = Topic("~/state", "std_msgs/msg/String", PLAIN, 10, "the state as JSON; its keys are below")
STATUS = Topic(
    "~/status",
    "failstop_msgs/msg/Status",
    PLAIN,
    10,
    "the state, typed; only where the package failstop_msgs is built",
)
EMERGENCY_STOP = Topic(
    "~/emergency_stop",
    "std_msgs/msg/Bool",
    LASTING,
    10,
    "true while a stop is latched, or nobody knows that none is; on every change too",
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    PLAIN,
    1,
    "the stop layer with the next command, the wheels, each process, port, link, battery, real-time rights, what ROS "
    "nodes do; on every change too",
)
ARM_GOAL = Topic(
    "arm/goal",
    "trajectory_msgs/msg/JointTrajectory",
    PLAIN,
    0,
    "where the arm goes: joints by the names of the settings, rad; without points it is held. A second publisher "
    "latches a stop. A goal that is older than arm.goal_timeout_s, by its stamp or since it had to wait, is refused; "
    "so is one that takes longer than arm.unwatched_s. The end of its publisher holds the arm",
)
ARM_BUSY = Topic("~/arm_busy", "std_msgs/msg/Bool", PLAIN, 10, "true while the arm moves, or is about to")
OUTWARD = (
    IMU,
    BATTERY,
    ODOMETRY,
    GAMEPAD,
    JOINT_STATES,
    STATE,
    STATUS,
    EMERGENCY_STOP,
    DIAGNOSTICS,
)
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", Qos(100), 50, "odom to base_link, only with `publish_tf`")

ENABLE_SERVICE = Service(
    "~/enable", "std_srvs/srv/SetBool", "enables or disables motion; the message is the gate's answer"
)
RESET_SERVICE = Service(
    "~/reset_estop",
    "std_srvs/srv/Trigger",
    "clears the latched stop and nothing else; refused while a nonzero cmd_vel arrives, or two nodes publish it",
)
STOP_SERVICE = Service(
    "~/stop",
    "std_srvs/srv/Trigger",
    "a latched stop; a success when it is known to be written, with what is known of it within 1 s",
)
SERVICES = (ENABLE_SERVICE, RESET_SERVICE, STOP_SERVICE)
ARM_SERVICES = tuple(
    Service(f"~/arm/{name}", "std_srvs/srv/Trigger", text)
    for name, text in (
        ("read_state", "reads where each joint is; the message is JSON, rad by joint"),
        ("drive", "to the drive pose"),
        ("tuck", "to the tuck pose"),
        ("hold", "stops the arm where it is; its torque stays"),
        ("release", "switches the torque off: the arm falls; refused while motion is enabled"),
    )
)
"""Likewise."""
ARM_ACTION = Service(
    "~/arm/follow_joint_trajectory",
    "control_msgs/action/FollowJointTrajectory",
    "the arm along a trajectory, for planners such as MoveIt; only with joints, and where the package control_msgs is "
    "installed. Its positions and times count; limits and tolerances are the service's settings",
)

STATE_KEYS = {
    "enabled": "motion is enabled",
    "estop": "the latch's first reason, or null",
    "plugged": "the charger: true, false, or null while that is not known",
    "arm_enabled": "there is an arm, and it may be moved now",
    "arm_moving": "it moves",
    "arm_pose": "its pulses by servo, as read; empty without an arm",
    "servo_silent": "servos that do not answer",
    "blocked": "why the wheels may not turn, or null",
    "body_vel": "m/s forward, m/s left, rad/s counter-clockwise, as commanded now",
    "scan_age": "s since the obstacle sensor delivered, or null",
    "gyro_bias_dps": "x, y, z in deg/s",
    "gyro_bias_tracking": "the bias follows the reading now",
    "arm_holding": "the arm does not move, and its torque is on",
    "pad_mode": "locked, drive or joint",
    "pad_joint": "the joint that the gamepad turns, or null",
    "auto_tuck_in_s": "s until the arm tucks itself, or null",
    "next": "what to do for the wheels to move, a list",
    "driver": "who drives, or null",
    "publishers": "the nodes that publish cmd_vel",
    "wrong": "what is wrong with cmd_vel, scan or estop, or null",
    "link": "whether the board answers: unproven, alive, deaf, silent, unheard, unasked",
    "port": "open, closed or lost",
    "processes": "pid, state, age_ms and restarts of each",
    "last_stop": "reason, written_us, acknowledged_us, observed_ms, or null",
    "wheels": "what is seen of the wheels: word (as in `failstop status`), does (turning, still, unknown), by (wheels: "
    "the board's reports; IMU; null), unexpected (they turn although they were told zero), age_ms of the reading, and "
    "radps, the measured speed by wheel",
    "state_age_ms": "of the gate's record; null: no service",
}
"""The keys of ~/state: up to auto_tuck_in_s those of the driver before, then the bridge's own."""


class Parameter(NamedTuple):
    """A parameter of the bridge itself, read at its start. `allowed`: the words that a text may be; empty: any."""

    name: str
    default: bool | str | list[str]
    text: str
    allowed: tuple[str, ...] = ()


SETTINGS = (
    Parameter("cmd_vel_type", "auto", "which message type cmd_vel accepts", tuple(COMMAND_TYPES)),
    Parameter("allowed_publishers", [""], "nodes that may publish cmd_vel; another one latches a stop. Empty: any"),
    Parameter("publish_tf", False, "publish odom to base_link; else an EKF does"),
    Parameter("imu_frame_id", "imu_link", "frame of imu/data_raw"),
    Parameter("odom_frame_id", "odom", "frame of wheel/odom"),
    Parameter("base_frame_id", "base_link", "child frame of wheel/odom"),
)
