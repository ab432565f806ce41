"""An evidence pack opens alone, is the same for the same record, and a change of it is noticed."""

from __future__ import annotations

import errno
import html
import json
import os
import re
import resource
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from failstop.api.errors import FailstopError
from failstop.cli.main import main
from failstop.policy.settings import Settings
from failstop_lab.commands.prove import record_of
from failstop_lab.prove import pack, report, saving
from failstop_lab.prove.means import Means
from failstop_lab.prove.report import Evidence
from failstop_lab.prove.run import Result
from failstop_lab.prove.sight import Unseen
from failstop_lab.prove.table import BY_PATH, BY_TURNING, TURNINGS
from tests.support.commands import FAILSTOP

LIMIT_S = 120


@pytest.fixture(scope="module")
def record() -> dict[str, Any]:
    """A stand test of one row, as the command hands it over (test_prove.py has it do so)."""
    row = Result(BY_PATH["stop-request"], BY_TURNING["0.2"], simulated=True, written_ms=1.0)
    return record_of(Evidence("/dev/any", simulated=True, realtime=True, results=[row], user=Settings({})))


@pytest.fixture
def made(record: dict[str, Any], tmp_path: Path) -> Path:
    path = tmp_path / "evidence.html"
    saved = pack.save(record, str(path))
    assert saved == [str(path), str(path.with_suffix(".json"))]
    assert json.loads(path.with_suffix(".json").read_text()) == record
    return path


def test_it_is_the_page_of_its_record_and_asks_for_nothing_else(made: Path, record: dict[str, Any]) -> None:
    text = made.read_text()
    assert text == pack.page(record)
    assert re.findall(r"(?:src|href|url)\s*[=(]|https?:", text) == []
    for value in (record["code_sha256"], record["settings_sha256"], "stop-request", *record["distances"]):
        assert value in text.replace("&#x27;", "'")


def test_what_is_in_it(record: dict[str, Any]) -> None:
    assert {"version", "machine", "board", "rows", "distances", "settings", "unproved"} <= record.keys()
    assert record["code_sha256"] == pack.code_digest()
    assert [row["path"] for row in record["rows"]] == ["stop-request"]


ALL = ("timeout", "frozen", "pad")
SILENT = Means(acknowledged_by="", observed_by="")
WHOLE = [(BY_PATH[name], velocity) for velocity in TURNINGS[:2] for name in ALL]


def of_part(*names: str, at: int = 2, simulated: bool = False, skips: str = "", **given: Any) -> dict[str, Any]:
    """The record of the paths with these names at the first velocities; the path `skips` is skipped. `given`: more of
    the evidence."""
    rows = [
        Result(path, velocity, simulated, skipped="nobody presses <Enter>" if path.name == skips else "")
        for path, velocity in WHOLE
        if path.name in names and velocity in TURNINGS[:at]
    ]
    found = {"results": rows, "user": Settings({}), "whole": WHOLE, **given}
    return record_of(Evidence("/dev/any", simulated, realtime=True, **found))


@pytest.mark.parametrize(
    ("record", "covers", "unproved"),
    [
        (of_part(*ALL), "3 of 3 stop paths", []),
        (of_part(*ALL, simulated=True), "3 of 3 stop paths, on a SIMULATED board", []),
        (
            of_part(*ALL, means=SILENT, character=Unseen()),
            "3 of 3 stop paths, NO WHEEL WAS OBSERVED, no stop was acknowledged",
            SILENT.unproved(blind=True),
        ),
        (of_part("timeout"), "1 of 3 stop paths", ["frozen, pad: not tested here"]),
        (
            of_part(*ALL, at=1),
            "3 of 3 stop paths, not each at every speed",
            ["timeout, frozen, pad: not tested at 0.35 m/s"],
        ),
        (of_part(*ALL, skips="frozen"), "2 of 3 stop paths", ["frozen: skipped (nobody presses <Enter>)"]),
    ],
)
def test_the_verdict_never_comes_without_what_it_is_about(
    record: dict[str, Any], covers: str, unproved: list[str], tmp_path: Path
) -> None:
    assert (record["verdict"], record["covers"], record["unproved"]) == ("PASS", covers, unproved)
    (path, *_) = pack.save(record, str(tmp_path / "e.html"))
    head = f"PASS: {covers}"
    assert pack.verified(path).startswith(f"{head}; ")
    text = Path(path).read_text()
    assert f'<p class="verdict">{head}</p>' in text
    assert f"<title>failstop prove: {head}</title>" in text
    assert ("Does this robot stop?" in text) is not record["simulated"]
    assert ('<body class="PASS">' in text) is (covers == "3 of 3 stop paths"), "only all of it is green"
    for reason in unproved:
        assert f"<p>{html.escape(reason)}</p>" in text


def test_a_row_says_why(record: dict[str, Any]) -> None:
    assert "<td>nobody presses &lt;Enter&gt;</td>" in pack.page(of_part(*ALL, skips="frozen"))
    row = {**record["rows"][0], "verdict": "FAIL", "wrong": ["NO STOP written", "late"]}
    assert "<td>NO STOP written; late</td>" in pack.page({**record, "rows": [row]})


def test_what_was_not_tested_is_printed() -> None:
    rows = [Result(WHOLE[0][0], WHOLE[0][1], simulated=True)]
    lines = report.last_lines(Evidence("/dev/any", simulated=True, realtime=True, results=rows, whole=WHOLE))
    assert "tested: 1 of 3 stop paths, not each at every speed, on a SIMULATED board" in lines
    assert "NOT PROVED HERE: frozen, pad: not tested here" in lines


def test_a_text_of_the_record_ends_no_script(record: dict[str, Any], tmp_path: Path) -> None:
    (path, *_) = pack.save({**record, "device": "</script><script>alert(1)</script>"}, str(tmp_path / "e.html"))
    assert Path(path).read_text().count("<script") == 1
    assert ": unchanged" in pack.verified(path)


def test_it_is_checked_by_a_command(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", "--check", str(made)]) == 0
    assert ": unchanged\nno signature" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("stop-request</td>", "stop-asked</td>", "was changed"),
        ('"verdict":"', '"verdict":"NOT ', "was changed"),
        ('id="record">{', 'id="record">', "can't be read"),
        ('id="record"', 'id="other"', "is not an evidence pack"),
    ],
)
def test_a_change_is_noticed(made: Path, tmp_path: Path, before: str, after: str, told: str) -> None:
    text = made.read_text()
    assert before in text
    changed = tmp_path / "changed.html"
    changed.write_text(text.replace(before, after))
    with pytest.raises(FailstopError, match=told):
        pack.verified(str(changed))


@pytest.mark.parametrize("value", ["a \ufffd of mine", "\ufffd"])
def test_a_byte_that_is_no_letter_is_a_change(value: str, record: dict[str, Any], tmp_path: Path) -> None:
    path = Path(pack.save({**record, "device": value}, str(tmp_path / "e.html"))[0])
    assert ": unchanged" in pack.verified(str(path))
    path.write_bytes(path.read_bytes().replace("\ufffd".encode(), b"\xff", 1))
    with pytest.raises(FailstopError, match="was changed"):
        pack.verified(str(path))


def test_a_pipe_a_device_and_an_endless_file_are_no_packs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe, long = tmp_path / "pipe", tmp_path / "long"
    os.mkfifo(pipe)
    for path, told in ((pipe, "a FIFO, not a regular file"), (Path("/dev/zero"), "a device, not a regular file")):
        assert main(["prove", "--check", str(path)]) == 1
        assert told in capsys.readouterr().err
    long.touch()
    os.truncate(long, pack.LONGEST_PACK + 1)
    with pytest.raises(FailstopError, match="is not an evidence pack: it has more than"):
        pack.verified(str(long))


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="no ssh-keygen here (openssh-client)")
def test_a_signature_is_of_this_page(record: dict[str, Any], tmp_path: Path) -> None:
    key, path = tmp_path / "key", str(tmp_path / "e.html")
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
    assert pack.save(record, path, str(key))[2] == f"{path}.sig"
    assert 'Good "failstop" signature' in pack.verified(path)
    pack.save({**record, "verdict": "FAIL"}, path)
    with pytest.raises(FailstopError, match=r"\.sig does not belong to this file"):
        pack.verified(path)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--pack", "{}/new/e.html"), "--pack {0}/new/e.html: there is no folder {0}/new"),
        (("--pack", "{}/e.html"), "--pack {0}/e.html: {0}/e.json: a directory, not a regular file"),
        (("--pack", "{}/a.html", "--key", "{}/none"), "--key {0}/none: nothing can be signed with it"),
        (("--key", "{}/none"), "--key goes with --pack"),
        (("--out", "{}/file/new"), "the evidence can't be saved in {0}/file/new: {0}/file is not a folder"),
    ],
)
def test_what_can_not_be_saved_is_told_before_anything_moves(
    words: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "e.json").mkdir()
    (tmp_path / "file").touch()
    assert main(["prove", "--sim", *(word.format(tmp_path) for word in words)]) == 1
    assert told.format(tmp_path) in capsys.readouterr().err


def test_a_key_whose_passphrase_nobody_types_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program(tmp_path, "exec tail -f /dev/null", monkeypatch)
    with pytest.raises(FailstopError, match=r"did not end within 0\.1 s; if it asks for a passphrase"):
        pack.check_place(str(tmp_path / "e.html"), "key", 0.1)


def program(place: Path, does: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An ssh-keygen that does this."""
    path = place / "ssh-keygen"
    path.write_text(f"#!/bin/sh\n{does}\n")
    path.chmod(0o755)
    monkeypatch.setenv("PATH", f"{place}:{os.environ['PATH']}")


def test_what_can_be_saved_is(tmp_path: Path) -> None:
    """A file that is too large stands for a full disk."""
    row = Result(BY_PATH["stop-request"], BY_TURNING["0.2"], simulated=True)
    evidence = Evidence("/dev/any", simulated=True, realtime=True, results=[row])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        full = [(str(tmp_path), lambda: report.save(evidence, str(tmp_path)))]
        assert saving.save_each(full) == (
            [],
            [f"the evidence could not be saved: {tmp_path}: {os.strerror(errno.EFBIG)}"],
        )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [], "no half result, which a setup would read"

    def fails() -> list[str]:
        raise FailstopError("no key")

    paths, failed = saving.save_each([("e.html", fails), *full])
    assert [Path(path).name for path in paths] == ["report.txt", "result.json"]
    assert failed == ["the evidence could not be saved: no key"]


SIGNS_ONCE = """\
[ -e "$0.used" ] && exit 1
: > "$0.used"
"""


@pytest.mark.slow
def test_a_signature_that_fails_at_the_end_costs_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Standard output is full, too."""
    program(tmp_path, SIGNS_ONCE, monkeypatch)
    out, page = tmp_path / "out", tmp_path / "e.html"
    words = ("--sim", "--json", "--only", "disable", "--at", "0.2", "--out", str(out), "--pack", str(page))
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [*FAILSTOP, "prove", *words, "--key", "any"],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    (result,) = out.glob("*/result.json")
    assert [row["path"] for row in json.loads(result.read_text())["rows"]] == ["disable"]
    assert page.read_text() == pack.page(json.loads(page.with_suffix(".json").read_text()))
    assert f"evidence: {result}\n" in done.stderr
    assert f"the evidence could not be saved: {page} is written, but can't be signed with any" in done.stderr
    assert "standard output can't be written" in done.stderr


def test_a_key_that_is_none_is_told(record: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(FailstopError, match="can't be signed with"):
        pack.save(record, str(tmp_path / "e.html"), str(tmp_path / "no-key"))
