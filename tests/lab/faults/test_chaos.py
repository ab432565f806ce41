"""`failstop chaos`: a short campaign of random faults, and what the command refuses."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
from collections import Counter
from pathlib import Path
from subprocess import PIPE

import pytest

from failstop.cli import main as cli
from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import traits_of
from failstop_lab.faults import report
from failstop_lab.faults.injection import draw
from failstop_lab.faults.report import rows_of
from tests.support.amounts import amount
from tests.support.commands import FAILSTOP, failstop

SECONDS = amount(4, 120)
"""Each row is injected by tests/lab/faults/test_table.py; here the command is tried, and chance in a campaign."""


EVERY = rows_of(traits_of(BOARDS[0]))


def chaos(*words: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    return failstop("chaos", *words, timeout=timeout)


@pytest.mark.slow
@pytest.mark.timeout(SECONDS + 260)
def test_random_faults(tmp_path: Path) -> None:
    """The seed is new every time: a failure says how to find it again."""
    out = tmp_path / "chaos.json"
    done = chaos("--seconds", str(SECONDS), "--json", str(out), timeout=SECONDS + 60)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(out.read_text())
    assert result["count"]
    assert result["missed"] == result["motion_after"] == result["wrong"] == 0
    assert {row["name"] for row in result["rows"]} == set(EVERY)
    assert f"{result['count']} faults in" in done.stdout
    assert f"--seed {result['seed']}" in done.stderr


WITHOUT = ("setpriv", "--bounding-set", "-dac_override")


def can_go_without() -> bool:
    """True where this user has the capability that passes every permission, and may give it up."""
    may = os.geteuid() == 0 and shutil.which("setpriv") is not None
    return may and subprocess.run([*WITHOUT, "true"], stderr=subprocess.DEVNULL, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not can_go_without(), reason="not root, or without the right to drop a capability")
def test_a_permission_that_comes_late(tmp_path: Path) -> None:
    """A process that passes every permission, as root's do, never meets this row: root gives that up first."""
    out = tmp_path / "chaos.json"
    command = [*FAILSTOP, "chaos", "--only", "usb-drop-permission", "--each", "1"]
    done = subprocess.run([*WITHOUT, *command, "--json", str(out)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    row = json.loads(out.read_text())["rows"][0]
    assert (row["count"], row["missed"], row["motion_after"], row["wrong"]) == (1, 0, 0, 0)


@pytest.mark.slow
def test_a_campaign_is_repeated_from_any_fault_on_with_settings_of_the_user(tmp_path: Path) -> None:
    """The first that are drawn are left out, and the rest is the same (tests/lab/faults/test_judge.py)."""
    out, config = tmp_path / "chaos.json", tmp_path / "mine.toml"
    config.write_text("[gate]\ncommand_timeout_s = 0.12\n")
    only = ("--only", "kill-gate,client-hung", "--seed", "7", "--count", "2", "--first", "1", "--config", str(config))
    assert chaos(*only, "--json", str(out)).returncode == 0
    rows = {row["name"]: row for row in json.loads(out.read_text())["rows"]}
    drawn = Counter(
        draw(tuple(EVERY[name] for name in ("kill-gate", "client-hung")), index, 7).name for index in (1, 2)
    )
    assert {name: row["count"] for name, row in rows.items()} == drawn == {"kill-gate": 1, "client-hung": 1}
    assert 110 < rows["client-hung"]["max_ms"] < 280, "before the 300 ms that hold where nothing is set"
    config.write_text("[gate]\nlease_s = 9.0\n")
    assert "gate.lease_s" in chaos(*only).stderr


@pytest.mark.slow
def test_a_campaign_goes_on_where_it_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, names = tmp_path / "chaos.json", ("kill-gate", "kill-stopper")
    only = ("--only", ",".join(names), "--count", "2")
    assert chaos(*only, "--seed", "7", "--json", str(out)).returncode == 0
    first = json.loads(out.read_text())
    assert chaos(*only, "--resume", str(out)).returncode == 0
    both = json.loads(out.read_text())
    drawn = Counter(draw(tuple(EVERY[name] for name in names), index, 7).name for index in range(4))
    assert {row["name"]: row["count"] for row in both["rows"]} == drawn
    assert (first["next"], both["next"], both["seed"]) == (2, 4, 7)
    times = [{row["name"]: row["times_ms"] for row in result["rows"]} for result in (first, both)]
    assert all(times[1][name][: len(found)] == found for name, found in times[0].items())
    parts = both["machine"]["parts"]
    assert [part["count"] for part in parts] == [2, 2]
    assert both["machine"]["took_s"] == sum(part["took_s"] for part in parts)
    page = report.markdown(both)
    together = all(parts[0][key] == parts[1][key] for key in ("date", "commit"))
    told = "4 faults." if together else "2 faults; "
    assert f"Run on {parts[0]['date']} at {parts[0]['commit'] or 'no commit'}: {told}" in page
    capsys.readouterr()
    assert cli.main(["chaos", "--resume", str(out), "--count", "1"]) == 1
    assert "it can't be continued: it was of another board or of other rows; --json" in capsys.readouterr().err
    assert json.loads(out.read_text()) == both


def test_an_interrupted_campaign_tells_what_it_has(tmp_path: Path) -> None:
    command = [*FAILSTOP, "chaos", "--only", "kill-gate", "--seconds", "60"]
    with subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True, start_new_session=True) as process:
        assert process.stderr is not None
        assert process.stderr.readline().endswith(" 1 rows\n")
        # As a terminal's Ctrl-C does: to the campaign, its board and its service alike.
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert " 0 not as the table says" in out
    assert "interrupted; to repeat it: --seed " in err


class Impatient(io.StringIO):
    """A terminal at which Ctrl-C is pressed as soon as the first line is there."""

    def write(self, text: str) -> int:
        before = self.getvalue()
        written = super().write(text)
        if "\n" in text and "\n" not in before:
            os.kill(os.getpid(), signal.SIGINT)
        return written


def test_ctrl_c_right_after_the_first_line_tells_the_seed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stderr = Impatient()
    monkeypatch.setattr("sys.stderr", stderr)
    assert cli.main(["chaos", "--only", "kill-gate", "--seconds", "60", "--seed", "7"]) == 130
    assert stderr.getvalue().splitlines() == ["seed 7, 1 rows", "interrupted; to repeat it: --seed 7"]
    assert " 0 not as the table says" in capsys.readouterr().out


def test_list_names_every_row(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["chaos", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(EVERY)
    assert cli.main(["chaos", "--list", "--only", "kill-*-hang-gate"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 4


def test_a_page_from_a_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "chaos.json"
    machine = dict.fromkeys(("version", "date", "python", "kernel", "machine", "cores", "took_s"), "x")
    totals = dict.fromkeys(("count", "missed", "motion_after", "wrong"), 0)
    out.write_text(json.dumps({"machine": machine, "seed": 1, **totals, "rows": [], "stories": []}))
    assert cli.main(["chaos", "--markdown", "--from", str(out)]) == 0
    page = capsys.readouterr().out
    assert all(f"| `{name}` |" in page for name in EVERY)


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("--count", "0"), 1, "--count 0: it must be more than 0"),
        (("--seconds", "-3"), 1, "--seconds -3: it must be more than 0"),
        (("--each", "2", "--first", "7"), 1, "--first goes with --count and --seconds"),
        (("--json", "/nowhere/chaos.json"), 1, "--json /nowhere/chaos.json: No such file or directory"),
        (("--only", "nonsense"), 1, "no row 'nonsense' in the fault table"),
        (("--from", "/nowhere"), 1, "--from goes with --markdown"),
        (("--resume", "/nowhere", "--seed", "7"), 1, "--resume goes with --count and --seconds"),
        (("--resume", "/nowhere"), 1, "/nowhere is not the result of a campaign"),
        (("--markdown", "--from", "/nowhere"), 1, "/nowhere is not the result of a campaign"),
        (("--device", "/dev/ttyACM0"), 2, "add --on-the-stand --wheels-are-free"),
        (("--device", "/dev/ttyACM0", "--on-the-stand"), 2, "add --wheels-are-free"),
        (("--device", "/dev/ttyNONE", "--on-the-stand", "--wheels-are-free"), 1, "no device /dev/ttyNONE"),
    ],
)
def test_what_is_refused(words: tuple[str, ...], code: int, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["chaos", *words]) == code
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
