"""`failstop prove` on every kind of board: rows that it can have, judged by what it gives, and what it can't prove."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from failstop.board.interface import BY_ECHO
from failstop.board.kinds import KINDS, board_of, wire_of
from failstop.cli.main import main
from failstop.supervisor import status
from failstop_lab.prove.means import NEVER_ACTS, NO_ANSWER, NO_PAD, NO_REPORTS, UNCONFIRMED
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import wait_for
from tests.lab.prove.judged import firm
from tests.support.boards import own_folder
from tests.support.commands import FAILSTOP, failstop

ROWS = ("stop-request", "frozen")
AT = ("--only", ",".join((*ROWS, "pad")), "--at", "0.2", "--quick")
LIMIT_S = 240


def settings(place: Path, **more: object) -> str:
    """The lease of a busy machine, whatever rights the service has."""
    file = place / "own.toml"
    values = {status.LEASE: status.LEASE_WITHOUT_S, **more}
    file.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items()))
    return str(file)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_described_board_is_proved_by_what_it_says_itself(kind: str, tmp_path: Path) -> None:
    """The simulated board judges too: within the freeze no stop comes to it, and its wheels stand all the same. A board
    without a watchdog is not frozen."""
    config, watchdog_ms = ("--config", settings(tmp_path)), wire_of(kind).watchdog.acts_ns / 1e6
    done = failstop("prove", "--sim", "--board", kind, "--json", *AT, *config, timeout=LIMIT_S)
    result = json.loads(done.stdout)
    rows = {row["path"]: row for row in result["rows"]}
    wanted = ROWS if watchdog_ms else ROWS[:1]
    assert tuple(rows) == wanted, done.stderr or result["ended"]
    assert [firm(row["wrong"]) for row in rows.values()] == [[]] * len(wanted), done.stderr
    assert any(NO_PAD in reason for reason in result["unproved"])
    assert all(row["rest_s"] is not None for row in rows.values())
    assert rows["stop-request"]["acknowledged_ms"] >= rows["stop-request"]["written_ms"] > 0
    if frozen := rows.get("frozen"):
        assert frozen["written_ms"] is None
        assert watchdog_ms - 300 < frozen["board_ms"] < watchdog_ms + 1500
        assert frozen["rest_s"] * 1000 >= frozen["board_ms"] - 50
        echoes = board_of(kind, 0.08, 0.0).acknowledged_by == BY_ECHO
        assert (frozen["acknowledged_ms"] is not None) is echoes
    assert (done.returncode == 0) is ({row["verdict"] for row in rows.values()} == {"PASS"})


def silent_folder(at: Path) -> str:
    """A board of the user's own that answers nothing and reports nothing."""
    folder = own_folder(at)
    wire = at / "wire.py"
    before, _, rest = wire.read_text().partition("    questions=(")
    after = (
        rest[rest.index("    reader=") :].replace("(ANSWERED, OBSERVED)", "()").replace("ping_ns=50 * _MS", "ping_ns=0")
    )
    wire.write_text(f"{before}    questions=(),\n{after}")
    return folder


@pytest.mark.slow
def test_a_person_says_when_the_wheels_of_a_board_that_reports_nothing_stand(tmp_path: Path) -> None:
    """On a board whose frames the test does not see. Here the person looks at the simulated one."""
    folder = silent_folder(tmp_path / "tank")
    config, out = settings(tmp_path, **{"board.kind": folder}), str(tmp_path / "evidence")
    with SimBoard(tmp_path / "board", board=folder) as board:
        words = (*FAILSTOP, "prove", "--device", board.link, *AT, "--config", config, "--out", out)
        pipe = subprocess.PIPE
        with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
            assert process.stdin
            assert process.stdout
            process.stdin.write("spin\n")
            process.stdin.flush()
            said = []
            for line in process.stdout:
                said.append(line)
                if "press Enter as soon as the wheels have stopped" in line:
                    assert any(board.wheels()), "nobody has stopped them"
                    wait_for("its own watchdog", lambda: not any(board.wheels()))
                    process.stdin.write("\n")
                    process.stdin.flush()
            process.wait(LIMIT_S)
    text = "".join(said)
    assert "press Enter" in text, text
    (folder_of,) = Path(out).iterdir()
    result = json.loads((folder_of / "result.json").read_text())
    rows = {row["path"]: row for row in result["rows"]}
    assert [firm(row["wrong"]) for row in rows.values()] == [[]] * len(ROWS), text
    assert {NO_REPORTS, NO_ANSWER} <= set(result["unproved"])
    assert text.count(NO_REPORTS) == 1
    assert rows["stop-request"]["rest_s"] is rows["stop-request"]["acknowledged_ms"] is None
    assert rows["frozen"]["rest_s"] > 1.7


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--sim", "--board", "ugv", "--only", "pad"), f"nothing to test of pad: {NO_PAD}"),
        (("--sim", "--only", "frozen"), f"nothing to test of frozen: {NEVER_ACTS}"),
        (("--board", "ugv"), "--board goes with --sim"),
    ],
)
def test_a_row_that_a_board_can_not_have_is_refused(
    words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["prove", *words]) == 1
    assert reason in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("too_large", [0.2, 5.0])
def test_wheels_that_do_not_turn_as_told_end_it_and_the_setting_is_named(too_large: float, tmp_path: Path) -> None:
    """The board reports rpm, whatever board.per_rps says."""
    config = settings(tmp_path, **{"board.kind": "hoverboard", "board.per_rps": 60.0 * too_large})
    done = failstop("prove", "--sim", "--json", *AT, "--config", config, timeout=LIMIT_S)
    result = json.loads(done.stdout)
    assert (done.returncode, result["verdict"], result["rows"]) == (1, "FAIL", [])
    assert "times as fast as they are told, as the board reports them: board.per_rps = " in result["ended"]
    would = float(result["ended"].partition("board.per_rps = ")[2].partition(" ")[0])
    assert would == pytest.approx(60.0, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("written", [{}, {"board.per_rps": 114.5}], ids=str)
def test_a_scale_that_nobody_has_confirmed_is_named_and_no_wheel_is_faster_than_its_cap(
    written: dict[str, object], tmp_path: Path
) -> None:
    config = settings(tmp_path, **{"board.kind": "arduino", **written})
    done = failstop("prove", "--sim", "--json", *AT, "--config", config, timeout=LIMIT_S)
    result = json.loads(done.stdout)
    assert {row["velocity"] for row in result["rows"]} == {"0.05"}
    assert UNCONFIRMED in result["unproved"]


@pytest.mark.slow
def test_a_scale_that_the_reports_fit_is_confirmed_by_the_test(tmp_path: Path) -> None:
    """It is so close to the usual one that the board's report fits, and the board reports in a unit of its own."""
    config = settings(tmp_path, **{"board.kind": "ugv", "board.per_rps": 0.27})
    done = failstop("prove", "--sim", "--json", *AT, "--config", config, timeout=LIMIT_S)
    result = json.loads(done.stdout)
    assert {row["velocity"] for row in result["rows"]} == {"0.2"}, "no cap here"
    assert "set board.per_rps_confirmed = 0.27" in json.dumps(result)
