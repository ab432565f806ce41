"""The doctor's check of the fleet: would this robot obey a fleet stop?"""

from __future__ import annotations

from failstop.doctor.look import Finding, Look, ok, skip, warn
from failstop.fleet.settings import UNIT

PROPERTIES = "LoadState,ActiveState,UnitFileState,StatusText,StatusErrno"


def check(look: Look) -> list[Finding]:
    """Check whether this robot obeys fleet stops, from the status that its publisher reports to systemd. A publisher
    that was started by hand is not seen."""
    said = look.system.said("systemctl", "show", UNIT, "--property", PROPERTIES)
    if said is None and look.system.booted():
        return skip(f"systemd can't be asked about {UNIT}, or takes too long", f"systemctl status {UNIT}")
    found = dict(line.split("=", 1) for line in (said or "").splitlines() if "=" in line)
    active, enabled = found.get("ActiveState") == "active", found.get("UnitFileState", "").startswith("enabled")
    if found.get("LoadState") != "loaded" or not (active or enabled):
        return ok("the robot is in no fleet")
    if not active:
        text = f"{UNIT} is enabled but {found.get('ActiveState')}, so the robot obeys no fleet stop"
        return warn(text, f"journalctl -xeu {UNIT}")
    if found.get("StatusErrno", "0") != "0":
        return warn(f"the robot {found.get('StatusText')}", f"journalctl -u {UNIT}", "docs/fleet.md says more")
    return ok(f"the robot {found.get('StatusText') or 'is in a fleet'}")
