"""Devices: whose token lets them reset and enable, and the code that makes a device one of these. Pure.

Of a token its hash alone is kept: who reads the file can't use it.
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
"""Crockford's: no letter that looks like a digit."""
CODE_CHARACTERS = 8
CODE_S = 120.0
TRIES = 5
"""Wrong codes after which the offer is over: 5 of 2 to the 40."""


class NotPaired(Exception):
    """The device is not paired by this; says why."""


@dataclasses.dataclass(frozen=True)
class Device:
    """One paired device."""

    id: str
    name: str
    digest: str
    """SHA-256 of its token: the token is random, so that nothing slower is needed."""
    made: float
    """Unix time, for people."""


def digest_of(token: str) -> str:
    """The digest of a token, which alone is kept."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()


def clean(name: str) -> str:
    """A device's name, as people may see it."""
    shown = "".join(c if c.isprintable() else "?" for c in " ".join(name.split()))
    return shown[:LONGEST_NAME] or "a device"


class Devices:
    """Every paired device."""

    def __init__(self, known: tuple[Device, ...] = ()) -> None:
        self._by_digest = {device.digest: device for device in known}

    def all(self) -> list[Device]:
        """In the order of their pairing."""
        return list(self._by_digest.values())

    def free_name(self, name: str) -> str:
        """That name as people may see it, with a number where a device has it already: a stop names one of them."""
        wanted, taken = clean(name), {device.name for device in self.all()}
        for number in range(2, MOST + 2):
            if wanted not in taken:
                return wanted
            wanted = f"{clean(name)[: LONGEST_NAME - 4]} {number}"
        return wanted

    def add(self, device: Device) -> None:
        """Raises NotPaired when there are too many."""
        if len(self._by_digest) >= MOST:
            raise NotPaired(f"{MOST} devices are paired already, so revoke one first (failstop web devices)")
        self._by_digest[device.digest] = device

    def of(self, token: str) -> Device | None:
        """The device with this token."""
        return self._by_digest.get(digest_of(token)) if token else None

    def revoke(self, identity: str) -> Device | None:
        """The device of that id may nothing any more."""
        found = next((device for device in self.all() if device.id == identity), None)
        if found:
            del self._by_digest[found.digest]
        return found

    def dump(self) -> bytes:
        """As a file's content."""
        return (json.dumps([dataclasses.asdict(device) for device in self.all()], indent=2) + "\n").encode()

    @classmethod
    def load(cls, data: bytes) -> Devices:
        """The inverse. Raises ValueError for what is none."""
        try:
            rows: list[dict[str, Any]] = json.loads(data)
            found = tuple(
                Device(str(row["id"]), clean(str(row["name"])), str(row["digest"]), float(row["made"])) for row in rows
            )
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
            raise ValueError(f"it is not a list of devices ({error})") from None
        return cls(found)


def code_of(data: bytes) -> str:
    """A code from random bytes, five of them."""
    number = int.from_bytes(data[:5], "big")
    characters = [ALPHABET[number >> 5 * at & 31] for at in range(CODE_CHARACTERS)]
    return f"{''.join(characters[:4])}-{''.join(characters[4:])}"


def typed(code: str) -> str:
    """The code that a person meant, with letters that look like digits replaced."""
    return code.upper().translate(str.maketrans("OIL", "011", " -_")).strip()


class Pairing:
    """One offer to pair: its code pairs one device, once, for CODE_S."""

    def __init__(self) -> None:
        self._code = ""
        self._until_s = 0.0
        self._left = 0

    def offer(self, code: str, now_s: float) -> None:
        """A new code; an earlier one is over. `now_s`: a monotonic clock."""
        self._code, self._until_s, self._left = typed(code), now_s + CODE_S, TRIES

    def redeem(self, code: str, now_s: float) -> None:
        """Use it up. Raises NotPaired for a wrong code, and when there is none to be had."""
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
