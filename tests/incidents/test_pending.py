"""A stop of a moment ago: its file is waited for, and nobody is shown an older one as the last without a word."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from failstop.api.errors import NoService
from failstop.api.snapshot import State
from failstop.cli.commands import incident as command
from failstop.cli.main import main
from failstop.policy import causes
from tests.support.incident_parts import drive_and_die
from tests.support.states import latched, state, stop

DIED = causes.DIED("gate")
STOPPED_S = 1_700_000_000.0


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    return tmp_path / "incidents"


def runs(monkeypatch: pytest.MonkeyPatch, told: State | None) -> None:
    """A service that tells this of itself; None: there is none."""

    class Reader:
        def __init__(self, name: str) -> None:
            if told is None:
                raise NoService(name)

        def read(self) -> State:
            assert told is not None
            return told

    monkeypatch.setattr(command, "StateReader", Reader)


def saved(folder: Path, after_s: float) -> None:
    """An incident whose cause was so long after the stop."""
    drive_and_die().save(folder, "20260921-143320-gate-died", unix_ns=round((STOPPED_S + after_s) * 1e9))


STOPPED = latched(DIED, last_stop=stop(DIED, t=STOPPED_S))
AGAIN = latched(DIED, last_stop=stop(causes.DIED("telemetry"), t=STOPPED_S))
RESET = state(last_stop=stop(DIED, t=STOPPED_S))


@pytest.mark.parametrize("told", [STOPPED, RESET])
def test_a_stop_that_is_in_no_file(folder: Path, monkeypatch: pytest.MonkeyPatch, told: State) -> None:
    runs(monkeypatch, told)
    assert command.unsaved("failstop") == told.last_stop
    saved(folder, -30.0)
    assert command.unsaved("failstop") == told.last_stop, "that is another's file"
    saved(folder, 0.002)
    assert command.unsaved("failstop") is None


@pytest.mark.parametrize("told", [None, state(), AGAIN])
@pytest.mark.usefixtures("folder")
def test_nothing_is_to_come(monkeypatch: pytest.MonkeyPatch, told: State | None) -> None:
    runs(monkeypatch, told)
    assert command.unsaved("failstop") is None


def test_its_file_is_waited_for(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs(monkeypatch, STOPPED)
    saved(folder, -30.0)
    now_s = [STOPPED_S + 1.0]

    def sleep(seconds: float) -> None:
        now_s[0] += seconds
        if now_s[0] > STOPPED_S + 2.4:
            saved(folder, 0.0)

    monkeypatch.setattr(command.time, "sleep", sleep)  # type: ignore[attr-defined]
    monkeypatch.setattr(command.time, "time", lambda: now_s[0])  # type: ignore[attr-defined]
    assert main(["incident", "show"]) == 0
    shown = capsys.readouterr()
    assert "Incident 20260921-143320-gate-died-2\n" in shown.out
    assert shown.err == ""


def test_an_older_one_is_not_shown_without_a_word(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs(monkeypatch, STOPPED)
    saved(folder, -30.0)
    assert time.time() > STOPPED_S + command.SAVED_S
    assert main(["incident", "show"]) == 0
    shown = capsys.readouterr()
    assert shown.out.startswith("Incident ")
    assert shown.err == "failstop: the last stop (gate died) is in no file so far: this is another\n"
