"""The robots of a fleet on a screen, whatever they are called and whatever they say."""

from __future__ import annotations

import json
from typing import Any

import pytest

from failstop.cli import style
from failstop.fleet import message, report, topics, view
from failstop.fleet.roster import Roster
from failstop.fleet.sender import Sender
from failstop.fleet.settings import FleetSettings
from tests.support import states

EVIL = "r\x1b[2J\u202e1"
SHOWN = r"r\x1b[2J\u202e1"


def told(name: str, extra: tuple[dict[str, Any], ...] = ()) -> Roster:
    """One robot, connected and driving."""
    roster = Roster()
    for last, body in (
        (topics.CONNECTION, message.connection(message.ONLINE)),
        (topics.STATE, message.body(states.driving(), extra)),
    ):
        payload = message.Header("m", name).message(last, body, states.NOW_S)
        roster.hear(topics.of_robot("m", name, last), payload, 0.0, retained=False)
    return roster


def screen(roster: Roster) -> str:
    lines = view.lines(roster.sorted(), "here:1883", "", 0.0, states.NOW_S, 120, 40)
    return "\n".join(style.plain(line) for line in lines)


def test_a_robot_s_name_can_not_write_on_the_terminal() -> None:
    found = screen(told(EVIL))
    assert SHOWN in found
    assert all(line.isprintable() for line in found.splitlines())


def test_a_robot_s_name_can_not_write_on_the_terminal_of_who_stops_it(key: str) -> None:
    sender = Sender(FleetSettings({"stop.key_file": key}), "smoke", "ann")
    body = json.dumps(message.connection(message.LOST)).encode()
    sender._hear(topics.of_robot("failstop", EVIL, topics.CONNECTION), body, True)
    lines = [style.plain(line) for line in report.lines(sender.tally)]
    assert any(SHOWN in line for line in lines)
    assert all(line.isprintable() for line in lines)


@pytest.mark.parametrize("text", ["a\x1bb", "a\nb", "a\u202eb", "a\x9bb", "a\u2028b"])
def test_what_a_robot_says_can_not_write_on_the_terminal(text: str) -> None:
    found = screen(told("r1", (message.warning(message.FLEET_STOP_OFF, text, ""),)))
    assert "OBEYS NO FLEET STOP" in found
    assert all(line.isprintable() for line in found.splitlines())


def test_a_robot_that_obeys_no_fleet_stop_is_seen_at_a_glance() -> None:
    found = screen(told("r1", (message.warning(message.FLEET_STOP_OFF, "the broker does not let it", ""),)))
    assert "1 OBEYS NO FLEET STOP" in found.splitlines()[2]
    assert "OBEYS NO FLEET STOP: the broker does not let it; " in found
    assert "FLEET STOP" not in screen(told("r1"))
