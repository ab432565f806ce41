"""A client says what it sees: every place where people look shows it, and none of them depends on it."""

from __future__ import annotations

from tests.support.simulated import Simulated


def test_words_of_a_client_reach_people(simulated: Simulated) -> None:
    with simulated.failstop.Robot(client="eyes") as robot:
        robot.say("looks ahead", "nobody feeds the lidar")
        simulated.wait_for("its words", lambda: any(client.sees for client in robot.state.clients))
        (client,) = (client for client in robot.state.clients if client.name == "eyes")
        assert (client.sees, client.wrong) == ("looks ahead", "nobody feeds the lidar")
        assert 0 <= client.said_s < 0.25, "looked at every ten periods, and at rest a period later"
        status, why = simulated.printed("status"), simulated.printed("why")
        assert "says eyes: looks ahead" in status
        assert "eyes says: nobody feeds the lidar" in status
        assert "also eyes says: nobody feeds the lidar" in why
        robot.say("looks ahead")
        simulated.wait_for("that it is well", lambda: not any(client.wrong for client in robot.state.clients))
    simulated.wait_for("that it has gone", lambda: "has gone" in simulated.printed("events", "--kind", "said"))
    assert simulated.robot.state.clients == ()
    _, told, _ = simulated.command("events", "--kind", "said")
    said = [line.partition("says: ")[2] for line in told.splitlines()]
    assert said[:2] == ["nobody feeds the lidar", "looks ahead"]
