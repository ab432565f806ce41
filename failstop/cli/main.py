"""The command `failstop`. It imports only the module of the subcommand, so that it starts fast."""

from __future__ import annotations

import contextlib
import errno
import os
import sys

from failstop import helpers
from failstop.cli import missing, standard
from failstop.version import VERSION, options

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser
    from types import ModuleType
    from typing import Any

GROUPS = {
    "drive": {
        "enable": ("cli.commands.requests", "enable motion"),
        "disable": ("cli.commands.requests", "disable motion: the wheels stop"),
        "drive": ("cli.commands.requests", "drive at a given speed for some seconds"),
        "teleop": ("cli.commands.teleop", "drive with the keyboard, for as long as you hold a key"),
        "attend": ("cli.commands.attend", "confirm that an operator is present, if the robot needs one to move"),
        "stop": ("cli.commands.stop", "stop now, even if the service is dead"),
        "estop": ("cli.commands.stop", "the same as stop"),
        "reset": ("cli.commands.requests", "clear a latched stop; nothing moves until the next enable"),
        "limit": ("cli.commands.requests", "limit every driver to a percentage of the speeds in the settings"),
        "arm": ("cli.commands.arm", "move the arm, hold it, release it, or show where it is"),
    },
    "look": {
        "status": ("cli.commands.status", "show what the wheels do and why, and the last stop; live with -w"),
        "why": ("cli.commands.status", "show why the wheels are stopped, and what to do next"),
        "events": ("cli.commands.events", "list what happened: stops, crashes, requests"),
        "incident": ("cli.commands.incident", "show the minute before a latched stop as text, plot or MCAP file"),
        "metrics": ("fleet.metrics_command", "print metrics for Prometheus, or serve them over HTTP"),
        "fleet": ("fleet.command", "watch and stop many robots at once, or add this robot to the fleet"),
    },
    "check": {
        "setup": ("setup.command", "set up your robot by answering questions, and test its stops"),
        "demo": ("failstop_lab.commands.demo", "kill a simulated robot's programs one by one, and time the stops"),
        "probe": ("failstop_lab.commands.probe", "measure how your robot stops today, without failstop, on a stand"),
        "doctor": ("cli.commands.doctor", "check the computer, port and service, and say what to fix"),
        "prove": ("failstop_lab.commands.prove", "time every kind of stop on your robot, on a stand"),
        "chaos": ("failstop_lab.commands.chaos", "inject random faults, and let a simulated board judge the stops"),
        "config": ("cli.commands.config", "show the settings and where each comes from, or check a file"),
    },
    "service": {
        "run": ("cli.commands.run", "run the service in the foreground"),
        "simulate": ("failstop_lab.commands.simulate", "run the service on a simulated computer, with every fault"),
        "sim": ("failstop_lab.commands.sim", "start a simulated motor board"),
        "guard": ("guard.command", "keep your driver: give it a serial port that behaves like the board"),
        "web": ("web.command", "serve the operator's page: stop the robot from a phone"),
        "ros2": ("ros2.command", "connect ROS 2, so that its nodes drive through the service"),
    },
}
"""The groups of commands in `failstop --help`. Each command has its module and a text that says what it does."""
COMMANDS = {name: row for rows in GROUPS.values() for name, row in rows.items()}
LABORATORY = "failstop_lab"
"""The package with the commands of the laboratory, which injects faults. It may be missing on a robot."""
HIDDEN = frozenset(("estop", "chaos"))
"""Commands that `failstop --help` does not show. `estop` is a second name for `stop`, and `chaos` is a tool for people
who change failstop."""

LOST = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Errors of standard output that are not bugs in failstop: no program reads the output, the disk is full, or the
terminal has been closed."""
EXAMPLES = "examples:"
"""The line above the examples at the end of a command's help."""
DESCRIPTION = """Stops your robot when its software crashes or hangs.
No robot yet? Try `failstop demo`. With a robot on a stand, begin with
`failstop setup`.
Exit codes: 0 done, 1 error, 2 refused, 3 no service of that name runs, 78 a
Python package is missing, 128 plus the number of the signal that ended it
(Ctrl-C: 130, but 0 for run and sim)."""


SYSTEM = "/usr"
"""The folder into which the Linux distribution installs programs."""
MAN_PAGES = ("share/man/man1/failstop.1", "share/man/man1/failstop.1.gz")


def _has_man_page() -> bool:
    """Return True if a manual page was installed with failstop. The Debian package installs one, and pip does not."""
    return any(os.path.exists(os.path.join(place, page)) for place in (SYSTEM, sys.prefix) for page in MAN_PAGES)


def _usage() -> str:
    width = max(map(len, COMMANDS))
    parts = ["usage: failstop COMMAND [OPTION ...]", DESCRIPTION]
    for title, rows in GROUPS.items():
        shown = (f"  {name:<{width}}  {what}" for name, (_, what) in rows.items() if name not in HIDDEN)
        parts.append("\n".join([f"{title}:", *shown]))
    man = "; so does `man failstop`" if _has_man_page() else ""
    parts.append(f"`failstop COMMAND --help` says more, with examples{man}.")
    return "\n\n".join(parts) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Run the command with these arguments (by default those of this process), and return its exit code."""
    if argv is None and sys.argv[1:2] in (["stop"], ["estop"]):
        _go_first()
    helpers.leave_current_folder()
    standard.fill()
    standard.accept_any_bytes()
    code = 0
    try:
        code = _main(sys.argv[1:] if argv is None else argv)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return 130
    except ImportError as error:
        return missing.say(error)
    except Exception as error:
        failed = _report_error(error)
        return code or failed
    return code


def _go_first() -> None:
    """Ask for real-time priority for the rest of this process, before the imports: on a busy computer, a program of
    ordinary priority needs seconds to start. The service's own processes, which have a higher one, still come first.
    Without the right to it, or with a real-time priority already, the priority stays as it is."""
    with contextlib.suppress(OSError):
        if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK not in (os.SCHED_FIFO, os.SCHED_RR):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def _main(words: list[str]) -> int:
    if words[:1] == ["help"] and len(words) > 1:
        words = [words[1], "--help"]
    if not words or words[0] in ("-h", "--help", "help"):
        sys.stdout.write(_usage())
        return 0 if words else 1
    if words[0] in ("-V", "--version"):
        sys.stdout.write(f"failstop {VERSION}\n")
        return 0
    if words[0] not in COMMANDS:
        standard.say(f"no command {words[0]!r}; {_meant(words[0])}`failstop --help` lists them")
        return 1
    return _run(words[0], words[1:])


def _meant(word: str) -> str:
    """Return a question such as "did you mean ...?" about a mistyped command. Empty if no command resembles `word`."""
    from difflib import get_close_matches

    found = get_close_matches(word.lower(), COMMANDS, 1)
    return f"did you mean `failstop {found[0]}`? " if found else ""


def is_laboratory(name: str) -> bool:
    """Return True if the command belongs to the laboratory, which may be missing on a robot."""
    return COMMANDS[name][0].startswith(LABORATORY)


def here(name: str) -> bool:
    """Return True if the command is installed."""
    if not is_laboratory(name):
        return True
    from importlib.util import find_spec

    return find_spec(LABORATORY) is not None


def load(name: str) -> tuple[ArgumentParser, ModuleType]:
    """Return the parser and the module of a command. The command's help ends with the module's EXAMPLES. EXAMPLES is a
    text, or a dict with a text for each command that the module serves. Raises FailstopError if the command is not
    installed."""
    import argparse

    from failstop.cli import style

    home, what = COMMANDS[name]
    if not here(name):
        from failstop.api.errors import FailstopError

        raise FailstopError(f"`failstop {name}` is not installed here; next: install failstop-lab (docs/install.md)")
    module = __import__(home if home.startswith(LABORATORY) else f"failstop.{home}", fromlist=["main"])

    class Help(argparse.RawDescriptionHelpFormatter):
        """Breaks lines as all screens of failstop do: at spaces, but not within a command or between a number and its
        unit."""

        def _split_lines(self, text: str, width: int) -> list[str]:
            words = " ".join(text.split())
            return [style.plain(line) for line in style.wrap([(words, style.PLAIN)], width, 0)]

    class Parser(argparse.ArgumentParser):
        """A parser that formats its help with Help. The parsers of its subcommands do the same."""

        def __init__(self, *, formatter_class: type[argparse.HelpFormatter] = Help, **given: Any) -> None:
            super().__init__(formatter_class=formatter_class, **given)

    description = f"{what[0].upper()}{what[1:]}."
    parser = Parser(prog=f"failstop {name}", description=description)
    module.add_arguments(parser)
    parser.epilog = "\n".join([EXAMPLES, *(f"  {line}" for line in examples(module, name))])
    return parser, module


def examples(module: ModuleType, name: str) -> list[str]:
    """Return the lines of a command's examples."""
    found: str | dict[str, str] = getattr(module, "EXAMPLES", "")
    text = found if isinstance(found, str) else found.get(name, "")
    return [line.strip() for line in text.splitlines() if line.strip()]


def _run(name: str, words: list[str]) -> int:
    import argparse

    parser, module = load(name)
    try:
        arguments = parser.parse_args(options(name, words), argparse.Namespace(command=name))
    except SystemExit as end:
        # argparse exits with 2 if it doesn't understand the arguments. In failstop 2 means that a request was refused.
        return 1 if end.code else 0
    code: int = module.main(arguments)
    return code


def _report_error(error: Exception) -> int:
    """Print an error that is meant for people, and return its exit code. Any other error is a bug, so it is raised
    again."""
    from failstop.api.errors import FailstopError, Refused
    from failstop.board.own import OwnBoardError
    from failstop.board.port import PortError
    from failstop.files.instance import InstanceError
    from failstop.messages.segments import AttachError
    from failstop.policy.setting import SettingError

    if lacking := _lack(error):
        standard.say(lacking)
    elif isinstance(error, (FailstopError, PortError, InstanceError, AttachError, SettingError, OwnBoardError)):
        standard.say(f"refused: {error}" if isinstance(error, Refused) else str(error))
        return getattr(error, "exit_code", 1)
    elif isinstance(error, OSError) and error.errno in LOST:
        standard.let_go()
        if error.errno != errno.EPIPE:
            standard.say(f"standard output can't be written ({error.strerror}), so the output above is incomplete")
    else:
        raise error
    return 1


def _lack(error: BaseException | None) -> str:
    """Return advice if `error`, or an error that led to it, means that this process has too many open files. Otherwise
    return an empty text."""
    import resource

    from failstop.procs.rights import no_descriptors

    while error is not None:
        if isinstance(error, OSError) and error.errno == errno.EMFILE:
            return no_descriptors(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
        error = error.__cause__ or error.__context__
    return ""
