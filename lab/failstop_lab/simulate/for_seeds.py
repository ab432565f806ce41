"""Scenarios for seeds alone: they are about the order in which shared memory is seen, and every single fault at each of
their calls would show nothing that those of scenarios.py do not."""

from __future__ import annotations

from failstop.messages import records
from failstop_lab.boards.traits import HAS_ARM, Traits
from failstop_lab.simulate.scenarios import ARM_SETTINGS, SCENARIOS, Play, driving
from failstop_lab.simulate.stage import NEEDS, SETTINGS, SPEED_MPS, Stage

FOR_SEEDS: dict[str, Play] = {}
LOOKS, ASKS, RESETS, BREATHS, FALLS_SILENT = 40, 20, 6, 4, 6
STREAMED = 10
CROWD = 3
"""So many programs ask at once."""


def play_of(name: str) -> Play:
    """The scenario of that name, of these or of all others."""
    return SCENARIOS.get(name) or FOR_SEEDS[name]


def for_seeds_of(traits: Traits) -> list[str]:
    """The names of those that a board can have."""
    return [name for name, play in FOR_SEEDS.items() if NEEDS[play] <= traits.parts]


def for_seeds(play: Play) -> Play:
    """Declare one that any board can have."""
    FOR_SEEDS[play.__name__] = play
    NEEDS[play] = frozenset()
    return play


@for_seeds
def stop_stays(stage: Stage) -> None:
    """A stop stays for a while, while a program looks at the robot, and asks for a stop again and again: so the
    supervisor looks at what telemetry says."""
    robot = driving(stage)
    stage.stop(robot)
    for _ in range(LOOKS):
        robot.state  # noqa: B018
        robot.estop("again")
        stage.time.sleep(0.01)


@for_seeds
def crowd(stage: Stage) -> None:
    """The gate is held up for a moment, in which each of several programs asks for something: it has several remarks at
    once then, while stops that are asked for have the supervisor look for remarks."""
    robots = [stage.connect() for _ in range(CROWD)]
    for _ in range(CROWD):
        stage.freeze("gate", 30)
        for number, robot in enumerate(robots):
            robot._client().write("speed_limit", 100 - number)
            robot._client().ask(records.LIMIT)
        stage.time.sleep(0.026)
        for _ in range(10):
            robots[0].estop("again")
            stage.time.sleep(0.003)
    for robot in robots:
        robot.close()


@for_seeds
def asks_and_looks(stage: Stage) -> None:
    """A program asks for one thing after another, and looks at the state as soon as it has its answer."""
    robot = stage.connect()
    for step in range(ASKS):
        robot.limit_speed(1 - step / 100)
        robot.state  # noqa: B018


@for_seeds
def resets(stage: Stage) -> None:
    """Stops and resets, one after another."""
    robot = driving(stage)
    for _ in range(RESETS):
        stage.stop(robot)
        stage.reset(robot)


@for_seeds
def silence(stage: Stage) -> None:
    """A program falls silent while it drives, again and again, and drives on: each time the wheels stop by themselves,
    wherever the board's own loop is."""
    robot = driving(stage)
    for times in range(FALLS_SILENT):
        stage.drive(robot, 0.06 + 0.003 * times)
        stage.time.sleep(0.45)


@for_seeds
def stops_in_one_breath(stage: Stage) -> None:
    """A program commands, and asks for a stop in the same breath: the gate is in the middle of its turn then."""
    robot = driving(stage)
    for _ in range(BREATHS):
        robot.sensed()
        robot.drive(SPEED_MPS, 0.0, 0.0)
        stage.stop(robot)
        stage.time.sleep(0.02)
        stage.enable(robot)
        stage.drive(robot, 0.02)


@for_seeds
def two_fall_silent(stage: Stage) -> None:
    """Telemetry hangs, and the stopper is starved: the supervisor notices both in one turn, and has just raised the
    epoch for the one when it asks for the other whether anything moves."""
    robot = driving(stage, 0.09)
    stage.freeze("telemetry", 700)
    stage.hold_again("stopper", 270, 400, starved=True)
    stage.hold_again("supervisor", 476, 20)
    stage.drive(robot, 0.44)
    stage.time.sleep(0.01)  # between two of the gate's own frames
    for step in range(6):  # a frame with each: one speed is told again after 200 ms alone
        stage.drive(robot, 0.02, SPEED_MPS / (1 + step % 2))


def _starves_again(name: str, ms: int) -> None:
    def play(stage: Stage) -> None:
        robot = stage.connect()
        robot.wait_for("ready", stage.ready_s)
        left_ms = ms - round(1000 * robot.state.processes["port_owner"].age_s)
        stage.freeze("port_owner", left_ms, starved=True)
        stage.hold_as_it_moves(140)
        stage.time.sleep(max(0, left_ms - 20) / 1000)
        for step in range(STREAMED):  # whenever it goes on, there is a frame that is young
            robot.arm.follow({"base": 0.02 * (step % 2)})
            stage.time.sleep(0.004)
        stage.time.sleep(0.05)

    play.__doc__ = f"The port owner is starved until {ms} ms after a beat, and again as it moves the arm."
    FOR_SEEDS[name] = play
    SETTINGS[play], NEEDS[play] = ARM_SETTINGS, frozenset((HAS_ARM,))


_starves_again("starves_again", 96)
_starves_again("starves_longer", 246)
