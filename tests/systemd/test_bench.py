"""The bench's rows of the unit."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench import service
from bench.container import Container, ContainerMissing
from bench.service_scene import Scene
from failstop_lab.trial import Stopped

MS = 1_000_000


def test_one_round_has_every_row(shared_scene: Scene) -> None:
    """It starts with the machine. A quiet one judges bars, and test_service.py the other faults; no stop is missed."""
    fault = service.FAULTS[0]
    rows = {row.measure: row for row in service.measure(1, 1, lambda text: None, [fault])}
    for measure in (f"{fault.label} -> stop frame", f"{fault.label} -> the service is restarted", "boot -> READY"):
        assert rows[f"systemd: {measure}"].numbers["samples"] == 1
    counts = [rows[f"systemd: {what}"] for what in ("stops missed", "motion frames after the stop")]
    assert [row.result for row in counts] == ["0 of 1"] * 2


def test_a_missed_stop_and_motion_after_one_miss_their_bars() -> None:
    fault = service.FAULTS[0]
    samples = service.Samples()
    samples.stops = [Stopped(0, None, None, None, 0, True), Stopped(0, 6 * MS, MS, MS, 2, False)]
    rows = {row.measure: row for row in service.rows_of({fault: samples}, [MS])}
    missed = {measure for measure, row in rows.items() if row.met is False}
    assert missed == {
        f"systemd: {fault.label} -> stop frame",
        "systemd: stops missed",
        "systemd: motion frames after the stop",
        "systemd: wheels found at rest",
    }


def test_where_there_can_be_no_container_the_row_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ContainerMissing) as missing:
        Container()
    [row] = service.measure(1, 1, lambda text: None)
    assert (row.result, row.met) == (f"skipped: {missing.value}", None)
