"""A broker for the tests that need one; a fleet's key; robots."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.fleet import signed

from .scene import LONG_AGO_S, MOSQUITTO, Listener, Mosquitto, Pretended, Robot, mosquitto, pump


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mosquitto]:
    if MOSQUITTO is None:
        pytest.skip("needs mosquitto: `make fleet` installs it")
    with mosquitto(tmp_path_factory.mktemp("broker")) as running:
        yield running


@pytest.fixture(scope="session")
def key(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("key") / "fleet.key"
    signed.make_key(str(path))
    return str(path)


Enrol = Callable[..., Robot]


@pytest.fixture
def enrol(broker: Mosquitto, key: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Enrol]:
    """Publish a pretended robot; its fleet is the test's, so that no test sees another's robots."""
    made: list[Robot] = []

    def publish(robot_id: str = "r1", robot: Pretended | None = None, **changed: object) -> Robot:
        settings = broker.settings(**{"stop__key_file": key, "robot__fleet": fleet_name(request), **changed})
        folder = tmp_path / robot_id
        folder.mkdir(exist_ok=True)
        publisher = Robot(settings, "failstop", robot or Pretended(), robot_id, str(folder))
        made.append(publisher)
        pump(f"{robot_id} to be connected", lambda: publisher.broker.listening, publisher)
        publisher.broker.up_s -= LONG_AGO_S
        return publisher

    yield publish
    for publisher in made:
        publisher.broker.close()


def fleet_name(request: pytest.FixtureRequest) -> str:
    """The name of a fleet that no other test uses."""
    return (
        "t-"
        + "".join(c if c.isalnum() else "-" for c in request.node.name)[:50]
        + f"-{abs(hash(request.node.nodeid)) % 10**6}"
    )


@pytest.fixture
def listener(broker: Mosquitto, request: pytest.FixtureRequest) -> Iterator[Listener]:
    """A listener that hears all that this test's robots say."""
    found = Listener(broker.settings(), f"failstop/v1/{fleet_name(request)}/#")
    pump("the listener to be connected", lambda: found.broker.listening, found)
    yield found
    found.broker.close()
