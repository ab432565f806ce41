"""Fence: the record of a hung process that was killed, so that nothing that it still wanted to do can happen."""

from __future__ import annotations


class Fence:
    """When a hang was noticed, the process killed, and the stop written on the supervisor's own descriptor (0: by the
    port owner, or not at all), CLOCK_MONOTONIC; and how long it had been silent. All in ns."""

    __slots__ = ("burst_ns", "kill_ns", "noticed_ns", "silent_ns")

    def __init__(self, noticed_ns: int, kill_ns: int, burst_ns: int, silent_ns: int = 0) -> None:
        self.silent_ns = silent_ns
        self.noticed_ns = noticed_ns
        self.kill_ns = kill_ns
        self.burst_ns = burst_ns

    def story(self, name: str, gone_ns: int, again_ns: int) -> str:
        """In words, in ms from the notice; `again_ns`: the burst after it was gone, where there is one."""
        names = {"kill": "killed", "burst": "stop written", "gone": "gone", "again": "stop again"}
        steps = [f"{names[key]} after {us / 1e3:.1f} ms" for key, us in self._times_us(gone_ns, again_ns).items()]
        return f"{name} was fenced: {', '.join(steps)}"

    def fields(self, gone_ns: int, again_ns: int) -> dict[str, float]:
        """The same for programs: us from the notice."""
        times = {f"{key}_us": us for key, us in self._times_us(gone_ns, again_ns).items()}
        return {"silent_ms": round(self.silent_ns / 1e6, 1), **times}

    def _times_us(self, gone_ns: int, again_ns: int) -> dict[str, float]:
        times = {"kill": self.kill_ns, "burst": self.burst_ns, "gone": gone_ns, "again": again_ns}
        return {key: (t - self.noticed_ns) / 1e3 for key, t in times.items() if t >= self.noticed_ns}
