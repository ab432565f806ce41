"""Misuses that a type checker refuses. `make lint` checks this file strictly: a misuse that it let pass would leave its
`type: ignore` unused, which is an error. Nothing here is run."""

from __future__ import annotations

from failstop import AsyncRobot, Block, Blocked, Driving, Preempted, Robot, State


def words(robot: Robot) -> None:
    robot.wait_for("stoped")  # type: ignore[arg-type]
    robot.wait_for(lambda state: state.velocity)  # type: ignore[attr-defined]
    robot.wait_for("latched", "2 s")  # type: ignore[arg-type]


def commands(robot: Robot) -> None:
    robot.drive(0.1, 0.0)  # type: ignore[call-arg]
    robot.drive("0.1", 0.0, 0.0)  # type: ignore[arg-type]
    robot.drive(0.1, 0.0, 0.0, True)  # type: ignore[call-arg]
    robot.drive((0.1, 0.0, 0.0))  # type: ignore[arg-type, call-arg]
    robot.assert_interlocks(["door"])  # type: ignore[arg-type]


def states(state: State) -> None:
    state.enabled = True  # type: ignore[misc]
    print(state.battery_mv)  # type: ignore[attr-defined]
    print(state.device["link"])  # type: ignore[index]
    print(state.odometry.x_m)  # type: ignore[union-attr]
    if state.block == "disabled":  # type: ignore[comparison-overlap]
        pass
    if state.device.link == "dead":  # type: ignore[comparison-overlap]
        pass


def answers(robot: Robot) -> str:
    """Every answer is met, so that something is returned."""
    match robot.drive(0.1, 0.0, 0.0):
        case Driving(velocity=velocity):
            return f"{velocity.vx_mps:.2f} m/s"
        case Preempted(by=who):
            return who
        case Blocked(block=Block.LATCHED, why=why):
            return why
        case Blocked():
            return "held"


def left_out(robot: Robot) -> str:  # type: ignore[return]
    match robot.drive(0.1, 0.0, 0.0):
        case Driving():
            return "drives"
        case Blocked():
            return "held"


async def not_awaited(robot: AsyncRobot) -> None:
    robot.enable()  # type: ignore[unused-coroutine]
    robot.wait_for("latched")  # type: ignore[unused-coroutine]
    await robot.drive(0.1, 0.0, 0.0)  # type: ignore[misc]
    for event in robot.events():  # type: ignore[attr-defined]
        print(event)
    async for event in robot.events():
        print(event.txt)  # type: ignore[attr-defined]
