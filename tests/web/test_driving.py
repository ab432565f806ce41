"""Driving from the page: by whom, under which conditions, and for how long a command counts. The board says when the
wheels stood; times are the robot's."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.policy.settings import UNATTENDED_DRIVE
from failstop.web import driving
from failstop.web.lease import answer_to
from failstop_lab.trial import Trial, judge, wait_for
from tests.web.driving_parts import COMMAND_S, DRIVING, LATE_S, enable_soon
from tests.web.parts import Web
from tests.web.viewer import Viewer

pytestmark = pytest.mark.page
SETTINGS = DRIVING

FORWARD = "1.00 0.00"
FULL_MPS = 0.2


@pytest.fixture(scope="module")
def anna(web: Web) -> dict[str, str]:
    """The headers of a paired device."""
    return web.pair("Anna")


def enable(trial: Trial, viewer: Viewer) -> None:
    """Enable as soon as somebody attends."""
    enable_soon(trial, lambda: viewer.stay(0.1))
    trial.board.events()


@contextlib.contextmanager
def ready(trial: Trial, web: Web, headers: dict[str, str], percent: int = 100) -> Iterator[Viewer]:
    """A device that attends and has chosen the limit; motion is enabled, and nothing moves."""
    with Viewer(web, headers) as viewer:
        viewer.attend()
        trial.robot.limit_speed(1.0)
        assert web.post("/api/limit", {"percent": percent}, headers)[0] == 200
        enable(trial, viewer)
        assert not trial.turning()
        yield viewer
    trial.robot.limit_speed(1.0)


def motion(trial: Trial) -> int:
    """Motion frames that the board has executed since somebody asked last."""
    return sum(event.is_motion for event in trial.board.events())


def told(viewer: Viewer) -> list[str]:
    """The reasons that stood in the way of its commands."""
    return [message["drive"] for message in viewer.seen if "drive" in message]


def test_a_held_stick_drives_within_the_limit_and_as_its_own_source(
    trial: Trial, web: Web, anna: dict[str, str]
) -> None:
    with ready(trial, web, anna, percent=50) as viewer:
        viewer.stay(1.0, FORWARD)
        state = trial.robot.state
        assert state.body_vel.vx_mps == pytest.approx(FULL_MPS / 2, abs=0.001)
        assert state.driver is not None
        assert (state.driver.source, state.driver.who.partition(" (pid")[0]) == ("page", "Anna (page)")
        viewer.stay(0.6, "0.00 -0.50")
        assert trial.robot.state.body_vel.wz_radps == pytest.approx(-0.25, abs=0.001)


def test_letting_go_is_zero_along_the_ramp(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    with ready(trial, web, anna) as viewer:
        viewer.stay(0.6, FORWARD)
        trial.board.events()
        since_ns = time.monotonic_ns()
        viewer.send(drive=False)
        viewer.stay(0.3)
        events = trial.board.events()
        seen = judge(events, since_ns, was_turning=True)
        assert seen.stop_ns is not None
        assert seen.stop_ns / 1e9 < COMMAND_S + LATE_S
        assert seen.motion_after == 0
        speeds = [max(map(abs, event.speeds)) for event in events if event.is_motor and event.arrival_ns >= since_ns]
        assert speeds[1:] == sorted(speeds[1:], reverse=True)
        assert trial.robot.state.enabled, "it is no stop"


def test_who_leaves_while_another_attends_drives_no_further(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    with ready(trial, web, anna) as viewer, Viewer(web, web.pair("Emil")) as other:
        other.attend()
        viewer.stay(0.5, FORWARD)
        other.stay(0.1)
        trial.board.events()
        since_ns = time.monotonic_ns()
        viewer.send(attend=False)
        other.stay(0.3)
        seen = judge(trial.board.events(), since_ns, was_turning=True)
        assert seen.stop_ns is not None
        assert seen.stop_ns / 1e9 < 0.1
        assert seen.motion_after == 0
        assert trial.robot.state.attended_by == ("Emil",)


@pytest.mark.parametrize("way", ["silent", "hangs-up"])
def test_a_command_is_good_for_a_third_of_a_second(trial: Trial, web: Web, anna: dict[str, str], way: str) -> None:
    with ready(trial, web, anna) as viewer:
        viewer.stay(0.6, FORWARD)
        trial.board.events()
        since_ns = time.monotonic_ns()
        if way == "hangs-up":
            viewer.hang_up()
        wait_for("the end of the command", lambda: not trial.turning())
        seen = judge(trial.board.events(), since_ns, was_turning=True)
        assert seen.stop_ns is not None
        assert seen.stop_ns / 1e9 < COMMAND_S + LATE_S
        wait_for("the operator to be gone", lambda: trial.robot.state.estop)
        assert motion(trial) == 0


def test_a_backlog_of_commands_moves_nothing(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    """Right, in order, and all at once, as a network lets them go; and each once more."""
    with ready(trial, web, anna) as viewer:
        held_back: list[str] = []
        while len(held_back) < 12:
            trial.robot.attend("another operator")
            if nonce := viewer.next().get("nonce"):
                held_back.append(nonce)
        trial.board.events()
        for nonce in (*held_back[:-3], *held_back[:-3]):
            viewer.answer(nonce, drive=FORWARD)
        viewer.next()
        viewer.next()
        assert motion(trial) == 0
        assert not trial.robot.state.sources
        assert trial.robot.state.enabled


def test_an_old_answer_is_as_old_as_its_nonce(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    """A command with the second newest nonce ends sooner by as much as it came late."""
    with ready(trial, web, anna) as viewer:
        viewer.stay(0.5, FORWARD)
        nonce = ""
        while not (nonce := viewer.next().get("nonce", "")):
            pass
        since_ns = time.monotonic_ns()
        while not viewer.next().get("nonce"):
            pass
        trial.board.events()
        viewer.answer(nonce, drive=FORWARD)
        wait_for("the end of the command", lambda: not trial.turning())
        seen = judge(trial.board.events(), since_ns, was_turning=True)
        assert seen.stop_ns is not None
        assert seen.stop_ns / 1e9 < COMMAND_S + LATE_S


@pytest.mark.parametrize("said", ["1.01 0.00", "nan 0.00", "inf 0.00", "0.5", "0.5 0.5 0.5", "x y", "true 1", "[1] 2"])
def test_what_is_no_command_moves_nothing(trial: Trial, web: Web, anna: dict[str, str], said: str) -> None:
    assert driving.share(said) is None
    with ready(trial, web, anna) as viewer:
        viewer.stay(0.3, said)
        assert motion(trial) == 0


def test_a_changed_command_is_not_proven(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    with ready(trial, web, anna) as viewer:
        for _ in range(5):
            if nonce := viewer.next().get("nonce"):
                viewer.send(nonce=nonce, answer=answer_to(f"{nonce}0.10 0.00", viewer.key), drive=FORWARD)
        assert motion(trial) == 0
        assert trial.robot.state.enabled


def test_who_does_not_attend_drives_nothing(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    with ready(trial, web, anna) as attending, Viewer(web, web.pair("Bert")) as bert, Viewer(web) as stranger:
        for viewer in (bert, stranger):
            for _ in range(4):
                viewer.next()
                viewer.answer("00" * 16, drive=FORWARD)
                viewer.send(drive=FORWARD)
        attending.stay(0.2)
        assert motion(trial) == 0
        assert trial.robot.state.enabled


def test_the_speed_limit_is_chosen_first_and_again_each_time(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    with ready(trial, web, anna) as viewer:
        viewer.stay(0.4, FORWARD)
        assert motion(trial)
        viewer.send(attend=False)
        wait_for("the stop", lambda: trial.robot.state.estop)
        viewer.attend()
        enable(trial, viewer)
        viewer.stay(0.4, FORWARD)
        assert motion(trial) == 0
        assert told(viewer)[-1] == driving.LIMIT_FIRST
        assert web.post("/api/limit", {"percent": 25}, anna)[0] == 200
        viewer.stay(0.4, FORWARD)
        assert motion(trial)


def test_the_speed_limit_is_chosen_again_after_a_restart_of_the_service(tmp_path: Path) -> None:
    """The next run has no limit, and a page stays open all the time."""
    path = tmp_path / "failstop.toml"
    path.write_text(SETTINGS)
    own = Trial(f"web-limit-{os.getpid()}", ("--config", str(path)))
    with own, Web(own.name, "--config", str(path), state=own.state) as page:
        anna, bert = page.pair("Anna"), page.pair("Bert")
        for headers in (anna, bert):
            assert page.post("/api/limit", {"percent": 10}, headers)[0] == 200
        with Viewer(page, anna) as viewer:
            viewer.attend()
            viewer.stay(0.3)
            assert told(viewer) == []
            own.service.end()
            wait_for("an answer", lambda: viewer.stay(0.1) or any("attend" in each for each in viewer.seen))
            viewer.stay(0.3)
            assert "nonce" not in viewer.next(), "it does not attend any more"
        own.service.start()
        with Viewer(page, bert) as viewer:
            viewer.attend()
            enable(own, viewer)
            viewer.stay(0.4, FORWARD)
            assert told(viewer)[-1] == driving.LIMIT_FIRST
            assert [message["chosen"] for message in viewer.seen if "chosen" in message][-1] is False
            assert motion(own) == 0


@pytest.mark.parametrize("attends", [False, True])
def test_another_tab_of_the_device_that_ends_does_not_stop_it(
    trial: Trial, web: Web, anna: dict[str, str], *, attends: bool
) -> None:
    """Nor does an old connection of it, which ends when the phone has a new one."""
    with ready(trial, web, anna) as viewer:
        with Viewer(web, anna) as tab:
            if attends:
                tab.attend()
            viewer.stay(0.3, FORWARD)
        viewer.stay(0.4, FORWARD)
        assert trial.robot.state.body_vel.vx_mps > 0
        assert told(viewer) == []


def test_a_stick_that_is_held_while_motion_is_enabled_moves_nothing(
    trial: Trial, web: Web, anna: dict[str, str]
) -> None:
    with ready(trial, web, anna) as viewer:
        trial.robot.disable()
        viewer.stay(0.3, FORWARD)
        trial.enable()
        trial.board.events()
        viewer.stay(0.3, FORWARD)
        assert motion(trial) == 0
        assert told(viewer)[-1] == driving.DISABLED
        viewer.stay(0.2)
        viewer.stay(0.3, FORWARD)
        assert motion(trial)


def disable(trial: Trial) -> None:
    trial.robot.disable()


def stop(trial: Trial) -> None:
    trial.robot.estop("a test")
    wait_for("the latch, which the enable then resets", lambda: trial.robot.state.estop)


@pytest.mark.parametrize("interrupts", [disable, stop])
def test_a_stick_that_is_held_over_a_quick_disable_or_stop_moves_nothing(
    trial: Trial, web: Web, anna: dict[str, str], interrupts: Callable[[Trial], None]
) -> None:
    """Somebody else disables or stops the robot, and enables it again before the page has noticed."""
    with ready(trial, web, anna) as viewer:
        viewer.stay(0.5, FORWARD)
        assert motion(trial)
        interrupts(trial)
        trial.enable()
        trial.board.events()
        viewer.stay(0.5, FORWARD)
        assert trial.robot.state.enabled
        assert motion(trial) == 0
        assert told(viewer)[-1] == driving.DISABLED
        viewer.stay(0.2)
        viewer.stay(0.3, FORWARD)
        assert motion(trial)


def test_two_devices_do_not_drive_at_once(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    other = web.pair("Cleo")
    with ready(trial, web, anna) as viewer, Viewer(web, other) as cleo:
        cleo.attend()
        assert web.post("/api/limit", {"percent": 100}, other)[0] == 200
        viewer.stay(0.2, FORWARD)
        for _ in range(4):
            viewer.stay(0.1, FORWARD)
            cleo.stay(0.1, "-1.00 0.00")
        assert trial.robot.state.estop is None
        assert "Anna drives" in told(cleo)
        assert trial.robot.state.body_vel.vx_mps > 0
        viewer.send(drive=False)
        viewer.stay(0.2)
        cleo.stay(0.8, "-1.00 0.00")
        assert trial.robot.state.body_vel.vx_mps < 0


def test_another_device_drives_half_a_second_after_the_first_was_let_go(
    trial: Trial, web: Web, anna: dict[str, str]
) -> None:
    other = web.pair("Dana")
    with ready(trial, web, anna) as viewer, Viewer(web, other) as dana:
        dana.attend()
        assert web.post("/api/limit", {"percent": 100}, other)[0] == 200
        for _ in range(3):
            viewer.stay(0.1, FORWARD)
            dana.stay(0.1)
        since_s = time.monotonic()
        viewer.send(drive=False)
        while trial.robot.state.body_vel.vx_mps >= 0:
            assert time.monotonic() < since_s + 10
            viewer.stay(0.02)
            dana.stay(0.02, "-1.00 0.00")
        assert time.monotonic() >= since_s + driving.OTHER_S
        assert "Anna drives" in told(dana)


def test_who_leaves_after_driving_is_no_client_any_more(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    with ready(trial, web, anna) as viewer, Viewer(web, web.pair("Fred")) as other:
        other.attend()
        viewer.stay(0.3, FORWARD)
        assert "Anna (page)" in {client.name for client in trial.robot.state.clients}
        viewer.send(drive=False)
        viewer.stay(0.2)
        viewer.send(attend=False)
        for _ in range(20):
            other.stay(0.1)
            if "Anna (page)" not in (names := {client.name for client in trial.robot.state.clients}):
                break
        assert "Anna (page)" not in names
        assert trial.robot.state.enabled


def test_it_is_off_unless_a_setting_says_otherwise(trial: Trial, tmp_path: Path) -> None:
    """Either setting turns it off: nobody drives from a page that proves nobody's presence."""
    for number, text in enumerate(('[attend]\nrequired = "on"\n[web]\n', '[web]\ndrive = "on"\n')):
        path = tmp_path / f"{number}.toml"
        path.write_text(f'{text}pairing = "on"\n')
        with Web(trial.name, "--config", str(path), state=str(tmp_path)) as other:
            headers = other.pair()
            me = json.loads(other.ask("GET", "/api/me", headers=headers)[2])
            assert (me["drive"], me["lacks"]) == (False, UNATTENDED_DRIVE if number else "")
            with Viewer(other, headers) as viewer:
                viewer.attend()
                assert other.post("/api/limit", {"percent": 100}, headers)[0] == 200
                trial.board.events()
                viewer.stay(0.3, FORWARD)
                assert motion(trial) == 0
                assert told(viewer)[-1] == driving.OFF
