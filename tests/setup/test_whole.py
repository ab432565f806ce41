"""A robot of each kind, from nothing to a proved robot by the conversation alone; the simulated board is the judge."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop import config
from failstop.policy.settings import mounted_wheels
from failstop_lab.sim.client import SimBoard
from tests.setup.person import Person, Wiring
from tests.support.amounts import LONG

MOST_ANSWERS = 25
PROOFS = 3
ONE = {0: "rear-"}
TWO = {0: "left+", 1: "right-"}
THREE = {0: "rear-", 1: "left+", 2: "right+"}
FOUR = {0: "rr-", 1: "fl+", 2: "fr-", 3: "rl+"}
LEFT = ("left", "fl", "rl")
ROBOTS = {
    "ugv": ("ugv", "ugv-rover", TWO),
    "rrc": ("rrc", "rosorin", FOUR),
    "tracks": ("rrc", "landerpi-tracks", FOUR),
    "arduino": ("arduino", "", TWO),
    "hoverboard": ("hoverboard", "", TWO),
    "feetech": ("feetech", "other", THREE),
    "lekiwi": ("feetech", "lekiwi", THREE),
    "vesc": ("vesc", "other", TWO),
    "roboracer": ("vesc", "roboracer", ONE),
    "damiao": ("damiao", "other", TWO),
    "openarm-base": ("damiao", "openarm-base", FOUR),
}
"""Each: the kind of board, the robot's name where there are names for it, how it is wired."""
MECANUM = ("rrc", "openarm-base")
LONG_BASE = (*MECANUM, "roboracer")
LEFTWARD = {1: "Do the steered wheels point to the left?", 3: "Did all three turn"}
AXLES = "Distance between the front and the rear axle"
UNNAMED = ("", "other", "openarm-base")
"""Robots whose sizes nobody knows."""
IN_SHORT = ("ugv",)
"""Without the proof, which takes most of the time and has tests of its own."""


def proved(person: Person) -> None:
    """The proof, once more where the machine was too busy to judge it."""
    for _ in range(PROOFS):
        person.says('Type "spin"', "spin")
        person.reads(" skipped")
        if "INVALID" not in person.reads("This result covers only what was tested here"):
            return
        person.says("Run it again?", "")
    pytest.skip("the machine is too busy")


def unproved(person: Person) -> None:
    """The proof is left out, and the settings are written all the same."""
    person.reads("You skipped the stand test, so nothing is proved yet.")


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS if LONG else IN_SHORT)
def test_a_robot_is_set_up_and_proved_by_the_conversation_alone(robot: str, place: Path) -> None:
    kind, name, wheels = ROBOTS[robot]
    named = [wheel[:-1] for wheel in wheels.values()]
    port = str(place / "b")
    motors = len(wheels) if kind == "damiao" else 0
    with (
        SimBoard(port, board=kind, motors=motors) as board,
        Person(place, *([] if LONG else ["--prove", "no"])) as person,
    ):
        person.says("Which port is the board at?", port)
        person.reads(f"({kind})")
        if name:
            listed = person.reads("Which number is your robot?")
            person.types(listed.split(f" {name} ")[0].split()[-1])
        if name == "other":
            person.says("What kind of drive does it have?", "omni3" if wheels is THREE else "differential")
        person.says("Type yes:", "yes")
        if kind in ("arduino", "vesc"):
            person.reads("How many turns did it make?")
            board.turn_by_hand(len(wheels) - 1, -2.0)
            person.types("2")
        wiring = Wiring(board, wheels)
        for id_ in wheels:
            person.reads(f"Id {id_}: which wheel turned, and which way?")
            person.types(wiring.seen())
        person.reads("and the rear one stand?" if wheels is THREE else "Did every wheel turn forward?")
        assert wiring.together() == ({"left": -1, "right": 1} if wheels is THREE else dict.fromkeys(named, 1))
        person.types("yes")
        person.reads(LEFTWARD.get(len(wheels), "Did the left wheels turn backward"))
        assert wiring.together() == {name: -1 if name in LEFT and wheels is not THREE else 1 for name in named}
        person.types("yes")
        across = (
            "Distance of each wheel from the middle" if wheels is THREE else "Distance between the left and the right"
        )
        for question in ("Wheel diameter", across, "Highest speed forward", "Highest turn rate"):
            measured = {"Wheel diameter": "0.08", across: "0.15", AXLES: "0.15"} if name in UNNAMED else {}
            if question == "Distance between the left and the right" and robot in LONG_BASE:
                person.says(AXLES, measured.get(AXLES, ""))
            if question == "Highest turn rate" and (robot in MECANUM or wheels is THREE):
                person.says("Highest speed sideways", "")
            person.says(question, measured.get(question, ""))
        (proved if LONG else unproved)(person)
        person.says("Which file should they be written to?", "")
        person.reads("Next")
        assert person.ends() == 0
        assert not any(board.wheels())
    assert person.answers < MOST_ANSWERS
    assert not person.wide(80)
    made = config.load(str(place / "etc/failstop/failstop.toml"))
    words = {1: ("rear",), 2: ("left", "right"), 3: ("left", "rear", "right"), 4: ("fl", "rl", "fr", "rr")}[len(wheels)]
    found = {
        id_: f"{words[at]}{'+' if sign > 0 else '-'}" for at, (id_, sign) in enumerate(mounted_wheels(made.values))
    }
    assert found == wheels
    assert not (place / "state/setup.json").exists()
