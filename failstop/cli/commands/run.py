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

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

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
    device, board, read, of, guessed = _device(arguments)
    port, lost = None, None
    try:
        if guessed:
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


def _device(arguments: Namespace) -> tuple[str, Board, dict[str, object] | None, str, bool]:
    """Choose the port and the board for the first stop. Both come from the settings file, even if other settings in it
    are wrong. If the file can't be read, or what it says about the board is wrong, they come from the last run, or else
    from the defaults. The option --device replaces the port.

    Returns five values: the port, the board, the unchecked settings in the file (None if they can't be read), a text
    about the port that is printed if the service can't start, and True if nothing has named the port or the kind of
    board. Raises FailstopError.
    """
    read, found, wrong = _checked(arguments)
    if wrong and (last := _of_last_run(arguments, found, wrong)):
        return *last, read, OF_LAST_RUN, False
    if read is None:
        read, found, wrong = _checked(arguments)  # try again, because the file may be readable now
    try:
        board = board_of(str(found[KIND]), 1.0, 0.0, baud=int(found[BAUD]), can_id=int(found[CAN_ID]))
    except ValueError as error:
        if last := _of_last_run(arguments, found, wrong):
            return *last, read, OF_LAST_RUN, False
        stop = f"`failstop stop{instance.option(arguments.name)}`"
        advice = f"if a wheel turns, try {stop}, or use the POWER SWITCH"
        raise FailstopError(f"{error}; no stop was written: {advice}") from None
    of = f"the stop of {board.name} is written to {OF_ANOTHER}" if wrong else OF_SETTINGS
    named = arguments.device or (DEVICE not in wrong and ({DEVICE, KIND} - wrong) & {*(read or {})})
    return arguments.device or str(found[DEVICE]), board, read, of, not named


def _checked(arguments: Namespace) -> tuple[dict[str, object] | None, dict[str, Any], set[str]]:
    """Return three values: the unchecked settings in the file, or None if they can't be read; what they say about the
    port and the board, or else the defaults; and which of these settings are wrong or below the wrong [table]. All are
    wrong if the file can't be read. A wrong port does not count if --device replaces it."""
    read = _read(arguments.config)
    keys = (DEVICE, KIND, BAUD, CAN_ID)
    found = {key: BY_KEY[key].default for key in keys}
    if read is None:
        return read, found, set(keys)
    wrong = {key for key in keys if any(other.endswith(f".{key}") for other in read)}
    for key in keys:
        try:
            found[key] = BY_KEY[key].check(read.get(key, found[key]))
        except SettingError:
            wrong.add(key)
    return read, found, wrong - ({DEVICE} if arguments.device else set())


def _of_last_run(arguments: Namespace, found: dict[str, Any], wrong: set[str]) -> tuple[str, Board] | None:
    """Return the port and the stop of the last run. None if another port is named, if another device is at the port by
    now, or if nobody knows that stop. `found`, `wrong`: as from _checked().

    If the file can't be read, a port that is named with --device gets this stop too, because no other board is more
    likely there."""
    from failstop.board import kept  # imported only here, so that the first stop does not wait for it

    last = instance.last(arguments.name)
    # These are stored bytes of a stop, not a program, and this user or root has written them.
    if last.owner not in (0, os.geteuid()) or not (known := kept.unpack_stop(last.stop)):
        return None
    named = arguments.device or ("" if DEVICE in wrong else str(found[DEVICE]))
    try:
        its = os.stat(last.device)
        same = not named or os.path.samestat(os.stat(named), its)
        still = finder.is_still(finder.usb_text(its.st_rdev), last.usb) is not False
    except OSError:
        same = still = not named or os.path.abspath(named) == last.device
    if (same and still) or (arguments.device and DEVICE in wrong):
        return named or last.device, known
    return None


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
    try:
        fit.checked_board(settings, arguments.config)
    except ValueError as error:  # an OwnBoardError: the first stop was the one of the last run
        raise FailstopError(str(error)) from None
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
