"""A client says what it sees: every place where people look shows it, and none of them depends on it."""

from __future__ import annotations

from failstop import Robot
from failstop.lab.trial import Trial, wait_for
from tests.support.commands import failstop


def test_words_of_a_client_reach_people(trial: Trial) -> None:
    with Robot(trial.name, client="eyes") as robot:
        robot.say("looks ahead", "nobody feeds the lidar")
        wait_for("its words", lambda: any(client.sees for client in robot.state.clients))
        client = next(client for client in robot.state.clients if client.name == "eyes")
        assert (client.sees, client.wrong) == ("looks ahead", "nobody feeds the lidar")
        assert client.said_s is not None
        assert 0 <= client.said_s < 5
        status, why, doctor = (
            " ".join(failstop(*words, "--name", trial.name).stdout.split())
            for words in (("status",), ("why",), ("doctor", "--quick"))
        )
        assert "says eyes: looks ahead" in status
        assert "eyes says: nobody feeds the lidar" in status
        assert "also eyes says: nobody feeds the lidar" in why
        assert "eyes says: nobody feeds the lidar" in doctor
        robot.say("looks ahead")
        wait_for("that it is well", lambda: not any(client.wrong for client in robot.state.clients))
    wait_for("that it has gone", lambda: not trial.robot.state.clients)
    events = failstop("events", "--name", trial.name, "--kind", "said").stdout
    said = [line.partition("says: ")[2] for line in events.splitlines()]
    assert said[:2] == ["nobody feeds the lidar", "looks ahead"]
    wait_for(
        "the last of it", lambda: "has gone" in failstop("events", "--name", trial.name, "--kind", "said").stdout, 5.0
    )
