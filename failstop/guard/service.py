"""Service: the guard's side of the service - a client slot under the driver's name, and what the board said.

A service that has gone is looked for again, and a driver notices nothing of that: its motion moves nothing meanwhile.
"""

from __future__ import annotations

import contextlib

from failstop.api.client import Client, attach
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
"""How often a service that is not there is looked for."""
SOURCE = "guard"
"""Commands are given as this source where the settings declare it, else as the one that is always there."""


class Service:
    """The run that is there now."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.note = ""
        """Why there is no service, or no slot, now."""
        self.settings: Settings | None = None
        """The settings of the present run, or of the last one. None: no run was found yet."""
        self.runs = 0
        """How many runs were found."""
        self._reader: StateReader | None = None
        self._client: Client | None = None
        self._who: tuple[str, int | None] | None = None
        self._tried_ns = -AGAIN_NS

    def look(self, now_ns: int) -> bool:
        """Whether a service is there; one that has gone is looked for every AGAIN_NS."""
        if self._reader and self._reader.over():
            self._drop()
        if self._reader is None and now_ns - self._tried_ns >= AGAIN_NS:
            self._tried_ns = now_ns
            try:
                reader = StateReader(self.name)
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
        self.note = f"the service {self.name!r} has ended"
        self._leave(in_order=True)

    def _connect(self) -> None:
        assert self._who
        try:
            self._client = Client(self.name, self._who[0], pid=self._who[1])
            self.note = ""
        except FailstopError as error:
            self.note = str(error)

    def join(self, who: str, pid: int | None) -> None:
        """Speak for this program from now on; `pid` None: for the guard itself."""
        self.leave(in_order=True)
        self._who = who, pid
        if self._reader:
            self._connect()

    def leave(self, *, in_order: bool) -> None:
        """Speak for it no more. Not `in_order`: it died or ended while it drove, and the service answers as the setting
        gate.driver_death says."""
        self._who = None
        self._leave(in_order=in_order)

    def _leave(self, *, in_order: bool) -> None:
        client, self._client = self._client, None
        if client:
            client.close(in_order=in_order)

    def command(self, command: Command) -> str:
        """Hand it over; returns what it asks for beyond the limits, in words."""
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
        """Hand over a frame for the board that is not motion. The service decides whether it goes out."""
        if self._client:
            with contextlib.suppress(FailstopError):
                self._client.write("aux", frame, wake=True)

    def say(self, sees: str, wrong: str) -> None:
        """Tell people about the driver."""
        if self._client:
            with contextlib.suppress(FailstopError):
                self._client.write("said", sees, wrong)

    def block(self) -> Block | None:
        """What keeps the wheels from turning; None: nothing."""
        if self._reader is None:
            return Block.DISABLED
        decided, cause, *_ = self._reader.decided()
        answer = judge(decided, self.source, cause)[0]
        return getattr(answer, "block", None)

    def heard(self) -> list[tuple[int, bytes]]:
        """What the board has said since the last call: when, and which bytes."""
        found = []
        for ring in self._received if self._reader else ():
            while entry := ring.next():
                found.append((entry[1], bytes(entry[2])))
        return found
