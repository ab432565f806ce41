"""The man page failstop(1), from the parsers and a few paragraphs: `python -m failstop_lab.pages.man | man -l -`."""

from __future__ import annotations

import argparse
import os
import sys
import time

from failstop.cli import main as cli
from failstop.files import root
from failstop.version import VERSION
from failstop_lab.pages import completion

DESCRIPTION = (
    "failstop is the layer between everything that wants to drive a robot and a motor board that keeps its last wheel "
    "speed forever. Whatever part of it dies or hangs, the wheels are told to stop, and nothing moves them "
    "until somebody enables motion. A client that dies stops them too; one that falls silent, when its last "
    "command is older than its source's timeout (0.3 s unless the settings say otherwise).",
    "It is a stop by software and no emergency stop in the sense of ISO 13850: keep a power switch in reach.",
    "A service, \x01failstop run\x02, owns the board's port. The commands enable, disable, reset, drive, teleop, "
    "status, why and events talk to the service of the same name; the others need none.",
)

EXITS = (
    ("0", "Done."),
    ("1", "An error; one line says what happened and what to do."),
    ("2", "Refused, by the service or by the command itself, with the reason."),
    ("3", "No service of that name runs."),
    ("78", "A Python package that failstop needs is missing; one line names it and the Python."),
    (
        "128 plus the signal's number",
        "A signal ended it, for example 130 for Ctrl-C. SIGTERM and Ctrl-C are the normal way to end run and sim, "
        "which then exit with 0.",
    ),
)

FILES = (
    ("/etc/failstop/failstop.toml", "The settings of the service that systemd runs."),
    (
        "/run/failstop/NAME",
        "The runtime directory of a service: its lock, its claims, the pipe for stop requests, the gate's bell, how "
        "the last run was started, and which shared memory belongs to it. failstop ignores one that another user "
        "could have put there.",
    ),
    ("/var/lib/failstop", "The state directory, with incidents, evidence and the battery log."),
)

ENVIRONMENT = (
    ("NO_COLOR", "If it is set, the output has no colours."),
    (
        "XDG_RUNTIME_DIR",
        "If /run/failstop can't be used, the runtime directory is below this folder (default: /run/user/UID). If "
        "neither can be used, it is below /dev/shm/failstop-UID, except for root.",
    ),
    (
        root.VARIABLE,
        "A folder that takes the place of / in /run/failstop, /var/lib/failstop and /etc/failstop, to keep runs apart.",
    ),
    ("STATE_DIRECTORY", "The state directory, as systemd sets it for a service."),
    (
        "XDG_STATE_HOME",
        "If /var/lib/failstop can't be used, the state directory is below this folder (default: ~/.local/state).",
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
    shown = completion.value(action)
    return " ".join(filter(None, (flags, shown and f"\\fI{_escaped(shown)}\\fR")))


def _table(title: str, rows: tuple[tuple[str, str], ...]) -> list[str]:
    return [f".SH {title}", *(line for name, text in rows for line in (".TP", f".B {_escaped(name)}", _escaped(text)))]


def _escaped(text: str) -> str:
    """Text that means itself: a line's first dot or quote would be a request, a dash a hyphen."""
    text = text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq").replace("`", "\\(ga")
    return f"\\&{text}" if text.startswith(".") else text


if __name__ == "__main__":
    sys.stdout.write(page())
