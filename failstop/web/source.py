"""Source: where the page's settings come from. This is shown to people, so that they know which file to change.
Pure."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Source:
    """Where the page's settings come from."""

    path: str = ""
    """The path of the settings file. Empty if the settings come from the running service, or if all of them are
    defaults."""
    running: bool = False
    """True if the settings come from the running service."""

    def described(self) -> str:
        """Return a description for people, for example the file's path."""
        if self.running:
            return "the settings of the running service"
        return self.path or "the defaults, because no settings file was found"

    def remedy(self, change: str) -> str:
        """Describe what a person must do to change a setting. `change`: the new line for the settings file."""
        if self.running:
            return f"set {change} in the service's settings file, then restart the service and the page"
        if self.path:
            return f"set {change} in {self.path}, and restart the page"
        return f"start the page with --config FILE, a settings file with {change}"
