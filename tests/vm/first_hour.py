"""The trials of a robot's first hour: `failstop setup` at a terminal, and the probe, with the board on USB."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from failstop_lab.trial import TrialError, wait_for
from tests.support.terminal import Terminal
from tests.vm.scene import FAILSTOP, LINK, SETTINGS, UNIT, Scene, sh, wrong_unless
from tests.vm.table import Result

SAYS_S = 400.0
"""The guest takes ten seconds to start a command of failstop's, and a stand test has some twenty rows."""
TURNS_S = 60.0
LEAVES = "no settings were written; run `failstop setup` again to go on from here"
WIRES = {0: "rr-", 1: "fl+", 2: "fr-", 3: "rl+"}
"""The wheel at each id, and its motor's sign, for setup to find out."""
FORWARD = {name[:-1]: 1 for name in WIRES.values()}
TO_THE_LEFT = FORWARD | {"fl": -1, "rl": -1}
WHICH_FILE = "Which file should they be written to?"
SIZES = ("Wheel diameter", "Distance between the front and the rear", "Distance between the left and the right")
LIMITS = ("Highest speed forward", "Highest speed sideways", "Highest turn rate")
PULLED = 2
"""The id while whose wheel turns the plug is pulled."""
NEVER_S = 10.0
CARD = "/run/vm-card"


def person_at(*words: str) -> Terminal:
    """A failstop command at a terminal."""
    return Terminal(FAILSTOP, *words, patience_s=SAYS_S)


def turned(scene: Scene) -> dict[str, int]:
    """Of each wheel that has turned since the last look which way it did, as a person sees it: 1 is forward."""
    found: dict[str, int] = {}
    for event in scene.board.events():
        for id_, name in WIRES.items():
            if event.is_motion and (speed := event.speeds[id_]):
                found[name[:-1]] = 1 if (speed > 0) == (name[-1] == "+") else -1
    return found


def one(scene: Scene) -> str:
    """The answer to: which wheel turned, and which way?"""
    found = turned(scene)
    if len(found) != 1:
        raise TrialError(f"not one wheel alone has turned: {found}")
    ((name, way),) = found.items()
    return f"{name}{'+' if way > 0 else '-'}"


def setup(scene: Scene) -> Iterator[Result]:
    """Setup beside the running service names what stops it. A plug is pulled while a wheel turns, and setup goes on
    from there to a file that the service then drives by."""
    found = Result("setup")
    (package,) = Path("/srv").glob("failstop-lab_*.deb")
    code, said, _ = sh("dpkg", "--install", str(package), timeout_s=400.0)
    if code:
        raise TrialError(said[-300:])
    scene.whole()
    with person_at("setup", "--port", scene.node(), "--robot", "rosorin") as person:
        person.reads("sudo systemctl stop failstop.service")
        person.reads(LEAVES)
        wrong_unless(found, setup_ends_well_beside_the_service=person.ends() == 1)
    sh("systemctl", "stop", UNIT)
    start_s, answers = time.monotonic(), _until_the_pull(scene, found)
    # The plug has started the service, which has stopped the wheels.
    scene.node()
    wait_for("the wheels to stand", lambda: not any(scene.board.wheels()), TURNS_S)
    scene.whole()
    sh("systemctl", "stop", UNIT)
    answers += _to_the_end(scene, found)
    found.note += f"; {answers} answers in {time.monotonic() - start_s:.0f} s"
    made = Path(SETTINGS).read_text()
    wrong_unless(
        found,
        the_wheels_turn_at_the_end=not any(scene.board.wheels()),
        another_port_is_written=f'path = "{LINK}"' in made,
        another_robot_is_written="ROSOrin" in made,
    )
    try:
        sh("systemctl", "start", UNIT)
        scene.moving()
        scene.run(0.5)
        wrong_unless(found, it_does_not_drive_forward_by_it=turned(scene) == FORWARD)
    finally:
        os.replace(f"{SETTINGS}.old", SETTINGS)
        sh("systemctl", "restart", UNIT)
    yield found


def _until_the_pull(scene: Scene, found: Result) -> int:
    """To the wheel of id PULLED, while which the plug is pulled."""
    with person_at("setup", "--afresh", "--port", scene.node(), "--robot", "rosorin") as person:
        person.reads("(rrc)")
        scene.board.events()
        person.says("Type yes:", "yes")
        for id_ in range(PULLED):
            person.reads(f"Id {id_}: which wheel turned, and which way?")
            person.types(one(scene))
        scene.board.wait_wheels(True, TURNS_S)
        scene.board.unplug()
        said = person.reads(LEAVES)
        wrong_unless(
            found,
            it_leaves_well=person.ends() == 1,
            no_remedy_is_told="POWER SWITCH" in said,
            something_is_written=not Path(f"{SETTINGS}.old").exists(),
        )
        scene.board.replug()
        return person.answers


def _to_the_end(scene: Scene, found: Result) -> int:
    """Taken up again, to the settings."""
    with person_at("setup") as person:
        person.says("Go on with it?")
        scene.board.events()
        person.says("Type yes:", "yes")
        for id_ in range(PULLED, len(WIRES)):
            person.reads(f"Id {id_}: which wheel turned, and which way?")
            person.types(one(scene))
        person.reads("Did every wheel turn forward?")
        wrong_unless(found, not_all_forward=turned(scene) == FORWARD)
        person.types("yes")
        person.reads("Did the left wheels turn backward")
        wrong_unless(found, not_to_the_left=turned(scene) == TO_THE_LEFT)
        person.types("yes")
        for question in (*SIZES, *LIMITS):
            person.says(question)
        person.says('Type "spin"', "spin")
        said = person.reads("Run it again?", WHICH_FILE)
        found.note = "proved"
        if not said.endswith(WHICH_FILE):
            # The guest may be too slow for it.
            found.note = "the stand test: INVALID"
            wrong_unless(found, the_stand_test_fails="ended with INVALID" in said)
            person.types("no")
            person.says("anyway?", "yes")
            person.reads(WHICH_FILE)
        person.types()
        person.says("to replace it:", "replace")
        person.reads("Next")
        wrong_unless(found, it_fails_at_the_end=person.ends() == 0)
        return person.answers


def probe(scene: Scene) -> Iterator[Result]:
    """As on a robot without failstop: the plug starts no service."""
    found = Result("probe")
    sh("systemctl", "mask", "--runtime", "--now", UNIT)
    try:
        with person_at("probe", "serial", "--board", "rrc", "--port", scene.node(), "--yes", "--out", CARD) as person:
            person.reads("PULL THE BOARD'S PLUG NOW")
            events = scene.board.events()
            scene.board.unplug()
            person.reads("Plug it in again")
            pulled = scene.board.wheels()
            scene.board.replug()
            scene.node()
            wrong_unless(found, it_says_that_it_stops=person.ends() == 1)
        rows = json.loads(Path(f"{CARD}.json").read_text())["rows"]
        for row in rows[:-1]:
            since_ns = row["failed_at_monotonic_s"] * 1e9
            stop_ns = next((each.executed_ns for each in events if each.is_stop and each.executed_ns > since_ns), 0.0)
            if not row["never"] or stop_ns - since_ns < NEVER_S * 1e9:
                found.wrong.append(f"{row['row']}: {row['stands_s']}, really {(stop_ns - since_ns) / 1e9:.2f} s")
        wait_for("the wheels to stand", lambda: not any(scene.board.wheels()), TURNS_S)
        wrong_unless(found, the_plug_is_no_never=rows[-1]["never"] and any(pulled))
        found.note = f"{len(rows)} ways, by {rows[0]['judged_by']}: never"
    finally:
        sh("systemctl", "unmask", "--runtime", UNIT)
        sh("systemctl", "start", UNIT)
    yield found


DO: dict[str, Callable[[Scene], Iterator[Result]]] = {"setup": setup, "probe": probe}
