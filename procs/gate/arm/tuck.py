"""AutoTuck: an arm that is left alone goes to its tuck pose, announced before. Pure."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.settings import Settings

ANNOUNCE = 1
GO = 2


class AutoTuck:
    """The time since the arm was last used, while motion is disabled and nothing is latched."""

    __slots__ = ("_after_ns", "_announced", "_notice_ns", "_on")

    def __init__(self, settings: Settings) -> None:
        self._on = settings.on("arm.auto_tuck")
        self._after_ns = settings.ns("arm.auto_tuck_s")
        self._notice_ns = min(settings.ns("arm.tuck_notice_s"), self._after_ns)
        self._announced = False

    def left_s(self, active_ns: int, now_ns: int) -> float | None:
        """Until it goes; None: it does not, since it was not used, or it is switched off."""
        return max(0.0, (active_ns + self._after_ns - now_ns) * 1e-9) if self._on and active_ns else None

    def follow(self, active_ns: int, now_ns: int) -> int:
        """ANNOUNCE once, GO when it is time, else 0."""
        left_s = self.left_s(active_ns, now_ns)
        if left_s is None or left_s * 1e9 > self._notice_ns:
            self._announced = False
            return 0
        if not self._announced:
            self._announced = True
            return ANNOUNCE
        return GO if left_s <= 0.0 else 0
