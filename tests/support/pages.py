"""Blocks of code of the pages, and what a mark above each says to do with it.

`<!-- run -->`: the block is run, in the page's own session, its output compared with what the page shows.
`<!-- run: in a terminal of its own -->`: the same, for a command that stays in the foreground.
`<!-- run: in the same terminal, after Ctrl-C -->`: the same, in place of that command's earlier start.
`<!-- run: save as NAME -->`: settings or a program, which later blocks use by this name.
`<!-- parse: WHY -->`: it is not run, for this reason; its commands must be accepted by their parsers.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

FENCE = re.compile(
    r"^(?:<!-- (?P<mark>[^\n]*) -->\n\n?)?```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
SHELL = ("sh", "console", "bash")


@dataclass(frozen=True)
class Block:
    """A fenced block."""

    page: str
    line: int
    mark: str | None
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    def steps(self) -> list[tuple[str, list[str]]]:
        """Commands, each with the output that is shown after it; only `console` blocks show any."""
        if self.language != "console":
            return [(command, []) for command in _joined(self.text) if not command.startswith("#")]
        steps: list[tuple[str, list[str]]] = []
        for line in _joined(self.text):
            if line.startswith("$ "):
                steps.append((line[2:], []))
            else:
                steps[-1][1].append(line)
        return steps


def _joined(text: str) -> list[str]:
    """The lines, those that end with a backslash with what follows them."""
    return [line for line in text.replace("\\\n", "").splitlines() if line.strip()]


def blocks(page: Path) -> list[Block]:
    text = page.read_text()
    name = str(page.relative_to(ROOT))
    return [
        Block(name, text.count("\n", 0, found.start("text")) + 1, found["mark"], found["language"], found["text"])
        for found in FENCE.finditer(text)
    ]


def indented(page: Path) -> list[str]:
    """The commands in blocks that are not fenced but indented by four spaces."""
    text = FENCE.sub("", page.read_text())
    found = re.findall(r"^    (?:\$ )?((?:sudo )?(?:\S*/)?failstop .*)$", text, re.MULTILINE)
    return [re.split(r"\s{2,}", line)[0] for line in found]  # what follows is a remark


def inline(page: Path) -> list[str]:
    """The commands in the running text: `failstop ...`."""
    text = FENCE.sub("", page.read_text())
    return re.findall(r"`((?:sudo )?failstop [^`]*)`", text.replace("\n", " "))


BEFORE = ("sudo", "exec", "time", "then", "do", "if")
"""Words after which a command comes."""


def commands_in(line: str) -> list[list[str]]:
    """The failstop commands of a shell line, as words; what is not theirs (sudo, redirections, pipes) is left out."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    found: list[list[str]] = []
    taking, may_begin, remote = False, True, False
    for word in lexer:
        if set(word) <= set("();<>|&"):
            taking, may_begin, remote = False, True, False
        elif taking:
            found[-1].append(word)
        elif (may_begin or remote) and (word == "failstop" or word.endswith("/failstop")):
            found.append([word])
            taking = True
        else:
            remote = remote or word == "ssh"
            may_begin = may_begin and (word in BEFORE or word.startswith("-") or "=" in word)
    return found
