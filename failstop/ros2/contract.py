"""The contract: declares every topic, service and parameter of the bridge. The bridge makes them from these tables, and
docs/ros2.md shows them. Names are relative to the node's namespace, or to the node if they begin with ~. Pure."""

from __future__ import annotations

from typing import NamedTuple

NODE = "rosorin_board_driver"
"""The name of the bridge's node. It is the name of an earlier driver, which the robot's launch files know."""
CLIENT = "ros2"
"""The name of the bridge as a client of the service, and the name of its interlock."""


class Qos(NamedTuple):
    """Quality of service. The history is always "keep last"."""

    depth: int
    reliable: bool = True
    transient_local: bool = False

    def words(self) -> str:
        """This quality of service in words."""
        reliability = "reliable" if self.reliable else "best effort"
        durability = ", transient local" if self.transient_local else ""
        return f"{reliability}{durability}, depth {self.depth}"


PLAIN = Qos(10)
SENSOR = Qos(5, reliable=False)
LOSSY = Qos(10, reliable=False)
LASTING = Qos(10, transient_local=True)


class Topic(NamedTuple):
    """One topic. `hz`: how often it is published per second; 0 if only when there is something new."""

    name: str
    type: str
    qos: Qos
    hz: int
    text: str


class Service(NamedTuple):
    """One service or action."""

    name: str
    type: str
    text: str


TWIST = "geometry_msgs/msg/Twist"
STAMPED = "geometry_msgs/msg/TwistStamped"
COMMAND_TYPES = {"auto": (TWIST, STAMPED), "twist": (TWIST,), "stamped": (STAMPED,)}
"""For each value of the parameter cmd_vel_type: the message types that are accepted on cmd_vel."""

CMD_VEL = Topic(
    "cmd_vel",
    TWIST,
    PLAIN,
    0,
    "the velocity command. The bridge reads the type that the publisher offers, Twist or TwistStamped, or only the "
    "type that you set with `cmd_vel_type`. A best-effort publisher is not heard. A command is refused if its stamp is "
    "older than the command timeout; a stamp of zero counts as now. It is also refused if it took longer to arrive "
    "than other commands of its publisher, by more than the command timeout, for example because DDS resent it. A zero "
    "velocity is never refused. NaN or infinity in any of the six fields latches a stop",
)
SCAN = Topic(
    "scan",
    "sensor_msgs/msg/LaserScan",
    SENSOR,
    0,
    "the obstacle sensor. Every message counts, whatever it contains. If none has arrived for 0.5 s, the wheels stop "
    '(`no scan`), unless you set `scan.gate = "off"`',
)
ESTOP = Topic(
    "estop",
    "std_msgs/msg/Bool",
    PLAIN,
    0,
    "true latches a stop (`estop topic`); false does nothing. The bridge hears best-effort publishers too. If a "
    "transient local publisher is still there, the bridge also gets its last message from before the bridge started, "
    "so an old `true` latches again at each start of the bridge. For both, the bridge has further subscriptions to "
    "this topic, the one for transient local publishers only once there is one. So ROS may warn of an incompatible QoS "
    "on `estop`, although the bridge hears the publisher. A `true` that comes while no service runs, or while one is "
    "ending, latches a stop as soon as one runs. A `true` that a service has heard does not latch again after a "
    "restart of the service",
)
ESTOP_LOSSY = ESTOP._replace(qos=LOSSY)
"""A second subscription to the topic estop. Both are needed, because a reliable subscription does not hear a
best-effort publisher, and a best-effort one may lose messages of a reliable publisher."""
ESTOP_LASTING = ESTOP._replace(qos=LASTING._replace(depth=1))
"""A third subscription to the topic estop, which also gets the last message from before the bridge started. It hears
only transient local publishers, and is made when the first one is seen."""
INWARD = (CMD_VEL, SCAN, ESTOP)

IMU = Topic(
    "imu/data_raw",
    "sensor_msgs/msg/Imu",
    PLAIN,
    110,
    "every sample of the board's IMU, usually two at a time, each with the time of its arrival. The gyro's bias is "
    "subtracted. 110 Hz is the rate of Hiwonder's board. There is no orientation (`orientation_covariance[0]` is -1)",
)
BATTERY = Topic(
    "battery",
    "sensor_msgs/msg/BatteryState",
    PLAIN,
    1,
    "the voltage. `power_supply_status` is charging while a charger is plugged in, discharging while none is, and "
    "unknown until failstop has seen the voltage jump, because only such a jump shows whether a charger is plugged in. "
    "Percentage, current and charge are NaN. If the board stops reporting its battery, the port is lost or the service "
    "ends, the voltage is NaN too, `present` is false, and `power_supply_status` is unknown",
)
ODOMETRY = Topic(
    "wheel/odom",
    "nav_msgs/msg/Odometry",
    PLAIN,
    50,
    "if the board reports its wheels: one message for each report, usually 10 a second or more and at most 50, with a "
    "covariance that grows with the distance. When the reports stop, so does this topic. Before the first report, and "
    "if the board never sends one: 50 Hz, computed from the commands, with a pose variance of 1000. After a restart "
    "of the service the pose goes on where it was; motion while no service ran is not counted",
)
GAMEPAD = Topic(
    "gamepad",
    "sensor_msgs/msg/Joy",
    PLAIN,
    20,
    "every report of the gamepad whose receiver is at the board: the axes lx, ly, rx and ry, divided by 127, and the "
    "hat; 16 buttons",
)
JOINT_STATES = Topic(
    "joint_states",
    "sensor_msgs/msg/JointState",
    PLAIN,
    10,
    "each wheel's position and velocity as the board reports them; the velocity is NaN if the last report is older "
    "than 0.5 s, and while no service runs. If the board does not report its wheels, both are computed from the "
    "commands, and the velocity is zero while no service runs. After a restart of the service the positions go on "
    "where they were. A steered base also has `steering`, the last commanded angle, positive to the left. An arm adds "
    "each joint that has been read",
)
STATE = Topic("~/state", "std_msgs/msg/String", PLAIN, 10, "the state as JSON, with the keys that are listed below")
STATUS = Topic(
    "~/status",
    "failstop_msgs/msg/Status",
    PLAIN,
    10,
    "the most important values of `~/state` as a typed message, if you have built the package failstop_msgs. While no "
    "service runs, `blocked` says so, `latched` is true as in `~/emergency_stop`, and everything else is unknown",
)
EMERGENCY_STOP = Topic(
    "~/emergency_stop",
    "std_msgs/msg/Bool",
    LASTING,
    10,
    "true while a stop is latched, and while the bridge can't reach the service, because a stop may be latched then. "
    "Also published when it changes",
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    PLAIN,
    1,
    "what holds the wheels and what to type next; the wheels, each process, port, link, battery and real-time rights; "
    "servos and the arm if there are any; measured speeds that differ much from the commanded ones; which nodes "
    "publish cmd_vel and scan. Also published when something changes",
)
ARM_GOAL = Topic(
    "arm/goal",
    "trajectory_msgs/msg/JointTrajectory",
    PLAIN,
    0,
    "where the arm must go: joints by their names in the settings, angles in rad. A message without points holds the "
    "arm. A second publisher latches a stop. A goal is refused if its stamp is older than `arm.goal_timeout_s`, if it "
    "waited longer than that before the bridge read it, or if the motion would take longer than `arm.unwatched_s`. "
    "When its publisher exits, the arm is held. If the bridge can't hold the arm, it latches a stop",
)
ARM_BUSY = Topic("~/arm_busy", "std_msgs/msg/Bool", PLAIN, 10, "true while the arm moves or is about to")
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
TF = Topic(
    "/tf", "tf2_msgs/msg/TFMessage", Qos(100), 50, "the transform from odom to base_link, only if `publish_tf` is true"
)

ENABLE_SERVICE = Service(
    "~/enable", "std_srvs/srv/SetBool", "enables or disables motion; the message is failstop's answer"
)
RESET_SERVICE = Service(
    "~/reset_estop",
    "std_srvs/srv/Trigger",
    "clears the latched stop; motion stays disabled. Refused while nonzero commands arrive on `cmd_vel`, while two "
    "nodes publish `cmd_vel` or `arm/goal`, and while a node that `allowed_publishers` does not allow publishes "
    "`cmd_vel`",
)
STOP_SERVICE = Service(
    "~/stop",
    "std_srvs/srv/Trigger",
    "latches a stop and answers after 1 s at most. Success means that the stop is known to be written to the board, "
    "and that nothing shows that it fails: the port is not lost, the board is not deaf, and the wheels don't turn "
    "again. The message says what else is proved, or why you need the power switch. If a stop was latched before, "
    "these are the proofs of that stop, and the message says so",
)
SERVICES = (ENABLE_SERVICE, RESET_SERVICE, STOP_SERVICE)
ARM_SERVICES = tuple(
    Service(f"~/arm/{name}", "std_srvs/srv/Trigger", text)
    for name, text in (
        ("read_state", "reads where each joint is; the message is JSON, with each joint's angle in rad"),
        ("drive", "moves the arm to the drive pose"),
        ("tuck", "moves the arm to the tuck pose"),
        ("hold", "stops the arm where it is, with its torque on"),
        ("release", "switches the arm's torque off, so the arm falls; refused while motion is enabled"),
    )
)
ARM_ACTION = Service(
    "~/arm/follow_joint_trajectory",
    "control_msgs/action/FollowJointTrajectory",
    "moves the arm along a trajectory, for planners such as MoveIt. Offered only if the settings name joints and the "
    "package control_msgs is installed. Only positions and times of the goal are used, because limits and tolerances "
    "are failstop's settings",
)

STATE_KEYS = {
    "enabled": "true while motion is enabled",
    "estop": "the first cause of the latched stop; null if none is latched",
    "plugged": "true while a charger is plugged in, false while none is; null if failstop can't tell",
    "arm_enabled": "true while the arm may be moved; false without an arm",
    "arm_moving": "true while the arm moves",
    "arm_pose": "each servo's last reading, in pulses, by the servo's number; empty without an arm",
    "servo_silent": "the numbers of the servos that do not answer",
    "blocked": "why the wheels may not turn; null if they may",
    "body_vel": "the velocity that is commanded now: m/s forward, m/s left, rad/s counter-clockwise",
    "scan_age": "seconds since the last scan; null if there was none",
    "gyro_bias_dps": "the gyro's bias about x, y and z, in deg/s",
    "gyro_bias_tracking": "true while failstop adjusts that bias, which it does while the robot is still",
    "arm_holding": "true while the arm is still and its torque is on",
    "pad_mode": "what the gamepad moves: `drive` (the wheels), `joint` (one joint of the arm) or `locked` (nothing)",
    "pad_joint": "the joint that the gamepad turns; null if none",
    "auto_tuck_in_s": "seconds until the arm tucks itself; null if it will not",
    "next": "a list of what to do so that the wheels can move",
    "driver": "the program that drives now, and its source; null if none drives",
    "publishers": "the nodes that publish cmd_vel",
    "wrong": "what is wrong with cmd_vel, arm/goal, scan or estop; null if nothing is",
    "link": "whether the board answers. `alive`: it does; `unproven`: it has never answered since the port was opened; "
    "`deaf`: it does not hear; `silent`: it used to send reports and now sends nothing; `unheard`: it has not answered "
    "since it was plugged in again; `unasked`: this kind of board can't answer",
    "port": "the board's serial port: `open`, `closed` or `lost` (unplugged)",
    "processes": "for each process of failstop: `pid`, `state`, `age_ms` (the time since its last sign of life) and "
    "`restarts`",
    "last_stop": "the last stop, or null. `reason`: its cause; `written_us`, `acknowledged_us`, `observed_ms`: the "
    "times from the cause until the stop was written, until the board acknowledged it and until the wheels were seen "
    "still",
    "wheels": "what is observed of the wheels. `word`: as in `failstop status`; `does`: turning, still or unknown; "
    "`by`: wheels (the board's reports), IMU or null; `unexpected`: true if they turn although they were told to stop; "
    "`age_ms`: the age of the reading; `radps`: each wheel's measured speed",
    "state_age_ms": "the age of these values; null if no service runs",
}
"""The keys of ~/state. The keys up to auto_tuck_in_s are those of an earlier driver, and the others were added by the
bridge."""


class Parameter(NamedTuple):
    """A parameter of the bridge itself, which is read at its start. `allowed`: the values that a text may have, or ()
    if any text is allowed."""

    name: str
    default: bool | str | list[str]
    text: str
    allowed: tuple[str, ...] = ()


SETTINGS = (
    Parameter("cmd_vel_type", "auto", "which message type cmd_vel accepts", tuple(COMMAND_TYPES)),
    Parameter("allowed_publishers", [""], "nodes that may publish cmd_vel; any other latches a stop. Empty: all may"),
    Parameter("publish_tf", False, "publish the transform from odom to base_link. Leave it false if an EKF does"),
    Parameter("imu_frame_id", "imu_link", "frame of imu/data_raw"),
    Parameter("odom_frame_id", "odom", "frame of wheel/odom"),
    Parameter("base_frame_id", "base_link", "child frame of wheel/odom"),
)
