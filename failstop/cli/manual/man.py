"""The man page failstop(1), made from the grammar and a few paragraphs."""

from __future__ import annotations

from failstop.cli.manual.grammar import Argument, Command
from failstop.shm import root
from failstop.version import VERSION

DESCRIPTION = (
    "failstop is the layer between everything that wants to drive a robot and a motor board that keeps its last wheel "
    "speed for ever. Whatever part of it dies or hangs, the wheels are told to stop, and nothing moves them again "
    "until somebody enables motion anew. A client that dies stops them too; one that falls silent, when its last "
    "command is older than its source's timeout (0.3 s unless the settings say otherwise).",
    "It is a stop by software and no emergency stop in the sense of ISO 13850: keep a power switch in reach.",
    "A service, \x01failstop run\x02, owns the board's port. The commands enable, disable, reset, drive, teleop, "
    "estop, status, watch, why and events talk to the service of the same name; the others need none.",
)

EXITS = (
    ("0", "Done."),
    ("1", "An error; one line says what happened and what to do."),
    ("2", "Refused, by the service or by the command itself, with the reason."),
    ("3", "No service of that name runs."),
    (
        "128 and the signal's number",
        "A signal ended it, as 130: Ctrl-C. run and sim take SIGTERM and Ctrl-C as an order to end, and end with 0.",
    ),
)

FILES = (
    ("/etc/failstop/failstop.toml", "Settings, where the system's service reads them."),
    (
        "/run/failstop/NAME",
        "Runtime directory of a service: lock, claims, the pipe for stop requests, the gate's bell, and which run's "
        "shared memory it is. One that somebody else could have put there is not believed.",
    ),
    ("/var/lib/failstop", "State directory."),
)

ENVIRONMENT = (
    ("NO_COLOR", "Set: no colours on a terminal."),
    (
        "XDG_RUNTIME_DIR",
        "The runtime directory is below it (default: /run/user/UID) where /run/failstop can't be used; where neither "
        "can, it is below /dev/shm/failstop-UID, but for root.",
    ),
    (root.VARIABLE, "The root of /run/failstop, /var/lib/failstop and /etc/failstop, for a run apart from these."),
    ("STATE_DIRECTORY", "The state directory, as systemd sets it for a service."),
    (
        "XDG_STATE_HOME",
        "The state directory is below it (default: ~/.local/state) where /var/lib/failstop can't be used.",
    ),
)

SEE_ALSO = "The pages in docs/ of the source: quickstart.md, robot.md, safety.md, causes.md, configuration.md."


def page(groups: list[tuple[str, list[Command]]]) -> str:
    """The whole page, for man(7) macros."""
    lines = [
        '.\\" Generated: python -m failstop.cli.manual > man/failstop.1',
        f'.TH FAILSTOP 1 "" "failstop {VERSION}" "User Commands"',
        ".nh",
        ".ad l",
        ".SH NAME",
        "failstop \\- the layer that makes a robot stop",
        ".SH SYNOPSIS",
        ".B failstop",
        ".I COMMAND",
        "[\\fIOPTION\\fR ...]",
        ".SH DESCRIPTION",
    ]
    for index, text in enumerate(DESCRIPTION):
        lines += [".PP"] * (index > 0)
        lines.append(_escaped(text).replace("\x01", "\\fB").replace("\x02", "\\fR"))
    for title, commands in groups:
        lines.append(f".SH COMMANDS: {title.upper()}")
        for command in commands:
            for below in command.walk():
                lines += _command(below)
    lines += _table("EXIT STATUS", EXITS) + _table("FILES", FILES) + _table("ENVIRONMENT", ENVIRONMENT)
    lines += [".SH SEE ALSO", _escaped(SEE_ALSO)]
    return "\n".join(lines) + "\n"


def _command(command: Command) -> list[str]:
    lines = [f".SS {_escaped(' '.join(('failstop', *command.path)))}", _escaped(command.what)]
    if not command.children:
        lines += [".PP", _synopsis(command)]
    for argument in (*command.positionals, *command.options):
        if "--help" in argument.flags:
            continue
        lines += [".TP", _head(argument), _escaped(argument.help) or "\\&"]
    if command.examples:
        lines += [".PP", "Examples:", ".PP", ".RS", ".nf", *map(_escaped, command.examples), ".fi", ".RE"]
    return lines


def _synopsis(command: Command) -> str:
    words = [f"\\fB{_escaped(' '.join(('failstop', *command.path)))}\\fR"]
    words += [_head(option) for option in command.options if option.required]
    if any(not option.required and "--help" not in option.flags for option in command.options):
        words.append("[\\fIOPTION\\fR ...]")
    for argument in command.positionals:
        name = f"\\fI{_escaped(argument.value or '')}\\fR"
        shown = f"{name} ..." if argument.repeats else name
        words.append(shown if argument.required else f"[{shown}]")
    return " ".join(words)


def _head(argument: Argument) -> str:
    value = f"\\fI{_escaped(argument.value)}\\fR" if argument.value is not None else ""
    flags = ", ".join(f"\\fB{_escaped(flag)}\\fR" for flag in argument.flags)
    return " ".join(filter(None, (flags, value)))


def _table(title: str, rows: tuple[tuple[str, str], ...]) -> list[str]:
    return [f".SH {title}", *(line for name, text in rows for line in (".TP", f".B {_escaped(name)}", _escaped(text)))]


def _escaped(text: str) -> str:
    """Text that means itself: a line's first dot or quote would be a request, a dash a hyphen."""
    text = text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq").replace("`", "\\(ga")
    return f"\\&{text}" if text.startswith(".") else text
