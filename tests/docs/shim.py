"""What `failstop` is in a session: the same command, for the service of the session and no other.

python shim.py NAME WORD ...
"""

from __future__ import annotations

import sys

from failstop.cli import main as cli


def words_for(name: str, words: list[str]) -> list[str]:
    """The words, with --name where the command takes it and it is not given."""
    if not words or words[0] not in cli.COMMANDS or "--name" in words or "--help" in words:
        return words
    parser, _ = cli.load(words[0])
    found = parser
    for action in parser._actions:
        for word in words[1:]:
            if action.nargs == "A..." and word in (action.choices or ()):
                found = action.choices[word]  # type: ignore[index, call-overload]
                break
    takes = any("--name" in action.option_strings for action in found._actions)
    return [*words, "--name", name] if takes else words


if __name__ == "__main__":
    sys.exit(cli.main(words_for(sys.argv[1], sys.argv[2:])))
