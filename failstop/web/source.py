"""Source: where the page's settings are from, for people who look for the one to change. Pure."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Source:
    """Where the page has its settings from."""

    path: str = ""
    """The file; empty: none was found, so every setting has its default."""
    running: bool = False
    """From the service that runs, whatever file it was started with."""

    def described(self) -> str:
        """In words."""
        if self.running:
            return "the settings of the running service"
        return self.path or "the defaults, because no settings file was found"

    def remedy(self, change: str) -> str:
        """How to change a setting: `change` is its new line."""
        if self.running:
            return f"set {change} in the service's settings file, then restart the service and the page"
        if self.path:
            return f"set {change} in {self.path}, and restart the page"
        return f"start the page with --config FILE, a settings file with {change}"
