"""Service: the guard as a client of the service. The guard occupies a client slot under the driver's name, and reads
the bytes that the board has sent.

If the service ends, the guard waits until the service is started again. The driver does not notice, but its commands
move nothing until then.
"""

from __future__ import annotations

import contextlib

from failstop.api.client import Client, attach, gone
from failstop.api.errors import FailstopError, NoService
from failstop.api.robot import judge
from failstop.api.snapshot import Block
from failstop.api.state import StateReader
from failstop.board import kinds
from failstop.guard.scale import Scale
from failstop.messages import layout, records
from failstop.policy.settings import FIRST_SOURCE, Settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.driver import DriverFrame
    from failstop.guard.talk import Command

AGAIN_NS = 500_000_000
"""How often the guard looks for the service while it is not running."""
SOURCE = "guard"
"""The name of the source under which the guard sends the driver's commands. If the settings have no source with this
name, the guard uses the source cmd_vel."""


class Service:
    """The guard's connection to the service. It connects again after the service was restarted."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.note = ""
        """Why the service is not running, or why the guard has no client slot. Empty if the service runs and the guard
        has a slot."""
        self.settings: Settings | None = None
        """The settings of the service's newest run, which may have ended. None until the guard has found a run."""
        self.runs = 0
        """How many runs of the service the guard has found."""
        self._reader: StateReader | None = None
        self._client: Client | None = None
        self._who: tuple[str, int | None] | None = None
        self._tried_ns = -AGAIN_NS

    def look(self, now_ns: int) -> bool:
        """If the guard has no running service, look for one, at most once every AGAIN_NS. If the guard has no client
        slot, try to get one. Returns True if the service is running."""
        if self._reader and self._reader.over():
            self._drop()
        if self._reader is None and now_ns - self._tried_ns >= AGAIN_NS:
            self._tried_ns = now_ns
            try:
                reader = StateReader(self.name)
                if reader.over():  # it has died a moment ago, and its memory still exists
                    raise gone(self.name)
                settings = Settings(dict(reader.settings()))
                views = [attach(self.name, which, reader.found) for which in (layout.TELEMETRY, layout.PORT_OWNER)]
            except FailstopError as error:
                self.note = str(error)
            else:
                self._reader, self.settings, self.note = reader, settings, ""
                self._received = [view.ring_reader("received") for view in views]
                self.runs += 1
                self.source = SOURCE if SOURCE in settings.sources() else FIRST_SOURCE
                board = kinds.board_of(*settings.board())
                self.scale = Scale(settings, board.per_rps, board.step_rps, assumed=board.scale_assumed)
        if self._reader and self._client is None and self._who and now_ns - self._tried_ns >= AGAIN_NS // 10:
            self._tried_ns = now_ns
            self._connect()
        return self._reader is not None

    def _drop(self) -> None:
        self._reader = None
        self.note = f"the service {self.name!r} has ended; the guard waits until it is started again"
        self._leave(in_order=True)

    def _connect(self) -> None:
        assert self._who
        try:
            self._client = Client(self.name, self._who[0], pid=self._who[1])
            self.note = ""
        except FailstopError as error:
            if self._reader and self._reader.over():
                self._drop()
            else:
                self.note = str(error)

    def join(self, who: str, pid: int | None) -> None:
        """Send all further commands in the name of the program `who`. `pid`: its pid, or None for the guard itself and
        for a driver whose pid is not known."""
        self.leave(in_order=True)
        self._who = who, pid
        if self._reader:
            self._connect()

    def rename(self, who: str, pid: int | None) -> None:
        """Show another name and pid for the further commands. The client stays the same, so the driving goes on."""
        self._who = who, pid
        if self._client:
            with contextlib.suppress(FailstopError):
                self._client.rename(who, pid)

    def leave(self, *, in_order: bool) -> None:
        """Stop sending commands in the driver's name. `in_order`: False if the driver ended or died while it was
        driving. The service then follows the setting gate.driver_death."""
        self._who = None
        self._leave(in_order=in_order)

    def _leave(self, *, in_order: bool) -> None:
        client, self._client = self._client, None
        if client:
            client.close(in_order=in_order)

    def command(self, command: Command) -> tuple[str, str]:
        """Pass a motion command to the service. Returns what Scale.beyond() says about the command."""
        if self._client is None:
            return "", ""
        velocity = self.scale.velocity(command.speeds, command.steering_rad)
        try:
            flags = records.GUARDED | (records.STANDS_IN if command.stands_in else 0)
            self._client.command(*velocity, manual=False, source=self.source, t_ns=command.t_ns, flags=flags)
        except NoService:
            self._drop()
            return "", ""
        return self.scale.beyond(velocity)

    def forward(self, frame: DriverFrame) -> None:
        """Pass one of the driver's frames that is not motion to the service. The service decides whether the board gets
        it."""
        if self._client:
            with contextlib.suppress(FailstopError):
                self._client.write("aux", frame.data, wake=True)

    def say(self, sees: str, wrong: str) -> None:
        """Report to people how the driver is doing. `sees`: what the guard sees. `wrong`: what is wrong; empty if
        nothing is."""
        if self._client:
            with contextlib.suppress(FailstopError):
                self._client.write("said", sees, wrong)

    def block(self) -> Block | None:
        """Why the wheels may not turn, or None if they may. Without a service, the answer is Block.DISABLED."""
        if self._reader is None:
            return Block.DISABLED
        decided, cause, *_ = self._reader.decided()
        answer = judge(decided, self.source, cause)[0]
        return getattr(answer, "block", None)

    def heard(self) -> list[tuple[int, bytes]]:
        """The board's bytes since the previous call, as (when they came in CLOCK_MONOTONIC ns, the bytes)."""
        found = []
        for ring in self._received if self._reader else ():
            while entry := ring.next():
                found.append((entry[1], bytes(entry[2])))
        return found
