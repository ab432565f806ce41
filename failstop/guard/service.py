"""Service: the guard as a client of the service. The guard has a client slot under the driver's name, and reads what
the board has sent.

If the service ends, the guard looks for the next run of it. The driver does not notice this, but meanwhile its commands
move nothing.
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
from failstop.messages import layout
from failstop.policy.settings import FIRST_SOURCE, Settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.guard.talk import Command

AGAIN_NS = 500_000_000
"""How often to look for the service while it is not running."""
SOURCE = "guard"
"""The source of the driver's commands if the settings have a source with this name. Otherwise the source is cmd_vel."""


class Service:
    """The service that currently runs, or the wait for the next one."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.note = ""
        """Why there is no service or no client slot at the moment. Empty if both exist."""
        self.settings: Settings | None = None
        """The settings of the current run, or of the last run if none is running. None until a run was found."""
        self.runs = 0
        """How many runs of the service have been found."""
        self._reader: StateReader | None = None
        self._client: Client | None = None
        self._who: tuple[str, int | None] | None = None
        self._tried_ns = -AGAIN_NS

    def look(self, now_ns: int) -> bool:
        """True if the service is running. If it is not, this looks for it, at most every AGAIN_NS."""
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
        """From now on, command in the name of this program. `pid`: None if it is the guard itself."""
        self.leave(in_order=True)
        self._who = who, pid
        if self._reader:
            self._connect()

    def leave(self, *, in_order: bool) -> None:
        """Stop commanding in the name of the program. `in_order`: False if it died or ended while it drove. The service
        then acts as the setting gate.driver_death says."""
        self._who = None
        self._leave(in_order=in_order)

    def _leave(self, *, in_order: bool) -> None:
        client, self._client = self._client, None
        if client:
            client.close(in_order=in_order)

    def command(self, command: Command) -> str:
        """Pass a command to the service. Returns a text if the command is beyond the limits, otherwise an empty
        text."""
        if self._client is None:
            return ""
        velocity = self.scale.velocity(command.speeds, command.steering_rad)
        try:
            self._client.command(*velocity, manual=False, source=self.source, t_ns=command.t_ns)
        except NoService:
            self._drop()
            return ""
        return self.scale.beyond(velocity)

    def forward(self, frame: bytes) -> None:
        """Pass a frame for the board that is not motion to the service. The service decides whether it is sent."""
        if self._client:
            with contextlib.suppress(FailstopError):
                self._client.write("aux", frame, wake=True)

    def say(self, sees: str, wrong: str) -> None:
        """Report to people how the driver is doing. `sees`: what the guard sees. `wrong`: what is wrong, or empty."""
        if self._client:
            with contextlib.suppress(FailstopError):
                self._client.write("said", sees, wrong)

    def block(self) -> Block | None:
        """Why the wheels may not turn, or None if they may."""
        if self._reader is None:
            return Block.DISABLED
        decided, cause, *_ = self._reader.decided()
        answer = judge(decided, self.source, cause)[0]
        return getattr(answer, "block", None)

    def heard(self) -> list[tuple[int, bytes]]:
        """What the board has sent since the last call, as (when it came, the bytes)."""
        found = []
        for ring in self._received if self._reader else ():
            while entry := ring.next():
                found.append((entry[1], bytes(entry[2])))
        return found
