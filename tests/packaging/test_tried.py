"""What was tried where: a run becomes a record, and the page has every record."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from failstop_lab.pages import tried as page
from tests.support.commands import script
from tests.support.pages import ROOT

PASSED = "....\n=========== 2 failed, 5325 passed, 3 skipped in 265.20s (0:04:25) ==========\n12 passed in 4.1s\n"


@pytest.fixture(scope="module")
def tried() -> Any:
    return script(ROOT / "packaging/tried.py")


def record(what: str, version: str, result: str = "passed") -> dict[str, str]:
    return dict(
        zip(page.IN_A_RECORD, (what, version, "Debian", result, "load 0.1", "2026-11-28", "abc", "make x"), strict=True)
    )


def test_a_run_s_result_is_what_pytest_counted(tried: Any) -> None:
    row = tried.ROWS["test"]
    counted = "2 failed, 5325 passed, 3 skipped; 12 passed"
    assert tried.results(row, PASSED, 0, "Python 3.14.8") == {"Python 3.14.8": counted}
    assert tried.results(row, PASSED, 2, "Python 3.14.8") == {"Python 3.14.8": f"FAILED ({counted})"}
    names = "  tests/a.py::one\n  tests/a.py::two\n"
    twice = f"{PASSED}\nPassed on the second try only, so find out why (x.txt):\n{names}make: y\n"
    better = "5325 passed, 3 skipped; 12 passed; 2 of them on the second try"
    assert tried.results(row, twice, 0, "Python 3.14.8") == {"Python 3.14.8": better}
    assert tried.results(row, "no such thing", 2, "x") == {"x": "FAILED (stopped early)"}


def test_a_bench_s_result_is_how_many_of_its_bars_were_met(tried: Any) -> None:
    table = "one\n    yes\n    bar: yes  met\ntwo\n    3 s\n    bar: < 2 s  MISSED\nthree\n    skipped\n"
    row = tried.ROWS["package-test"]
    assert tried.results(row, table, 1, "Debian") == {"Debian": "FAILED (1 of 2 bars met)"}
    assert tried.results(row, table.replace("MISSED", "met"), 0, "Debian") == {"Debian": "2 of 2 bars met"}


def test_of_a_release_that_is_built_twice_the_files_are_counted(tried: Any) -> None:
    line = "built twice, equal to the byte: 16 files\n"
    assert tried.results(tried.ROWS["reproduce"], line, 0, "x") == {"x": "equal to the byte: 16 files"}


@pytest.mark.parametrize(
    ("row", "output", "result"),
    [
        (
            "chaos",
            "\n2000 faults in 1101 s: 0 stops missed, 0 motion frames after a stop, 0 not as the table says; the p9\n",
            "2000 faults in 1101 s: 0 stops missed, 0 motion frames after a stop, 0 not as the table says",
        ),
        (
            "rrc-faults",
            "\n13111 runs at 2981 calls; 4816 more would be the same as one of these: 0 wrong, in 199 s\n",
            "13111 runs at 2981 calls; 4816 more would be the same as one of these: 0 wrong",
        ),
        (
            "rrc-seeds",
            "from seed 1: 3 x\n125 seeds, 300 rounds, 900 faults (1300 a second of a core): 1 wrong: [7]\n",
            "125 seeds, 300 rounds, 900 faults (1300 a second of a core): 1 wrong",
        ),
        ("model", "x holds\nevery verdict is the expected one\n", "every verdict is the expected one"),
        ("fuzz", "frames: good; Done 12\nsettings: FAILED; x\n", "1 of 2 parsers passed"),
        ("controls", "| a |\n68 of 68 controls found\n", "68 of 68 controls found"),
    ],
)
def test_of_a_campaign_its_last_line_is_kept(tried: Any, row: str, output: str, result: str) -> None:
    assert tried.results(tried.ROWS[row], output, 0, "x") == {"x": result}
    assert tried.results(tried.ROWS[row], output, 1, "x") == {"x": f"FAILED ({result})"}


@pytest.mark.starts
def test_a_ros_is_named_with_its_rclpy_and_where_it_is_from(tried: Any, tmp_path: Path) -> None:
    manifest = tmp_path / "share/rclpy/package.xml"
    manifest.parent.mkdir(parents=True)
    manifest.write_text("<package>\n  <version>7.1.3</version>\n</package>\n")
    setup = tmp_path / "setup.sh"
    setup.write_text(f"ROS_DISTRO=jazzy AMENT_PREFIX_PATH={tmp_path}\n")
    done = subprocess.run(
        ["sh", "-c", tried.ASK_ROS], env={"ROS": str(setup), "PATH": "/usr/bin:/bin"}, capture_output=True, text=True
    )
    assert done.stdout == "ROS 2 jazzy, rclpy 7.1.3, built from source\n", done.stderr


def test_every_python_of_make_versions_is_a_record_and_one_that_is_not_here_is_none(tried: Any) -> None:
    output = "python 3.10: good, 80 s\npython 3.11: not tried; ALL=yes tries it\npython 3.14: FAILED, 3 s\n"
    assert tried.results(tried.ROWS["versions"], output, 1, "") == {"Python 3.10": "passed", "Python 3.14": "FAILED"}


def test_a_new_record_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "tried.json"
    path.write_text("[]")
    page.kept([record("tests", "Python 3.9"), record("tests", "Python 3.10", "FAILED"), record("a", "x")], path)
    page.kept([record("tests", "Python 3.10")], path)
    assert [(row["what"], row["with"], row["result"]) for row in page.records(path)] == [
        ("a", "x", "passed"),
        ("tests", "Python 3.9", "passed"),
        ("tests", "Python 3.10", "passed"),
    ]
    path.write_text(json.dumps([{**record("a", "x"), "day": ""}]))
    with pytest.raises(ValueError, match=r"tried\.json: a: each record needs what, with"):
        page.records(path)


def test_an_unknown_row_is_named_and_nothing_is_tried(tried: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert tried.main(["nothing"]) == 2
    assert "no row 'nothing': there are versions, test," in capsys.readouterr().err


@pytest.mark.starts
def test_a_run_becomes_a_record_of_what_it_was_tried_with(tried: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(tried.ROWS, "make", tried.Row("make itself", ("--version",), "echo GNU make"))
    (found,) = tried.attempt("make")
    assert tuple(found) == page.IN_A_RECORD
    assert (found["what"], found["with"], found["result"]) == ("make itself", "GNU make", "passed")
    assert found["row"] == "make tried ROWS=make"


@pytest.mark.starts
def test_a_record_names_a_commit_of_main_and_whether_anything_differed(
    tried: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def git(*words: str) -> str:
        own = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        return subprocess.run(["git", *own, *words], cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    records, table, code = (tmp_path / name for name in ("tried.json", "tried.md", "code.py"))
    for path in (records, table, code):
        path.write_text("")
    monkeypatch.setattr(page, "FILE", records)
    monkeypatch.setattr(tried, "PAGE", table)
    monkeypatch.setattr(tried, "ROOT", tmp_path)
    git("init", "--quiet", "--initial-branch=main")
    git("add", ".")
    git("commit", "--quiet", "-m", "all")
    commit = git("rev-parse", "HEAD")[:8]
    assert tried.tree() == commit
    records.write_text("renewed")
    table.write_text("renewed")
    assert tried.tree() == commit
    code.write_text("changed")
    assert tried.tree() == f"{commit}+"
    git("checkout", "--quiet", "-b", "mine")
    git("commit", "--quiet", "--all", "-m", "mine")
    assert tried.tree() == f"{commit}+", "the branch's commit may get another name"
    git("checkout", "--quiet", "main")
    git("merge", "--quiet", "mine")
    assert tried.tree() == git("rev-parse", "HEAD")[:8]


@pytest.mark.starts
def test_a_row_is_out_of_date_once_what_it_tries_has_changed(
    tried: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def git(*words: str) -> str:
        own = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        return subprocess.run(["git", *own, *words], cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    records = [record("the model", "Spin", "passed")]
    monkeypatch.setattr(tried, "ROOT", tmp_path)
    monkeypatch.setitem(tried.ROWS, "x", tried.Row("the model", ("model",), "", ("model", ":(exclude)model/notes")))
    monkeypatch.setattr(page, "records", lambda: records)
    for name in ("model/a.pml", "model/notes/n.md", "other.py"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text("")
    git("init", "--quiet", "--initial-branch=main")
    git("add", ".")
    git("commit", "--quiet", "-m", "all")
    commit = git("rev-parse", "HEAD")[:8]
    assert tried.since("x") == "never tried", "another row has the record"
    records[0] |= {"row": "make tried ROWS=x"}
    assert tried.since("x") == "tried on 2026-11-28; this checkout lacks its commit abc"
    records[0] |= {"commit": f"{commit}+"}
    assert tried.since("x") == f"tried on 2026-11-28 at {commit}; since then nothing changed"
    for name in ("model/notes/n.md", "other.py"):
        (tmp_path / name).write_text("changed")
    assert tried.since("x").endswith("since then nothing changed")
    (tmp_path / "model/a.pml").write_text("changed")
    records[0] |= {"result": "FAILED"}
    assert tried.since("x") == f"tried on 2026-11-28 at {commit}, FAILED; since then out of date: 1 file changed"


def test_every_row_is_a_target_of_make(tried: Any) -> None:
    makefile = (ROOT / "Makefile").read_text()
    for row in tried.ROWS.values():
        assert f"\n{row.command[0]}:" in makefile
