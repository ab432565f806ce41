"""Starts a controller manager that drives through failstop: `ros2 launch failstop_ros2_control failstop.launch.py
base:=diff`.

Let systemd start failstop's service, because the service must stop the robot even if the controller manager fails. A
controller manager that dies is restarted, but nothing moves until somebody enables motion.
"""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessStart
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

BASES = {
    "diff": ("joint_state_broadcaster", "base_controller"),
    "mecanum": ("joint_state_broadcaster", "imu_broadcaster", "base_controller"),
    "ackermann": ("joint_state_broadcaster", "imu_broadcaster", "base_controller"),
}
"""The controllers of each example."""
ARGUMENTS = {
    "base": ("diff", "diff, mecanum or ackermann: the example whose URDF and controllers are taken"),
    "urdf": ("", "your own URDF, a file; its ros2_control block names failstop_ros2_control/System"),
    "controllers": ("", "your own parameters of the controllers, a YAML file"),
}


def _spawners(names: tuple[str, ...], controllers: str) -> list[Node]:
    """The nodes that load the controllers. They exit as soon as the controllers are active."""
    return [
        Node(
            package="controller_manager",
            executable="spawner",
            arguments=[name, "--param-file", controllers],
            output="screen",
        )
        for name in names
    ]


def _actions(context: LaunchContext) -> list[Action]:
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    base = chosen["base"]
    if base not in BASES:
        raise ValueError(f"base:={base}: allowed is {', '.join(BASES)}")
    share = Path(get_package_share_directory("failstop_ros2_control"))
    controllers = chosen["controllers"] or str(share / "config" / f"{base}.yaml")
    text = Path(chosen["urdf"] or share / "urdf" / f"{base}.urdf").read_text("utf-8")
    description = {"robot_description": ParameterValue(text, value_type=str)}
    # Humble reads the description as a parameter, newer ones from the topic that robot_state_publisher serves.
    manager = Node(
        package="controller_manager",
        executable="ros2_control_node",
        parameters=[description, controllers],
        remappings=[("~/robot_description", "/robot_description")],
        respawn=True,
        respawn_delay=1.0,
        output="screen",
    )
    publisher = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        parameters=[description],
        output="screen",
    )
    # A controller manager that was respawned has no controllers, so each of its starts loads them.
    loaded = OnProcessStart(target_action=manager, on_start=lambda event, context: _spawners(BASES[base], controllers))
    return [publisher, RegisterEventHandler(loaded), manager]


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` runs."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_actions)])
