"""Configuration: one TOML file, read and checked once, by the supervisor."""

from __future__ import annotations

from failstop.supervisor.settings import SettingError, Settings

MODE_BUTTON = "pad.mode_button"
BITS = tuple(1 << bit for bit in range(16))


def load(path: str | None, changed: dict[str, object] | None = None) -> Settings:
    """Return the settings of a file (none: the defaults) with `changed` over them. Raises SettingError."""
    return checked({**read(path), **(changed or {})})


def checked(changed: dict[str, object]) -> Settings:
    """The settings that a person wrote, by whole key. Raises SettingError."""
    button = changed.get(MODE_BUTTON)
    # Two bits would be two buttons that do not stop.
    if isinstance(button, (int, float)) and not isinstance(button, bool) and button not in BITS:
        shown = f"0x{button:04X}" if isinstance(button, int) else repr(button)
        raise SettingError(f"{MODE_BUTTON} = {shown}: allowed is exactly one bit, 0x0001, 0x0002 ... 0x8000")
    return Settings(changed)


def read(path: str | None) -> dict[str, object]:
    """What a file sets (none: nothing), by whole key, unchecked. Raises SettingError when it is no TOML file."""
    return dict(_flat("", _parse(path))) if path else {}


def _parse(path: str) -> dict[str, object]:
    # Only a run with a file pays for the parser.
    import sys

    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    try:
        with open(path, "rb") as file:
            table: dict[str, object] = tomllib.load(file)
    except OSError as error:
        raise SettingError(f"configuration {path}: {error.strerror}: check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingError(f"configuration {path} is not TOML: {error}") from None
    return table


def _flat(prefix: str, table: dict[str, object]) -> list[tuple[str, object]]:
    found: list[tuple[str, object]] = []
    for key, value in table.items():
        if "." in key or not key:
            # It would pass for the table and the key on either side of its dot, and hide what those say.
            raise SettingError(f'{prefix}"{key}": no such setting; write tables as [gate], keys without quotes')
        # An empty table says something too: a source or an interlock with every default, or a name that is wrong.
        if isinstance(value, dict) and value:
            found += _flat(f"{prefix}{key}.", value)
        else:
            found.append((prefix + key, value))
    return found
