"""`failstop ros2`: runs the bridge to ROS 2 in the foreground."""

from __future__ import annotations

import glob
import os
import sys
from argparse import REMAINDER, ArgumentParser, Namespace
from importlib import import_module

from failstop.api.errors import FailstopError
from failstop.cli.commands import add_name
from failstop.cli.missing import INCOMPLETE
from failstop.ros2 import transport

EXAMPLES = """\
. /opt/ros/humble/setup.sh; failstop ros2
failstop ros2 --ros-args -r cmd_vel:=/base/cmd_vel -p cmd_vel_type:=stamped
"""


class NoRos(FailstopError):
    """This Python can't import rclpy. The message says what to do."""

    exit_code = INCOMPLETE
    """Exit code of a command that fails with this error."""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of `failstop ros2` to its parser."""
    add_name(parser)
    words = "arguments for ROS 2: -r FROM:=TO, -p NAME:=VALUE, --params-file FILE, ..."
    parser.add_argument("--ros-args", nargs=REMAINDER, default=[], metavar="ARG", help=words)


def main(arguments: Namespace) -> int:
    """Run the bridge. Raises NoRos if rclpy can't be imported."""
    transport.udp_alone(os.environ)
    find_rclpy()
    from failstop.ros2 import bridge

    words = ["--ros-args", *arguments.ros_args] if arguments.ros_args else []
    return bridge.main(arguments.name, words)


def find_rclpy() -> None:
    """Make rclpy importable. Adds the folders of PYTHONPATH to sys.path, because ROS puts its packages there and the
    installed command ignores it. Raises NoRos."""
    known = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    sys.path += [path for path in known if os.path.isabs(path) and path not in sys.path]
    try:
        import_module("rclpy")
    except ImportError as error:
        this = f"rclpy can't be imported by this Python {sys.version_info[0]}.{sys.version_info[1]} ({error})"
        advice = f"{this}: install failstop for ROS's own Python"
        if not (setups := sorted(glob.glob("/opt/ros/*/setup.sh"))):
            advice = "there is no ROS 2 here (no /opt/ros/*/setup.sh): install it, or source its setup.sh where it is"
        elif "AMENT_PREFIX_PATH" not in os.environ:
            advice = f"rclpy can't be imported: first type `. {setups[-1]}`"
        raise NoRos(advice) from None
