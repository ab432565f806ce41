"""A stop of a moment ago: its file is waited for, and nobody is shown an older one as the last."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any

import msgpack
import pytest

from failstop.cli.commands import incident as command
from failstop.cli.main import main
from failstop.policy import causes
from failstop.shm import layout, segment

RUN = 0x99
DIED = causes.DIED("gate").pack()
NOW_S = 1_790_000_000.0
SAVED = {"run": f"{RUN:016x}", "epoch": 7}


class Service:
    """The supervisor's segment, and in it the last stop."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.memory = segment.memory(name, RUN)
        segment.create(self.memory, layout.SUPERVISOR, RUN).close()
        self._stop = segment.attach(self.memory, layout.SUPERVISOR, RUN, write=True).latest_writer("stop")

    def stopped(self, **fields: Any) -> None:
        stop = {"cause": DIED, "latched": DIED, "epoch": 7, "t": NOW_S - 1.0}
        self._stop.write(msgpack.packb(stop | fields))


@pytest.fixture
def service() -> Iterator[Service]:
    made = Service(f"pending{os.getpid()}")
    yield made
    segment.unlink_all(made.memory)


def test_a_recent_stop_that_is_in_no_file(service: Service) -> None:
    assert command.unsaved(service.name, [], NOW_S) == "", "there was no stop"
    service.stopped()
    assert command.unsaved(service.name, [], NOW_S) == "gate died"


@pytest.mark.parametrize(
    ("heads", "fields"),
    [
        ([SAVED], {}),
        ([SAVED | {"epoch": 8}], {}),
        ([], {"t": NOW_S - command.RECENT_S - 1}),
        ([], {"t": NOW_S + 60}),
        ([], {"latched": causes.DIED("telemetry").pack()}),
        ([], {"t": "junk"}),
    ],
)
def test_nothing_is_to_come(service: Service, heads: list[dict[str, Any]], fields: dict[str, Any]) -> None:
    service.stopped(**fields)
    assert command.unsaved(service.name, heads, NOW_S) == ""


@pytest.mark.parametrize("head", [SAVED | {"epoch": 6}, SAVED | {"run": "another"}])
def test_another_stops_file_is_not_this_ones(service: Service, head: dict[str, Any]) -> None:
    service.stopped()
    assert command.unsaved(service.name, [head], NOW_S) == "gate died"


def test_without_a_service_nobody_waits() -> None:
    assert command.unsaved("nobody-of-this-name", [], NOW_S) == ""


def test_show_says_that_it_is_to_come(
    service: Service, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "PATIENCE_S", 0.0)
    service.stopped(t=time.time())
    assert main(["incident", "show", "--name", service.name]) == 1
    told = "failstop: the stop (gate died) is not saved yet: again in a few seconds\n"
    assert capsys.readouterr().err == told
