"""The table of measurements: rows that differ in one name are one row, in which nothing is lost."""

from __future__ import annotations

from typing import Any

from bench import pages

HEAD = f"# Measured\n\n<!-- run: generated -->\nold\n<!-- end of run -->\n\n{pages.HEAD}"
RAN = {"date": "2026-01-02", "commit": "abc", "cores": 2, "kernel": "6.1", "python": "3.11", "realtime": True}
RAN |= {"pty carriers": "real-time", "took_s": 60, "steal": 0.01, "command": "python -m bench --kills 8"}


def row(measure: str, result: str, bar: str = "-", met: bool | None = None) -> dict[str, Any]:
    return {"measure": measure, "result": result, "bar": bar, "met": met}


def table(*rows: dict[str, Any]) -> list[str]:
    return pages.renewed(f"{HEAD}| old |\n\nafter", {"machine": RAN, "rows": list(rows)}).splitlines()[8:-2]


def test_kills_that_differ_in_the_process_are_one_row_with_each_time_and_bar() -> None:
    assert table(
        row("kill gate while the arm moves -> every joint stands", "p50 1.0  p99 2.0  max 3.0 ms", "p99 < 65 ms", True),
        row("memory", "40 MB", "< 60 MB", True),
        row(
            "kill stopper while the arm moves -> every joint stands",
            "p50 4.0  p99 5.0  max 6.0 ms",
            "p99 < 70 ms",
            True,
        ),
    ) == [
        "| kill each process while the arm moves -> every joint stands "
        "| p50 / p99 / max: gate 1.0 / 2.0 / 3.0 ms; stopper 4.0 / 5.0 / 6.0 ms | p99 < 65, 70 ms | met |",
        "| memory | 40 MB | < 60 MB | met |",
    ]


def test_one_missed_bar_is_named_and_misses_the_row() -> None:
    (line,) = table(
        row("kill gate, of 100 MB -> stop frame", "p50 1.0  p99 2.0  max 3.0 ms", "p99 < 5 ms", True),
        row("kill stopper, of 100 MB -> stop frame", "p50 4.0  p99 5.0  max 6.0 ms", "p99 < 5 ms", False),
    )
    assert line.endswith("gate 1.0 / 2.0 / 3.0 ms; stopper 4.0 / 5.0 / 6.0 ms **missed** | p99 < 5 ms | **missed** |")


def test_trials_that_did_not_go_as_they_should_are_counted_together() -> None:
    assert table(
        row("kill gate while the arm moves: not as its row says", "1 of 24", "0", False),
        row("unplugged while it moves: not as its row says", "0 of 4", "0", True),
    ) == ["| faults while the arm moves: not as its row says | 1 of 28 | 0 | **missed** |"]


def test_a_kill_that_is_compared_with_the_floor_keeps_its_row() -> None:
    rows = [row(f"kill {name} -> stop frame", "p50 1.0  p99 2.0  max 3.0 ms") for name in ("gate", "stopper")]
    rows += [row("systemd: hang of the supervisor -> stop frame", "p50 1.0  p99 2.0  max 3.0 ms")]
    assert pages.folded(rows) == rows


def test_peers_without_a_bar_are_one_row() -> None:
    one_way = "one way, 64 bytes at 1 kHz: "
    assert (
        table(
            row(one_way + "ring + bell", "p50 30.0  p99 80.3 us", "p50 <= 33 us", True),
            row(one_way + "pipe (the floor)", "p50 27.5  p99 68.4 us"),
            row(one_way + "ZeroMQ", "skipped: no pyzmq"),
        )[1]
        == f"| {one_way}others | p50 / p99: pipe (the floor) 27.5 / 68.4 us; ZeroMQ skipped: no pyzmq | - |  |"
    )
