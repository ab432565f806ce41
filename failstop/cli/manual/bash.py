"""The completion script for bash: two tables made from the grammar, and the function that looks into them."""

from __future__ import annotations

from collections.abc import Iterator

from failstop.cli.manual.grammar import Argument, Command
from failstop.incidents.file import SUFFIX

SCRIPT = """\
# bash completion for failstop. Generated: `failstop completion bash`.

# What may follow a path of commands: words, or what kind of value stands at a place.
_failstop_next() {
    case $1 in
%(next)s
    esac
}

# The options of a path of commands.
_failstop_options() {
    case $1 in
%(options)s
    esac
}

# What an option takes; nothing for one that takes none.
_failstop_takes() {
    case $1 in
%(takes)s
    esac
}

# The services of this machine, without those whose lock names a process that is gone.
_failstop_instances() {
    local place pid
    for place in /run/failstop/*/ "${XDG_RUNTIME_DIR:-/run/user/$UID}"/failstop/*/ "/dev/shm/failstop-$UID"/*/; do
        [[ -p ${place}stop ]] || continue
        [[ -f ${place}lock && -r ${place}lock ]] && read -r pid < "${place}lock" && [[ ! -d /proc/$pid ]] && continue
        basename "$place"
    done
}

# The incidents that are kept on this machine.
_failstop_incidents() {
    local file
    echo last
    for file in {/var/lib,"${XDG_STATE_HOME:-$HOME/.local/state}"}/failstop/{,*/}incidents/*%(suffix)s; do
        [[ -f $file ]] && basename "$file" %(suffix)s
    done
}

# Fill COMPREPLY with what a kind of value can be.
_failstop_fill() {
    case $1 in
        file) compopt -o filenames; mapfile -t COMPREPLY < <(compgen -f -- "$2") ;;
        directory) compopt -o filenames; mapfile -t COMPREPLY < <(compgen -d -- "$2") ;;
        instance) mapfile -t COMPREPLY < <(compgen -W "$(_failstop_instances)" -- "$2") ;;
        incident) mapfile -t COMPREPLY < <(compgen -W "$(_failstop_incidents)" -- "$2") ;;
        words:*) mapfile -t COMPREPLY < <(compgen -W "${1#words:}" -- "$2") ;;
    esac
}

_failstop() {
    local current=${COMP_WORDS[COMP_CWORD]} path=failstop place=0 option= word i
    COMPREPLY=()
    for ((i = 1; i < COMP_CWORD; i++)); do
        word=${COMP_WORDS[i]}
        if [[ $word == "=" ]]; then
            continue
        elif [[ -n $option ]]; then
            option=
        elif [[ $word == -* && ! $word =~ ^-[0-9.] ]]; then
            [[ -n $(_failstop_takes "$path $word") ]] && option=$word
        elif [[ -n $(_failstop_options "$path $word") ]]; then
            path="$path $word" place=0
        else
            ((place++))
        fi
    done
    [[ $current == "=" ]] && current=
    if [[ -n $option ]]; then
        _failstop_fill "$(_failstop_takes "$path $option")" "$current"
    elif [[ $current == -* ]]; then
        _failstop_fill "words:$(_failstop_options "$path")" "$current"
    else
        _failstop_fill "$(_failstop_next "$path $place")" "$current"
    fi
}

complete -F _failstop failstop
"""


def script(commands: list[Command]) -> str:
    """The whole file."""
    first = "words:" + " ".join(["help", *(command.path[0] for command in commands)])
    every = [below for command in commands for below in command.walk()]
    following = [("failstop 0", first)]
    following.append(("failstop help 0", "words:" + " ".join(command.path[0] for command in commands)))
    options = [("failstop", "--help --version"), ("failstop help", "--help")]
    takes: list[tuple[str, str]] = []
    for command in every:
        path = " ".join(("failstop", *command.path))
        options.append(
            (path, " ".join(flag for option in command.options for flag in option.flags if flag[1:2] == "-"))
        )
        following += [(f"{path} {place}", kind) for place, kind in _places(command)]
        for option in command.options:
            if option.kind != "none":
                takes += [(f"{path} {flag}", _kind(option)) for flag in option.flags]
    return SCRIPT % {"next": _rows(following), "options": _rows(options), "takes": _rows(takes), "suffix": SUFFIX}


def _places(command: Command) -> Iterator[tuple[str, str]]:
    """Number of the positional argument, as a pattern, and its kind; the words of commands below are at place 0."""
    if command.children:
        yield "0", "words:" + " ".join(child.path[-1] for child in command.children)
    for index, argument in enumerate(command.positionals):
        yield ("*" if argument.repeats else str(index)), _kind(argument)


def _kind(argument: Argument) -> str:
    return "words:" + " ".join(argument.choices) if argument.choices else argument.kind


def _rows(rows: list[tuple[str, str]]) -> str:
    return "\n".join(f'        "{path}") echo "{found}" ;;' for path, found in rows).replace('*")', '"*)')
