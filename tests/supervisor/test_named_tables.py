"""Sources and interlocks: the tables of the settings that have a name of the user's."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.policy.setting import SettingError
from failstop.policy.settings import FAMILIES, PAD_SOURCE, Settings
from failstop.procs.gate import sources

BY_PRIORITY = FAMILIES["sources"][0]
MS = 1_000_000


def refusal(changed: dict[str, object]) -> str:
    with pytest.raises(SettingError) as raised:
        Settings(dict(changed))
    return str(raised.value)


def test_by_default_there_is_one_source_and_no_interlock() -> None:
    assert Settings().sources() == {"cmd_vel": (0, 300 * MS)}
    assert Settings().interlocks() == {}


def test_a_source_is_silent_after_the_command_timeout_unless_it_says_otherwise() -> None:
    changed = {"gate.command_timeout_s": 0.4, "sources.teleop.priority": 10, "sources.nav.priority": 5}
    settings = Settings({**changed, "sources.nav.timeout_s": 0.25})
    assert settings.sources() == {"teleop": (10, 400 * MS), "nav": (5, 250 * MS), "cmd_vel": (0, 400 * MS)}
    assert list(settings.sources()) == ["teleop", "nav", "cmd_vel"], "the highest first"


def test_the_source_that_is_always_there_can_be_set() -> None:
    settings = Settings({"sources.cmd_vel.priority": 7, "sources.cmd_vel.timeout_s": 1})
    assert settings.sources() == {"cmd_vel": (7, 1000 * MS)}


def test_the_gamepad_is_a_source_without_settings() -> None:
    assert refusal({"sources.gamepad.priority": 5}) == (
        f"sources.{PAD_SOURCE}.priority: the board's gamepad always has the highest priority, so it has no settings"
    )
    assert BY_PRIORITY.high is not None
    assert BY_PRIORITY.high < sources.PAD_PRIORITY
    assert "gamepad" in Settings({"interlocks.gamepad": {}}).interlocks()


def test_the_gate_and_the_settings_name_the_same_default_source() -> None:
    assert sources.Command(1, "", 0, (0.0, 0.0, 0.0)).source in Settings().sources()


@pytest.mark.parametrize("name", ["a", "0", "a-b_c", "abcdefghijklmnop"])
def test_names_that_are_allowed(name: str) -> None:
    assert name in Settings({f"interlocks.{name}": {}}).interlocks()


@pytest.mark.parametrize("name", ["A", "a b", "ä", "abcdefghijklmnopq", "a=b", "a\nb"])
@pytest.mark.parametrize("processes", FAMILIES)
def test_names_that_are_not(processes: str, name: str) -> None:
    assert (
        refusal({f"{processes}.{name}": {}}) == f"{processes}.{name!r}: a name has 1 to 16 characters, of a-z 0-9 _ -"
    )


def test_at_most_eight_of_each() -> None:
    seven = {f"sources.s{n}.priority": n for n in range(1, 8)}
    assert len(Settings(dict(seven)).sources()) == 8
    assert refusal({**seven, "sources.s8.priority": 8}) == "sources.s8: at most 8 sources are allowed (cmd_vel is one)"
    eight: dict[str, object] = {f"interlocks.i{n}": {} for n in range(8)}
    assert len(Settings(dict(eight)).interlocks()) == 8
    told = "interlocks.i8: at most 8 interlocks are allowed"
    assert refusal({**eight, "interlocks.i8": {}}) == told


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"sources.a.priority": 101}, "sources.a.priority = 101: it must be 0 to 100"),
        ({"sources.a.priority": 1.5}, "sources.a.priority = 1.5: it must be a whole number, 0 to 100"),
        ({"sources.a.timeout_s": 9}, "sources.a.timeout_s = 9: it must be 0.05 to 2 s"),
        ({"interlocks.a.timeout_s": 0}, "interlocks.a.timeout_s = 0: it must be 0.05 to 10 s"),
        ({"interlocks.a.refusal": 5}, "interlocks.a.refusal = 5: it must be a text of 0 to 255 characters of one line"),
        ({"sources.a.prio": 5}, "sources.a.prio is not a setting; did you mean sources.a.priority?"),
        ({"interlocks.a.b.c": 5}, "interlocks.a.b.c is not a setting; did you mean interlocks.a.refusal?"),
        ({"sources.a": 5}, "sources.a = 5: it must be a table, [sources.NAME]"),
        ({"sources": 5}, "sources = 5: it must be a table, [sources.NAME]"),
        ({"sources.a": [{}]}, "sources.a = [{}]: it must be a table, [sources.NAME]"),
    ],
)
def test_what_a_named_table_must_not_say(changed: dict[str, object], message: str) -> None:
    assert refusal(changed) == message


named = st.dictionaries(st.text("abz09_-", min_size=1, max_size=16), st.floats(0.1, 2.0), max_size=7)
texts = st.text(st.characters(exclude_categories=("C", "Z")), max_size=40)


@given(named, named, texts)
def test_named_tables_survive_the_lines(tables: dict[str, float], locks: dict[str, float], refusal: str) -> None:
    changed: dict[str, object] = {"sources.cmd_vel.priority": 100}
    for priority, (name, timeout_s) in enumerate(tables.items()):
        changed.update({f"sources.{name}.priority": priority, f"sources.{name}.timeout_s": timeout_s})
    for name, timeout_s in locks.items():
        changed.update({f"interlocks.{name}.timeout_s": timeout_s, f"interlocks.{name}.refusal": refusal})
    settings = Settings(changed)
    again = Settings.from_lines(settings.lines())
    assert again.flat() == settings.flat()
    assert (again.sources(), again.interlocks()) == (settings.sources(), settings.interlocks())
