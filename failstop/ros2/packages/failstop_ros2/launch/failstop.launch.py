"""Starts the bridge, and publishes where the laser and the IMU are on the robot: `ros2 launch failstop_ros2
failstop.launch.py`.

This file does not start failstop's service. systemd starts the service without ROS, so the service runs even if this
launch fails.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction
from launch.conditions import IfCondition
from launch.events.process import ProcessExited, ShutdownProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PLACE = {"x": "m", "y": "m", "z": "m", "yaw": "rad", "pitch": "rad", "roll": "rad"}
ARGUMENTS = {
    "name": ("failstop", "the name of failstop's service"),
    "namespace": ("", "the namespace of the bridge"),
    "node": ("rosorin_board_driver", "the name of the bridge's node"),
    "params_file": ("", "a file with the bridge's parameters, such as a copy of this package's config/bridge.yaml"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "cmd_vel": ("cmd_vel", "the topic of the velocity commands"),
    "scan": ("scan", "the topic of the obstacle sensor"),
    "laser_frame_id": ("laser", "frame of the obstacle sensor, for static_tf"),
    "static_tf": ("true", "publish the transforms from the base to the laser and to the IMU"),
    **{f"laser_{part}": ("0", f"where the laser is on the base: {part}, {unit}") for part, unit in PLACE.items()},
    **{f"imu_{part}": ("0", f"where the IMU is on the base: {part}, {unit}") for part, unit in PLACE.items()},
}

PARAMETERS = {
    "cmd_vel_type": ("auto", "auto, twist or stamped"),
    "allowed_publishers": ("[]", "nodes that may publish cmd_vel, such as [/velocity_smoother]; []: all may"),
    "publish_tf": ("false", "publish the transform from the odometry frame to the base, if no EKF does"),
    "odom_frame_id": ("odom", "frame of wheel/odom"),
    "base_frame_id": ("base_link", "child frame of wheel/odom"),
    "imu_frame_id": ("imu_link", "frame of imu/data_raw"),
}
"""The bridge's parameters, each with its default and its description. A launch argument overrides params_file, and
params_file overrides the default."""

INCOMPLETE = 78
"""The exit code of a bridge that can't run because ROS or a package that it needs is missing. It also logs what is
missing."""


def _ended(event: ProcessExited, _context: LaunchContext) -> EmitEvent | None:
    """Don't restart a bridge that has exited with INCOMPLETE, because it would fail again each second."""
    if event.returncode != INCOMPLETE:
        return None
    return EmitEvent(event=ShutdownProcess(process_matcher=lambda action: action is event.action))


def _argument(context: LaunchContext, name: str) -> str:
    """The value of a launch argument. If no value is given, the default in PARAMETERS, or "" for other arguments."""
    given: str = LaunchConfiguration(name).perform(context)
    return given or (PARAMETERS[name][0] if name in PARAMETERS else "")


def _placed(context: LaunchContext, frame: str, prefix: str) -> Node:
    """A node that publishes a static transform from the base to `frame`."""
    words = []
    for part in PLACE:
        words += [f"--{part}", LaunchConfiguration(f"{prefix}_{part}")]
    base = _argument(context, "base_frame_id")
    return Node(
        package="tf2_ros",
        executable="static_transform_publisher",
        name=f"{base}_to_{frame}".replace("/", "_"),
        arguments=[*words, "--frame-id", base, "--child-frame-id", frame],
        condition=IfCondition(LaunchConfiguration("static_tf")),
    )


def _nodes(context: LaunchContext) -> list[Node]:
    """The nodes to start: the bridge, and the static transforms. Launch arguments override params_file."""
    file = _argument(context, "params_file")
    given = {name: LaunchConfiguration(name) for name in PARAMETERS if LaunchConfiguration(name).perform(context)}
    bridge = Node(
        package="failstop_ros2",
        executable="bridge",
        name=LaunchConfiguration("node"),
        namespace=LaunchConfiguration("namespace"),
        arguments=["--name", LaunchConfiguration("name")],
        ros_arguments=["--log-level", LaunchConfiguration("log_level")],
        parameters=[*([file] if file else []), *([given] if given else [])],
        remappings=[("cmd_vel", LaunchConfiguration("cmd_vel")), ("scan", LaunchConfiguration("scan"))],
        respawn=True,
        respawn_delay=1.0,
        on_exit=_ended,
        output="screen",
    )
    laser, imu = _argument(context, "laser_frame_id"), _argument(context, "imu_frame_id")
    return [bridge, _placed(context, laser, "laser"), _placed(context, imu, "imu")]


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` runs."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    declared += [
        DeclareLaunchArgument(name, default_value="", description=f"{text} (default: {default}, or params_file's)")
        for name, (default, text) in PARAMETERS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])
