"""Run: what the parts of the supervisor have in common."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.settings import Settings
    from failstop.procs.loop import Loop
    from failstop.procs.world import World
    from failstop.shm.segment import Segment
    from failstop.supervisor.events import Events
    from failstop.supervisor.resources import Resources


class Run:
    """`own`: the supervisor's segment, to write; `views`: every process's, to read."""

    __slots__ = ("events", "loop", "own", "resources", "settings", "views", "world")

    def __init__(
        self,
        world: World,
        resources: Resources,
        settings: Settings,
        own: Segment,
        views: dict[str, Segment],
        loop: Loop,
        events: Events,
    ) -> None:
        self.world = world
        self.resources = resources
        self.settings = settings
        self.own = own
        self.views = views
        self.loop = loop
        self.events = events
