"""Configuration: one TOML file, read and checked once, at the start."""

from __future__ import annotations

import os
import sys

from failstop.files import durable, root
from failstop.policy.setting import SettingError, shortened, shown
from failstop.policy.settings import Settings, is_setting
from failstop.version import renewed

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

MOST_BYTES = 65536
"""Nine times a file that sets everything and explains it."""
LONGEST_LINE = 1000
LONGEST_KEY = 80
"""Twice the longest there is."""
FOLDER = "/etc/failstop"
MODE_BUTTON = "pad.mode_button"


def installed(name: str) -> str:
    """The file of an instance that was installed on this machine."""
    return root.at(f"{FOLDER}/{name}.toml")


def chosen(name: str, path: str | None) -> str | None:
    """The file that a person named, else the installed one of this instance; None: this user can't read one."""
    default = installed(name)
    return path or (default if os.access(default, os.R_OK) else None)


def load(path: str | None, changed: dict[str, object] | None = None) -> Settings:
    """Return the settings of a file (none: the defaults) with `changed` over them. Raises SettingError."""
    return checked({**read(path), **(changed or {})}, path)


def checked(changed: dict[str, object], path: str | None = None) -> Settings:
    """The settings that a person wrote, by whole key. Raises SettingError, which names the file, if there is one."""
    button = changed.get(MODE_BUTTON)
    try:
        # Two bits would be two buttons that do not stop.
        if type(button) in (int, float) and button not in [1 << bit for bit in range(16)]:
            found = f"0x{button:04X}" if isinstance(button, int) and abs(button) < 1 << 32 else shown(button)
            raise SettingError(f"{MODE_BUTTON} = {found}: it must be exactly one bit, 0x0001, 0x0002 ... 0x8000")
        return Settings(changed)
    except SettingError as error:
        raise SettingError(f"{path}: {misplaced(path, changed, is_setting) or error}" if path else str(error)) from None


def misplaced(path: str, found: dict[str, object], known: Callable[[str], bool]) -> str:
    """The lines of a file that stand below the wrong [table], and where they belong; empty: none does. `found`: what it
    sets, by whole key; `known`: whether there is such a setting."""
    from failstop.policy import placing

    try:
        return placing.misplaced(_text(path), found, known)
    except (OSError, ValueError):
        return ""


def read(path: str | None) -> dict[str, object]:
    """The values that a file sets (none: nothing), by whole key, unchecked. Raises SettingError, and nothing else,
    whatever is at that path and in it."""
    if not path:
        return {}
    text = ""
    try:
        # Only a run with a file pays for the parser.
        if sys.version_info >= (3, 11):
            import tomllib
        else:
            import tomli as tomllib

        text = _text(path)
        found = _flat("", tomllib.loads(text))
        if len(values := dict(found)) < len(found):
            raise SettingError("a setting is given by its old and its new name: remove the old one")
        return values
    except SettingError as error:
        raise SettingError(f"{path}: {error}") from None
    except OSError as error:
        raise SettingError(f"configuration {path}: {error.strerror}: check the path") from None
    except RecursionError:
        problem = "it is nested too deeply"
    except Exception as error:  # the stop tool reads it too, and no file may keep a stop from being written
        from failstop.policy import placing

        problem = shortened(str(error) or type(error).__name__)
        if twice := placing.twice(text, problem):
            raise SettingError(f"configuration {path} is not TOML: {twice}") from None
    raise SettingError(f"configuration {path} is not TOML: {problem}; `failstop config --example` prints one that is")


def _text(path: str) -> str:
    """The text of a settings file. Only a regular file is read, and only as much as a settings file can have, because a
    device or a pipe may never end, and the parser's time grows with the square of the parts of a key."""
    fd = durable.open_regular(path)
    try:
        data = b""
        while len(data) <= MOST_BYTES and (part := os.read(fd, MOST_BYTES + 1 - len(data))):
            data += part
    finally:
        os.close(fd)
    if len(data) > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES} bytes")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ValueError("it is UTF-16: save it as UTF-8")
    # Some editors begin a file with a mark that says that it is UTF-8.
    text = data.decode("utf-8-sig")
    for number, line in enumerate(text.split("\n"), 1):
        if len(line) > LONGEST_LINE:
            raise ValueError(f"line {number} has more than {LONGEST_LINE} characters")
    return text


def _flat(prefix: str, table: dict[str, object]) -> list[tuple[str, object]]:
    found: list[tuple[str, object]] = []
    for key, value in table.items():
        whole = prefix + key
        if len(whole) > LONGEST_KEY or not whole.isprintable():
            raise SettingError(f"{shown(whole)} is not a setting; `failstop config` lists them all")
        if "." in key or not key:
            # It would pass for the table and the key on either side of its dot, and hide what those say.
            raise SettingError(f'{prefix}"{key}" is not a setting; write tables as [gate], keys without quotes')
        # An empty table says something too: a source or an interlock with every default, or a name that is wrong.
        if isinstance(value, dict) and value:
            found += _flat(f"{whole}.", value)
        else:
            found.append((renewed(whole), value))
    return found
