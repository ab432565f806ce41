"""The command `failstop`: finds the subcommand and imports nothing but that one."""

from __future__ import annotations

import sys

COMMANDS = {
    "run": ("run", "run the service in the foreground"),
    "sim": ("sim", "a simulated board on a pty"),
    "demo": ("demo", "simulated board, service, a drive, and every kill with its measured stop"),
    "status": ("status", "what the wheels may do and why, processes, last stop"),
    "enable": ("requests", "enable motion"),
    "disable": ("requests", "disable motion: the wheels stop"),
    "reset": ("requests", "clear a latched stop; motion stays disabled"),
    "estop": ("estop", "latched stop, for every local user"),
    "drive": ("drive", "drive for a while"),
    "stop": ("stop", "write the stop to the port; needs no service running"),
    "config": ("config", "every setting with its value and origin"),
    "chaos": ("chaos", "random faults from the fault table on a simulated board, judged by it"),
}

DESCRIPTION = "The layer that makes a robot stop. Exit codes: 0 done, 1 error, 2 refused, 3 no service of that name."


def _usage() -> str:
    width = max(map(len, COMMANDS))
    rows = "\n".join(f"  {name:<{width}}  {what}" for name, (_, what) in COMMANDS.items())
    return f"usage: failstop COMMAND [OPTION ...]\n\n{DESCRIPTION}\n\n{rows}\n\n`failstop COMMAND --help` says more.\n"


def main(argv: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    if not words or words[0] in ("-h", "--help", "help"):
        sys.stdout.write(_usage())
        return 0 if words else 1
    if words[0] in ("-V", "--version"):
        from failstop.version import VERSION

        sys.stdout.write(f"failstop {VERSION}\n")
        return 0
    if words[0] not in COMMANDS:
        sys.stderr.write(f"failstop: no command {words[0]!r}; `failstop --help` lists them\n")
        return 1
    return _run(words[0], words[1:])


def _run(name: str, words: list[str]) -> int:
    import argparse

    home, what = COMMANDS[name]
    module = __import__(f"failstop.commands.{home}", fromlist=["main"])
    parser = argparse.ArgumentParser(prog=f"failstop {name}", description=what[0].upper() + what[1:] + ".")
    module.add_arguments(parser)
    arguments = parser.parse_args(words, argparse.Namespace(command=name))
    try:
        code: int = module.main(arguments)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 1
    except Exception as error:
        if not _expected(error):
            raise
        sys.stderr.write(f"failstop: {error}\n")
        return getattr(error, "exit_code", 1)
    return code


def _expected(error: Exception) -> bool:
    """Errors with a message made for people; anything else is a defect and shows its traceback."""
    from failstop.board.port import PortError
    from failstop.errors import FailstopError
    from failstop.shm.instance import InstanceError
    from failstop.shm.segment import AttachError
    from failstop.supervisor.settings import SettingError

    return isinstance(error, (FailstopError, PortError, InstanceError, AttachError, SettingError))
