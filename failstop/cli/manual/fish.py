"""The completion script for fish: one `complete` for each command, option and argument."""

from __future__ import annotations

from failstop.cli.manual.grammar import Argument, Command
from failstop.incidents.file import SUFFIX

HEAD = """\
# fish completion for failstop. Generated: `failstop completion fish`.

function __failstop_instances
    set -q XDG_RUNTIME_DIR; or set -l XDG_RUNTIME_DIR /run/user/(id -u)
    for place in /run/failstop/*/stop $XDG_RUNTIME_DIR/failstop/*/stop /dev/shm/failstop-(id -u)/*/stop
        test -p $place; or continue
        set -l folder (dirname $place)
        if test -f $folder/lock; and test -r $folder/lock
            read -l pid < $folder/lock; and not test -d /proc/$pid; and continue
        end
        basename $folder
    end
end

function __failstop_incidents
    set -q XDG_STATE_HOME; or set -l XDG_STATE_HOME ~/.local/state
    echo last
    for file in {/var/lib,$XDG_STATE_HOME}/failstop/{,*/}incidents/*%(suffix)s
        basename $file %(suffix)s
    end
end

complete -c failstop -f
complete -c failstop -n __fish_use_subcommand -l help -d 'the commands'
complete -c failstop -n __fish_use_subcommand -l version -d 'the version'
"""


def script(commands: list[Command]) -> str:
    """The whole file."""
    lines = [_word("__fish_use_subcommand", command) for command in commands]
    for command in commands:
        for below in command.walk():
            lines += _lines(below)
    return HEAD % {"suffix": SUFFIX} + "\n".join(lines) + "\n"


def _word(condition: str, command: Command) -> str:
    return f"complete -c failstop -n {condition} -a {command.path[-1]} -d {_quoted(command.what)}"


def _lines(command: Command) -> list[str]:
    here = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in command.path)
    below = " ".join(child.path[-1] for child in command.children)
    itself = _quoted(f"{here}; and not __fish_seen_subcommand_from {below}" if below else here)
    lines = [_word(itself, child) for child in command.children]
    for option in command.options:
        flags = " ".join(f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}" for flag in option.flags)
        lines.append(f"complete -c failstop -n {itself} {flags}{_value(option)} -d {_quoted(option.help)}")
    lines += [
        f"complete -c failstop -n {itself}{_value(argument, '')}"
        for argument in command.positionals
        if argument.kind not in ("other", "none")
    ]
    return lines


def _value(argument: Argument, required: str = " -x") -> str:
    if argument.choices:
        return f"{required} -a {_quoted(' '.join(argument.choices))}"
    return {
        "none": "",
        "file": f"{required and ' -r'} -F",
        "directory": f"{required} -a '(__fish_complete_directories)'",
        "instance": f"{required} -a '(__failstop_instances)'",
        "incident": f"{required} -a '(__failstop_incidents)'",
    }.get(argument.kind, required)


def _quoted(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
