"""`failstop completion`: the script that makes a shell complete what is typed after `failstop`."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace

SHELLS = ("bash", "zsh", "fish")

EXAMPLES = """\
source <(failstop completion bash)   # or in ~/.bashrc, for every shell
failstop completion zsh > ~/.zfunc/_failstop
failstop completion fish > ~/.config/fish/completions/failstop.fish
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop completion`."""
    parser.add_argument("shell", choices=SHELLS, help="for which shell")


def main(arguments: Namespace) -> int:
    """Print the script."""
    sys.stdout.write(script(arguments.shell))
    return 0


def script(shell: str) -> str:
    """The completion script for one of SHELLS."""
    from failstop.cli.manual import grammar

    module = __import__(f"failstop.cli.manual.{shell}", fromlist=["script"])
    written: str = module.script([command for _, commands in grammar.read() for command in commands])
    return written
