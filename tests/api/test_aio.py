"""The Robot in an event loop."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time

import pytest

from failstop import AsyncRobot, Block, Driving, Refused, Robot, TimedOut
from failstop_lab.trial import Trial


def test_a_robot_in_an_event_loop(trial: Trial) -> None:
    async def drives() -> None:
        async with Robot.connect(trial.name) as robot:
            await robot.wait_for("ready", 5.0)
            assert await robot.enable() == "motion enabled"
            robot.sensed()
            until_s = time.monotonic() + 5.0
            while not isinstance(robot.drive(0.1, 0.0, 0.0, manual=True), Driving):
                assert time.monotonic() < until_s
            assert (await robot.wait_for("moving", 5.0)).moving
            assert await robot.disable() == "motion disabled"

    asyncio.run(drives())
    assert not trial.robot.state.enabled


def test_a_driver_that_is_cancelled_because_another_task_failed_has_not_ended_cleanly(trial: Trial) -> None:
    """Motion that somebody else enabled stays enabled after a clean end, so that the program would drive off again."""

    async def drives(begun: asyncio.Event) -> None:
        async with Robot.connect(trial.name, disable_on_exit=False) as robot:
            while True:
                robot.sensed()
                state = robot.state
                robot.drive(0.1 if state.enabled else 0.0, 0.0, 0.0)
                if state.moving:
                    begun.set()
                await asyncio.sleep(0.02)

    async def fails() -> None:
        begun = asyncio.Event()
        driver = asyncio.create_task(drives(begun))
        await asyncio.sleep(0)
        await asyncio.to_thread(trial.robot.wait_for, "ready", 5.0)
        await asyncio.to_thread(trial.robot.enable)
        await asyncio.wait_for(begun.wait(), 5.0)
        driver.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await driver

    asyncio.run(fails())
    assert not trial.robot.wait_for("disabled", 5.0).enabled
    assert trial.robot.state.cause is None


@pytest.mark.parametrize(
    ("raised", "clean"),
    [
        (None, True),
        (KeyboardInterrupt(), True),
        (SystemExit(), True),
        (SystemExit(0), True),
        (SystemExit(1), False),
        (SystemExit("camera lost"), False),
        (asyncio.CancelledError(), False),
        (GeneratorExit(), False),
        (RuntimeError(), False),
    ],
)
def test_which_ends_are_clean(raised: BaseException | None, clean: bool) -> None:
    ends: list[bool] = []
    robot = Robot.__new__(Robot)
    robot._close = lambda *, in_order: ends.append(in_order)  # type: ignore[method-assign]
    robot.__exit__(type(raised) if raised else None, raised, None)
    assert ends == [clean]


def test_events_and_requests_of_several_tasks(trial: Trial) -> None:
    async def stop_is_told() -> list[str]:
        async with Robot.connect(trial.name) as robot:
            events = robot.events()
            asker = asyncio.create_task(_ask(robot))
            found: list[str] = []
            async for event in events:
                found.append(event.kind)
                if event.kind == "stop":
                    break
            await asker
            return found

    found = asyncio.run(stop_is_told())
    assert found[-1] == "stop"
    # What lasts for less than the supervisor's next look is no event; others come of what the machine does meanwhile.
    asked = ["enabled", "disabled", "enabled", "stop"]
    happened = iter(asked)
    assert all(kind in happened for kind in found if kind in asked), found


def test_what_takes_no_await_goes_before_a_task_that_waits_for_its_answer(trial: Trial) -> None:
    """The end of the Robot is such a call: it would wait for a task that can't go on meanwhile."""

    async def end() -> None:
        robot = Robot.connect(trial.name)
        await robot.enable()
        robot._pending = (threading.get_ident(), object())
        robot.close()

    asyncio.run(end())
    assert not trial.robot.state.enabled


def test_the_speed_is_limited_by_either(trial: Trial) -> None:
    async def limit() -> None:
        async with Robot.connect(trial.name) as robot:
            assert await robot.limit_speed(0.4) == "speed limited to 40 % of the settings'"
            assert robot.state.speed_limit == 0.4
            assert await robot.limit_speed(1) == "speed limit lifted"
            for wrong in (0.0, -1.0, 1.01, float("nan")):
                with pytest.raises(ValueError, match="speed limit"):
                    await robot.limit_speed(wrong)
            with pytest.raises(Refused, match="must be 5 to 100"):
                await robot.limit_speed(0.01)

    asyncio.run(limit())


def test_nothing_that_holds_the_wheels_makes_the_loop_wait(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer of drive comes from what is known, whatever holds the wheels; nor does the end of `async with`
    sleep."""

    def asleep(_: float) -> None:
        raise AssertionError("a thread that runs an event loop sleeps")

    async def drives() -> list[Block | None]:
        found: list[Block | None] = []

        async def holds(block: Block | None, *, manual: bool = False) -> None:
            until_s = time.monotonic() + 10.0
            while (state := robot.state).block is not block or (block is None and not state.moving):
                assert time.monotonic() < until_s
                # It has commanded all the time, so behind an enable it must send zero once.
                robot.drive(0.0 if state.block is Block.HELD else 0.1, 0.0, 0.0, manual=manual)
                await asyncio.sleep(0)
            answer = robot.drive(0.1, 0.0, 0.0, manual=manual)
            found.append(None if answer else getattr(answer, "block", None))

        async with Robot.connect(trial.name) as robot:
            await holds(Block.DISABLED)
            await robot.enable()
            await holds(Block.NO_SCAN)
            await holds(None, manual=True)
            robot.estop("enough")
            await holds(Block.LATCHED)
            await robot.reset()
            await robot.enable()
        return found

    monkeypatch.setattr(time, "sleep", asleep)
    assert asyncio.run(drives()) == [Block.DISABLED, Block.NO_SCAN, None, Block.LATCHED]
    monkeypatch.undo()
    assert not trial.robot.state.enabled


@pytest.mark.parametrize("fails", [False, True])
def test_a_gate_that_is_silent_does_not_make_the_loop_wait_at_the_end(
    trial: Trial, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    slept: list[float] = []
    turns = 0

    async def counts() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async def drives() -> None:
        nonlocal turns
        async with Robot.connect(trial.name, answer_s=0.2) as robot:
            await robot.enable()
            counting = asyncio.create_task(counts())
            monkeypatch.setattr("failstop.api.client.Client.answer", lambda *_: None)
            monkeypatch.setattr(time, "sleep", slept.append)
            if fails:
                raise KeyError("of the program")
        counting.cancel()

    with pytest.raises(KeyError) if fails else contextlib.nullcontext():
        asyncio.run(drives())
    monkeypatch.undo()
    assert slept == []
    assert turns > 10
    trial.robot.disable()


async def _ask(robot: AsyncRobot) -> None:
    await asyncio.gather(robot.enable(), robot.disable(), robot.enable())
    robot.estop("enough")
    await robot.wait_for("latched", 5.0)
    with pytest.raises(Refused):
        await robot.enable()


def test_the_loop_goes_on_while_one_waits(trial: Trial) -> None:
    async def waits() -> int:
        turns = 0
        async with Robot.connect(trial.name) as robot:
            waiting = asyncio.create_task(robot.wait_for("latched", 10.0))
            while not waiting.done():
                await asyncio.sleep(0)
                turns += 1
                if turns == 1000:
                    robot.estop("seen")
            assert "seen" in ((await waiting).estop or "")
            with pytest.raises(TimedOut):
                await robot.wait_for("clear", 0.0)
        return turns

    assert asyncio.run(waits()) > 1000
