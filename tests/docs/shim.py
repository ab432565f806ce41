"""The command `failstop` of a session: for the service of the session and no other.

python shim.py NAME WORD ...
"""

from __future__ import annotations

import contextlib
import io
import sys

from failstop.cli import main as cli


def words_for(name: str, words: list[str]) -> list[str]:
    """The words, with --name where the command takes it and it is not given."""
    if not words or words[0] not in cli.COMMANDS or "--name" in words or "--help" in words:
        return words
    named = [*words, "--name", name]
    parser, _ = cli.load(words[0])
    with contextlib.suppress(SystemExit), contextlib.redirect_stderr(io.StringIO()):
        return words if "--name" in parser.parse_known_args(named[1:])[1] else named
    return words


if __name__ == "__main__":
    sys.exit(cli.main(words_for(sys.argv[1], sys.argv[2:])))
