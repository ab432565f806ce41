"""Draft: the answers to the setup's questions so far, in a file that is deleted when the setup is complete."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping

from failstop.files import durable
from failstop.files.root import state_directory

FILE = "setup.json"
MOST_BYTES = 65536
HARDWARE = ("port", "board", "can_id", "robot", "layout")
"""The questions about what is connected and what it is, in the order in which setup asks them. The answers to all later
questions, and the settings that setup has found, count only for this hardware."""
WHEEL = "wheel_"
TOGETHER = ("forward", "turn")
"""The questions that are asked while all wheels turn. Their answers count only for these answers about each wheel."""
BEFORE = "before."


class Draft:
    """Keeps the answers, each under the key of its question, and the settings that setup has found from them. Each is
    saved at once."""

    def __init__(self, name: str, environ: Mapping[str, str]) -> None:
        """Reads the answers of an earlier setup, if there are any. `name`: the name of the service."""
        self.path = os.path.join(state_directory(name, environ), FILE)
        read = self._read()
        self.answers = {key: value for key, value in read.items() if "." not in key}
        self.found = {key: value for key, value in read.items() if "." in key and not key.startswith(BEFORE)}
        """The settings that setup has measured or corrected, each by its whole key. An answer such as "yes, forward"
        was given with these settings, so it must not be used without them."""
        self._before = {key: value for key, value in read.items() if key.startswith(BEFORE)}
        """Answers about the hardware that must be given again. If a new answer is the same, the later ones still
        count."""
        self.unwritten = ""
        """Why an answer could not be saved. Empty while all answers are saved."""

    def _read(self) -> dict[str, str]:
        try:
            with os.fdopen(durable.open_own(self.path), "rb") as file:
                found = json.loads(file.read(MOST_BYTES))
        except (OSError, ValueError):
            return {}
        if not isinstance(found, dict):
            return {}
        return {str(key): value for key, value in found.items() if isinstance(value, str)}

    def keep(self, key: str, answer: str) -> None:
        """Add an answer, and save it. If the earlier answer was another one, delete everything that was answered or
        found for that one."""
        if self.answers.get(key, self._before.pop(f"{BEFORE}{key}", None)) != answer:
            self._drop_later(key)
        self.answers[key] = answer
        self._write()

    def keep_found(self, key: str, value: object) -> None:
        """Add a setting that setup has found, and save it. `value`: a number."""
        self.found[key] = str(value)
        self._write()

    def _drop_later(self, key: str) -> None:
        if key in HARDWARE:
            earlier = HARDWARE[: HARDWARE.index(key)]
            self.answers = {each: self.answers[each] for each in self.answers if each in earlier}
            self._before = {each: self._before[each] for each in self._before if each.removeprefix(BEFORE) in earlier}
            self.found.clear()
        elif key.startswith(WHEEL):
            for each in TOGETHER:
                self.answers.pop(each, None)

    def forget_tested(self) -> None:
        """Delete everything that a stand test tests: all answers except those about the hardware, and all settings
        that setup has found. Only a person who looks at the wheels again can tell which of them was wrong."""
        self.answers = {key: answer for key, answer in self.answers.items() if key in HARDWARE}
        self.found.clear()
        self._write()

    def forget(self, *keys: str) -> None:
        """Delete the answers to these questions, so that they are asked again. Without arguments, delete
        everything."""
        popped = {key: self.answers.pop(key) for key in keys if key in self.answers}
        for key in HARDWARE:
            later = {*self.answers, *self.found} - {*HARDWARE[: HARDWARE.index(key)]}
            if key in popped and later:
                self._before[f"{BEFORE}{key}"] = popped[key]
        if not keys:
            for kept in (self.answers, self.found, self._before):
                kept.clear()
        self._write()

    def _write(self) -> None:
        if not (everything := {**self.answers, **self.found, **self._before}):
            with contextlib.suppress(OSError):
                os.unlink(self.path)
            return
        try:
            os.makedirs(os.path.dirname(self.path), exist_ok=True)
            durable.write_draft(f"{self.path}.new", json.dumps(everything, indent=1).encode())
            durable.publish(f"{self.path}.new", self.path)
        except OSError as error:
            self.unwritten = f"{self.path}: {error.strerror}"
