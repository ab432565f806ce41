"""The launch file starts the bridge, which waits for the service and ends cleanly: `colcon test`."""

import unittest
from typing import Any

import pytest
from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing.actions import ReadyToTest
from launch_testing.asserts import assertExitCodes
from launch_testing.post_shutdown_test import post_shutdown_test

SHARE = get_package_share_directory("failstop_ros2")
NOBODY = "failstop-launch-test"
"""The name of a service that is not running."""


@pytest.mark.launch_test
def generate_test_description() -> LaunchDescription:
    """Run the launch file with the example parameter file, for a service that is not running."""
    arguments = {"name": NOBODY, "params_file": f"{SHARE}/config/bridge.yaml", "node": "base_driver"}
    source = PythonLaunchDescriptionSource(f"{SHARE}/launch/failstop.launch.py")
    return LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments.items()), ReadyToTest()])


class TestStart(unittest.TestCase):
    """Tests while the bridge is running."""

    def test_it_waits_for_the_service(self, proc_output: Any) -> None:
        proc_output.assertWaitFor("the bridge waits for it", timeout=30, stream="stderr")


@post_shutdown_test()
class TestEnd(unittest.TestCase):
    """Tests after the bridge has ended."""

    def test_it_ends_cleanly(self, proc_info: Any) -> None:
        assertExitCodes(proc_info)
