"""The two websockets: STOP by one of its own, and holds that the robot measures."""

from __future__ import annotations

import json
import os
import socket
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest

from failstop.files import instance
from failstop.web import connections, control, hold, page, stopping
from failstop.web.handlers import Guarded
from failstop.web.limits import Limit
from failstop.web.stopping import WRITTEN_S
from failstop_lab.trial import Trial, wait_for
from tests.support.waiting import STORY_S
from tests.web.parts import Web
from tests.web.viewer import Viewer

IDLE = connections.MOST + 5
STOPS = "/api/stop/live"
EQUAL_S = 0.15
DEEP = "[" * 4000
TOO_LARGE = "1" + "0" * 3000
POLL_S = 0.2
"""Between two looks at what is being made: each takes time from the process that makes it."""
SETTINGS = '[web]\npairing = "on"\n'


@pytest.fixture(scope="module")
def anna(web: Web) -> dict[str, str]:
    return web.pair()


@pytest.fixture
def latched(trial: Trial) -> Trial:
    trial.robot.estop("a test")
    wait_for("the latch", lambda: trial.robot.state.estop)
    return trial


def said(viewer: Viewer, text: str) -> None:
    """A message as it stands."""

    async def say() -> None:
        await viewer.connection.write_message(text)

    viewer.loop.run_until_complete(say())


def said_of(viewer: Viewer, identity: str) -> object:
    """The robot's word on a hold."""
    while (found := viewer.next()).get("hold") != identity or "said" not in found:
        pass
    return found["said"]


def test_a_stop_is_answered_by_the_way_that_it_came(trial: Trial, web: Web) -> None:
    before = trial.robot.state.epoch
    with Viewer(web, path=STOPS) as stopping:
        stopping.send(stop="a")
        found = stopping.next()
        assert (found["id"], found["written"], found["view"]["latched"]) == ("a", True, True)
        assert trial.robot.state.epoch == before + 1
        stopping.send(stop="a")
        assert stopping.next()["written"], "the same stop, asked for again"
        assert trial.robot.state.epoch == before + 1


def test_a_stop_reaches_the_service_that_was_started_anew_under_an_open_page() -> None:
    """The page holds the pipe of the run before open, which leads to nobody, or to a process that has not ended yet."""
    with ExitStack() as stack:
        own = stack.enter_context(Trial(f"web-anew-{os.getpid()}"))
        stopping = stack.enter_context(Viewer(stack.enter_context(Web(own.name)), path=STOPS))
        for run in range(3):
            if run == 1:
                pipe = os.open(instance.stop_path(instance.find(own.name)), os.O_RDONLY | os.O_NONBLOCK)
                stack.callback(os.close, pipe)
            if run:
                own.service.end()
                own.service.start()
            before = own.robot.state.epoch
            stopping.send(stop=f"run {run}")
            assert stopping.next()["written"]
            wait_for("the latch", lambda: own.robot.state.estop)
            assert own.robot.state.epoch > before


def test_all_tries_of_one_touch_have_the_time_of_the_first_that_was_sent() -> None:
    """The page compares it with the time of the stop, which may be that of a try whose answer was lost."""
    sent: list[str] = []

    def send(who: str) -> None:
        sent.append(who)
        until_s = time.monotonic() + 2 * EQUAL_S
        while time.monotonic() < until_s:
            pass

    asked = stopping.Asked(SimpleNamespace(send=send))  # type: ignore[arg-type]
    first, again, other = (asked.ask("Anna", identity) for identity in ("a", "a-1", "b"))
    assert len(sent) == 3
    assert again.asked_ns > first.asked_ns
    assert again.unix_s == pytest.approx(first.unix_s, abs=EQUAL_S)
    assert other.unix_s > first.unix_s + EQUAL_S


def test_a_stop_with_the_same_id_is_sent_again_after_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody's own program may always send the same one."""
    sent: list[str] = []
    now_ns = [10**12]
    monkeypatch.setattr(stopping, "time", SimpleNamespace(time=time.time, monotonic_ns=lambda: now_ns[0]))
    asked = stopping.Asked(SimpleNamespace(send=sent.append))  # type: ignore[arg-type]
    first = asked.ask("hmi", "x")
    now_ns[0] += stopping.KNOWN_NS - 1
    assert asked.ask("hmi", "x").asked_ns == first.asked_ns
    assert len(sent) == 1
    now_ns[0] += 1
    again = asked.ask("hmi", "x")
    assert (len(sent), again.asked_ns) == (2, now_ns[0])
    assert again.unix_s == pytest.approx(time.time(), abs=5), "it is a press of its own"


def test_a_device_that_was_revoked_stops_in_its_own_name_no_more(trial: Trial, web: Web) -> None:
    """It may stop as everybody may, also by a connection from before."""
    with Viewer(web, web.pair("Dora"), path=STOPS) as viewer:
        listed = control.ask(web.name, web.environment, "GET", "/devices")["devices"]
        (identity,) = [each["id"] for each in listed if each["name"] == "Dora"]
        control.ask(web.name, web.environment, "POST", "/devices", {"id": identity})
        viewer.send(stop="by a stranger")
        assert viewer.next()["written"]
        wait_for("the latch", lambda: trial.robot.state.estop)
        assert "page at 127.0.0.1" in str(trial.robot.state.estop)
    trial.robot.reset()


def test_a_page_learns_how_old_a_message_may_be(web: Web) -> None:
    with Viewer(web) as viewer:
        assert "asked" not in viewer.next()
        for wrong in (True, -1, "1", 1e300, [1], None):
            viewer.send(asked=wrong)
        viewer.send(asked=4711)
        while "asked" not in (found := viewer.next()):
            pass
        number, passed_ms = found["asked"]
        assert (number, passed_ms >= 0) == (4711, True)
        until_s = time.monotonic() + 10
        while viewer.next()["asked"][1] < passed_ms + 200:
            assert time.monotonic() < until_s
        viewer.send(asked=4712)
        while viewer.next()["asked"][0] != 4712:
            assert time.monotonic() < until_s


def test_idle_connections_of_one_address_close_no_websocket(trial: Trial, web: Web) -> None:
    with ExitStack() as stack:
        viewer = stack.enter_context(Viewer(web))
        stopping = stack.enter_context(Viewer(web, path=STOPS))
        for _ in range(IDLE):
            stack.enter_context(socket.create_connection(("127.0.0.1", web.port), timeout=5))
        assert web.post("/api/stop")[1]["written"], "the newest connection is let in"
        for _ in range(20):
            viewer.next()
        stopping.send(stop="b")
        assert stopping.next()["written"]


def test_there_is_an_end_to_the_connections_for_stop_and_the_newest_has_one(trial: Trial, web: Web) -> None:
    with ExitStack() as stack:
        first = stack.enter_context(Viewer(web, path=STOPS))
        for _ in range(page.MOST_STOPS):
            newest = stack.enter_context(Viewer(web, path=STOPS))
        with pytest.raises(ConnectionError):
            first.next()
        newest.send(stop="c")
        assert newest.next()["written"]


def test_a_hold_resets_and_another_enables(latched: Trial, web: Web, anna: dict[str, str]) -> None:
    with Viewer(web, anna) as viewer:
        since_s = time.monotonic()
        found = viewer.hold("reset")
        assert found["done"], found
        assert time.monotonic() - since_s >= hold.HOLD_S
        assert latched.robot.state.estop is None
        assert viewer.hold("enable")["said"] == "motion enabled"
        assert latched.robot.state.enabled
        latched.robot.disable()


def test_a_hold_that_is_let_go_does_nothing(latched: Trial, web: Web, anna: dict[str, str]) -> None:
    with Viewer(web, anna) as viewer:
        assert viewer.hold("reset", hold.HOLD_S - 0.3) == {}
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            assert "hold" not in viewer.next()
        assert latched.robot.state.estop


def test_no_page_can_ask_by_itself(latched: Trial, web: Web, anna: dict[str, str]) -> None:
    """No request does it, nor saying at once all that a hold says, nor saying nothing in between."""
    for verb in ("reset", "enable"):
        assert web.ask("POST", f"/api/{verb}", {}, {"X-Failstop": "1", **anna})[0] in (404, 405)
    with ExitStack() as stack:
        viewers = {verb: stack.enter_context(Viewer(web, anna)) for verb in ("reset", "enable", "limit")}
        epoch = latched.robot.state.epoch
        for verb, viewer in viewers.items():
            viewer.send(hold=verb, id="a", epoch=epoch, percent=50)
            for _ in range(40):
                viewer.send(held="a")
            viewer.send(sure="a")
            assert said_of(viewer, "a") == hold.LATE, verb
        for verb, viewer in viewers.items():
            viewer.send(hold=verb, id="b", epoch=epoch, percent=50)
        time.sleep(hold.HOLD_S + 0.1)
        for verb, viewer in viewers.items():
            viewer.send(held="b")
            assert said_of(viewer, "b") == hold.LATE, verb
        assert latched.robot.state.estop
        assert not latched.robot.state.enabled
        assert latched.robot.state.speed_limit == 1.0


def test_a_reset_that_is_held_while_another_stop_comes_clears_nothing(
    latched: Trial, web: Web, anna: dict[str, str]
) -> None:
    with Viewer(web, anna) as viewer:
        while not (epoch := viewer.epoch()):
            viewer.next()
        latched.robot.estop("another")
        wait_for("the stop", lambda: latched.robot.state.epoch > epoch)
        assert viewer.hold("reset", epoch=epoch) | {"t": 0, "hold": ""} == {
            "t": 0,
            "hold": "",
            "done": False,
            "said": hold.NEWER_STOP,
        }
        assert latched.robot.state.estop


def test_strangers_hold_nothing(latched: Trial, web: Web) -> None:
    with Viewer(web) as viewer:
        assert viewer.hold("reset")["said"] == "this device is not paired"
        assert latched.robot.state.estop


def test_a_limit_is_lowered_by_a_touch_and_raised_by_a_hold(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    assert web.post("/api/limit", {"percent": 25}, anna)[0] == 200
    assert web.post("/api/limit", {"percent": 50}, anna) == (
        409,
        {"error": "to raise the limit, hold its button on the page"},
    )
    assert trial.robot.state.speed_limit == 0.25
    with Viewer(web, anna) as viewer:
        assert viewer.hold("limit", percent=100)["done"]
    assert trial.robot.state.speed_limit == 1.0


def test_nonsense_fills_no_journal(trial: Trial, web: Web, journal: Path) -> None:
    """Nested too deeply, and numbers of no end."""
    before = journal.read_bytes()
    bert = web.pair("Bert")
    for text in (DEEP, f'{{"percent": {TOO_LARGE}}}', '{"percent": 1e400}', '{"id": "\\ud800"}'):
        for path in ("/api/stop", "/api/limit", "/api/pair", "/api/disable"):
            status = web.ask("POST", path, None, {"X-Failstop": "1", **bert}, raw=text.encode())[0]
            assert status in (200, 403, 409, 429), (path, text[:20])
    with Viewer(web, bert) as viewer, Viewer(web, path=STOPS) as stopping:
        for each in (viewer, stopping):
            for text in (DEEP, f'{{"hold": "limit", "id": 1, "epoch": {TOO_LARGE}}}', '{"stop": {"a": []}}'):
                said(each, text)
        assert viewer.next()
        stopping.send(stop="d")
        while stopping.next()["id"] != "d":
            pass
    assert journal.read_bytes() == before


def test_a_story_and_a_picture_are_not_waited_for(latched: Trial, web: Web) -> None:
    """Each that asks hears at once what there is, however many ask."""
    wait_for("a card", lambda: time.sleep(POLL_S) or web.get("/api/incidents")["incidents"], 30)
    identity = web.get("/api/incidents")["incidents"][0]["id"]
    found = [web.ask("GET", f"/api/incidents/{identity}/{what}") for what in ("story", "picture") for _ in range(8)]
    assert (found[0][0], found[8][0]) == (202, 202), "to draw one takes longer"
    assert json.loads(found[0][2]) == {"story": None, "picture": None}
    assert web.post("/api/stop")[1]["written"]

    def whole() -> bool:
        time.sleep(POLL_S)
        told = json.loads(web.ask("GET", f"/api/incidents/{identity}/story")[2])
        return bool(told.get("story")) and told["picture"] is True

    wait_for("the story and the picture", whole, STORY_S)
    drawn: list[tuple[int, dict[str, str], bytes]] = []

    def there() -> bool:
        time.sleep(POLL_S)
        drawn.append(web.ask("GET", f"/api/incidents/{identity}/picture"))
        return drawn[-1][0] != 429

    wait_for("another look to be let in", there)
    status, headers, content = drawn[-1]
    assert (status, headers["content-type"], content[:4]) == (200, "image/png", b"\x89PNG")


def test_stops_do_not_wait_for_each_other(trial: Trial, web: Web) -> None:
    """Each is answered after 0.3 s while the board is away: all of them are asked for before the first answer."""
    told = trial.service.written()
    with Viewer(web, path=STOPS) as stopping:
        trial.board.unplug()
        wait_for("the loss", lambda: "is gone" in trial.service.said(told))
        for number in range(6):
            stopping.send(stop=str(number))
        found = [stopping.next() for _ in range(6)]
        asked = [each["asked"] for each in found]
        assert max(asked) < min(asked) + WRITTEN_S
        assert [each["written"] for each in found] == [False] * 6
        assert found[-1]["view"]["latched"]
        trial.board.replug()


def test_a_defect_is_told_in_a_line_and_seldom(caplog: pytest.LogCaptureFixture) -> None:
    handler = Guarded.__new__(Guarded)
    handler.page = SimpleNamespace(defect_limit=Limit(0.001, 2))  # type: ignore[assignment]
    try:
        raise RuntimeError("a defect")
    except RuntimeError as error:
        for _ in range(100):
            handler.log_exception(type(error), error, error.__traceback__)
    assert len(caplog.messages) == 2
    assert "RuntimeError: a defect" in caplog.messages[0]
    assert "\n" not in caplog.messages[0]
