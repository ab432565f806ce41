"""Configuration: reads and checks the settings file (TOML). The service reads it once, when it starts."""

from __future__ import annotations

import errno
import os
import sys

from failstop.files import durable, place, root
from failstop.policy.setting import SettingError, shortened, shown
from failstop.policy.settings import Settings, is_setting
from failstop.version import renewed

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

MOST_BYTES = 65536
"""The largest settings file that is read, in bytes. A file that sets and explains every setting has only a ninth of
this size."""
LONGEST_LINE = 1000
LONGEST_KEY = 80
"""The longest key that is accepted, in characters. No setting has a key of more than half this length."""
FOLDER = "/etc/failstop"
MODE_BUTTON = "pad.mode_button"


def installed(name: str) -> str:
    """The path of the installed settings file of an instance, for example `/etc/failstop/failstop.toml`."""
    return root.at(f"{FOLDER}/{name}.toml")


def chosen(name: str, path: str | None) -> str | None:
    """The settings file to use: `path` if given, else the installed file of this instance. Without `path`, None if no
    file is installed. This user may not be able to read the file."""
    default = installed(name)
    return (None if durable.missing(default) else default) if path is None else path


def load(path: str | None, changed: dict[str, object] | None = None) -> Settings:
    """Load a settings file, or the defaults if `path` is None. Values in `changed` replace those of the file. Raises
    SettingError."""
    return checked({**read(path), **(changed or {})}, path)


def checked(changed: dict[str, object], path: str | None = None) -> Settings:
    """Check settings and return them as Settings. `changed`: the values by whole key, such as `gate.lease_s`. Raises
    SettingError, which names the file if `path` is given."""
    button = changed.get(MODE_BUTTON)
    try:
        # With two bits set, two buttons would not stop the robot.
        if type(button) in (int, float) and button not in [1 << bit for bit in range(16)]:
            found = f"0x{button:04X}" if isinstance(button, int) and abs(button) < 1 << 32 else shown(button)
            raise SettingError(f"{MODE_BUTTON} = {found}: it must be exactly one bit, 0x0001, 0x0002 ... 0x8000")
        return Settings(changed)
    except SettingError as error:
        raise SettingError(f"{path}: {misplaced(path, changed, is_setting) or error}" if path else str(error)) from None


def unreadable(path: str, user: str) -> str:
    """Say that this user can't read a settings file, and what to do. `user`: the name of the user who runs this
    program."""
    import shlex  # imported only here, so that a stop does not wait for it

    text = f"configuration {path} can't be read by {user}"
    try:
        os.stat(path)
    except PermissionError:  # the mode of the file does not help if a folder above it is closed
        return f"{text}, because a folder above it lets only other users in: move the file to {FOLDER}"
    except OSError:
        pass
    return f"{text}: sudo chmod 644 {shlex.quote(path)}"


def exposed(path: str, where: str) -> tuple[str, str]:
    """Say that others may change a settings file, and how to end that. Returns (a text, a command). `where`: what they
    may write, which is the file or a folder on the way to it."""
    import shlex  # imported only here, so that a stop does not wait for it

    text = f"others may write {where}, so they can change the settings in {path}, such as the command still.command"
    return text, f"sudo chmod go-w {shlex.quote(where)}"


def misplaced(path: str, found: dict[str, object], known: Callable[[str], bool]) -> str:
    """Say which lines of a settings file are below the wrong [table], and where they belong. Empty if there are none,
    or if the file can't be read. `found`: the values that the file sets, by whole key. `known`: returns True if a
    setting with that key exists."""
    from failstop.policy import placing

    try:
        return placing.misplaced(_text(path), found, known)
    except (OSError, ValueError):
        return ""


def read(path: str | None) -> dict[str, object]:
    """Read the values that a settings file sets, by whole key, without checking them. Without `path`, there are no
    values. Whatever the file contains, this raises only SettingError."""
    if path is None:
        return {}
    if not path:
        raise SettingError("the path of the configuration is empty: name a file")
    text = ""
    try:
        # imported only if a file was named, because the parser takes time to load
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
        if error.errno == errno.EACCES:
            raise SettingError(unreadable(path, place.user(os.geteuid()))) from None
        raise SettingError(f"configuration {path}: {error.strerror}: check the path") from None
    except RecursionError:
        problem = "it is nested too deeply"
    except Exception as error:  # the stop tool reads settings too, and must write its stop whatever the file contains
        from failstop.policy import placing

        problem = shortened(str(error) or type(error).__name__)
        if twice := placing.twice(text, problem):
            raise SettingError(f"configuration {path} is not TOML: {twice}") from None
    raise SettingError(f"configuration {path} is not TOML: {problem}; `failstop config --example` prints one that is")


def _text(path: str) -> str:
    """Read the text of a settings file. Raises OSError, ValueError.

    Devices and pipes are refused, because reading them may never end. Long files and long lines are refused, because
    the parser's time grows with the square of the number of parts of a key.
    """
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
    # Some editors begin a UTF-8 file with a byte order mark.
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
            # Such a key looks like a table and a key in it, and would hide the value that was set there.
            raise SettingError(f'{prefix}"{key}" is not a setting; write tables as [gate], keys without quotes')
        # Keep an empty table, because it means something: a source or an interlock with every default, or a wrong name.
        if isinstance(value, dict) and value:
            found += _flat(f"{whole}.", value)
        else:
            found.append((renewed(whole), value))
    return found
