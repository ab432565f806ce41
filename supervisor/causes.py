"""Causes: of all that stops the robot, the first since the last reset is the one that people are told. Pure."""

from __future__ import annotations


class Cause:
    """Something that stops: when it was noticed (CLOCK_MONOTONIC ns), by whom, and why."""

    __slots__ = ("noticed_by", "reason", "t_ns", "written_ns")

    def __init__(self, t_ns: int, noticed_by: str, reason: str, written_ns: int = 0) -> None:
        self.t_ns = t_ns
        self.noticed_by = noticed_by
        self.reason = reason
        self.written_ns = written_ns
        """When its burst was handed to the kernel; 0 while that is not known."""


class Causes:
    """The standing cause: the first since the last reset; and the epoch that it was raised to."""

    __slots__ = ("epoch", "standing")

    def __init__(self) -> None:
        self.standing: Cause | None = None
        self.epoch = 0

    def add(self, news: list[Cause], epoch: int, reset_epoch: int) -> Cause:
        """Causes that came together, for which the epoch is being raised to `epoch`; a reset in `reset_epoch` ended
        what stood before. Returns the standing cause."""
        if self.standing is None or reset_epoch >= self.epoch:
            self.standing = min(news, key=lambda cause: cause.t_ns)
        self.epoch = epoch
        return self.standing
