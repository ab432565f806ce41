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
    """The standing cause, the first since the last reset, and the epoch that was raised for it; the newest, and the
    newest epoch."""

    __slots__ = ("epoch", "newest", "since", "standing")

    def __init__(self) -> None:
        self.standing: Cause | None = None
        self.since = 0
        self.newest: Cause | None = None
        self.epoch = 0

    def settle(self, reset_epoch: int) -> None:
        """A reset in `reset_epoch` ended what had come by then. One that was made in the epoch before the newest is
        seen only after that was raised: then the newest stands."""
        if self.standing and self.since <= reset_epoch:
            self.standing = self.newest if self.epoch > reset_epoch else None
            self.since = self.epoch

    def add(self, news: list[Cause], epoch: int, reset_epoch: int) -> tuple[Cause, Cause]:
        """Causes that came together, for which the epoch is being raised to `epoch`; `reset_epoch` as in settle().
        Returns (the standing cause, the newest)."""
        self.settle(reset_epoch)
        self.newest = min(news, key=lambda cause: cause.t_ns)
        self.epoch = epoch
        if self.standing is None:
            self.standing, self.since = self.newest, epoch
        return self.standing, self.newest
