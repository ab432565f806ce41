"""`ros2 run failstop_ros2 bridge`: the same as `failstop ros2`, in ROS's own interpreter."""

from __future__ import annotations

import glob
import sys

INCOMPLETE = 78
"""The exit code with which the launch file does not start it again, as failstop's own for a missing package."""
INSTALLED = "/opt/failstop/site-packages"


def main() -> int:
    """Run the bridge of the failstop that is installed; returns the exit code."""
    # Behind everything else: what ROS was built with comes first, numpy above all.
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
