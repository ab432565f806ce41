"""Incidents by the words of a person, and how many are kept."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from failstop.cli.main import main
from failstop.incidents import files
from failstop.incidents.files import IncidentError, prune
from failstop.incidents.incident import Incident
from tests.support.incident_parts import UNIX_NS, drive_and_die

MADE = drive_and_die()
IDS = ["20260921-143320-gate-died", "20260921-150000-key1", "20260922-020000-device-lost"]


@pytest.fixture
def environ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Three incidents of the service `failstop`, and one of another in the same folder."""
    found = {"STATE_DIRECTORY": str(tmp_path / "state"), "XDG_STATE_HOME": str(tmp_path / "home")}
    folder = tmp_path / "state" / "incidents"
    for number, identity in enumerate(IDS):
        MADE.save(folder, identity, unix_ns=UNIX_NS + number * 10**12)
    MADE.save(folder, "20260930-000000-other", "other", UNIX_NS + 10**15)
    for key, value in found.items():
        monkeypatch.setenv(key, value)
    return found


def test_last_is_the_newest_of_this_name(environ: dict[str, str]) -> None:
    assert Incident.read(files.find("last", "failstop", environ)).id == IDS[-1]
    assert Incident.read(files.find("last", "other", environ)).id == "20260930-000000-other"


def test_the_beginning_of_an_id_is_enough_if_it_is_the_only_one(environ: dict[str, str]) -> None:
    assert Incident.read(files.find("20260922", "failstop", environ)).id == IDS[2]
    with pytest.raises(IncidentError, match=f"may be {IDS[0]}, {IDS[1]}: write more of it"):
        files.find("20260921", "failstop", environ)
    with pytest.raises(IncidentError, match="`failstop incident list` shows them"):
        files.find("2025", "failstop", environ)


def test_a_path_is_read_wherever_it_is(environ: dict[str, str], tmp_path: Path) -> None:
    copy = tmp_path / "sent-by-mail.incident"
    copy.write_bytes((tmp_path / "state" / "incidents" / f"{IDS[0]}.incident").read_bytes())
    assert Incident.read(files.find(str(copy), "any", {"XDG_STATE_HOME": str(tmp_path)})).id == "sent-by-mail"


def test_without_any_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(IncidentError, match="no incidents of 'nobody'"):
        files.find("last", "nobody", {"XDG_STATE_HOME": str(tmp_path)})


def test_a_damaged_one_is_told_of_and_hides_no_other(
    environ: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "state" / "incidents" / f"{IDS[2]}.incident"
    path.write_bytes(path.read_bytes()[:200])
    assert main(["incident", "list"]) == 1
    shown = capsys.readouterr()
    assert IDS[0] in shown.out
    assert f"{path} is cut short: 200 of" in shown.err
    assert main(["incident", "show", IDS[2]]) == 1
    assert capsys.readouterr().err.startswith(f"failstop: {path} is cut short")


@pytest.mark.usefixtures("environ")
def test_list_and_show_for_people_and_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["incident", "list"]) == 0
    shown = capsys.readouterr().out
    assert [line for line in shown.splitlines() if not line.startswith(" ")] == IDS
    assert "written after 0.21 ms, acknowledged after 3.10 ms, still after about 0.3 s" in shown
    assert main(["incident", "list", "--json"]) == 0
    assert [row["id"] for row in json.loads(capsys.readouterr().out)] == IDS
    assert main(["incident", "show"]) == 0
    assert capsys.readouterr().out.startswith(f"Incident {IDS[-1]}\n")
    assert main(["incident", "show", "last", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["id"] == IDS[-1]


def test_the_oldest_go_first_and_nothing_of_others_is_touched(environ: dict[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "state" / "incidents"
    (folder / "notes.txt").write_text("mine")
    (folder / "broken.incident").write_bytes(b"?")
    prune(str(folder), "failstop", 2, 10**9)
    left = {"notes.txt", "broken.incident", "20260930-000000-other.incident"}
    assert set(os.listdir(folder)) == left | {f"{identity}.incident" for identity in IDS[1:]}
    prune(str(folder), "failstop", 2, 10**9)
    assert len(os.listdir(folder)) == 5


def test_size_counts_too_and_the_newest_always_stays(environ: dict[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "state" / "incidents"
    size = os.stat(folder / f"{IDS[0]}.incident").st_size
    prune(str(folder), "failstop", 50, size * 2 + size // 2)
    assert set(os.listdir(folder)) == {f"{identity}.incident" for identity in (*IDS[1:], "20260930-000000-other")}
    prune(str(folder), "failstop", 50, 1)
    assert Incident.read(files.find("last", "failstop", environ)).id == IDS[2]


@pytest.mark.usefixtures("environ")
@pytest.mark.slow
def test_a_file_is_named_for_the_incident_or_as_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("mcap_ros2.writer")
    monkeypatch.chdir(tmp_path)
    asked = [["plot"], ["export"], ["export", "-o", "mine.mcap"]]
    for (action, *words), name in zip(asked, (f"{IDS[-1]}.png", f"{IDS[-1]}.mcap", "mine.mcap"), strict=True):
        assert main(["incident", action, *words]) == 0
        assert capsys.readouterr().out.startswith(f"wrote {name}")
        assert (tmp_path / name).stat().st_size > 1000
    other = tmp_path / "state" / "incidents" / f"{IDS[0]}.incident"
    before = other.read_bytes()
    for action in ("plot", "export"):
        assert main(["incident", action, "-o", str(other)]) == 1
        assert f"{other}: " in capsys.readouterr().err
        assert other.read_bytes() == before, "an incident is not written over"


@pytest.mark.usefixtures("environ")
def test_show_tells_what_matters_and_with_all_the_rest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["incident", "show"]) == 0
    short = capsys.readouterr().out
    assert main(["incident", "show", "--all"]) == 0
    whole = capsys.readouterr().out
    assert "Around it" not in short
    assert "Around it" in whole
    assert len(short.splitlines()) < 24 < len(whole.splitlines())
