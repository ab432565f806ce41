"""`failstop guard`: opens a serial port for a driver program, which then drives through the service."""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import sys
import tempfile
import time
from argparse import ArgumentParser, Namespace

from failstop import config
from failstop.api.client import runtime_dir
from failstop.api.errors import FailstopError, NoService
from failstop.board.driver import language_of
from failstop.cli import standard
from failstop.cli.commands import add_name
from failstop.files import instance
from failstop.guard.door import Door
from failstop.guard.dry import Nothing
from failstop.guard.guard import Guard
from failstop.guard.pty import Pty
from failstop.guard.service import Service
from failstop.policy.settings import Settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.guard.guard import Board

EXAMPLES = """\
failstop guard                    # prints the path that your driver must open
failstop guard --path /run/port   # your driver opens this path
failstop guard --dry-run          # without a robot: what your driver writes
"""
PORT = "port"
"""The name of the guard port's link in the runtime directory."""
LOOK_S = 0.5
NICE = -10
"""The guard's nice value. With this value, the guard runs before ordinary programs, but after the service's real-time
processes. The guard handles all that the driver writes, so otherwise a driver that writes without end could take
processor time from the service through the guard."""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of `failstop guard`."""
    add = parser.add_argument
    add("--path", metavar="PATH", help="where your driver opens the port (default: the setting guard.path)")
    add(
        "--dry-run",
        action="store_true",
        help="try your driver without a robot: print what it writes, and what failstop would do with it",
    )
    add(
        "--board",
        metavar="KIND",
        help="with --dry-run: the board that the port imitates (default: the setting board.kind)",
    )
    add("--config", metavar="FILE", help="with --dry-run: TOML file with settings (default: the installed file)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Serve the guard port until SIGTERM or Ctrl-C. Raises FailstopError or SettingError."""
    instance.check_name(arguments.name)
    ends = _Ends()
    if arguments.dry_run:
        with tempfile.TemporaryDirectory(prefix="failstop-guard-") as folder:
            return _dry_run(arguments, folder, ends)
    for option in ("board", "config"):
        if getattr(arguments, option):
            raise FailstopError(f"--{option} goes with --dry-run: a guard has the settings of the service that runs")
    service = Service(arguments.name)
    settings = _wait(service, ends)
    return _serve(service, settings, arguments.path or _usual(settings, arguments.name), ends) if settings else 0


class _Ends:
    """Handles SIGTERM and Ctrl-C. After one of the two, `now` is True, and the guard must end."""

    def __init__(self) -> None:
        self.now = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._end)

    def _end(self, _number: int, _frame: object) -> None:
        self.now = True


def _dry_run(arguments: Namespace, folder: str, ends: _Ends) -> int:
    asked = {"board.kind": arguments.board} if arguments.board else {}
    settings = config.load(config.chosen(arguments.name, arguments.config), asked)
    _print_line(f"a dry run, as the board {settings.text('board.kind')}: nothing moves")
    path = arguments.path or settings.text("guard.path") or os.path.join(folder, PORT)
    return _serve(Nothing(settings, _print_line), settings, path, ends)


def _wait(service: Service, ends: _Ends) -> Settings | None:
    """Wait until the service runs, and return its settings. Returns None after SIGTERM or Ctrl-C."""
    said = ""
    while not ends.now:
        if service.look(time.monotonic_ns()):
            return service.settings
        if service.note != said:
            said = service.note
            _print_line(f"{said}; waiting for it")
        time.sleep(LOOK_S)
    return None


def _usual(settings: Settings, name: str) -> str:
    """The path of the port if --path is not given. This is the setting guard.path if it is set. Otherwise the port is
    in the first of these folders that exists: the runtime folder that systemd has made for the guard's unit; the
    service's runtime folder, if this user may write there; the user's runtime folder, if this user may write there.
    Raises FailstopError if none of them exists."""
    if path := settings.text("guard.path"):
        return path
    if folder := os.environ.get("RUNTIME_DIRECTORY"):
        return os.path.join(folder, PORT)
    with contextlib.suppress(NoService):
        if os.access(folder := runtime_dir(name), os.W_OK):
            return os.path.join(folder, PORT)
    session = os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}"
    if os.access(session, os.W_OK):
        return os.path.join(session, f"{name}-{PORT}")
    raise FailstopError("this user can't write to any of the usual folders for the port; choose a place with --path")


def _serve(board: Board, settings: Settings, path: str, ends: _Ends) -> int:
    kind = settings.text("board.kind")
    try:
        described = language_of(kind, settings.flat()) is not None
    except ValueError as error:
        raise FailstopError(str(error)) from None
    if not described:
        raise FailstopError(
            f"{os.path.join(kind, 'wire.py')} does not say what a driver program may write to this board: add `driver` "
            'to its Wire ("The guard port" in docs/porting.md), or let your program drive with failstop.Robot'
        )
    if not os.path.isabs(path):
        raise FailstopError(f"{path}: give the whole path, because your driver may run in another folder")
    pty = Pty(path)
    try:
        guard = Guard(board, pty, Door(pty), _print_line)
        try:
            _print_line(f"your driver opens {path} instead of the board's port; Ctrl-C ends the guard")
            gc.freeze()
            with contextlib.suppress(OSError):  # without the right to do so, answers come late on a busy machine
                _go_first()
            while not ends.now:
                guard.turn()
        finally:
            guard.close()
    finally:
        pty.close()
    return 0


def _go_first() -> None:
    """Make Linux run the guard before ordinary programs. Raises OSError.

    Linux first shares the processor among sessions (autogroup), so a nice value counts only within one session. A guard
    that runs as a service is alone in its session, so the session gets the nice value too. In a terminal, the session
    has other programs, so only the guard gets the nice value.
    """
    os.setpriority(os.PRIO_PROCESS, 0, NICE)
    if os.getsid(0) == os.getpid():
        with open("/proc/self/autogroup", "w", encoding="ascii") as file:
            file.write(str(NICE))


def _print_line(line: str) -> None:
    """Print a line. Drop it if printing would have to wait, for example on a paused terminal, because the driver would
    have to wait too. Also drop it if it has characters that the output's encoding lacks."""
    with contextlib.suppress(OSError, ValueError):
        if select.select((), (sys.stdout,), (), 0)[1]:
            print(standard.folded(line), flush=True)
