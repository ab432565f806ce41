"""The man page failstop(1), from the parsers and a few paragraphs: `python -m failstop_lab.pages.man | man -l -`."""

from __future__ import annotations

import argparse
import os
import sys
import time

from failstop.cli import main as cli
from failstop.cli import style
from failstop.files import root
from failstop.version import VERSION
from failstop_lab.pages import completion

DESCRIPTION = (
    "Most motor boards keep the last wheel speed forever, so a robot keeps going when the program that drives it "
    "crashes. failstop owns the board's port, and your programs drive through it. If one of failstop's own processes "
    "dies or hangs, failstop stops the wheels, and nothing moves them until somebody enables motion. If a program that "
    "drives dies, the wheels stop too. If it falls silent, they stop as soon as its last command is older than the "
    "timeout of its source (0.3 s unless the settings say otherwise).",
    "This is a stop by software, not an emergency stop in the sense of ISO 13850, so keep a power switch within reach.",
    "The service is \x01failstop run\x02. Commands that drive or look, such as enable, drive and status, talk to the "
    "service that is running under the name given with --name. \x01failstop stop\x02 works with and without a service.",
)

EXITS = (
    ("0", "Done."),
    ("1", "An error; one line says what happened and what to do."),
    ("2", "The service or the command itself refused, and printed the reason."),
    ("3", "No service of that name is running."),
    ("78", "A Python package that failstop needs is missing; one line names the package and the Python."),
    (
        "128 plus the signal's number",
        "A signal ended the command, for example 130 for Ctrl-C. SIGTERM and Ctrl-C are the normal way to end run, "
        "sim, ros2, guard, web and fleet, which then exit with 0.",
    ),
)

FILES = (
    ("/etc/failstop/failstop.toml", "The settings of the service that systemd runs."),
    (
        "/run/failstop/NAME",
        "The runtime directory of the service NAME. It holds the service's lock, the file in which programs lock their "
        "client slots, the pipe for stop requests, the pipe that wakes the gate when a program has written a command, "
        "the command line of the last run, and the number that identifies that run's shared memory. failstop "
        "refuses a directory that another user could have put there.",
    ),
    (
        "/var/lib/failstop/NAME",
        "The state directory of the service NAME. It holds the incidents, the evidence of failstop prove and the "
        "battery log.",
    ),
)

ENVIRONMENT = (
    ("NO_COLOR", "If it is set, the output has no colours."),
    (
        "XDG_RUNTIME_DIR",
        "If your user can't use /run/failstop, the runtime directory is below this folder (default: /run/user/UID). If "
        "your user can use neither, it is below /dev/shm/failstop-UID. If root can use neither, failstop prints an "
        "error and does not use /dev/shm.",
    ),
    (
        root.VARIABLE,
        "A folder that takes the place of / in /run/failstop, /var/lib/failstop and /etc/failstop. Use it to keep a "
        "test apart from the installed service.",
    ),
    ("STATE_DIRECTORY", "The state directory. systemd sets this variable for a service."),
    (
        "XDG_STATE_HOME",
        "If your user can't use /var/lib/failstop, the state directory is below this folder (default: ~/.local/state).",
    ),
)

SEE_ALSO = (
    "The pages in docs/ of the source: quickstart.md, setup.md, safety.md, reference/causes.md, reference/settings.md."
)


def page() -> str:
    """The whole page, for man(7) macros. Its date is SOURCE_DATE_EPOCH's where that is set, else today."""
    day = time.strftime("%Y-%m-%d", time.gmtime(int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))))
    lines = [
        '.\\" Generated: lab/failstop_lab/pages/man.py',
        f'.TH FAILSTOP 1 "{day}" "failstop {VERSION}" "User Commands"',
        ".nh",
        ".ad l",
        ".SH NAME",
        "failstop \\- stops a robot when its software crashes or hangs",
        ".SH SYNOPSIS",
        ".B failstop",
        ".I COMMAND",
        "[\\fIOPTION\\fR ...]",
        ".SH DESCRIPTION",
    ]
    for index, text in enumerate(DESCRIPTION):
        lines += [".PP"] * (index > 0)
        lines.append(_escaped(text).replace("\x01", "\\fB").replace("\x02", "\\fR"))
    for title, names in cli.GROUPS.items():
        if installed := [name for name in names if cli.here(name)]:
            lines.append(f".SH COMMANDS: {title.upper()}")
            for name in installed:
                for parser in completion.walk(cli.load(name)[0]):
                    lines += command(parser)
    lines += _table("EXIT STATUS", EXITS) + _table("FILES", FILES) + _table("ENVIRONMENT", ENVIRONMENT)
    lines += [".SH SEE ALSO", _escaped(SEE_ALSO)]
    return "\n".join(lines) + "\n"


def command(parser: argparse.ArgumentParser) -> list[str]:
    """The lines of one command."""
    lines = [f".SS {_escaped(parser.prog)}", _escaped(completion.what(parser))]
    arguments = completion.arguments(parser)
    if parser._subparsers is None:
        lines += [".PP", _synopsis(parser.prog, arguments)]
    for action in arguments:
        lines += [".TP", _head(action), _escaped(completion.help_of(parser, action)) or "\\&"]
    if examples := completion.examples(parser):
        lines += [".PP", "Examples:", ".PP", ".RS", ".nf", *map(_escaped, examples), ".fi", ".RE"]
    return lines


def _synopsis(prog: str, arguments: list[argparse.Action]) -> str:
    options = [action for action in arguments if action.option_strings]
    words = [f"\\fB{_escaped(prog)}\\fR", *(_head(option) for option in options if option.required)]
    if not all(option.required for option in options):
        words.append("[\\fIOPTION\\fR ...]")
    words += [completion.placed(action, _head(action)) for action in arguments if not action.option_strings]
    return " ".join(words)


def _head(action: argparse.Action) -> str:
    flags = ", ".join(f"\\fB{_escaped(flag)}\\fR" for flag in action.option_strings)
    shown = completion.placeholder(action)
    return " ".join(filter(None, (flags, shown and f"\\fI{_escaped(shown)}\\fR")))


def _table(title: str, rows: tuple[tuple[str, str], ...]) -> list[str]:
    return [f".SH {title}", *(line for name, text in rows for line in (".TP", f".B {_escaped(name)}", _escaped(text)))]


def _escaped(text: str) -> str:
    """Text that means itself: a line's first dot or quote would be a request, a dash a hyphen; and no line ends between
    a number and its unit."""
    text = text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq").replace("`", "\\(ga")
    text = style.bound(text, "\\~")
    return f"\\&{text}" if text.startswith(".") else text


if __name__ == "__main__":
    sys.stdout.write(page())
