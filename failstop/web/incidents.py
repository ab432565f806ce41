"""Incidents: lists the saved incidents as cards, and gets their stories and pictures. `failstop incident` makes stories
and pictures in a separate process, because matplotlib takes several times the memory of the whole page."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import logging
import os
import re
import tempfile
import time
from typing import Any

from failstop import helpers
from failstop.incidents import files, memory

MOST_SHOWN = 20
FRESH_S = 2.0
MAKE_S = 300.0
"""A story or a picture that is not ready after this many seconds is given up. The commands that make them give way to
all other programs (`nice`), so on a busy computer a picture can take minutes."""
MOST_PICTURES = 24
LINES = 40
NEAR_MS = 3000.0
ID = re.compile(r"[0-9A-Za-z_.-]{1,80}")


@dataclasses.dataclass
class Made:
    """The story and the picture of an incident. Each is None until it is made."""

    story: list[dict[str, Any]] | None = None
    picture: bytes | None = None
    """The picture as PNG. It is empty if this computer can't draw it."""


class Incidents:
    """Lists the incidents of one service, and makes one story or picture at a time. No viewer waits until a story is
    made."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._pictures: tempfile.TemporaryDirectory[str] | None = None
        """The folder for pictures. It is made for the first picture, so that the page starts on a full disk too."""
        self._made: dict[str, Made] = {}
        self._making: asyncio.Task[None] | None = None
        self._cards: list[dict[str, Any]] = []
        self._looked_s = float("-inf")

    async def cards(self) -> list[dict[str, Any]]:
        """Return the newest incidents as cards, the newest first."""
        if time.monotonic() - self._looked_s > FRESH_S:
            self._looked_s = time.monotonic()
            found = await asyncio.get_running_loop().run_in_executor(None, self._heads)
            self._cards = [_card(head) for head in found[: -MOST_SHOWN - 1 : -1]]
        return self._cards

    def _heads(self) -> list[dict[str, Any]]:
        return files.heads(self._name, files.folders(self._name, os.environ))[0]

    async def known(self, identity: str) -> bool:
        """Return True if one of the cards has this id."""
        return bool(ID.fullmatch(identity)) and identity in {card["id"] for card in await self.cards()}

    def story(self, identity: str) -> tuple[list[dict[str, Any]] | None, bool | None]:
        """Return (the story's lines, True if there is a picture). The times of the lines are in ms from the cause. Each
        value is None until it is known."""
        made = self._of(identity)
        return made.story, None if made.picture is None else bool(made.picture)

    def picture(self, identity: str) -> bytes | None:
        """Return the picture as PNG. None if the picture is not made yet. Empty if this computer can't draw
        pictures."""
        return self._of(identity).picture

    def _of(self, identity: str) -> Made:
        made = self._made.get(identity) or Made()
        if made.picture is None and self._making is None:
            self._made[identity] = made
            if len(self._made) > MOST_PICTURES:
                self._made.pop(next(iter(self._made)))
            self._making = asyncio.ensure_future(self._make(identity, made))
            self._making.add_done_callback(self._ready)
        return made

    async def _make(self, identity: str, made: Made) -> None:
        said = await self._command("show", identity, "--json")
        if said is None:
            return
        made.story = _near(json.loads(said)["story"] if said else [])
        try:
            self._pictures = self._pictures or tempfile.TemporaryDirectory(prefix="failstop-web-")
            path = os.path.join(self._pictures.name, f"{identity}.png")
            if await self._command("plot", identity, "-o", path) is None:
                return
            with open(path, "rb") as file:
                made.picture = file.read()
            os.unlink(path)
        except OSError:
            made.picture = b""

    def _ready(self, done: asyncio.Task[None]) -> None:
        self._making = None
        if not done.cancelled() and (error := done.exception()):
            logging.getLogger(__name__).error("a story was not made: %r", error)

    async def _command(self, *words: str) -> bytes | None:
        """Run `failstop incident` with these arguments, and return its output. Returns b"" if the command failed, and
        None if it took longer than MAKE_S. After None, the next viewer's request runs the command again."""
        command = helpers.python("failstop", "incident", *words, "--name", self._name)
        folder = {"MPLCONFIGDIR": self._pictures.name} if self._pictures else {}
        made = await asyncio.create_subprocess_exec(
            *("nice", "-n", "10", *command),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            env={**os.environ, "MPLBACKEND": "Agg", **folder},
        )
        try:
            said, _ = await asyncio.wait_for(made.communicate(), MAKE_S)
        except asyncio.TimeoutError:
            return None
        finally:
            if made.returncode is None:
                made.kill()
        return said if made.returncode == 0 else b""

    def close(self) -> None:
        """Cancel the story or picture that is being made, and remove the folder with the pictures."""
        if self._making:
            self._making.cancel()
        if self._pictures:
            self._pictures.cleanup()


def _card(head: dict[str, Any]) -> dict[str, Any]:
    proof = "; ".join(filter(None, (memory.proven(head), files.jumped(head))))
    return {"id": head["id"], "t": head["t"], "reason": head["reason"], "proof": proof}


def _near(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the story's lines that are at most NEAR_MS from the cause, in their order. If there are more than LINES,
    only those closest to the cause are returned."""
    near = [at for at in range(len(lines)) if abs(lines[at]["ms"]) <= NEAR_MS]
    kept = sorted(near, key=lambda at: abs(lines[at]["ms"]))[:LINES]
    return [{name: lines[at][name] for name in ("ms", "what", "text")} for at in sorted(kept)]
