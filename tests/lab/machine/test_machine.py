"""The simulated machine: it runs what ships, tells nothing of the machine that it runs on, and is the same for the same
seed."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest

from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import traits_of
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import HARMLESS, SHARED_MODULES, Loader
from failstop_lab.machine.robot import Robot
from failstop_lab.simulate.control_runs import BOTH
from failstop_lab.simulate.controls import Mutant
from failstop_lab.simulate.for_seeds import FOR_SEEDS, play_of
from failstop_lab.simulate.scenarios import driving, scenarios_of
from failstop_lab.simulate.stage import Stage
from tests.support import rooms

SHELL_OF_ITS_OWN = {"failstop.shm.futex", "failstop.procs.rights", "failstop.procs.starved"}
"""Modules that a stand-in replaces: they speak with the kernel below Python."""
TRACE = """\
import zlib
from failstop_lab.simulate.scenarios import SCENARIOS
from failstop_lab.simulate.stage import Stage
from tests.support import rooms
stage, trace = Stage(SCENARIOS["replug"]), []
stage.machine.at_seam = lambda thread, call, about: trace.append((stage.machine.now_ns, thread.number, call))
stage.run()
print(zlib.crc32(repr((trace, stage.witness.story)).encode()), len(trace))
"""


def names() -> list[str]:
    return [rooms.name_of(path) for room in (*rooms.CORE, "api") for path in rooms.modules(room)]


def test_every_module_of_the_core_loads_on_it() -> None:
    loader = Loader(Machine())
    loaded = {name: loader.load(name) for name in names()}
    assert len(loaded) > 90
    real = sys.modules["os"], sys.modules["time"], sys.modules["select"]
    for name, module in loaded.items():
        assert not [value for value in vars(module).values() if any(value is each for each in real)], name


def test_modules_that_machines_share_ask_none() -> None:
    """None of their lines may import a module that each machine has of its own."""
    paths = {name: path for path in rooms.package() if (name := rooms.name_of(path)) in SHARED_MODULES}
    assert paths.keys() == SHARED_MODULES
    found: set[str] = set()
    for node, types in (each for path in paths.values() for each in rooms.imports(path)):
        above = [] if isinstance(node, ast.Import) else [node.module or ""]
        names = [".".join([*above, name.name]) for name in node.names]
        found |= set() if types else {*above, *names}
    rooms_of = {"failstop", *(f"failstop.{room}" for room in ("board", "board.rrc", "messages", "policy"))}
    # The settings ask kinds.py only for facts, and facts_of() imports nothing but the facts.py of a board.
    facts = {"failstop.board.kinds", "failstop.board.kinds.ALL_KINDS", "failstop.board.kinds.facts_of"}
    own = found - SHARED_MODULES - rooms_of - facts
    own = {name for name in own if name.rpartition(".")[0] not in SHARED_MODULES}
    assert {name for name in own if name.partition(".")[0] not in HARMLESS} == set()


def test_what_is_not_simulated_is_not_there() -> None:
    loader = Loader(Machine())
    with pytest.raises(ImportError, match="no subprocess"):
        loader._import("subprocess")
    with pytest.raises(AttributeError):
        loader.system["os"].fork()


def test_each_scenario_is_right_without_a_fault() -> None:
    wrong = {
        name: stage.witness.violations
        for name in (*scenarios_of(traits_of(BOARDS[0])), *FOR_SEEDS)
        if (stage := played(name)).witness.violations
    }
    assert wrong == {}


def played(name: str) -> Stage:
    stage = Stage(play_of(name), weak=name in FOR_SEEDS)
    stage.run()
    return stage


def test_one_seed_is_one_trace_whatever_the_hashes_are() -> None:
    told = {
        subprocess.run(
            [sys.executable, "-c", TRACE],
            env={"PYTHONHASHSEED": seed, "PATH": ""},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(told) == 1
    assert int(told.pop().split()[1]) > 1000


def test_a_new_robot_in_the_place_of_a_freed_one_is_a_new_one() -> None:
    """Where Python puts an object is chance, so nothing of a run may depend on it."""
    in_its_place: list[bool] = []
    stopped_first: list[tuple[float, ...]] = []

    def play(stage: Stage) -> None:
        while not any(in_its_place) and len(in_its_place) < 50:
            robot = stage.connect()
            stage.enable(robot)
            stage.drive(robot, 0.1)
            place = id(robot)
            del robot
            robot = stage.connect()
            in_its_place.append(id(robot) == place)
            robot.drive = lambda *velocity: stopped_first.append(velocity)
            stage.enable(robot)
            del robot

    Stage(play).run()
    assert in_its_place[-1], "none lay in the place of another, so this proves nothing"
    assert stopped_first == []


def test_stamps_are_of_the_simulated_clock() -> None:
    """Every record of the black box carries a time between the machine's start and now."""
    robot = Robot()
    began_ns = robot.machine.now_ns
    robot.start()
    robot.machine.run(lambda: False, 2_000_000_000)
    segment = robot.loader.load("failstop.messages.segments")
    stamps: list[int] = []

    def look(failstop: object) -> None:
        client = robot.loader.load("failstop.api.client")
        memory, _ = client.run("failstop")
        for name in ("supervisor", "port_owner", "gate", "telemetry"):
            ring = segment.attach(memory, name).ring_reader("box", from_oldest=True)
            while entry := ring.next():
                stamps.append(entry[1])

    process = robot.program("look.py", look)
    robot.machine.run(lambda: process.dead, 1_000_000_000)
    assert len(stamps) > 20
    assert all(began_ns <= stamp <= robot.machine.now_ns for stamp in stamps)


@pytest.mark.parametrize("control", BOTH, ids=lambda control: control.row)
def test_a_control_is_of_a_scenario_and_changes_source_that_is_there_once(control: Mutant) -> None:
    assert play_of(control.scenario)
    loader, names = Loader(Machine(), control.patches), {name for name, _, _ in control.patches}
    assert names
    assert all(map(loader.load, names))


def test_a_start_beside_a_port_owner_that_is_held_is_refused_and_a_later_one_drives() -> None:
    """It has stopped for the supervisor's death, so nobody fences it, and holds the port longer than a start waits."""

    def play(stage: Stage) -> None:
        driving(stage)
        stage.kill("supervisor")
        stage.time.sleep(0.001)
        stage.freeze("port_owner", 1_125, starved=True)
        stage.time.sleep(1.3)

    stage = Stage(play)
    stage.run()
    assert stage.witness.violations == []
    assert "'failstop' is already running" in stage.robot.said
    assert sum("supervisor" in text and "starts" in text for _, text in stage.witness.story) == 3
