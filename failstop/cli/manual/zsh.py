"""The completion script for zsh: one function for each command, with the help texts."""

from __future__ import annotations

from failstop.cli.manual.grammar import Argument, Command
from failstop.incidents.file import SUFFIX

ACTIONS = {
    "file": "_files",
    "directory": "_files -/",
    "instance": "_failstop_instances",
    "incident": "_failstop_incidents",
}

HEAD = """\
#compdef failstop
# zsh completion for failstop. Generated: `failstop completion zsh`.

_failstop_instances() {
    local -a found
    local place pid
    for place in {/run,${XDG_RUNTIME_DIR:-/run/user/$UID}}/failstop/*/stop(Np:h) /dev/shm/failstop-$UID/*/stop(Np:h); do
        [[ -f $place/lock && -r $place/lock ]] && read -r pid < $place/lock && [[ ! -d /proc/$pid ]] && continue
        found+=($place:t)
    done
    compadd -a found
}

_failstop_incidents() {
    local -a found
    found=(last {/var/lib,${XDG_STATE_HOME:-~/.local/state}}/failstop/{,*/}incidents/*%(suffix)s(N:t:r))
    compadd -a found
}
"""

TAIL = """\
if [[ $funcstack[1] == _failstop ]]; then
    _failstop "$@"
else
    compdef _failstop failstop
fi
"""


def script(commands: list[Command]) -> str:
    """The whole file."""
    parts = [HEAD % {"suffix": SUFFIX}]
    parts += [_function(below) for command in commands for below in command.walk()]
    parts += [
        _chooser("_failstop", commands, ["'(- *)'{-h,--help}'[the commands]'", "'(- *)'{-V,--version}'[the version]'"])
    ]
    return "\n".join([*parts, TAIL])


def _function(command: Command) -> str:
    name = "_" + "_".join(("failstop", *command.path))
    specs = [_spec(argument) for argument in (*command.options, *command.positionals)]
    if command.children:
        return _chooser(name, list(command.children), specs)
    return f"{name}() {{\n    _arguments -s" + "".join(f" \\\n        {spec}" for spec in specs) + "\n}\n"


def _chooser(name: str, commands: list[Command], specs: list[str]) -> str:
    """A function that completes one of the commands, and then calls that one's."""
    words = "\n".join(f"            {_quoted(f'{command.path[-1]}:{command.what}')}" for command in commands)
    cases = "\n".join(
        f"                {command.path[-1]}) _{'_'.join(('failstop', *command.path))} ;;" for command in commands
    )
    lines = "".join(f" \\\n        {spec}" for spec in (*specs, "'1: :->command'", "'*:: :->rest'"))
    return f"""\
{name}() {{
    local curcontext=$curcontext state line
    local -a commands
    _arguments -C{lines}
    case $state in
        command)
            commands=(
{words}
            )
            _describe command commands ;;
        rest)
            case $line[1] in
{cases}
            esac ;;
    esac
}}
"""


def _spec(argument: Argument) -> str:
    """One argument of _arguments."""
    value = "" if argument.value is None else f":{_escaped(argument.value)}:{_action(argument)}"
    if not argument.flags:
        return _quoted(
            f"{'*' if argument.repeats else ''}:{_escaped(argument.help or argument.value or '')}:{_action(argument)}"
        )
    text = f"[{_escaped(argument.help)}]{value}"
    first = "(- *)" if "--help" in argument.flags else f"({' '.join(argument.flags)})"
    if len(argument.flags) == 1:
        return _quoted(argument.flags[0] + text)
    return f"'{first}'{{{','.join(argument.flags)}}}{_quoted(text)}"


def _action(argument: Argument) -> str:
    return f"({' '.join(argument.choices)})" if argument.choices else ACTIONS.get(argument.kind, " ")


def _escaped(text: str) -> str:
    return "".join(f"\\{character}" if character in "[]:\\" else character for character in text)


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"
