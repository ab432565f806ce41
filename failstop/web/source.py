"""Source: where the page's settings come from, so that people know which file to change. Pure."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Source:
    """The source of the page's settings."""

    path: str = ""
    """The path of the file; empty if none was found, so that every setting has its default."""
    running: bool = False
    """True if the settings come from the running service, whatever file it was started with."""

    def described(self) -> str:
        """The source in words."""
        if self.running:
            return "the settings of the running service"
        return self.path or "the defaults, because no settings file was found"

    def remedy(self, change: str) -> str:
        """How to change a setting. `change`: the new line for the file."""
        if self.running:
            return f"set {change} in the service's settings file, then restart the service and the page"
        if self.path:
            return f"set {change} in {self.path}, and restart the page"
        return f"start the page with --config FILE, a settings file with {change}"
