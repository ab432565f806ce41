"""Devices: the paired devices, whose tokens let them reset and enable, and the code with which a device is paired.
Pure.

Only the hash of a token is kept, so that nobody who reads the file can use it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
import json
from typing import Any

TOKEN_BYTES = 32
LONGEST_NAME = 32
MOST = 32
ALPHABET = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""The characters of a code (Crockford's alphabet), without letters that look like digits."""
CODE_CHARACTERS = 8
CODE_S = 120.0
TRIES = 5
"""After this many wrong codes the offer ends. There are 2 to the 40 codes."""


class NotPaired(Exception):
    """The device was not paired; the message says why."""


@dataclasses.dataclass(frozen=True)
class Device:
    """One paired device."""

    id: str
    name: str
    digest: str
    """The SHA-256 of its token. A slow hash is not needed, because tokens are random."""
    made: float
    """When it was paired (Unix time, s), for people."""


def digest_of(token: str) -> str:
    """The hash of a token, which is all that is kept of it."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()


def clean(name: str) -> str:
    """A device's name in a form that is safe to show to people."""
    shown = "".join(c if c.isprintable() else "?" for c in " ".join(name.split()))
    return shown[:LONGEST_NAME] or "a device"


class Devices:
    """All paired devices."""

    def __init__(self, known: tuple[Device, ...] = ()) -> None:
        self._by_digest = {device.digest: device for device in known}

    def all(self) -> list[Device]:
        """The devices in the order in which they were paired."""
        return list(self._by_digest.values())

    def free_name(self, name: str) -> str:
        """That name, safe to show, and with a number if another device has it already, because a stop names the
        device."""
        wanted, taken = clean(name), {device.name for device in self.all()}
        for number in range(2, MOST + 2):
            if wanted not in taken:
                return wanted
            wanted = f"{clean(name)[: LONGEST_NAME - 4]} {number}"
        return wanted

    def add(self, device: Device) -> None:
        """Add a device. Raises NotPaired if there are too many."""
        if len(self._by_digest) >= MOST:
            raise NotPaired(f"{MOST} devices are paired already, so revoke one first (failstop web devices)")
        self._by_digest[device.digest] = device

    def of(self, token: str) -> Device | None:
        """The device with this token."""
        return self._by_digest.get(digest_of(token)) if token else None

    def revoke(self, identity: str) -> Device | None:
        """Remove the device with this id, so that it can only watch and stop. Returns it, or None."""
        found = next((device for device in self.all() if device.id == identity), None)
        if found:
            del self._by_digest[found.digest]
        return found

    def dump(self) -> bytes:
        """The content of the file."""
        return (json.dumps([dataclasses.asdict(device) for device in self.all()], indent=2) + "\n").encode()

    @classmethod
    def load(cls, data: bytes) -> Devices:
        """The devices in the content of the file. Raises ValueError if it is damaged."""
        try:
            rows: list[dict[str, Any]] = json.loads(data)
            found = tuple(
                Device(str(row["id"]), clean(str(row["name"])), str(row["digest"]), float(row["made"])) for row in rows
            )
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
            raise ValueError(f"it is not a list of devices ({error})") from None
        return cls(found)


def code_of(data: bytes) -> str:
    """A code from five random bytes."""
    number = int.from_bytes(data[:5], "big")
    characters = [ALPHABET[number >> 5 * at & 31] for at in range(CODE_CHARACTERS)]
    return f"{''.join(characters[:4])}-{''.join(characters[4:])}"


def typed(code: str) -> str:
    """The code that a person meant: letters that look like digits are replaced."""
    return code.upper().translate(str.maketrans("OIL", "011", " -_")).strip()


class Pairing:
    """An offer to pair. Its code pairs one device, once, within CODE_S."""

    def __init__(self) -> None:
        self._code = ""
        self._until_s = 0.0
        self._left = 0

    def offer(self, code: str, now_s: float) -> None:
        """Make an offer with this code; an earlier offer ends. `now_s`: time.monotonic()."""
        self._code, self._until_s, self._left = typed(code), now_s + CODE_S, TRIES

    def redeem(self, code: str, now_s: float) -> None:
        """Use the code up. Raises NotPaired if it is wrong, or if there is no offer."""
        if not self._code or now_s > self._until_s:
            self._code = ""
            raise NotPaired("no code is valid now: run failstop web pair on the robot, which shows one for two minutes")
        if not hmac.compare_digest(self._code.encode(), typed(code).encode("utf-8", "replace")):
            self._left -= 1
            if not self._left:
                self._code = ""
            left = f"{self._left} tries are left" if self._left else "run failstop web pair on the robot again"
            raise NotPaired(f"wrong code; {left}")
        self._code = ""
