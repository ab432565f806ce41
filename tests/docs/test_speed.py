"""The README's table of times has the numbers of the pages that it is made from."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from bench import pages as bench_pages
from failstop_lab.faults import report, table
from failstop_lab.faults.fault import CLIENT_FAILS, GUARD_FAILS
from failstop_lab.pages import marked, speed
from tests.support.pages import ROOT


@pytest.fixture
def pages(tmp_path: Path) -> Path:
    """A checkout with the last campaign and the page on measurements, to change."""
    for name in (report.LAST, speed.MEASURED):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def test_each_line_sums_up_rows_of_the_fault_table() -> None:
    for line in speed.LINES:
        assert set(line.rows) <= table.FAULT_BY_NAME.keys()


def test_each_program_that_dies_or_hangs_is_in_a_line_or_named_as_left_out() -> None:
    rows = {row.name for row in table.TABLE if row.event in (CLIENT_FAILS, GUARD_FAILS)}
    shown = {name for line in speed.LINES for name in line.rows}
    assert rows == (shown & rows) | speed.NOT_SHOWN.keys()
    assert not shown & speed.NOT_SHOWN.keys()


def test_a_kind_that_was_never_tried_or_always_missed_has_no_number(pages: Path) -> None:
    found = report.last_campaign(pages)
    for row in found["rows"]:
        if row["name"] in ("scan-silent", "usb-drop", "hang-telemetry", "hang-stopper"):
            for name in ("p50_ms", "p99_ms", "max_ms"):
                row.pop(name, None)
            row |= {"count": 0} if row["name"] == "scan-silent" else {"missed": row["count"]}
    (pages / report.LAST).write_text(json.dumps(found))
    made = " ".join(speed.text(pages).split())
    assert "(counted from its last reading) | not tried | not tried | 0 |" in made
    assert "telemetry or stopper hangs | missed | missed |" in made
    assert re.search(r"the port is back: of (\d+) of these stops, \1 were missed\.", made)


def test_a_line_shows_its_slowest_row_and_counts_all(pages: Path) -> None:
    rows = {row["name"]: row for row in report.last_campaign(ROOT)["rows"]}
    hangs = [rows[name] for name in speed.LINES[3].rows]
    slowest_ms = max(row["p99_ms"] for row in hangs)
    tried = sum(row["count"] for row in hangs)
    fails = re.escape(speed.LINES[3].fails)
    assert re.search(rf"{fails} \| \d+ ms \| {slowest_ms:.0f} ms \| {tried} \|", speed.text(pages))


def test_kinds_that_were_never_injected_are_not_counted(pages: Path) -> None:
    rows = report.last_campaign(ROOT)["rows"]
    injected = [row for row in rows if row["count"]]
    assert f" faults of {len(injected)} kinds were injected" in " ".join(speed.text(pages).split())


def test_a_slower_campaign_and_a_missed_stop_show(pages: Path) -> None:
    found = report.last_campaign(pages)
    (row,) = (row for row in found["rows"] if row["name"] == "hang-telemetry")
    row |= {"p50_ms": 600.0, "p99_ms": 777.0, "max_ms": 900.0}
    (pages / report.LAST).write_text(json.dumps({**found, "missed": 3}))
    made = " ".join(speed.text(pages).split())
    assert "| 600 ms | 777 ms |" in made
    assert "**3 stops were missed" in made


def test_a_page_without_measurements_is_refused(pages: Path) -> None:
    (pages / speed.MEASURED).write_text("nothing\n")
    with pytest.raises(ValueError, match="no row of a killed process"):
        speed.text(pages)


def test_what_readme_says_of_the_bench_is_what_the_bench_says_of_itself(pages: Path) -> None:
    run = {"date": "2026-01-02", "commit": "", "cores": 2, "kernel": "6.1", "python": "3.11", "realtime": False}
    run |= {"pty carriers": "ordinary", "took_s": 60, "steal": 0.01, "command": "python -m bench --kills 8"}
    page = (pages / speed.MEASURED).read_text()
    (pages / speed.MEASURED).write_text(marked.renewed(page, "run", bench_pages.ran(run)))
    made = " ".join(speed.text(pages).split())
    assert "The bench ran on 2026-01-02, without real-time rights." in made
    assert "It gives a real-time priority to the threads" not in made
    assert "It gives a real-time priority to the threads" in " ".join(speed.text(ROOT).split())


def test_what_readme_says_of_memory_and_processor_was_measured() -> None:
    """Each number with its unit, and the row of the page on measurements that it comes from."""
    readme, measured = " ".join((ROOT / "README.md").read_text().split()), (ROOT / speed.MEASURED).read_text()
    said = re.search(
        r"takes (\d+) MB of memory, and about (\d+) % of one core while the robot drives\. "
        r"The ROS 2 bridge takes another (\d+) MB and (\d+) % of a core",
        readme,
    )
    assert said, "README.md says it in other words: change this test with it"
    rows = (
        r"\| memory of the whole service \(PSS\) \| ([\d.]+) MB",
        r"\| processor, driving, IMU at 110 Hz \| ([\d.]+) %",
        r"\| memory \(PSS\) \| ([\d.]+) MB",
        r"\| processor, IMU 110 Hz, [^|]*\| ([\d.]+) %",
    )
    bridge = measured.partition("## The bridge to ROS 2")[2]
    found = [re.search(row, page) for row, page in zip(rows, (measured, measured, bridge, bridge), strict=True)]
    assert [int(number) for number in said.groups()] == [round(float(row[1])) for row in found if row]
