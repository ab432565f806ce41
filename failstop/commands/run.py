"""`failstop run`: the service in the foreground."""

from __future__ import annotations

from failstop.board.port import PortError
from failstop.commands import add_name
from failstop.errors import FailstopError
from failstop.shm import instance, segment
from failstop.supervisor import config, starter
from failstop.supervisor.port import OwnPort

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace


EXAMPLES = """\
failstop run                             # /dev/ttyACM0, default settings
failstop run --config /etc/failstop/failstop.toml
failstop run --name left --device /dev/ttyACM1  # a second robot
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop run`."""
    parser.add_argument("--config", metavar="FILE", help="TOML file with settings; `failstop config` lists them")
    parser.add_argument("--device", metavar="PATH", help="the board's port (default: the setting device.path)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Stop first, then become the supervisor. Raises what cli.py turns into one line."""
    settings = config.load(arguments.config, {"device.path": arguments.device} if arguments.device else None)
    runtime_dir = instance.make_runtime_dir(arguments.name)
    lock = instance.lock(runtime_dir)
    if pid := segment.living_supervisor(arguments.name):
        raise instance.already_running(arguments.name, pid)
    try:
        port = OwnPort.open_and_stop(settings.text("device.path"))
    except PortError as error:
        raise FailstopError(f"{error}{_others(error)}") from None
    starter.become_supervisor(arguments.name, runtime_dir, settings, lock, port.fd)
    raise AssertionError("exec returned")


def _others(error: PortError) -> str:
    """The serial devices that are there, when the one that was asked for is not."""
    if error.kind != "absent":
        return ""
    from failstop.board import discovery

    found = ", ".join(f"{path} ({what})" for path, what in discovery.candidates())
    return f"; here there is {found}" if found else ""
