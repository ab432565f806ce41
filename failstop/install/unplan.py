"""What taking an installation away would do, from the list that it kept. Pure."""

from __future__ import annotations

import dataclasses

from failstop.install import InstallError
from failstop.install.layout import (
    ACCOUNT_FILES,
    CATALOG,
    CONFIGURATION,
    MANIFEST,
    PREFIX,
    RUNTIME,
    STATE,
    UDEV,
    UNITS,
    configuration_of,
    unit_of,
)
from failstop.install.parts import LATE
from failstop.install.plan import RELOAD, UDEV_RELOAD, Found, Request, run, stops, update_catalog
from failstop.install.steps import Command, File, Plan, Remove, Step

NO_SUCH_GROUP = 6
"""groupdel's exit code, when userdel has taken the group along."""


def uninstall(request: Request, found: Found, purge: bool = False) -> Plan:
    """The steps that take everything away, configuration and logs only with `purge`. Raises InstallError."""
    manifest = found.manifest
    if manifest is None:
        if purge and not found.package:
            return Plan(tuple(_purge(request, found)))
        raise InstallError(_absent(found))
    files = [*manifest.links, *manifest.files]
    steps: list[Step] = [*stops(found.active)]
    if request.live:
        steps += [_given_up("*"), Command("", "", "", (), RELOAD)]
    steps += [Remove("remove", path, "", path) for path in files]
    whole = "the Python environment" if manifest.tree else "the list of what was installed"
    steps.append(Remove("remove", PREFIX, whole, PREFIX))
    if request.live:
        steps.append(run(*RELOAD))
        if found.udev and UDEV in manifest.files:
            steps.append(run(*UDEV_RELOAD))
    if CATALOG in manifest.files:
        steps.append(update_catalog(request))
    if purge:
        steps += _purge(request, found)
    steps += [Remove("", path, "", path, only_empty=True) for path in reversed(manifest.directories)]
    kept = () if purge else (f"{CONFIGURATION}, {STATE} and the user failstop stay; --purge removes them too",)
    return Plan(tuple(steps), kept, found.active)


def uninstall_instance(request: Request, found: Found, purge: bool = False) -> Plan:
    """The steps that take one instance away and leave the rest. Raises InstallError."""
    manifest = found.manifest
    if manifest is None:
        raise InstallError(_absent(found))
    unit = unit_of(request.name)
    links = [path for path in manifest.links if path.startswith(UNITS) and path.endswith(f"/{unit}")]
    if not links:
        raise InstallError(f"no instance {request.name!r} is installed")
    active = tuple(name for name in found.active if name == unit)
    left = {path: target for path, target in manifest.links.items() if path not in links}
    steps: list[Step] = [*stops(active)]
    if request.live:
        steps += [_given_up(request.name), Command("", "", "", (), RELOAD)]
    steps += [Remove("remove", path, "no longer starts at boot", path) for path in links]
    if purge:
        steps.append(Remove("remove", configuration_of(request.name), "your settings", configuration_of(request.name)))
        steps.append(Remove("remove", f"{STATE}/{request.name}", "logs and incidents", f"{STATE}/{request.name}"))
    steps.append(File("", MANIFEST, "", MANIFEST, dataclasses.replace(manifest, links=left).dump()))
    if request.live:
        steps.append(run(*RELOAD))
    return Plan(tuple(steps), (), active)


def _absent(found: Found) -> str:
    if found.package:
        return "failstop is installed as a Debian package here: apt remove failstop (apt purge failstop: all of it)"
    return "no installation of `failstop install` is here; --purge removes what an earlier one has left"


def _given_up(name: str) -> Command:
    """Whoever still tries to stop a board that could not be stopped, because of the end just now for one."""
    return Command("", f"who tries to stop {name}", "", ("systemctl", "stop", LATE.replace("@", f"@{name}")))


def _purge(request: Request, found: Found) -> list[Step]:
    """What an installation leaves, and what an earlier uninstall has left."""
    steps: list[Step] = [
        Remove("remove", CONFIGURATION, "your configuration", CONFIGURATION),
        Remove("remove", STATE, "logs and incidents", STATE),
    ]
    if request.live:
        steps.append(Remove("", RUNTIME, "", RUNTIME))
    # With another home it is a person's, or another program's.
    if any(row[0] == "failstop" and row[5] == STATE for row in found.rows("/etc/passwd") if len(row) == 7):
        where = () if request.live else ("--prefix", request.root)
        user, group = ("userdel", *where, "failstop"), ("groupdel", *where, "failstop")
        steps.append(Command("remove", "user failstop", "", user, touches=ACCOUNT_FILES))
        steps.append(Command("", "group failstop", "", group, touches=ACCOUNT_FILES, accepted=(0, NO_SUCH_GROUP)))
    return steps
