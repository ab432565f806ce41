"""`failstop run`: runs the service in the foreground. It writes a stop to the port before it does anything that may
fail."""

from __future__ import annotations

import contextlib
import os
import shlex
from argparse import ArgumentParser, Namespace

from failstop import config, instances
from failstop.api.errors import FailstopError
from failstop.board import finder
from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.board.port import PortError
from failstop.cli.commands import add_name
from failstop.files import instance
from failstop.policy.setting import SettingError
from failstop.policy.settings import BY_KEY
from failstop.procs import rights
from failstop.supervisor import starter
from failstop.supervisor.port_handover import OwnPort

DEVICE, KIND, BAUD, CAN_ID = "device.path", "board.kind", "board.baud", "board.can_id"
OF_SETTINGS = "the stop is written to {}"
OF_LAST_RUN = "the stop of the last run's board is written to {}"
OF_ANOTHER = "{}; if another board is there, use the POWER SWITCH"
REFUSALS = (FailstopError, SettingError, instance.InstanceError, OSError)
"""Errors that keep the service from starting."""

EXAMPLES = """\
failstop run                             # /dev/ttyACM0, default settings
failstop run --config /etc/failstop/failstop.toml
failstop run --name left --device /dev/ttyACM1  # a second robot
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop run`."""
    parser.add_argument(
        "--config", metavar="FILE", help="TOML file with settings (without it, every setting has its default)"
    )
    parser.add_argument("--device", metavar="PATH", help="the board's port (default: the setting device.path)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Write a stop to the port, then become the supervisor. Raises errors that main.py prints as one line."""
    device, board, read, of = _device(arguments)
    port, lost = None, None
    try:
        if not (arguments.device or {DEVICE, KIND} & {*(read or {})} or of == OF_LAST_RUN):
            finder.refuse_stranger(device, board)
        port = OwnPort.open_and_stop(device, board, lambda: instances.refuse_locked(arguments.name))
    except PortError as error:
        if error.kind == "busy":
            instances.refuse_listening(arguments.name)
        lost = error
    try:
        _start(arguments, read, port)
    except REFUSALS as error:
        told = f"no stop was written: {lost}"
        if port:
            written = port.stopped and port.drain()
            told = of.format(device) if written else f"{device} takes no bytes: use the POWER SWITCH"
            port.close()
        raise FailstopError(f"{_why(error)}; {told}") from None
    absent = lost is not None and lost.kind == "absent"
    raise FailstopError(f"{lost}{'; `failstop doctor --quick` lists the ports that are there' if absent else ''}")


def _device(arguments: Namespace) -> tuple[str, Board, dict[str, object] | None, str]:
    """Choose the port and the board for the first stop. Both come from the settings file, even if other settings in it
    are wrong. If the file can't be read, they come from the last run, or else from the defaults. The option --device
    replaces the port.

    Returns four values: the port, the board, the unchecked settings in the file (None if they can't be read), and a
    text about the port that is printed if the service can't start. Raises FailstopError.
    """
    if (read := _read(arguments.config)) is None:
        from failstop.board import kept  # imported only here, so that the first stop does not wait for it

        last = instance.last(arguments.name)
        # These are stored bytes of a stop, not a program, and this user or root has written them.
        if last.owner in (0, os.geteuid()) and (known := kept.unpack_stop(last.stop)):
            return arguments.device or last.device, known, None, OF_LAST_RUN
        read = _read(arguments.config)  # try again, because the file may be readable now
    found = {key: BY_KEY[key].default for key in (DEVICE, KIND, BAUD, CAN_ID)}
    for key in found:
        with contextlib.suppress(SettingError):
            found[key] = BY_KEY[key].check((read or {}).get(key, found[key]))
    try:
        board = board_of(str(found[KIND]), 1.0, 0.0, baud=int(found[BAUD]), can_id=int(found[CAN_ID]))
    except ValueError as error:
        advice = "if a wheel turns, try `failstop stop`, or use the POWER SWITCH"
        raise FailstopError(f"{error}; no stop was written: {advice}") from None
    of = OF_SETTINGS if read is not None else f"the stop of {board.name} is written to {OF_ANOTHER}"
    return arguments.device or str(found[DEVICE]), board, read, of


def _read(path: str | None) -> dict[str, object] | None:
    """Return the settings in a settings file, unchecked. None if the file can't be read."""
    with contextlib.suppress(Exception):
        return config.read(path)
    return None


def _start(arguments: Namespace, read: dict[str, object] | None, port: OwnPort | None) -> None:
    """Check the settings and the name, then turn this process into the supervisor. If `port` is None, only check.
    Raises one of REFUSALS."""
    from failstop.supervisor import fit, status  # imported only here, so that the first stop does not wait for them

    rights.raise_limits()
    given = {DEVICE: BY_KEY[DEVICE].check(arguments.device, "--device")} if arguments.device else {}
    read = config.read(arguments.config) if read is None else read
    settings = status.leased(config.checked({**read, **given}, arguments.config), read)
    fit.checked_board(settings, arguments.config)
    instance.check_name(arguments.name)
    if port is None:
        return
    folder = instances.make_runtime_dir(arguments.name)
    instances.refuse_listening(arguments.name, folder)
    starter.become_supervisor(arguments.name, folder, settings, instances.lock(folder), port.fd, _again(arguments))


def _again(arguments: Namespace) -> str:
    """Return the command line that starts this service again from any folder, quoted for a shell."""
    from failstop.supervisor.status import own_unit

    if (unit := instances.unit_of(arguments.name)) == own_unit():
        return f"sudo systemctl start {unit.removesuffix('.service')}"
    words = [] if arguments.name == instance.DEFAULT_NAME else ["--name", arguments.name]
    for option, path in (("--config", arguments.config), ("--device", arguments.device)):
        words += [option, os.path.abspath(path)] if path else []
    return shlex.join(["failstop", "run", *words])


def _why(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)
