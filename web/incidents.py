"""Incidents: the black box's files as cards. Stories and pictures are made by the command of that name, in a process of
its own: matplotlib is several times as large as all of the page."""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
import tempfile
import time
from typing import Any

from failstop.incidents import files, memory

MOST_SHOWN = 20
FRESH_S = 2.0
MAKE_S = 60.0
MOST_PICTURES = 24
LINES = 40
NEAR_MS = 3000.0
ID = re.compile(r"[0-9A-Za-z_.-]{1,80}")


class Incidents:
    """Of one service."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._one_at_a_time = asyncio.Lock()
        self._pictures = tempfile.TemporaryDirectory(prefix="failstop-web-")
        self._stories: dict[str, list[dict[str, Any]]] = {}
        self._cards: list[dict[str, Any]] = []
        self._looked_s = float("-inf")

    async def cards(self) -> list[dict[str, Any]]:
        """The newest first."""
        if time.monotonic() - self._looked_s > FRESH_S:
            self._looked_s = time.monotonic()
            found = await asyncio.get_running_loop().run_in_executor(None, self._heads)
            self._cards = [_card(head) for head in found[: -MOST_SHOWN - 1 : -1]]
        return self._cards

    def _heads(self) -> list[dict[str, Any]]:
        return files.heads(self._name, files.folders(self._name, os.environ))[0]

    async def _known(self, identity: str) -> bool:
        return bool(ID.fullmatch(identity)) and identity in {card["id"] for card in await self.cards()}

    async def story(self, identity: str) -> list[dict[str, Any]] | None:
        """What happened, line by line, in ms from the cause; None for an incident that there is not."""
        if not await self._known(identity):
            return None
        if identity not in self._stories:
            async with self._one_at_a_time:
                said = await self._command("show", identity, "--json")
            lines = json.loads(said)["story"] if said else []
            self._stories[identity] = _near(lines)
            if len(self._stories) > MOST_SHOWN:
                self._stories.pop(next(iter(self._stories)))
        return self._stories[identity]

    async def picture(self, identity: str) -> bytes | None:
        """As PNG; None where there is none, or nothing that draws it."""
        if not await self._known(identity):
            return None
        path = os.path.join(self._pictures.name, f"{identity}.png")
        async with self._one_at_a_time:
            if not os.path.exists(path):
                await self._command("plot", identity, "-o", path)
                self._forget()
        try:
            with open(path, "rb") as file:
                return file.read()
        except OSError:
            return None

    def _forget(self) -> None:
        """The oldest pictures."""
        found = sorted(os.scandir(self._pictures.name), key=lambda entry: entry.stat().st_mtime)
        for entry in found[:-MOST_PICTURES]:
            os.unlink(entry.path)

    async def _command(self, *words: str) -> bytes:
        """What it said; nothing when it failed."""
        command = (sys.executable, "-m", "failstop", "incident", *words, "--name", self._name)
        made = await asyncio.create_subprocess_exec(
            *("nice", "-n", "10", *command),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            env={**os.environ, "MPLBACKEND": "Agg", "MPLCONFIGDIR": self._pictures.name},
        )
        try:
            said, _ = await asyncio.wait_for(made.communicate(), MAKE_S)
        except asyncio.TimeoutError:
            made.kill()
            await made.wait()
            return b""
        return said if made.returncode == 0 else b""

    def close(self) -> None:
        """The pictures go."""
        self._pictures.cleanup()


def _card(head: dict[str, Any]) -> dict[str, Any]:
    return {"id": head["id"], "t": head["t"], "reason": head["reason"], "proof": ", ".join(memory.proofs(head))}


def _near(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The lines of the seconds around the cause, those nearest to it if they are too many, in order."""
    near = [at for at in range(len(lines)) if abs(lines[at]["ms"]) <= NEAR_MS]
    kept = sorted(near, key=lambda at: abs(lines[at]["ms"]))[:LINES]
    return [{name: lines[at][name] for name in ("ms", "what", "text")} for at in sorted(kept)]
