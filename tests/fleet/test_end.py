"""The end of a robot's publisher: the broker is told, whatever is on its way, or says the last will."""

from __future__ import annotations

import json
import signal
import threading

import pytest

from failstop.fleet import topics

from .conftest import Enrol, fleet_name
from .scene import Listener, Mosquitto, Robot, pump

LONG_ENOUGH_S = 0.3
"""A publisher that waits for nobody has ended by then."""
ENDS_S = 30.0


def told(listener: Listener) -> list[str]:
    """The words on the robot's connection, the oldest first."""
    return [json.loads(payload)["connection"] for topic, payload in listener.all if topic.endswith("/connection")]


@pytest.fixture
def ending(enrol: Enrol, listener: Listener) -> Robot:
    publisher = enrol()
    pump("online", lambda: told(listener) == ["online"], publisher, listener)
    return publisher


def ended_before_a_slow_broker(broker: Mosquitto, end: threading.Thread) -> None:
    """The broker reads what there is after the publisher has waited."""
    end.start()
    end.join(LONG_ENOUGH_S)
    broker.signal(signal.SIGCONT)
    end.join(ENDS_S)
    assert not end.is_alive()


@pytest.mark.parametrize("coming", ["nothing", "stops", "an answer"])
def test_a_robot_that_ended_in_order_is_offline_and_stays_it(
    coming: str, ending: Robot, listener: Listener, broker: Mosquitto, request: pytest.FixtureRequest
) -> None:
    """Bytes for a connection that is closed already would make it lost."""
    broker.signal(signal.SIGSTOP)
    if coming == "stops":
        for _ in range(2):
            listener.broker.say(topics.stop(fleet_name(request)), b"nobody's")
    elif coming == "an answer":
        ending.broker.client.subscribe("more")
    ended_before_a_slow_broker(broker, threading.Thread(target=ending.close))
    after = Listener(broker.settings(), next(topic for topic in listener.last if topic.endswith("/connection")))
    pump("what the broker keeps", lambda: told(after), after, listener)
    after.broker.close()
    assert (told(listener), told(after)) == (["online", "offline"], ["offline"])


def test_a_connection_that_is_closed_is_not_lost(ending: Robot, listener: Listener, broker: Mosquitto) -> None:
    broker.signal(signal.SIGSTOP)
    for _ in range(3):
        ending.broker.client.subscribe("more")
    ended_before_a_slow_broker(broker, threading.Thread(target=ending.broker.close))
    listener.broker.say(next(iter(listener.last)), b'{"connection": "the end of the test"}')
    pump("the last word", lambda: told(listener)[-1] == "the end of the test", listener)
    assert told(listener) == ["online", "the end of the test"]


def test_a_robot_whose_broker_confirms_nothing_is_lost(
    ending: Robot, listener: Listener, broker: Mosquitto, capsys: pytest.CaptureFixture[str]
) -> None:
    broker.signal(signal.SIGSTOP)
    ending.close()
    assert "did not confirm that this robot signed off, so it shows it as lost" in capsys.readouterr().err
    broker.signal(signal.SIGCONT)
    pump("the last will", lambda: told(listener)[-1] == "lost", listener)


def test_a_robot_that_ends_without_a_connection_makes_one(ending: Robot, listener: Listener, broker: Mosquitto) -> None:
    broker.kill()
    pump("the loss", lambda: ending.broker.problem, ending)
    broker.start()
    listener.all.clear()
    ending.close()
    pump("offline", lambda: told(listener), listener)
    assert told(listener) == ["offline"]
