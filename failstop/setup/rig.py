"""Rig: a service that runs during one step of the setup only, with the settings that setup has found so far.

Setup turns wheels only through this service, so everything that stops a robot also works during setup. To turn one
wheel, the rig uses settings and a velocity that move only this wheel. So the gate needs no special code for setup.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Mapping
from math import pi
from types import TracebackType

from failstop import config, helpers
from failstop.api.client import attach, send_stop
from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Blocked, Robot
from failstop.api.snapshot import Block, State
from failstop.board.interface import BY_WHEELS, HEARD_WHEELS
from failstop.board.kinds import board_of
from failstop.messages import layout
from failstop.policy import causes
from failstop.setup import leftovers
from failstop.setup.ending import end_with_parent, uninterrupted
from failstop.setup.halt import Halt
from failstop.setup.pace import Pace
from failstop.setup.talk import Left

RIG = "setup-"
"""The prefix of the service's name."""
READY_S = 15.0
GONE_S = 1.0
"""How long a port must be missing until it counts as unplugged, s. A port may also be missing for a moment while it is
being opened again."""
END_S = 5.0
STANDS_S = 5.0
REPEAT_S = 0.05
LEVER_M = 0.125
"""The distance from the robot's middle to each wheel, m. To turn only one of two wheels, the robot drives forward and
turns at the same time, so that the two motions cancel at the other wheel. The distance is a power of two, so that
multiplying by it rounds nothing. So the motions cancel exactly, also while the speeds ramp up and down."""
RAMP_MPS2 = 0.5
MOST_WORDS = 300
BLOCKED_S = 1.0
"""How long drive() keeps trying while its commands are blocked, s. On a busy machine, commands may still be blocked for
some time after the gate has answered enable()."""
OVERRIDES: dict[str, object] = {"battery.log": "off", "incidents.save": "off"}

Velocity = tuple[float, float, float]


def alone(kind: str, speeds: int, id_: int, rim_mps: float, diameter_m: float) -> tuple[dict[str, object], Velocity]:
    """Return settings and a velocity that turn only the wheel with the id `id_`. The motor turns in its own forward
    direction. The motor's wiring decides which way the wheel turns.

    `speeds` is the number of wheel speeds in a frame of the board. `rim_mps` is the speed of the wheel's rim. With more
    than two speeds, the settings are for a base with three wheels (omni3), so the board must be able to drive such a
    base.
    """
    base: dict[str, object] = {
        "board.kind": kind,
        "wheels.diameter_m": diameter_m,
        "limits.acceleration_mps2": RAMP_MPS2,
        "limits.acceleration_radps2": RAMP_MPS2 / LEVER_M,
    }
    if speeds == 1:
        base |= {"wheels.layout": "ackermann", "wheels.id_1": 0, "wheels.sign_1": 1, "limits.vx_mps": rim_mps}
        return base, (rim_mps, 0.0, 0.0)
    if speeds == 2:
        vx, wz = rim_mps / 2, rim_mps / 2 / LEVER_M
        base |= {"wheels.layout": "differential", "wheels.track_m": 2 * LEVER_M}
        base |= {"wheels.id_1": 0, "wheels.id_2": 1, "wheels.sign_1": 1, "wheels.sign_2": 1}
        base |= {"limits.vx_mps": vx, "limits.wz_radps": wz}
        return base, (vx, 0.0, -wz if id_ == 0 else wz)
    others = [other for other in range(speeds) if other != id_]
    base |= {"wheels.layout": "omni3", "wheels.lever_m": LEVER_M, "limits.vx_mps": rim_mps}
    for number, (wheel, way) in enumerate(zip((id_, *others[:2]), (0.0, 90.0, 90.0), strict=True), 1):
        base |= {f"wheels.id_{number}": wheel, f"wheels.sign_{number}": 1, f"wheels.angle_{number}_deg": way}
    return base, (rim_mps, 0.0, 0.0)


def rim_mps(rps: float, diameter_m: float) -> float:
    """Return the speed of a wheel's rim, m/s, at this many turns per second."""
    return rps * pi * diameter_m


def toml(values: Mapping[str, object]) -> str:
    """Return the text of a settings file with these values. Each line has the whole key, so that a person can add a
    line anywhere. All texts must be printable."""
    groups: dict[str, list[str]] = {}
    for key, value in values.items():
        groups.setdefault(key.rpartition(".")[0], []).append(f"{key} = {json.dumps(value)}\n")
    return "\n".join("".join(lines) for lines in groups.values())


class Rig:
    """A service for one step of the setup. Use it as a context manager, which always stops the wheels at the end.
    Raises Left if the wheels may still turn."""

    def __init__(self, device: str, values: Mapping[str, object], halt: Halt) -> None:
        """`device`: the board's port. `values`: the settings. `halt` stops the wheels after the service has ended.
        Raises SettingError."""
        self._values = {**values, **OVERRIDES}
        settings = config.checked(dict(self._values))
        self._board = board_of(*settings.board())
        self._hearing = self._board.hearing()
        self._device, self._halt = device, halt
        self.name = f"{RIG}{os.getpid()}"
        self._folder = ""
        self._process: subprocess.Popen[bytes] | None = None
        self._robot: Robot | None = None
        self._drove = False
        self.turned: dict[int, float] = {}
        """For each wheel id, the fastest speed that the board has reported, with its sign, in the board's unit. If the
        board reports only positions, the value is the direction in which the position has changed: 1, -1, or 0 for no
        change. Empty if the board reported nothing."""
        self.moved: dict[int, float] = {}
        """How far the position of each wheel id has changed, in the board's counts, without a sign. Empty if the board
        reports speeds, because positions are then ignored, or if the board reports nothing."""
        self.ratio = 0.0
        """The measured speed of the fastest wheel divided by the commanded speed, see Pace. 0.0 if the board does not
        measure speeds by a scale of its own."""
        self._pace: Pace | None = None

    def __enter__(self) -> Rig:
        try:
            self._start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        if self._drove and (known := self._halt.last) and (isinstance(error, Left) or not known.safe):
            raise Left(f"{error}; {known.sentence()}" if isinstance(error, Left) else known.sentence()) from error

    def _start(self) -> None:
        leftovers.remove_ended(RIG)
        self._folder = leftovers.folder(self.name)
        path = os.path.join(self._folder, "settings.toml")
        with open(path, "w", encoding="utf-8") as file:
            file.write(toml(self._values))
        words = ["run", "--name", self.name, "--device", self._device, "--config", path]
        with open(os.path.join(self._folder, "log"), "wb") as log:
            self._process = subprocess.Popen(
                helpers.python("failstop", *words),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, "STATE_DIRECTORY": self._folder},
                preexec_fn=end_with_parent,
                # Ctrl-C must reach setup only, which then ends this service cleanly.
                start_new_session=True,
            )
        refused = ""
        there_s = time.monotonic()
        until_s = there_s + READY_S + self._board.port.deaf_ns / 1e9
        while True:
            if there := os.path.exists(self._device):
                there_s = time.monotonic()
            elif time.monotonic() - there_s >= GONE_S:
                raise Left(f"{self._device} was unplugged before the wheels were turned: plug the board in again")
            if self._process.poll() is not None:
                if there:
                    raise Left(f"the service did not start: {self._said()}")
                # The service may have exited because the board was unplugged. Look again whether the port is gone.
                time.sleep(REPEAT_S)
                continue
            try:
                self._robot = self._robot or Robot(self.name, client="setup")
                state = self._robot.wait_for("ready", 0.2)
                if state.cause and state.cause.kind in causes.BY_SOMEBODY:
                    raise Left(f"somebody stopped the robot: {state.cause}")
                if state.cause:
                    self._robot.reset(seen=state.epoch)
                self._robot.enable()
                return
            except Refused as error:
                refused = error.reason
            except Left:
                raise
            except FailstopError:
                pass  # the service has not started yet, or is not ready
            if time.monotonic() > until_s:
                why = refused or self._why() or self._said()
                raise Left(f"the service was not ready within {READY_S:g} s: {why}")

    def drive(self, velocity: Velocity, seconds: float) -> None:
        """Drive at this velocity for `seconds`, then wait until the wheels are stopped. Raises Left if the robot can't
        drive, or if the wheels don't stop."""
        assert self._robot
        view = attach(self.name, layout.TELEMETRY).ring_reader("received")
        self._hearing.reset()
        self.turned, self.moved = {}, {}
        self._pace = Pace(self._board.reports) if self._board.reports.own_scale else None
        places: dict[int, list[float]] = {}
        blocked, began, moved_s = "", False, time.monotonic()
        self._drove = True
        until_s = moved_s + seconds
        try:
            while time.monotonic() < until_s:
                answer = self._robot.drive(*velocity, manual=True)
                blocked = answer.why if isinstance(answer, Blocked) else ""
                disabled = isinstance(answer, Blocked) and answer.block == Block.DISABLED
                if not blocked:
                    began, moved_s = True, time.monotonic()
                elif time.monotonic() - moved_s > BLOCKED_S or (disabled and began):
                    break  # somebody may have disabled motion on purpose
                elif disabled:
                    self._robot.enable()
                told_rps = self._told_rps()
                time.sleep(REPEAT_S)
                # After a pause in which the commands became too old, the wheels have been stopped.
                told_rps = min(told_rps, self._told_rps())
                for entry in iter(view.next, None):
                    self._hear(entry, told_rps, places)
        except (FailstopError, Refused) as error:
            blocked = str(error)
        if blocked:
            raise Left(f"the wheels stopped before the test was over: {self._why() or blocked}")
        self._stand()
        for entry in iter(view.next, None):
            self._hear(entry, 0.0, places)
        self.ratio = self._pace.ratio if self._pace else 0.0

    def _told_rps(self) -> float:
        """Return how fast the gate commands the fastest wheel to turn, in turns per second."""
        assert self._robot
        return max(map(abs, self._robot.state.wheels_radps), default=0.0) / (2 * pi)

    def _stand(self) -> None:
        """Stop the wheels. Wait until the board has acknowledged the stop and reports that the wheels are stopped. If
        the board can't do one of the two, don't wait for it. Raises Left.

        The wheels must still be driven, because a board without questions acknowledges only a stop that ends
        motion."""
        assert self._robot
        epoch = self._robot.state.epoch

        def stands(state: State) -> bool:
            stop = state.last_stop
            if stop is None or stop.epoch <= epoch:
                return False
            seen = stop.observed_s is not None or stop.observed_by != BY_WHEELS
            return seen and (stop.acknowledged_s is not None or not stop.acknowledged_by)

        try:
            self._robot.estop("setup: the wheels have turned")
            self._robot.wait_for(stands, STANDS_S)
        except FailstopError:
            raise Left(f"the board did not report within {STANDS_S:g} s that the wheels are stopped") from None

    def _hear(self, entry: tuple[int, int, bytes], told_rps: float, places: dict[int, list[float]]) -> None:
        _, t_ns, data = entry
        for kind, said in self._hearing.feed(data):
            if kind == HEARD_WHEELS:
                self._add(said, places)
                if self._pace:
                    speeds, positions = said
                    self._pace.add(speeds, positions, told_rps, t_ns)

    def _add(self, said: tuple[tuple[float, ...], tuple[float, ...]], places: dict[int, list[float]]) -> None:
        speeds, positions = said
        for id_, speed in enumerate(speeds):
            if abs(speed) >= abs(self.turned.get(id_, 0.0)):
                self.turned[id_] = speed
        for id_, place in enumerate(positions) if not speeds else ():
            places.setdefault(id_, []).append(place)
            way = place - places[id_][0]
            self.moved[id_] = abs(way)
            self.turned[id_] = float((way > 0) - (way < 0))

    def _why(self) -> str:
        """Return why the wheels are stopped, in a few words. Empty if the reason is not known."""
        with contextlib.suppress(FailstopError):
            if self._robot:
                state = self._robot.state
                return str(state.cause or state.waiting_for or state.blocked or "")
        return ""

    def _said(self) -> str:
        with contextlib.suppress(OSError), open(os.path.join(self._folder, "log"), errors="replace") as file:
            lines = [line.strip().removeprefix("failstop: ") for line in file.read().splitlines() if line.strip()]
            return lines[-1][:MOST_WORDS] if lines else ""
        return ""

    def close(self) -> None:
        """Stop the wheels through the service, and end the service. If the wheels were driven, then write a stop
        directly to the port."""
        with uninterrupted():
            self._end()

    def _end(self) -> None:
        if self._process:
            with contextlib.suppress(FailstopError):
                send_stop(self.name, "setup: the step is over")
            if self._robot:
                self._robot.close()
                self._robot = None
            self._process.terminate()
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None
            if self._drove:
                self._halt.now()
            leftovers.remove(self.name)
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = ""
