"""`failstop completion`: the script that makes a shell complete what is typed after `failstop`."""

from __future__ import annotations

import os
import sys
from argparse import SUPPRESS, ArgumentParser, Namespace

SHELLS = ("bash", "zsh", "fish")

EXAMPLES = """\
source <(failstop completion bash)   # or in ~/.bashrc, for every shell
failstop completion zsh > ~/.zfunc/_failstop
failstop completion fish > ~/.config/fish/completions/failstop.fish
"""

# Bash takes a word apart at each "=", and shtab counts the parts.
EQUALS = """
_failstop() {
    local word words=()
    for word in "${COMP_WORDS[@]:0:COMP_CWORD}"; do
        [[ $word == "=" ]] || words+=("$word")
    done
    local COMP_WORDS=("${words[@]}" "${COMP_WORDS[COMP_CWORD]#=}") COMP_CWORD=${#words[@]}
    _shtab_failstop
}
complete -o bashdefault -F _failstop failstop
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop completion`."""
    parser.add_argument("shell", choices=SHELLS, help="for which shell")
    parser.add_argument("--list", choices=("services", "incidents"), help=SUPPRESS)


def main(arguments: Namespace) -> int:
    """Print the script, or what it asks for."""
    if arguments.list == "services":
        from failstop import instances

        print(*instances.listening(), sep="\n")
    elif arguments.list == "incidents":
        from failstop.incidents import files

        print(files.LAST, *files.identities(os.environ), sep="\n")
    else:
        sys.stdout.write(script(arguments.shell))
    return 0


def script(shell: str) -> str:
    """The completion script for one of SHELLS."""
    import shtab

    from failstop.cli import grammar

    files = dict.fromkeys(("FILE", "PATH", "LINK", "F", "F.PNG", "F.MCAP"), shtab.FILE) | {"DIR": shtab.DIRECTORY}
    lists = {"name": _asked("services"), "id": _asked("incidents")}
    whole = grammar.whole()
    for parser in grammar.walk(whole):
        for action in grammar.arguments(parser):
            if found := lists.get(action.dest) or files.get(grammar.value(action)):
                action.complete = found  # type: ignore[attr-defined]
    return str(shtab.complete(whole, shell)) + (EQUALS if shell == "bash" else "")


def _asked(what: str) -> dict[str, str | dict[str, str]]:
    """For shtab: values that the shell asks this command for, at the time of the completion."""
    ask = f"failstop completion %s --list {what} 2>/dev/null"
    bash = f'_failstop_{what}() {{ compgen -W "$({ask % "bash"})" -- "$1"; }}'
    zsh = f'_failstop_{what}() {{ compadd -- ${{(f)"$({ask % "zsh"})"}} }}'
    name = f"_failstop_{what}"
    return {"bash": name, "zsh": name, "fish": f"({ask % 'fish'})", "preamble": {"bash": bash, "zsh": zsh}}
