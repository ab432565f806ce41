"""The bridge, and where the laser and the IMU are on the robot: `ros2 launch failstop_ros2 failstop.launch.py`.

The service itself is none of ROS's: systemd starts it, and it makes the robot stop whatever becomes of this launch.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent
from launch.conditions import IfCondition
from launch.events.process import ProcessExited, ShutdownProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "name": ("failstop", "the service's name"),
    "namespace": ("", "the namespace of the bridge"),
    "cmd_vel": ("cmd_vel", "the topic of the velocity commands"),
    "scan": ("scan", "the topic of the obstacle sensor"),
    "cmd_vel_type": ("auto", "auto, twist or stamped"),
    "publish_tf": ("false", "publish odom to base_link; else an EKF does"),
    "static_tf": ("true", "publish where laser and imu_link are on base_link"),
    **{f"laser_{part}": ("0", f"of laser on base_link: {part}") for part in ("x", "y", "z", "yaw", "pitch", "roll")},
    **{f"imu_{part}": ("0", f"of imu_link on base_link: {part}") for part in ("x", "y", "z", "yaw", "pitch", "roll")},
}

INCOMPLETE = 78
"""The bridge ends with this code when ROS or a package that it needs is missing, and says which."""


def _ended(event: ProcessExited, _context: LaunchContext) -> EmitEvent | None:
    """Don't respawn a bridge that can't run as it is installed: it would say the same again each second."""
    if event.returncode != INCOMPLETE:
        return None
    return EmitEvent(event=ShutdownProcess(process_matcher=lambda action: action is event.action))


def _placed(frame: str, prefix: str) -> Node:
    """A static transform from base_link."""
    words = []
    for part in ("x", "y", "z", "yaw", "pitch", "roll"):
        words += [f"--{part}", LaunchConfiguration(f"{prefix}_{part}")]
    return Node(
        package="tf2_ros",
        executable="static_transform_publisher",
        name=f"base_link_to_{frame}",
        arguments=[*words, "--frame-id", "base_link", "--child-frame-id", frame],
        condition=IfCondition(LaunchConfiguration("static_tf")),
    )


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` runs."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    bridge = Node(
        package="failstop_ros2",
        executable="bridge",
        namespace=LaunchConfiguration("namespace"),
        arguments=["--name", LaunchConfiguration("name")],
        parameters=[
            {
                "cmd_vel_type": LaunchConfiguration("cmd_vel_type"),
                "publish_tf": LaunchConfiguration("publish_tf"),
            }
        ],
        remappings=[("cmd_vel", LaunchConfiguration("cmd_vel")), ("scan", LaunchConfiguration("scan"))],
        respawn=True,
        respawn_delay=1.0,
        on_exit=_ended,
        output="screen",
    )
    return LaunchDescription([*declared, bridge, _placed("laser", "laser"), _placed("imu_link", "imu")])
