"""Causes: of all that stops the robot, the first since the last reset is the one that people are told. Pure."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.supervisor.stops import Stop


class Causes:
    """The standing cause, the first since the last reset, and the epoch that was raised for it; the newest, and the
    newest epoch."""

    __slots__ = ("epoch", "newest", "since", "standing")

    def __init__(self) -> None:
        self.standing: Stop | None = None
        self.since = 0
        self.newest: Stop | None = None
        self.epoch = 0

    def settle(self, reset_epoch: int) -> None:
        """A reset in `reset_epoch` ended what had come by then. One that was made in the epoch before the newest is
        seen only after that was raised: then the newest stands."""
        if self.standing and self.since <= reset_epoch:
            self.standing = self.newest if self.epoch > reset_epoch else None
            self.since = self.epoch

    def add(self, news: list[Stop], epoch: int, reset_epoch: int) -> tuple[Stop, Stop]:
        """Causes that came together, for which the epoch is being raised to `epoch`; `reset_epoch` as in settle().
        Returns (the standing cause, the newest)."""
        self.settle(reset_epoch)
        self.newest = min(news, key=lambda one: one.t_ns)
        self.epoch = epoch
        if self.standing is None:
            self.standing, self.since = self.newest, epoch
        return self.standing, self.newest
