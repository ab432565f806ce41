"""Scenarios: what programs and the world do in a simulated run, before the faults of the campaign."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from failstop_lab.boards.traits import HAS_ARM, HAS_DRIVERS, HAS_KEYS, HAS_REPORTS, HAS_WHEEL_REPORTS, Traits
from failstop_lab.simulate.guard_driver import Guarded
from failstop_lab.simulate.stage import (
    ATTENDED,
    FROM_THE_START,
    INTERLOCKED,
    NEEDS,
    OPERATOR_MS,
    SENSOR_MS,
    SETTINGS,
    Continuation,
    Stage,
)

Play = Callable[[Stage], object]
SCENARIOS: dict[str, Play] = {}
DRIVEN: dict[str, Continuation] = {}
"""The scenarios that all begin with driving(), by name: what each does then, with the program that drives."""
JOINTS = {"base": (1, 500, 500), "shoulder": (2, 600, 540)}
"""Servo, pulses of the tuck pose and of the drive pose."""
SLOW_MPS = 0.01
UNASKED_S = 4.6
"""So long wheels turn unasked: longer than it takes to disable motion, and to latch a stop, at any board."""
LOOKS = 25
"""For so many ticks a process is killed as soon as it is there, which is more often than it is restarted."""
JOINT_KEYS = ("servo", "tuck", "drive")
ARM_SETTINGS: dict[str, object] = {
    f"joints.{name}.{key}": value for name, row in JOINTS.items() for key, value in zip(JOINT_KEYS, row, strict=True)
}


def scenario(
    play: Play, name: str = "", told: str = "", settings: dict[str, object] | None = None, needs: tuple[str, ...] = ()
) -> Play:
    """Declare one. `needs`: what a board must have for it (lab/boards/traits.py)."""
    SCENARIOS[name or play.__name__] = play
    play.__doc__ = told or play.__doc__
    if settings:
        SETTINGS[play] = settings
    NEEDS[play] = frozenset(needs)
    return play


def scenarios_of(traits: Traits) -> list[str]:
    """The names of those that a board can have."""
    return [name for name, play in SCENARIOS.items() if NEEDS[play] <= traits.parts]


def driving(stage: Stage, seconds: float = 0.04) -> Any:
    """A program that has enabled motion, and has driven for so long."""
    robot = stage.connect()
    stage.enable(robot)
    stage.drive(robot, seconds)
    return robot


def driven(rest: Continuation, name: str = "", told: str = "", needs: tuple[str, ...] = ()) -> Continuation:
    """Declare a scenario that begins by driving(), with the settings of most: a fault before its rest is tried for all
    of them at once (single_faults.py)."""

    def play(stage: Stage) -> None:
        robot = driving(stage)
        stage.branch(rest)(stage, robot)

    name = name or rest.__name__
    scenario(play, name, told or rest.__doc__ or "", needs=needs)
    DRIVEN[name] = rest
    return rest


@scenario
def drive_and_stop(stage: Stage) -> None:
    """Enable, drive, stop, reset, enable, drive, disable."""
    robot = driving(stage, 0.06)
    stage.stop(robot)
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.disable(robot)
    robot.close()


FROM_THE_START.add(drive_and_stop)


@driven
def drive(stage: Stage, robot: Any) -> None:
    """Drive, and nothing else: what stops it is the fault alone, or the end of the program."""
    stage.drive(robot, 0.16)
    robot.close()


def _death(name: str) -> Continuation:
    def rest(stage: Stage, robot: Any) -> None:
        stage.kill(name)
        stage.drive(robot, 0.04)

    return rest


def _silence(name: str, ms: int) -> Continuation:
    def rest(stage: Stage, robot: Any) -> None:
        stage.freeze(name, ms)
        stage.drive(robot, ms / 1000 + 0.04)

    return rest


for _name in ("supervisor", "port_owner", "gate", "telemetry", "stopper"):
    driven(_death(_name), f"{_name}_dies", f"The {_name.replace('_', ' ')} is killed while it drives.")
for _name, _ms in {"supervisor": 120, "port_owner": 160, "gate": 120, "telemetry": 560, "stopper": 320}.items():
    driven(_silence(_name, _ms), f"{_name}_hangs", f"The {_name.replace('_', ' ')} is silent for {_ms} ms.")


@driven
def port_owner_and_supervisor_hang(stage: Stage, robot: Any) -> None:
    """Both are silent, and the stopper is the one that notices."""
    stage.hold_again("supervisor", 60, 640)
    stage.freeze("port_owner", 700)
    stage.drive(robot, 0.9)


@driven
def stopper_dies_while_telemetry_hangs(stage: Stage, robot: Any) -> None:
    """The supervisor asks whether anything moves, since telemetry is silent, just when it has raised the epoch."""
    stage.freeze("telemetry", 300)
    stage.drive(robot, 0.2)
    stage.kill("stopper")
    stage.drive(robot, 0.04)


@driven
def stopper_alone_runs(stage: Stage, robot: Any) -> None:
    """Nothing but the stopper runs for a while; supervisor and gate wake before the port owner, and judge nobody."""
    for name in ("supervisor", "gate"):
        stage.hold_again(name, 70, 187)
    stage.freeze("port_owner", 260)
    stage.drive(robot, 0.4)


@scenario
def port_owner_starves_and_hangs(stage: Stage) -> None:
    """Nothing may move, and the machine does not run the port owner, which is spared for that; then it hangs."""
    stage.connect()
    stage.freeze("port_owner", 200, starved=True)
    stage.time.sleep(0.15)
    stage.freeze("port_owner", 200)
    stage.time.sleep(0.3)


@driven
def port_owner_hangs_shortly(stage: Stage, robot: Any) -> None:
    """The port owner is silent for hardly longer than the supervisor waits."""
    stage.freeze("port_owner", 112)
    stage.drive(robot, 0.2)


@scenario
def port_owner_held_in_its_write(stage: Stage) -> None:
    """It is past its checks when telemetry dies; a program goes on more slowly as soon as it may."""
    robot = driving(stage, 0.1)
    stage.hold_in_write("port_owner", 76)
    stage.drive(robot, 0.02)
    stage.kill("telemetry")
    robot.wait_for("latched", 1.0)
    stage.enable(robot)
    stage.drive(robot, 0.06, SLOW_MPS)


def _die_once(stage: Stage, robot: Any) -> None:
    """The next death of the port owner is the one after which it stays down; another process may still die."""
    stage.kill("port_owner")
    robot.wait_for("latched", 1.0)


def _stays_down(stage: Stage) -> None:
    """The port owner dies and is not started again; the board is unplugged meanwhile, and is back."""
    robot = stage.connect()
    _die_once(stage, robot)
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.unplug()
    stage.kill("port_owner")
    stage.time.sleep(0.03)
    stage.replug()
    stage.time.sleep(0.1)


def _hangs_and_stays_down(stage: Stage) -> None:
    """The port owner is silent, and not started again after it was killed for that."""
    robot = stage.connect()
    _die_once(stage, robot)
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.freeze("port_owner", 160)
    stage.drive(robot, 0.2)


for _play in (_stays_down, _hangs_and_stays_down):
    scenario(_play, f"port_owner{_play.__name__}", settings={"restart.deaths": 2})


def _telemetry_dies_often(stage: Stage) -> None:
    """Telemetry is killed until it is not restarted any more, then people reset."""
    robot = stage.connect()
    for _ in range(LOOKS):
        stage.kill("telemetry")
        stage.time.sleep(0.02)
    robot.reset()


scenario(_telemetry_dies_often, "telemetry_dies_often", settings={"restart.deaths": 3})


@driven
def replug(stage: Stage, robot: Any) -> None:
    """The board is unplugged while it drives, and is back."""
    stage.unplug()
    stage.time.sleep(0.03)
    stage.replug()
    stage.time.sleep(0.03)


@driven
def port_does_not_drain(stage: Stage, robot: Any) -> None:
    """The port keeps what is written to it, then passes it on."""
    stage.block_port()
    stage.drive(robot, 0.2)
    stage.free_port()
    stage.time.sleep(0.03)


@driven
def reset_races_stop(stage: Stage, robot: Any) -> None:
    """A reset is under way when another stop is asked for."""
    stage.stop(robot)
    stage.time.sleep(0.1)
    robot.reset()
    stage.stop(robot, "again")
    stage.enable(robot)
    stage.drive(robot, 0.04, SLOW_MPS)
    robot.close()


@scenario
def two_programs(stage: Stage) -> None:
    """A second program commands under the same source; then one commands what is no number."""
    robot, other = stage.connect(), stage.connect()
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.compete(robot, other, robot)
    robot.wait_for("latched", 1.0)
    other.close()
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.disturb_command(robot)
    robot.wait_for("latched", 1.0)


def _key(stage: Stage, robot: Any) -> None:
    stage.press(1)
    robot.wait_for("latched", 1.0)


driven(_key, "key", "A key of the board is pressed while it drives.", needs=(HAS_KEYS,))


@driven
def stop_pipe(stage: Stage, robot: Any) -> None:
    """Somebody's bytes come to the stop pipe."""
    stage.write_to_pipe(b"x")
    robot.wait_for("latched", 1.0)


def _driver_dies(stage: Stage) -> None:
    """A program that drives dies, and that is to latch a stop."""
    robot = stage.connect()
    stage.enable(robot)
    driver = stage.start_driver(1.0)
    stage.kill_driver(driver)
    robot.wait_for("latched", 1.0)


scenario(_driver_dies, "driver_dies", settings={"gate.driver_death": "latch"})


@scenario
def another_commands_after_a_death(stage: Stage) -> None:
    """A program that drives dies, which disables motion; another one commands then."""
    robot = stage.connect()
    stage.enable(robot)
    driver = stage.start_driver(1.0)
    stage.kill_driver(driver)
    stage.drive(robot, 0.1)


@driven
def supervisor_suspended(stage: Stage, robot: Any) -> None:
    """The supervisor is suspended by a signal, and goes on."""
    stage.suspend("supervisor", 150)
    stage.drive(robot, 0.2)


@driven
def pipe_is_removed(stage: Stage, robot: Any) -> None:
    """Somebody takes the stop pipe away: the service ends, and a new one is started."""
    stage.remove_pipe()
    stage.drive(robot, 1.2)


@driven
def board_falls_silent(stage: Stage, robot: Any) -> None:
    """The board does not hear any more while it drives; motion is disabled, and it hears again."""
    stage.deafen()
    stage.drive(robot, 1.3)
    stage.disable(robot)
    stage.time.sleep(0.4)
    stage.hear_again()
    stage.time.sleep(0.35)


@driven
def commands_after_a_disable(stage: Stage, robot: Any) -> None:
    """A program disables motion, and goes on commanding."""
    stage.disable(robot)
    stage.drive(robot, 0.1)


@driven
def commands_more_than_the_limit(stage: Stage, robot: Any) -> None:
    """A program commands a speed far beyond the limit, for long enough to come to it by the ramp."""
    stage.drive(robot, 0.6, 5.0)


@driven
def memory_is_damaged(stage: Stage, robot: Any) -> None:
    """A command that nobody gave comes into the memory of the program that drives, again and again."""
    for _ in range(4):
        stage.drive(robot, 0.02)
        stage.damage_command(robot)
        stage.time.sleep(0.05)


@driven
def sensor_falls_silent(stage: Stage, robot: Any) -> None:
    """The obstacle sensor delivers nothing any more, while a program goes on commanding."""
    stage.lose("the obstacle sensor", SENSOR_MS)
    stage.drive(robot, 0.7, sensed=False)


def _operator_is_lost(stage: Stage) -> None:
    """The operator who must attend is not heard any more, while a program goes on commanding."""
    robot = stage.connect()
    stage.enable(robot)
    stage.lose("the operator", OPERATOR_MS)
    stage.drive(robot, 1.2)


def _interlock_is_lost(stage: Stage) -> None:
    """Nobody asserts the interlock any more, while a program goes on commanding."""
    robot = stage.connect()
    stage.enable(robot)
    stage.lose("the interlock", SENSOR_MS)
    stage.drive(robot, 0.7)


scenario(_operator_is_lost, "operator_is_lost", settings=ATTENDED)
scenario(_interlock_is_lost, "interlock_is_lost", settings=INTERLOCKED)


def _board_restarts(stage: Stage, robot: Any) -> None:
    stage.drive(robot, 0.8)
    stage.restart_board(800)
    stage.drive(robot, 1.0)


driven(
    _board_restarts,
    "board_restarts",
    "The board starts again while it drives, as after a dip of its supply.",
    needs=(HAS_REPORTS,),
)


def _board_says_nothing(stage: Stage, robot: Any) -> None:
    stage.drive(robot, 0.0 if stage.traits.language.reports.every_ns else 2.0)
    stage.silence_board()
    stage.drive(robot, 1.3)


driven(
    _board_says_nothing,
    "board_says_nothing",
    "The board reports nothing any more while it drives.",
    needs=(HAS_REPORTS,),
)


def _wheel_runs_away(stage: Stage, robot: Any) -> None:
    stage.drive(robot, 0.8)
    stage.run_away(5.0)
    stage.drive(robot, 2.2)


driven(
    _wheel_runs_away,
    "wheel_runs_away",
    "A wheel turns five times as fast as it is told, and the board reports it.",
    needs=(HAS_WHEEL_REPORTS,),
)


def _wheels_turn_unasked(stage: Stage, robot: Any) -> None:
    """The program sends zero for so long that its last command is over, then nothing."""
    robot.drive(0.0, 0.0, 0.0)
    stage.time.sleep(0.7)
    stage.push(0.4)
    stage.time.sleep(UNASKED_S)
    stage.push(0.0)
    stage.enable_unseen(robot)
    stage.drive(robot, 0.2)


driven(
    _wheels_turn_unasked,
    "wheels_turn_unasked",
    "Wheels turn although they are told to stop while motion is enabled, until a stop is latched for it.",
    needs=(HAS_WHEEL_REPORTS,),
)


@driven
def reports_lie(stage: Stage, robot: Any) -> None:
    """The board says that its wheels stand while they turn, and that they turn while they stand: no stop depends on
    it."""
    stage.lie(0.0)
    stage.drive(robot, 0.1)
    stage.stop(robot)
    stage.lie(1.0, 0.4)
    stage.time.sleep(0.2)
    stage.enable(robot)
    stage.drive(robot, 0.1)
    stage.disable(robot)
    stage.lie(1.0)


@driven
def reports_are_late(stage: Stage, robot: Any) -> None:
    """What the board says arrives a quarter of a second late: no stop waits for it."""
    stage.delay_reports(250)
    stage.drive(robot, 0.3)
    stage.stop(robot)
    stage.enable(robot)
    stage.drive(robot, 0.1)
    stage.disable(robot)
    stage.delay_reports(0)


@driven
def commands_through_an_enable(stage: Stage, robot: Any) -> None:
    """A program goes on commanding while motion is enabled: it drives only after a zero, or a pause."""
    stage.stop(robot)
    stage.reset(robot)
    stage.drive(robot, 0.04)
    stage.enable_for(robot)
    stage.drive(robot, 0.1)
    stage.enable(robot)
    stage.drive(robot, 0.04)
    robot.close()


@driven
def machine_sleeps(stage: Stage, robot: Any) -> None:
    """The machine sleeps while it drives."""
    stage.sleep_machine(20.0)
    stage.drive(robot, 0.04)


@driven
def service_ends(stage: Stage, robot: Any) -> None:
    """The service is told to end while it drives."""
    stage.end_service()


def _at_the_guard_port(stage: Stage) -> Guarded:
    """A driver of the bare board drives through the guard."""
    robot = stage.connect()
    stage.enable(robot)
    guarded = Guarded(stage, robot)
    guarded.moves()
    return guarded


def _guard_driver_dies(stage: Stage) -> None:
    """A driver at the guard port is killed, and started again at once."""
    guarded = _at_the_guard_port(stage)
    guarded.kill_driver()
    guarded.start_driver()
    guarded.watch(0.5)


def _guard_driver_hangs(stage: Stage) -> None:
    """A driver at the guard port is silent, and dies of it."""
    guarded = _at_the_guard_port(stage)
    guarded.hold(guarded.driver, 900)
    guarded.watch(0.5)
    guarded.kill_driver()
    guarded.watch(0.1)


def _guard_dies(stage: Stage) -> None:
    """The guard is killed while its driver writes on."""
    guarded = _at_the_guard_port(stage)
    guarded.kill_guard()
    guarded.watch(0.4)


def _guard_hangs_and_its_driver_dies(stage: Stage) -> None:
    """The guard is silent while its driver writes on and dies: what waits to be read then moves nothing."""
    guarded = _at_the_guard_port(stage)
    guarded.hold(guarded.guard, 500)
    guarded.watch(0.4)
    guarded.kill_driver()
    guarded.watch(0.5)


def _guard_driver_goes_on_behind_a_stop(stage: Stage) -> None:
    """A stop is asked for, reset, and motion disabled, while the driver at the guard port never ceases to command."""
    guarded = _at_the_guard_port(stage)
    stage.stop(guarded.robot)
    guarded.watch(0.1)
    stage.reset(guarded.robot)
    guarded.watch(0.1)
    stage.enable(guarded.robot)
    guarded.watch(0.1)
    stage.disable(guarded.robot)
    guarded.watch(0.1)


for _play in (
    *(_guard_driver_dies, _guard_driver_hangs, _guard_dies, _guard_hangs_and_its_driver_dies),
    _guard_driver_goes_on_behind_a_stop,
):
    scenario(_play, _play.__name__[1:], needs=(HAS_DRIVERS,))


def _arm_to_drive_pose(stage: Stage) -> None:
    """The arm goes to its drive pose, then the wheels turn; a stop; the arm is streamed to, and held."""
    robot = stage.connect()
    robot.wait_for("ready", 3.0)
    robot.arm.pose("drive")
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.stop(robot)
    stage.reset(robot)
    for step in range(4):
        robot.arm.follow({"base": 0.02 * step})
        stage.time.sleep(0.02)
    robot.arm.hold()


scenario(_arm_to_drive_pose, "arm_to_drive_pose", settings=ARM_SETTINGS, needs=(HAS_ARM,))
