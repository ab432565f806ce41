"""The metrics: what a state becomes, and that Prometheus's own parser reads it so."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import socket
import threading
import urllib.request
from typing import Any

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from failstop.api.snapshot import OLD_S, Ages, Device
from failstop.api.state import State
from failstop.fleet import FleetError, exposition, metrics, scraped
from failstop.policy import causes
from failstop.version import VERSION
from failstop_lab.pages import fleet as page
from tests.support import states
from tests.support.pages import ROOT

UNITS = ("seconds", "volts", "celsius", "meters_per_second", "radians_per_second")


class Told(exposition.Collector):
    """The collector, of a state that is given."""

    def __init__(self, state: State | None) -> None:
        super().__init__("nobody")
        self._told = state

    def state(self) -> State | None:
        return self._told


def parsed(state: State | None) -> dict[str, dict[frozenset[tuple[str, str]], float]]:
    registry = CollectorRegistry()
    registry.register(Told(state))
    found: dict[str, dict[frozenset[tuple[str, str]], float]] = {}
    for family in text_string_to_metric_families(generate_latest(registry).decode()):
        for sample in family.samples:
            found.setdefault(sample.name, {})[frozenset(sample.labels.items())] = sample.value
    return found


def one(state: State, name: str, /, **labels: str) -> float:
    return parsed(state)[f"failstop_{name}"][frozenset(labels.items())]


def test_without_a_service_there_is_up_alone() -> None:
    assert parsed(None) == {"failstop_up": {frozenset(): 0.0}}
    assert parsed(states.state())["failstop_up"] == {frozenset(): 1.0}


def test_every_family_has_samples_of_some_state_with_its_labels_and_no_others() -> None:
    servos = {"joint elbow (servo 3)": (-0.25, 41)}
    full = states.latched(scan_age_s=0.2, plugged="plugged", arm=states.arm("elbow", "wrist"), servos=servos)
    full = dataclasses.replace(full, turning=states.TURNS_ON, ages=Ages(battery_s=1.5))
    assert one(full, "reading_age_seconds", reading="battery") == 1.5
    assert one(full, "servo_load_ratio", servo="joint elbow (servo 3)") == -0.25
    assert one(full, "servo_temperature_celsius", servo="joint elbow (servo 3)") == 41
    seen = {family.name: samples for family, samples in metrics.collect(full)}
    assert set(seen) == {family.name for family in metrics.FAMILIES}
    for family in metrics.FAMILIES:
        for labels, _ in seen[family.name]:
            assert tuple(name for name, _ in labels) == family.labels, family.name
    names = {name for name in parsed(full) if not name.endswith("_created")}
    assert names == set(seen), "what Prometheus reads is called as the table says"


def test_names_are_as_prometheus_wants_them() -> None:
    for family in metrics.FAMILIES:
        assert re.fullmatch(r"failstop_[a-z]+(_[a-z]+)*", family.name)
        assert (family.kind == metrics.COUNTER) == family.name.endswith("_total")
        assert not re.search(r"_(ms|us|mv|percent|millivolts)(_|$)", family.name), "base units only"
        if re.search(
            r"_(age|timestamp|written|acknowledged|observed|turn_rad|volts|temperature|velocity)", family.name
        ):
            assert family.name.endswith(UNITS), family.name
        assert family.doc
        assert "\n" not in family.doc


def test_a_latched_stop() -> None:
    state = states.latched(causes.DIED("gate"))
    assert one(state, "stop_latched") == 1
    assert one(state, "stop_latched_cause", cause="died") == 1
    assert one(state, "blocked", reason="latched") == 1
    assert one(state, "blocked", reason="disabled") == 0
    assert one(state, "last_stop_info", cause="died", noticed_by="port_owner") == 1
    assert one(state, "last_stop_written_seconds") == pytest.approx(210e-6)
    assert one(state, "last_stop_acknowledged_seconds") == pytest.approx(4.4e-3)
    assert one(state, "last_stop_observed_seconds") == pytest.approx(0.3)
    assert one(state, "last_stop_timestamp_seconds") == states.NOW_S - 12
    assert "failstop_stop_latched_cause" not in parsed(states.state())


def test_a_level_that_a_stop_has_not_reached_has_no_sample() -> None:
    stop = states.stop(written_s=None, acknowledged_s=None, observed_s=None)
    found = parsed(states.latched(last_stop=stop))
    assert not [name for name in found if re.search("written|acknowledged|observed", name)]
    whole = states.stop()
    for stop in (dataclasses.replace(whole, sent=False), dataclasses.replace(whole, believed=False)):
        # The board may not have what is written.
        assert "failstop_last_stop_written_seconds" not in parsed(states.latched(last_stop=stop))
    assert one(states.latched(last_stop=states.stop(observed_s=0.0)), "last_stop_observed_seconds") == 0


@pytest.mark.parametrize(
    ("blocked", "reason"),
    [("disabled", "disabled"), ("cmd timeout", "no_command"), ("no scan", "no_scan"), ("interlock gripper", "other")],
)
def test_one_reason_blocks(blocked: str, reason: str) -> None:
    found = parsed(states.state(blocked=blocked))["failstop_blocked"]
    assert [labels for labels, value in found.items() if value] == [frozenset({("reason", reason)})]


def test_nothing_blocks_while_it_drives() -> None:
    assert not any(parsed(states.driving())["failstop_blocked"].values())
    assert one(states.driving(), "moving") == 1
    assert one(states.driving(), "velocity_meters_per_second", axis="x") == 0.2


def test_wheels_may_turn_while_the_port_is_lost_or_the_board_is_deaf() -> None:
    for device in (
        Device("/dev/x", "lost", "alive"),
        Device("/dev/x", "open", "deaf"),
    ):
        assert one(states.state(device=device), "wheels_may_turn") == 1
        assert one(states.state(device=device), "link_state", state=device.link) == 1
    assert one(states.state(), "wheels_may_turn") == 0


def test_what_is_not_known_has_no_sample() -> None:
    found = parsed(states.state(battery_v=None))
    assert "failstop_battery_volts" not in found
    assert "failstop_scan_age_seconds" not in found
    assert "failstop_arm_moving" not in found
    assert "failstop_battery_charger_plugged" not in found


@pytest.mark.parametrize(
    "changed",
    [
        {"ages": Ages(battery_s=OLD_S, servos_s=OLD_S)},
        {"device": Device("/dev/x", "lost", "alive"), "arm": states.arm("elbow")},
        {"device": Device("/dev/x", "open", "silent"), "arm": states.arm("elbow")},
    ],
)
def test_a_reading_from_before_the_board_fell_silent_has_no_sample(changed: dict[str, Any]) -> None:
    servos = {"joint elbow (servo 3)": (-0.25, 41)}
    found = parsed(states.state(plugged="plugged", servos=servos, **changed))
    assert not [name for name in found if re.search("battery|servo_|arm_joint", name)]


def test_a_state_that_this_version_does_not_know_is_shown() -> None:
    strange = states.state(processes={"gate": states.process(state="dreaming")})
    assert one(strange, "process_state", process="gate", state="dreaming") == 1


def test_a_label_is_escaped() -> None:
    name = 'a"b\\c\nd'
    assert one(states.state(name=name), "build_info", service=name, version=VERSION) == 1


def test_served_over_http_and_gone_afterwards() -> None:
    with exposition.serving("nobody", "127.0.0.1", 0) as port:
        url = f"http://127.0.0.1:{port}/metrics"
        with urllib.request.urlopen(url, timeout=10) as answer:
            assert answer.headers["Content-Type"].startswith("text/plain")
            assert b"\nfailstop_up 0.0\n" in answer.read()
        with (
            pytest.raises(FleetError, match=f"127.0.0.1:{port} can't be listened at"),
            exposition.serving("nobody", "127.0.0.1", port),
        ):
            pass
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url, timeout=10)


@pytest.mark.slow
def test_idle_connections_take_few_threads_and_keep_nobody_from_the_metrics() -> None:
    before = threading.active_count()
    with exposition.serving("nobody", "127.0.0.1", 0) as port, contextlib.ExitStack() as idle:
        for number in range(40):
            with contextlib.suppress(OSError):  # its backlog is full for a moment
                idle.enter_context(socket.create_connection(("127.0.0.1", port), 5))
            assert threading.active_count() <= before + 1 + scraped.MOST_CONNECTIONS, number
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
            assert b"\nfailstop_up 0.0\n" in answer.read()
        assert threading.active_count() <= before + 1 + scraped.MOST_CONNECTIONS


@pytest.mark.parametrize(
    "given",
    ["", "9464", "localhost", "127.0.0.1:x", "127.0.0.1:65536", "127.0.0.1:-1", "127.0.0.1:²", ":" + "1" * 5000],
)
def test_an_address_that_is_none(given: str) -> None:
    with pytest.raises(FleetError, match="HOST:PORT is expected"):
        exposition.address(given)


@pytest.mark.parametrize("host", ["a..b", "é" * 70], ids=["empty label", "long"])
def test_a_host_that_is_none(host: str) -> None:
    with pytest.raises(FleetError, match="no host can have this name"):
        exposition.address(f"{host}:9464")


def test_addresses() -> None:
    assert exposition.address(":9464") == ("127.0.0.1", 9464)
    assert exposition.address("[::1]:0") == ("::1", 0)


def test_the_page_has_the_tables_of_this_version() -> None:
    text = (ROOT / "docs" / "fleet.md").read_text("utf-8")
    for lines in page.TABLES.values():
        assert "\n".join(lines()) in text, "renew it: make docs"
    assert all(f"`{family.name}`" in text for family in metrics.FAMILIES)
