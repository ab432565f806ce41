"""Fence: the record of a hung process that was killed, so that nothing that it still wanted to do can happen."""

from __future__ import annotations


class Fence:
    """When a hang was noticed, the process killed, and the stop written on the supervisor's own descriptor (0: by the
    port owner, or not at all); CLOCK_MONOTONIC, ns."""

    __slots__ = ("burst_ns", "kill_ns", "noticed_ns")

    def __init__(self, noticed_ns: int, kill_ns: int, burst_ns: int) -> None:
        self.noticed_ns = noticed_ns
        self.kill_ns = kill_ns
        self.burst_ns = burst_ns

    def story(self, name: str, gone_ns: int, again_ns: int) -> str:
        """In words, in ms from the notice; `again_ns`: the burst after it was gone, where there is one."""
        times = [("killed", self.kill_ns), ("stop written", self.burst_ns), ("gone", gone_ns), ("stop again", again_ns)]
        steps = [f"{what} after {(t - self.noticed_ns) / 1e6:.1f} ms" for what, t in times if t >= self.noticed_ns]
        return f"{name} was fenced: {', '.join(steps)}"
