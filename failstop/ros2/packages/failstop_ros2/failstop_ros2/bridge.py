"""`ros2 run failstop_ros2 bridge`: the same as `failstop ros2`, in ROS's own interpreter."""

from __future__ import annotations

import glob
import sys

INCOMPLETE = 78
"""The exit code if a package is missing, which is also failstop's own. With this code the launch file does not restart
the bridge."""
INSTALLED = "/opt/failstop/site-packages"


def main() -> int:
    """Run the bridge of the installed failstop. Returns the exit code."""
    # Last, so that packages with which ROS was built come first, above all numpy.
    sys.path += glob.glob(INSTALLED)
    try:
        from failstop.cli import main as cli
    except ImportError as error:
        version = f"Python {sys.version_info[0]}.{sys.version_info[1]}"
        sys.stderr.write(
            f"failstop can't be imported by ROS's {version} ({error}): install it with that Python's pip\n"
        )
        return INCOMPLETE
    return cli.main(["ros2", *sys.argv[1:]])
