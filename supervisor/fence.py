"""Fence: the record of a hung process that was killed, so that nothing that it still wanted to do can happen."""

from __future__ import annotations

NAMES = {"kill": "killed", "burst": "stop written", "gone": "gone", "again": "stop again"}


class Fence:
    """When a hang was noticed, the process killed, the stop written on the supervisor's own descriptor (0: by the port
    owner, or not at all), its end noticed, and the stop written again for that (0: as before), CLOCK_MONOTONIC; and how
    long it had been silent. All in ns."""

    def __init__(
        self, noticed_ns: int, kill_ns: int, burst_ns: int, silent_ns: int = 0, *, was_starved: bool = False
    ) -> None:
        self.was_starved = was_starved
        """The machine did not run it: no fault of its own."""
        self.kill_ns = kill_ns
        self._noticed_ns = noticed_ns
        self._silent_ns = silent_ns
        self._times_ns = {"kill": kill_ns, "burst": burst_ns}

    def gone(self, gone_ns: int, again_ns: int) -> None:
        """It is gone; `again_ns`: when the burst for that was written."""
        self._times_ns |= {"gone": gone_ns, "again": again_ns}

    def story(self, name: str) -> str:
        """In words, in ms from the notice."""
        steps = [f"{NAMES[key]} after {us / 1e3:.1f} ms" for key, us in self._times_us().items()]
        return f"{name} was fenced: {', '.join(steps)}"

    def fields(self) -> dict[str, float]:
        """The same for programs: us from the notice."""
        times = {f"{key}_us": us for key, us in self._times_us().items()}
        return {"silent_ms": round(self._silent_ns / 1e6, 1), **times}

    def _times_us(self) -> dict[str, float]:
        """Of what has happened."""
        return {key: (t_ns - self._noticed_ns) / 1e3 for key, t_ns in self._times_ns.items() if t_ns}
