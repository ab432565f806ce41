"""Signed messages: they prove that their sender has the fleet's key. Pure, except for the key's file.

A message is {"body": "...", "mac": "..."}. The mac is the HMAC-SHA256 of the message's purpose and the body's text. The
text itself is signed, so it does not matter how a program formats JSON. The purpose is signed too, so nobody can pass
an answer off as a stop.
"""

from __future__ import annotations

import hmac
import json
import os
import secrets
import stat

from failstop.files import durable
from failstop.fleet import FleetError
from failstop.fleet.settings import KEY, unreadable

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

KEY_BYTES = 32
MOST_BYTES = 4096
"""The longest allowed message, bytes. A longer one is refused without reading it."""
STOP_PURPOSE = "failstop fleet stop 1"
ANSWER_PURPOSE = "failstop fleet answer 1"
OTHERS = stat.S_IRWXG | stat.S_IRWXO


class Forged(ValueError):
    """The message is too long, is malformed, or was not signed with the fleet's key."""


def sign(key: bytes, purpose: str, body: dict[str, Any]) -> bytes:
    """Make a signed message from this body. `purpose`: STOP_PURPOSE or ANSWER_PURPOSE."""
    text = json.dumps(body, separators=(",", ":"), sort_keys=True)
    return json.dumps({"body": text, "mac": _mac(key, purpose, text)}, separators=(",", ":")).encode()


def verify(key: bytes, purpose: str, message: bytes) -> dict[str, Any]:
    """Check a signed message, and return its body. Raises Forged, also if the message was signed for another
    purpose."""
    if len(message) > MOST_BYTES:
        raise Forged(f"{len(message)} bytes")
    try:
        outer = json.loads(message)
        text, mac = outer["body"], outer["mac"]
        if not (isinstance(text, str) and isinstance(mac, str)):
            raise TypeError
        expected = _mac(key, purpose, text)
        genuine = hmac.compare_digest(expected.encode(), mac.encode())
    except (ValueError, TypeError, KeyError, RecursionError):
        raise Forged("it is not signed") from None
    if not genuine:
        raise Forged("it is signed with another key")
    try:
        body = json.loads(text)
    except (ValueError, RecursionError):
        body = None
    if not isinstance(body, dict):
        raise Forged("it is not a message")
    return body


def _mac(key: bytes, purpose: str, text: str) -> str:
    return hmac.digest(key, f"{purpose}\n{text}".encode(), "sha256").hex()


def make_key(path: str) -> None:
    """Write a new key to a new file that only its owner may read. Raises FleetError if the file exists already or can't
    be written."""
    try:
        os.makedirs(os.path.dirname(path) or ".", exist_ok=True)
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except FileExistsError:
        raise FleetError(
            f"{path} exists already, and a fleet has one key. To make a new one, remove it first"
        ) from None
    except OSError as error:
        raise FleetError(f"{path} can't be made: {error.strerror}") from None
    with os.fdopen(fd, "w") as file:
        file.write(secrets.token_hex(KEY_BYTES) + "\n")


def read_key(path: str) -> bytes:
    """Read the key from its file. Raises FleetError if the file is missing, if other users may read it, or if it
    contains no key."""
    try:
        fd = durable.open_regular(path)
        try:
            found, text = os.fstat(fd), os.read(fd, MOST_BYTES)
        finally:
            os.close(fd)
    except PermissionError as error:
        raise unreadable("the fleet's key", path, error, KEY) from None
    except OSError as error:
        raise FleetError(
            f"the fleet's key {path}: {error.strerror}; `failstop fleet key` makes one, and all robots need the same"
        ) from None
    if found.st_mode & OTHERS and not _handed_over(path):
        raise FleetError(f"other users may read the fleet's key {path}: chmod 600 {path}")
    try:
        key = bytes.fromhex(text.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise FleetError(f"{path} is not a fleet's key, which has {2 * KEY_BYTES} hexadecimal digits")
    return key


def _handed_over(path: str) -> bool:
    """Return True if the file is a credential from systemd. Its permissions do not matter, because systemd puts it into
    a folder that only this service can open."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY", "")
    return bool(folder) and os.path.dirname(os.path.realpath(path)) == os.path.realpath(folder)
