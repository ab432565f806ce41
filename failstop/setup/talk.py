"""Talk: questions in a terminal, each answered by an option, by the draft of a setup that was left, or by a person."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
from collections.abc import Callable, Mapping, Sequence

from failstop.api.errors import FailstopError
from failstop.cli import style
from failstop.setup.draft import Draft
from failstop.setup.ending import arrivals

WIDEST = 80
AGAIN = "run `failstop setup` again to go on from here"
YES, NO = "yes", "no"


class Left(FailstopError):
    """The setup ends before its end: what is wrong, and what helps."""


class NotAnAnswer(ValueError):
    """An answer that can't be: why, and what can."""


Check = Callable[[str], str]
"""The answer in its usual form. Raises NotAnAnswer."""


class Talk:
    """One conversation."""

    def __init__(self, given: Mapping[str, str], draft: Draft, *, silent: bool) -> None:
        """`given`: answers by options; `silent`: nobody is there to ask."""
        self.given = dict(given)
        self.draft = draft
        self.silent = silent
        self.asked = 0
        """How many answers a person has typed."""

    def step(self, number: int, title: str) -> None:
        """The head of a step."""
        style.show([[], [(f"{number}. {title}", style.STRONG)]])

    def say(self, text: str, role: str = style.PLAIN, indent: int = 3, hang: int = 0) -> None:
        """A sentence, wrapped. `hang`: by how much its further lines begin behind the first."""
        line = [(" " * indent, style.PLAIN), (text, role)]
        style.show(style.wrap(line, min(WIDEST, style.width()), indent + hang))

    def warn(self, text: str, remedy: str = "", fix: str = "") -> None:
        """A fault, and what helps. `fix`: a command that does, which stays whole to be copied."""
        self.say(text, style.WARN)
        if fix:
            style.show([[(f"     -> {fix}", style.STRONG)]])
        if remedy:
            self.say(f"{'   ' if fix else '-> '}{remedy}", style.PLAIN if fix else style.STRONG, 5, 3)

    def ask(self, key: str, question: str, default: str = "", check: Check = str.strip, *, keep: bool = True) -> str:
        """The answer to a question. `default`: of an empty line; `keep`: it is taken up again from the draft. Raises
        Left where an option is wrong, or nobody can be asked."""
        if (value := self.given.pop(key, None)) is not None:
            try:
                found = check(value)
            except NotAnAnswer as error:
                raise Left(f"{option(key)} {value}: {error}") from None
            self._show_answer(key, found, option(key))
        elif keep and key in self.draft.answers:
            try:
                found = check(self.draft.answers[key])
            except NotAnAnswer:
                self.draft.forget(key)
                return self.ask(key, question, default, check, keep=keep)
            self._show_answer(key, found, "as before")
        else:
            found = self._typed(key, question, default, check)
        if keep:
            self.draft.keep(key, found)
        return found

    def _show_answer(self, key: str, found: str, by: str) -> None:
        self.say(f"{key.replace('_', ' ')}: {found} ({by})", style.DIM)

    def known(self, key: str) -> bool:
        """Whether a question is answered without asking."""
        return key in self.given or key in self.draft.answers

    def _typed(self, key: str, question: str, default: str, check: Check) -> str:
        if self.silent:
            raise Left(f"there is no terminal to ask you at ({question}): give {option(key)}")
        while True:
            # What was typed before, for example while a wheel turned, is no answer to this.
            with contextlib.suppress(OSError, termios.error):
                termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)
            *lines, last = style.wrap(
                [("   ", style.PLAIN), (f"{question}{f' [{default}]' if default else ''} ", style.PLAIN)],
                min(WIDEST, style.width()) - 8,
                3,
            )
            style.show(lines)
            try:
                answer = read_line(style.plain(last).rstrip() + " ").strip() or default
            except EOFError:
                raise Left("the terminal was closed") from None
            self.asked += 1
            try:
                return check(answer)
            except NotAnAnswer as error:
                self.warn(str(error))

    def agreed(self, key: str, question: str, default: str = "") -> bool:
        """Yes or no."""
        return self.ask(key, question, default, yes_or_no, keep=False) == YES


def read_line(prompt: str) -> str:
    """The line that a person types. Unlike input(), it misses no Ctrl-C. Raises EOFError."""
    sys.stdout.write(prompt)
    sys.stdout.flush()
    with arrivals() as arrived:
        while sys.stdin not in select.select((sys.stdin, arrived), (), ())[0]:
            os.read(arrived, 4096)  # of signals whose handlers let it go on
    if not (line := sys.stdin.readline()):
        raise EOFError
    return line


def option(key: str) -> str:
    """The command line's option that answers a question."""
    return f"--{key.replace('_', '-')}"


def yes_or_no(answer: str) -> str:
    """Raises NotAnAnswer."""
    word = answer.lower()
    if word and YES.startswith(word):
        return YES
    if word and NO.startswith(word):
        return NO
    raise NotAnAnswer("type yes or no")


def one_of(choices: Mapping[str, str]) -> Check:
    """A check: the number of a choice, counted from 1, or its name, which is the mapping's key."""
    names = list(choices)

    def check(answer: str) -> str:
        if answer in names:
            return answer
        if answer.isdecimal() and 1 <= int(answer) <= len(names):
            return names[int(answer) - 1]
        raise NotAnAnswer(f"type a number from 1 to {len(names)}")

    return check


def word_of(words: Sequence[str]) -> Check:
    """A check: one of these words, or the beginning of one alone."""

    def check(answer: str) -> str:
        if (found := begun(answer, words)) is None:
            raise NotAnAnswer(f"type {', '.join(words)}")
        return found

    return check


def begun(answer: str, words: Sequence[str]) -> str | None:
    """The word that is meant: it, or its beginning where no other word begins so."""
    text = answer.lower().strip()
    found = [word for word in words if word == text] or [word for word in words if text and word.startswith(text)]
    return found[0] if len(found) == 1 else None


def number(least: float, most: float, unit: str) -> Check:
    """A check: a number within these, in this unit."""

    def check(answer: str) -> str:
        try:
            value = float(answer.removesuffix(unit).strip().replace(",", "."))
        except ValueError:
            value = float("nan")
        if not least <= value <= most:
            raise NotAnAnswer(f"type a number from {least:g} to {most:g}, in {unit}")
        return f"{value:g}"

    return check
