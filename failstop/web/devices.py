"""Devices: the paired devices, and the code that pairs a new one. Pure.

The token of a paired device allows more than watching and stopping, for example resets and enables. The page stores
only the hash of a token, so that nobody can get a token from the page's files.
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
"""The characters of a pairing code (Crockford's alphabet). Letters that look like digits are left out."""
CODE_CHARACTERS = 8
CODE_S = 120.0
TRIES = 5
"""How many wrong codes end an offer to pair. There are 2 to the power of 40 codes, so nobody can guess one in so few
tries."""


class NotPaired(Exception):
    """The device was not paired. The message says why."""


@dataclasses.dataclass(frozen=True)
class Device:
    """One paired device."""

    id: str
    name: str
    digest: str
    """The SHA-256 of the device's token. No slow hash is needed, because a token is random."""
    made: float
    """When the device was paired (Unix time, s). It is shown to people."""


def digest_of(token: str) -> str:
    """Return the hash of a token. Only this hash is stored."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()


def clean(name: str) -> str:
    """Return the device's name in a form that is safe to show: printable, on one line, and not too long."""
    shown = "".join(c if c.isprintable() else "?" for c in " ".join(name.split()))
    return shown[:LONGEST_NAME] or "a device"


class Devices:
    """All paired devices."""

    def __init__(self, known: tuple[Device, ...] = ()) -> None:
        self._by_digest = {device.digest: device for device in known}

    def all(self) -> list[Device]:
        """Return the devices, in the order in which they were paired."""
        return list(self._by_digest.values())

    def free_name(self, name: str) -> str:
        """Return a name for a new device, made from the wanted name and safe to show. If the name is taken, a
        number is added, because the reason of a stop must name only one device."""
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
        """Return the device that has this token, or None."""
        return self._by_digest.get(digest_of(token)) if token else None

    def revoke(self, identity: str) -> Device | None:
        """Remove the device with this id, so that it may only watch and stop. Returns the device, or None if the id is
        unknown."""
        found = next((device for device in self.all() if device.id == identity), None)
        if found:
            del self._by_digest[found.digest]
        return found

    def dump(self) -> bytes:
        """Return the devices as the content of their file."""
        return (json.dumps([dataclasses.asdict(device) for device in self.all()], indent=2) + "\n").encode()

    @classmethod
    def load(cls, data: bytes) -> Devices:
        """Read the devices from the content of their file. Raises ValueError if the content is damaged."""
        try:
            rows: list[dict[str, Any]] = json.loads(data)
            found = tuple(
                Device(str(row["id"]), clean(str(row["name"])), str(row["digest"]), float(row["made"])) for row in rows
            )
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
            raise ValueError(f"it is not a list of devices ({error})") from None
        return cls(found)


def code_of(data: bytes) -> str:
    """Return the pairing code made from five random bytes."""
    number = int.from_bytes(data[:5], "big")
    characters = [ALPHABET[number >> 5 * at & 31] for at in range(CODE_CHARACTERS)]
    return f"{''.join(characters[:4])}-{''.join(characters[4:])}"


def typed(code: str) -> str:
    """Return a typed pairing code in its usual form. For example, the letter O becomes the digit 0, and blanks and
    dashes are removed."""
    return code.upper().translate(str.maketrans("OIL", "011", " -_")).strip()


class Pairing:
    """An offer to pair one device by a code, which is valid for CODE_S."""

    def __init__(self) -> None:
        self._code = ""
        self._until_s = 0.0
        self._left = 0

    def offer(self, code: str, now_s: float) -> None:
        """Make an offer with this code. It replaces an earlier offer. `now_s`: time.monotonic()."""
        self._code, self._until_s, self._left = typed(code), now_s + CODE_S, TRIES

    def redeem(self, code: str, now_s: float) -> None:
        """Use up the code of the offer. Raises NotPaired if the code is wrong, or if no offer is open."""
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
