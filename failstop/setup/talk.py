"""Talk: asks questions in a terminal. An answer comes from a command-line option, from the saved answers of an earlier
setup, or from a person."""

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
YES, NO = "yes", "no"
AS_BEFORE = "as before"


class Left(FailstopError):
    """The setup ends early. The message says what is wrong and what to do."""


class NotAnAnswer(ValueError):
    """The answer is not allowed. The message says what is allowed."""


Check = Callable[[str], str]
"""A function that checks an answer and returns it in its usual form. Raises NotAnAnswer."""


class Talk:
    """One conversation with a person."""

    def __init__(self, given: Mapping[str, str], draft: Draft, *, silent: bool) -> None:
        """`given`: answers from command-line options. `silent`: nobody can be asked, because there is no terminal."""
        self.given = dict(given)
        self.draft = draft
        self.silent = silent
        self.asked = 0
        """How many answers a person has typed."""

    def step(self, number: int, title: str) -> None:
        """Print the title of a step."""
        style.show([[], [(f"{number}. {title}", style.STRONG)]])

    def say(self, text: str, role: str = style.PLAIN, indent: int = 3, hang: int = 0) -> None:
        """Print a sentence, wrapped to the terminal's width. `hang`: how many columns further all lines after the first
        are indented."""
        line = [(" " * indent, style.PLAIN), (text, role)]
        style.show(style.wrap(line, min(WIDEST, style.width()), indent + hang))

    def warn(self, text: str, remedy: str = "", fix: str = "") -> None:
        """Print a problem and its remedy. `fix`: a command that helps, on one line, so that a person can copy it."""
        self.say(text, style.WARN)
        if fix:
            style.show([[(f"     -> {fix}", style.STRONG)]])
        if remedy:
            self.say(f"{'   ' if fix else '-> '}{remedy}", style.PLAIN if fix else style.STRONG, 5, 3)

    def ask(
        self,
        key: str,
        question: str,
        default: str = "",
        check: Check = str.strip,
        *,
        keep: bool = True,
        passing: Sequence[str] = (),
    ) -> str:
        """Ask a question, and return the checked answer. Enter alone gives `default`. With `keep`, the answer is saved,
        and an answer that was saved earlier is used. `passing`: words that are not saved, because they only ask setup
        to do something. Raises Left if an option has a wrong answer, or if nobody can be asked."""
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
                return self.ask(key, question, default, check, keep=keep, passing=passing)
            self._show_answer(key, found, AS_BEFORE)
        else:
            found = self._typed(key, question, default, check)
        if keep and found not in passing:
            self.draft.keep(key, found)
        return found

    def _show_answer(self, key: str, found: str, by: str) -> None:
        self.say(f"{key.replace('_', ' ')}: {found} ({by})", style.DIM)

    def known(self, key: str) -> bool:
        """Return True if the question has been answered already, by an option or in an earlier setup."""
        return key in self.given or key in self.draft.answers

    def _typed(self, key: str, question: str, default: str, check: Check) -> str:
        if self.silent:
            raise Left(f"there is no terminal to ask you at ({question}): give {option(key)}")
        while True:
            # Discard what was typed before the question, for example while a wheel turned.
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
        """Ask a question that is answered with yes or no. Returns True for yes."""
        return self.ask(key, question, default, yes_or_no, keep=False) == YES


def read_line(prompt: str) -> str:
    """Read a line that a person types. Unlike input(), it never misses a Ctrl-C. Raises EOFError."""
    sys.stdout.write(prompt)
    sys.stdout.flush()
    with arrivals() as arrived:
        while sys.stdin not in select.select((sys.stdin, arrived), (), ())[0]:
            os.read(arrived, 4096)  # the signal's handler raised nothing, so keep waiting
    if not (line := sys.stdin.readline()):
        raise EOFError
    return line


def option(key: str) -> str:
    """Return the command-line option that answers this question, for example --can-id for `can_id`."""
    return f"--{key.replace('_', '-')}"


def yes_or_no(answer: str) -> str:
    """Check that the answer is yes or no, or the beginning of either word. Raises NotAnAnswer."""
    word = answer.lower()
    if word and YES.startswith(word):
        return YES
    if word and NO.startswith(word):
        return NO
    raise NotAnAnswer("type yes or no")


def one_of(choices: Mapping[str, str]) -> Check:
    """Return a check for one of these choices. The person types a name, or its number in the list, counted from 1.
    `choices`: the names, each with its description."""
    names = list(choices)

    def check(answer: str) -> str:
        if answer in names:
            return answer
        if answer.isdecimal() and 1 <= int(answer) <= len(names):
            return names[int(answer) - 1]
        raise NotAnAnswer(f"type a number from 1 to {len(names)}")

    return check


def word_of(words: Sequence[str]) -> Check:
    """Return a check for one of these words. The beginning of a word is enough if it fits only one word."""

    def check(answer: str) -> str:
        if (found := begun(answer, words)) is None:
            raise NotAnAnswer(f"type {', '.join(words)}")
        return found

    return check


def begun(answer: str, words: Sequence[str]) -> str | None:
    """Return the word that equals the answer, or else the only word that begins with the answer. None if there is no
    such word."""
    text = answer.lower().strip()
    found = [word for word in words if word == text] or [word for word in words if text and word.startswith(text)]
    return found[0] if len(found) == 1 else None


def number(least: float, most: float, unit: str) -> Check:
    """Return a check for a number between these limits. `unit`: the unit that a person may type after the number, if
    any."""
    range_ = f"{least:g} to {most:g}{f', in {unit}' if unit else ''}"

    def check(answer: str) -> str:
        try:
            value = float(answer.removesuffix(unit).strip().replace(",", "."))
        except ValueError:
            value = float("nan")
        if not least <= value <= most:
            raise NotAnAnswer(f"type a number from {range_}")
        return f"{value:g}"

    return check
