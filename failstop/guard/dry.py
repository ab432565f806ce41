"""Dry: a guard without a service and without a robot. It prints what the guard would do with a driver's bytes."""

from __future__ import annotations

from failstop.api.words import printable, velocity
from failstop.board import kinds
from failstop.guard.said import REFUSED, WAITS
from failstop.guard.scale import Scale
from failstop.policy import scale
from failstop.policy.settings import FIRST_SOURCE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.board.driver import DriverFrame
    from failstop.guard.talk import Command
    from failstop.policy.settings import Settings

AT_DEATH = {
    "disable": "and motion is disabled",
    "latch": "and a stop is latched",
    "stay": "but motion stays enabled",
}
"""What happens, besides the stop, when a driver dies while it drives. The keys are the values of the setting
gate.driver_death."""
UNANSWERED = "no board answers in a dry run: a driver that waits for the answer goes no further"
MOST_SHOWN = 200
"""How many different motions are printed for one driver at most. The same number limits the different frames that are
not motion."""


class Nothing:
    """Stands in for the service in a dry run. No board answers, and no wheel turns."""

    def __init__(self, settings: Settings, tell: Callable[[str], None]) -> None:
        """`tell`: prints a line. Raises ValueError."""
        self.settings: Settings | None = settings
        self.source = FIRST_SOURCE
        self.runs = 1
        self.note = ""
        board = kinds.board_of(*settings.board())
        limited = scale.capped(settings, assumed=board.scale_assumed)
        self.scale = Scale(limited, board.per_rps, board.step_rps, assumed=board.scale_assumed)
        self._tell = tell
        self._shown: set[tuple[float, ...]] = set()
        self._passed: set[bytes] = set()
        self._asked = self._complained = False

    def look(self, now_ns: int) -> bool:
        """Return True, because a dry run needs no service."""
        return True

    def join(self, who: str, pid: int | None) -> None:
        """Forget which lines were printed, because a new driver begins."""
        self._shown.clear()
        self._passed.clear()
        self._asked = False

    def rename(self, who: str, pid: int | None) -> None:
        """Do nothing, because a dry run shows no name of its own."""

    def leave(self, *, in_order: bool) -> None:
        """If the driver did not end cleanly (`in_order` is False), print what failstop would do."""
        if not in_order and self.settings:
            then = AT_DEATH[self.settings.text("gate.driver_death")]
            self._tell(f"  with failstop: the wheels stop, {then} (gate.driver_death)")

    def command(self, command: Command) -> tuple[str, str]:
        """Print a motion, unless a motion with the same wheel speeds was printed already. Returns what Scale.beyond()
        says about the motion."""
        self._complained = False
        asked = self.scale.velocity(command.speeds, command.steering_rad)
        if command.speeds not in self._shown and len(self._shown) < MOST_SHOWN:
            self._shown.add(command.speeds)
            speeds = " ".join(f"{speed:g}" for speed in command.speeds)
            self._tell(f"  motion: wheels {speeds}: {velocity(*asked) or 'a stop'}")
        return self.scale.beyond(asked)

    def forward(self, frame: DriverFrame) -> None:
        """Print a frame that the service would pass on to the board, unless the same frame was already printed. At the
        driver's first question, print that no board answers."""
        if frame.data not in self._passed and len(self._passed) < MOST_SHOWN:
            self._passed.add(frame.data)
            self._tell(f"  passed on to the board: {printable(frame.data.decode('ascii', 'backslashreplace').strip())}")
        if frame.asks and not self._asked:
            self._asked = True
            self._tell(f"  {UNANSWERED}")

    def say(self, sees: str, wrong: str) -> None:
        """Print `wrong`, at most once for each motion of the driver. Refusals and texts about a driver's end are not
        printed, because the guard itself prints these."""
        if wrong and not wrong.startswith(REFUSED) and not sees.startswith(WAITS) and not self._complained:
            self._complained = True
            self._tell(f"  {wrong}")

    def block(self) -> None:
        """Return None, because nothing blocks motion in a dry run."""

    def heard(self) -> list[tuple[int, bytes]]:
        """Return an empty list, because no board sends anything."""
        return []
