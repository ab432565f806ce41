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


class Draft:
    """Keeps the answers, each under the key of its question. Each answer is saved at once."""

    def __init__(self, name: str, environ: Mapping[str, str]) -> None:
        """Reads the answers of an earlier setup, if there are any. `name`: the name of the service."""
        self.path = os.path.join(state_directory(name, environ), FILE)
        self.answers = self._read()
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
        """Add an answer, and save it."""
        self.answers[key] = answer
        self._write()

    def forget(self, *keys: str) -> None:
        """Delete the answers to these questions. Without arguments, delete all answers."""
        for key in keys or tuple(self.answers):
            self.answers.pop(key, None)
        self._write()

    def _write(self) -> None:
        if not self.answers:
            with contextlib.suppress(OSError):
                os.unlink(self.path)
            return
        try:
            os.makedirs(os.path.dirname(self.path), exist_ok=True)
            durable.write_draft(f"{self.path}.new", json.dumps(self.answers, indent=1).encode())
            durable.publish(f"{self.path}.new", self.path)
        except OSError as error:
            self.unwritten = f"{self.path}: {error.strerror}"
