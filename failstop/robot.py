"""Robot: drive and stop a robot from Python."""

from __future__ import annotations

import os
import sys
from math import isfinite
from types import TracebackType

from failstop.client import Client, send_stop
from failstop.errors import FailstopError, Refused
from failstop.procs.gate.sources import DEFAULT as DEFAULT_SOURCE
from failstop.shm import records
from failstop.shm.instance import DEFAULT_NAME
from failstop.state import State, StateReader


class Robot:
    """A connection to the running service of that name; a context manager.

    Reading the state and estop() need no permission. The other calls take one of the service's client slots, at their
    first use, which needs the group `failstop` (or the service's user). Not thread-safe: one Robot a thread.
    """

    def __init__(self, name: str = DEFAULT_NAME, *, client: str | None = None) -> None:
        """`client` is what others see of this program; by default its file name. Raises NoService, FailstopError."""
        self.name = name
        self.client_name = client or os.path.basename(sys.argv[0]) or "python"
        self._reader = StateReader(name)
        self._connected: Client | None = None

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Give the client slot back. If this program was driving, the wheels stop at once."""
        if self._connected:
            self._connected.close()
            self._connected = None

    def _client(self) -> Client:
        if self._connected is None:
            self._connected = Client(self.name, self.client_name)
        return self._connected

    def _ask(self, verb: int) -> str:
        done, text = self._client().request(verb)
        if not done:
            raise Refused(text)
        return text

    def enable(self) -> str:
        """Enable motion. Raises Refused with the reason: latched, not ready, an interlock that does not hold, or asked
        before the last stop."""
        return self._ask(records.ENABLE)

    def disable(self) -> str:
        """Disable motion: the wheels stop at once."""
        return self._ask(records.DISABLE)

    def reset(self) -> str:
        """Clear the latched stop; motion stays disabled until enable(). With nothing latched it changes nothing. Raises
        Refused."""
        return self._ask(records.RESET)

    def drive(self, vx: float, vy: float, wz: float, *, manual: bool = False, source: str = DEFAULT_SOURCE) -> None:
        """Command a velocity: m/s forward, m/s left, rad/s counter-clockwise. It holds for its source's timeout (0.3
        s unless the settings say otherwise, 2 s at most), so repeat it. Values past the limits are clamped; whether
        anything moves, and why not, is in `state.blocked`.

        A command by a person (`manual`) is exempt from the scan gate. `source` is a name of the settings' [sources].
        Raises ValueError for a value that is not finite, NoService when the service has gone.
        """
        if not (isfinite(vx) and isfinite(vy) and isfinite(wz)):
            raise ValueError(f"drive({vx}, {vy}, {wz}): every value must be finite")
        self._client().command(vx, vy, wz, manual=manual, source=source)

    def sensed(self) -> None:
        """The obstacle sensor delivered just now. Software commands move the wheels only while somebody says so at
        least every 0.5 s (setting scan.timeout_s); else they are blocked with `no scan`."""
        self._client().sensed()

    def hold(self, *interlocks: str) -> None:
        """These interlocks hold now (names of the settings' [interlocks]); repeat it within their timeout.

        Enabling needs every declared one, and losing one disables motion. What an earlier call named and this one does
        not is no longer asserted, and ends with its timeout.
        """
        self._client().hold(list(interlocks))

    def estop(self, reason: str = "") -> None:
        """Latched protective stop (a stop by software, category 2; not an emergency stop in the sense of ISO 13850).
        Motion stays off until reset() and enable(). Anyone may; raises NoService when nothing is there to stop. The
        latch's reason is `stop request: REASON (CLIENT, pid N)`; of a reason of more than 180 bytes the rest is left
        out."""
        send_stop(self.name, reason, self.client_name)

    @property
    def state(self) -> State:
        """One snapshot of the service. Raises FailstopError."""
        return self._reader.read()


__all__ = ["FailstopError", "Refused", "Robot", "State"]
