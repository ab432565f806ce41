"""Incidents by the words of a person, and how many are kept."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from failstop.api import words
from failstop.cli.main import main
from failstop.files import durable
from failstop.incidents import files
from failstop.incidents.files import IncidentError, prune
from failstop.incidents.incident import Incident
from tests.support.incident_parts import UNIX_NS, drive_and_die
from tests.support.unprivileged import unprivileged

MADE = drive_and_die()
NAMES = ["20260921-143320-gate-died", "20260921-150000-key1", "20260922-020000-device-lost"]
IDS = [f"{number:06}-{name}" for number, name in enumerate(NAMES, 1)]


@pytest.fixture
def environ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Three incidents of the service `failstop`, and one of another in the same folder."""
    found = {"STATE_DIRECTORY": str(tmp_path / "state"), "XDG_STATE_HOME": str(tmp_path / "home")}
    folder = tmp_path / "state" / "incidents"
    for number, identity in enumerate(NAMES):
        MADE.save(folder, identity, unix_ns=UNIX_NS + number * 10**12)
    MADE.save(folder, "20260930-000000-other", "other", UNIX_NS + 10**15)
    for key, value in found.items():
        monkeypatch.setenv(key, value)
    return found


def test_last_is_the_newest_of_this_name(environ: dict[str, str]) -> None:
    assert Incident.read(files.find("last", "failstop", environ)).id == IDS[-1]
    assert Incident.read(files.find("last", "other", environ)).id == "000004-20260930-000000-other"


def test_the_beginning_of_an_id_is_enough_if_it_is_the_only_one(environ: dict[str, str]) -> None:
    assert Incident.read(files.find("20260922", "failstop", environ)).id == IDS[2]
    with pytest.raises(IncidentError, match=f"could be {IDS[0]}, {IDS[1]}: write more of its id"):
        files.find("20260921", "failstop", environ)
    with pytest.raises(IncidentError, match="`failstop incident list` shows them"):
        files.find("2025", "failstop", environ)


def test_the_number_of_an_incident_is_enough_too(environ: dict[str, str]) -> None:
    for wanted in ("2", "000002", "000002-2026"):
        assert Incident.read(files.find(wanted, "failstop", environ)).id == IDS[1]


def test_the_date_and_the_time_as_the_screens_show_them_are_enough(
    environ: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    shown = [words.clock(head["t"]) for head in files.heads("failstop", files.folders("failstop", environ))[0]]
    date, _, time = shown[1].partition(" ")
    for typed in ([shown[1]], [date, time], [time], [date, time[:5]], ["2"]):
        assert main(["incident", "show", *typed]) == 0, typed
        assert capsys.readouterr().out.startswith(f"Incident {IDS[1]}\n")
    with pytest.raises(IncidentError, match=r"could be .*: write more of its id, or its number"):
        files.find(date[:8], "failstop", environ)
    with pytest.raises(IncidentError, match="no incident '2026-11-29'"):
        files.find("2026-11-29", "failstop", environ)


def test_an_error_names_a_few_incidents_and_the_service(environ: dict[str, str], tmp_path: Path) -> None:
    for number in range(20):
        MADE.save(tmp_path / "state" / "incidents", f"20261129-1200{number:02}-key1", "left", UNIX_NS + number)
    with pytest.raises(IncidentError, match=" or one of 17 older ones: write more") as error:
        files.find("20261129", "left", environ)
    assert str(error.value).count("-key1") == files.MOST_NAMED
    with pytest.raises(IncidentError, match="`failstop incident list --name left` shows them"):
        files.find("2025", "left", environ)


def test_the_last_stop_is_the_last_whatever_the_clock_said(
    environ: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A computer without a battery-backed clock boots in the past."""
    folder = tmp_path / "state" / "incidents"
    past = MADE.save(folder, "20240101-000010-gate-died", unix_ns=UNIX_NS - 85_000_000 * 10**9)
    assert files.find("last", "failstop", environ) == str(past)
    prune(str(folder), "failstop", 3, 10**9)
    found = [head["id"] for head in files.heads("failstop", [str(folder)])[0]]
    assert found == [*IDS[1:], past.stem], "the oldest by its number went, and the new one stayed"
    said = "before this incident the clock was set back by 984 days"
    assert main(["incident", "list"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line for line in shown if not line.startswith(" ")][-1] == past.stem
    assert [line.strip() for line in shown if "set back" in line] == [said]
    assert main(["incident", "show"]) == 0
    assert f"  clock     {said}" in capsys.readouterr().out
    assert main(["incident", "show", "3"]) == 0
    assert "set back" not in capsys.readouterr().out


def test_within_a_run_a_clock_that_was_set_forward_is_seen_too(tmp_path: Path) -> None:
    offsets = [0, 0, 10**13, 10**13]
    for number, offset_ns in enumerate(offsets):
        head = MADE.head(unix_ns=UNIX_NS + offset_ns + number * 10**9)
        head |= {"run": "00c0ffee", "unix_minus_monotonic_ns": offset_ns}
        files.write(str(tmp_path), f"20260101-00000{number}-x", files.build(head, {}))
    heads, problems = files.heads("failstop", [str(tmp_path)])
    assert ([head["clock_jump_s"] for head in heads], problems) == ([0.0, 0.0, 1e4, 0.0], [])
    assert files.jumped(heads[2]).startswith("before this incident the clock went forward by 2 h 46 min (")


def test_incidents_from_before_there_were_numbers_are_older(environ: dict[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "state" / "incidents"
    for entry in os.listdir(folder):
        os.rename(folder / entry, folder / entry.partition("-")[2])
    new = MADE.save(folder, "20240101-000010-gate-died", unix_ns=1)
    assert [head["id"] for head in files.heads("failstop", [str(folder)])[0]] == [
        *NAMES,
        "000001-20240101-000010-gate-died",
    ]
    assert files.find("last", "failstop", environ) == str(new)
    assert Incident.read(files.find("20260921-1433", "failstop", environ)).id == NAMES[0]
    prune(str(folder), "failstop", 2, 10**9)
    assert [head["id"] for head in files.heads("failstop", [str(folder)])[0]] == [NAMES[2], new.stem]


def test_two_folders_keep_their_own_order(tmp_path: Path) -> None:
    """No number orders the incidents of two folders, so time does, as far as it goes."""
    ours, theirs = tmp_path / "a", tmp_path / "b"
    for folder, days in ((ours, (1, 3, -900)), (theirs, (2,))):
        for number, day in enumerate(days):
            MADE.save(folder, f"20260101-00000{number}-x", unix_ns=UNIX_NS + day * 86_400 * 10**9)
    found = [head["path"] for head in files.heads("failstop", [str(ours), str(theirs)])[0]]
    assert [path for path in found if path.startswith(str(ours))] == sorted(map(str, ours.iterdir()))
    assert found[1].startswith(str(theirs))


@pytest.mark.parametrize("free", [0, durable.LEAST_ROOM - 1])
def test_a_full_disk_is_named_where_no_incident_is_saved(
    free: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    real = os.statvfs(tmp_path)
    fields = [*real]
    fields[1], fields[4] = 1, free
    monkeypatch.setattr(os, "statvfs", lambda path: os.statvfs_result(fields))
    assert main(["incident", "show"]) == 1
    told = capsys.readouterr().err
    assert (
        f"the disk of {tmp_path} is full ({free // 1000} kB free), so stops leave no file until there is room" in told
    )
    assert "latched" not in told


def test_a_path_is_read_wherever_it_is(environ: dict[str, str], tmp_path: Path) -> None:
    copy = tmp_path / "sent-by-mail.incident"
    copy.write_bytes((tmp_path / "state" / "incidents" / f"{IDS[0]}.incident").read_bytes())
    assert Incident.read(files.find(str(copy), "any", {"XDG_STATE_HOME": str(tmp_path)})).id == "sent-by-mail"


def test_without_any_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(IncidentError, match="no incident of 'nobody' is saved in "):
        files.find("last", "nobody", {"XDG_STATE_HOME": str(tmp_path)})


@pytest.mark.parametrize("closed", ["state", "state/incidents"])
def test_a_folder_that_this_user_may_not_see_is_a_problem(
    closed: str, environ: dict[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "state" / "incidents"
    (tmp_path / closed).chmod(0)
    try:
        code = unprivileged(lambda: str(main(["incident", "list", "--name", "left"])))
        listed = capfd.readouterr()
        unprivileged(lambda: str(main(["incident", "show", "--name", "left"])))
        shown = capfd.readouterr()
    finally:
        (tmp_path / closed).chmod(0o755)
    assert (code, listed.out) == ("1", "")
    told = f"{folder} can't be read by this user, so use sudo: sudo failstop incident ..."
    assert told in listed.err
    assert f"no incident 'last' of 'left' was found; {told}" in shown.err


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
    left = {"notes.txt", "broken.incident", "000004-20260930-000000-other.incident"}
    assert set(os.listdir(folder)) == left | {f"{identity}.incident" for identity in IDS[1:]}
    prune(str(folder), "failstop", 2, 10**9)
    assert len(os.listdir(folder)) == 5


def test_size_counts_too_and_the_newest_always_stays(environ: dict[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "state" / "incidents"
    size = os.stat(folder / f"{IDS[0]}.incident").st_size
    prune(str(folder), "failstop", 50, size * 2 + size // 2)
    assert set(os.listdir(folder)) == {
        f"{identity}.incident" for identity in (*IDS[1:], "000004-20260930-000000-other")
    }
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
    for (action, *others), name in zip(asked, (f"{IDS[-1]}.png", f"{IDS[-1]}.mcap", "mine.mcap"), strict=True):
        assert main(["incident", action, *others]) == 0
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
