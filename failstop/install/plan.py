"""What an installation would do, or taking it away, from the rows, what is wanted and what is found. Pure: nothing is
read and nothing is done."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping

from failstop.discovery import BOARD_VID, LINK
from failstop.install import InstallError, layout, rows
from failstop.install.found import Found, Request
from failstop.install.steps import Command, Directory, File, Link, Plan, Remove, Start, Step, Tree
from failstop.shm.instance import DEFAULT_NAME
from failstop.version import VERSION

MASK = "/dev/null"
RELOAD = ("systemctl", "daemon-reload")
UDEV_RELOAD = ("udevadm", "control", "--reload")
TRIGGERED = (("--subsystem-match=tty",), ("--subsystem-match=usb", f"--attr-match=idVendor={BOARD_VID:04x}"))
"""Which devices the rule is about, in udevadm's words."""
SETTLE_S = 5
"""How long the new rule may take to name a board that is plugged in; else the service waits for it."""
NO_SUCH_GROUP = 6
"""groupdel's exit code, when userdel has taken the group along."""

Texts = Mapping[str, str]
"""By the names of rows.py and extras.py."""


def install(texts: Texts, request: Request, tree: str, found: Found) -> Plan:
    """The steps to what is wanted; `tree` is the digest of the environment to install, empty for none. Raises
    InstallError."""
    _refuse(texts, request, found)
    before = found.manifest or layout.Manifest()
    files, links = _files(texts, request, found), _links(texts, request, found)
    gone = [path for path in before.files if path not in files]
    new_tree = bool(tree) and tree != found.tree
    content = [*_differing(files, found, before), *_settings(texts, request, found)]
    linking = [_link(path, target, found) for path, target in links.items() if found.links.get(path) != target]
    written = {step.subject for step in content}
    changed = {*written, *(step.subject for step in linking), *gone}
    restarts = found.active if new_tree or any(layout.unit_file(unit) in written for unit in found.active) else ()
    making = _make_accounts(texts[rows.SYSUSERS], request, found)
    paths = (*files, *links, *written, layout.PREFIX if new_tree else layout.MANIFEST)
    needed = dict.fromkeys(part for path in paths for part in layout.parents(path))
    directories = [part for part in needed if part not in found.directories]
    listed = layout.Manifest(
        VERSION,
        request.command,
        tree,
        {path: layout.sha256(data) for path, (data, _) in files.items()},
        {**before.links, **links},
        tuple(dict.fromkeys([*before.directories, *directories])),
    )
    steps: list[Step] = [
        *_stops(restarts),
        *_on_undo(request, found, changed),
        *(Directory("", path) for path in directories),
        # First the list: what was cut short by a power failure can be taken away, or done again.
        *_listed(listed.dump(), new_tree, found),
        *(Remove("remove", path, "of another version") for path in gone),
        *content,
        *making,
        *_make_member(request, found),
        *linking,
        *_told(request, found, changed),
        *(_name_board() if layout.UDEV in written and request.live and found.udev else ()),
        *([_check(request)] if request.live and (new_tree or making or content) else ()),
        *_starts(request, found, restarts),
    ]
    return Plan(tuple(steps), _notes(request, found), restarts)


def uninstall(request: Request, found: Found, purge: bool = False) -> Plan:
    """The steps that take everything away, configuration and logs only with `purge`. Raises InstallError."""
    manifest = found.manifest
    if manifest is None and purge and not found.package:
        return Plan(tuple(_purge(request, found)))
    manifest = _listed_by(found)
    gone = [*manifest.links, *manifest.files]
    steps = [
        *_ends(request, found, found.active, "*", gone),
        *(Remove("remove", path) for path in gone),
        Remove(
            "remove", layout.PREFIX, "the Python environment" if manifest.tree else "the list of what was installed"
        ),
        *_told(request, found, gone),
        *(_purge(request, found) if purge else ()),
        *(Remove("", path, only_empty=True) for path in reversed(manifest.directories)),
    ]
    kept = (
        ()
        if purge
        else (f"{layout.CONFIGURATION}, {layout.STATE} and the user failstop stay; --purge removes them too",)
    )
    return Plan(tuple(steps), kept, found.active)


def uninstall_instance(request: Request, found: Found, purge: bool = False) -> Plan:
    """The steps that take one instance away and leave the rest. Raises InstallError."""
    manifest = _listed_by(found)
    unit = layout.unit_of(request.name)
    gone = [path for path in manifest.links if path.startswith(layout.UNITS) and path.endswith(f"/{unit}")]
    if not gone:
        raise InstallError(f"no instance {request.name!r} is installed")
    active = tuple(name for name in found.active if name == unit)
    left = {path: target for path, target in manifest.links.items() if path not in gone}
    own = {
        layout.configuration_of(request.name): "your settings",
        f"{layout.STATE}/{request.name}": "logs and incidents",
    }
    steps = [
        *_ends(request, found, active, request.name, gone),
        *(Remove("remove", path, "no longer starts at boot") for path in gone),
        *(Remove("remove", path, what) for path, what in own.items() if purge),
        File("", layout.MANIFEST, data=dataclasses.replace(manifest, links=left).dump()),
        *_told(request, found, gone),
    ]
    return Plan(tuple(steps), (), active)


def device_of(texts: Texts, request: Request, found: Found) -> str:
    """The board's port, as the service will have it: by the name that outlives a replug, where the rule gives one."""
    named = request.device or found.configured_device
    return named or (LINK if found.board else _example_device(texts[rows.SETTINGS].splitlines())[1])


def _example_device(lines: list[str]) -> tuple[int, str]:
    """Where the example says the board's port is: the line's number, and the path."""
    at = next(number for number, line in enumerate(lines) if line.startswith("path = "))
    return at, lines[at].split('"')[1]


def _refuse(texts: Texts, request: Request, found: Found) -> None:
    for extra in rows.EXTRAS:
        extra.refuse(request, found)
    if found.package:
        raise InstallError(
            "the Debian package of failstop is installed here: it is the service already; "
            "remove it first (apt remove failstop) if you want another one"
        )
    if layout.PREFIX in found.links:
        raise InstallError(f"{layout.PREFIX} is a link to {found.links[layout.PREFIX]}: remove it")
    if found.tree and found.manifest is None:
        raise InstallError(f"{layout.PREFIX} is there, and is not an installation's: remove it, or move it away")
    if found.manifest and found.manifest.command != request.command:
        raise InstallError(
            f"an installation that runs {found.manifest.command} is here, this one would run {request.command}: "
            "`failstop uninstall` first; it keeps your configuration"
        )
    unit, configuration = layout.unit_of(request.name), layout.configuration_of(request.name)
    for path in (*(row.place for row in rows.OWN), layout.unit_file(unit), configuration):
        if (target := found.links.get(path)) == MASK:
            raise InstallError(f"{path} is masked: systemctl unmask {unit}")
        if target is not None:
            raise InstallError(f"{path} is a link to {target}, and is not an installation's: remove it")
    if request.name != DEFAULT_NAME and not request.device and not found.configured_device:
        raise InstallError(f"robot {request.name!r} needs a board of its own: name its port with --device PATH")
    if request.device and found.configured_device not in ("", request.device):
        raise InstallError(
            f"{configuration} says device.path = {found.configured_device!r}: "
            f"change it there to {request.device!r}, and call this without --device"
        )
    if not found.device_there and request.live and request.start and unit not in found.active:
        raise InstallError(
            f"no device {device_of(texts, request, found)}: plug the board in, name another port with "
            "--device PATH, or say --no-start, and the service is started at the next boot"
        )


def _files(texts: Texts, request: Request, found: Found) -> dict[str, tuple[bytes, str]]:
    """Content and remark of every file but the settings."""
    files = {}
    for row in rows.ROWS:
        if choice := row.choice(request, found):
            text, remark = row.filled(texts[row.source], choice, found)
            text = text.replace(layout.UNIT_COMMAND, request.command) if row.place.startswith(layout.UNITS) else text
            files[row.place] = (text.encode(), remark)
    return files


def _boot_units(request: Request, found: Found) -> list[str]:
    """What starts with the machine."""
    units = [row.source for row in rows.ROWS if row.boot and row.choice(request, found)]
    return [layout.unit_of(request.name) if unit == rows.SERVICE else unit for unit in units]


def _links(texts: Texts, request: Request, found: Found) -> dict[str, str]:
    links = {layout.COMMAND_LINK: request.command}
    for unit in _boot_units(request, found):
        source = layout.unit_file(unit)
        targets = rows.wanted_by(texts[source.rpartition("/")[2]])
        links |= {f"{layout.UNITS}/{target}.wants/{unit}": source for target in targets}
    return links


def _differing(files: dict[str, tuple[bytes, str]], found: Found, before: layout.Manifest) -> list[File]:
    steps = []
    for path, (data, remark) in files.items():
        there = found.files.get(path)
        if there is None:
            steps.append(File("create", path, remark, data))
        elif there != data:
            by_hand = "" if layout.sha256(there) == before.files.get(path) else "; it was changed by hand"
            steps.append(File("replace", path, remark + by_hand, data))
    return steps


def _settings(texts: Texts, request: Request, found: Found) -> list[File]:
    """The examples, where there are no settings: those are the user's, and stay as they are."""
    lines = texts[rows.SETTINGS].splitlines(keepends=True)
    at, _ = _example_device(lines)
    device = device_of(texts, request, found)
    lines[at] = f'path = "{device}"\n'
    examples = {layout.configuration_of(request.name): ("".join(lines), f"your settings; the board at {device}")}
    for extra in rows.EXTRAS:
        if extra.settings and extra.choice(request, found):
            examples[extra.settings] = (texts[rows.FLEET_SETTINGS], "where its broker is: look at it")
    return [
        File("create", path, remark, text.encode())
        for path, (text, remark) in examples.items()
        if path not in found.files
    ]


def _link(path: str, target: str, found: Found) -> Link:
    if path in found.files:
        raise InstallError(f"{path} is a file, and is not an installation's: remove it, or move it away")
    sleep = "/sleep.target.wants/" in path
    remark = "the command" if path == layout.COMMAND_LINK else "before a sleep" if sleep else "starts at boot"
    return Link("replace" if path in found.links else "create", path, remark, target)


def _listed(manifest: bytes, new_tree: bool, found: Found) -> list[Step]:
    """The environment with the list in it; the list alone, or nothing, if these are as they should be."""
    if new_tree:
        verb = "replace" if found.tree else "create"
        return [Tree(verb, layout.PREFIX, "failstop and what it needs, copied from here", manifest)]
    return [File("", layout.MANIFEST, data=manifest)] if found.files.get(layout.MANIFEST) != manifest else []


def _starts(request: Request, found: Found, restarts: tuple[str, ...]) -> list[Start]:
    if not (request.live and request.start):
        return []
    remarks = {extra.source: extra.started for extra in rows.EXTRAS}
    others = [extra.source for extra in rows.EXTRAS if extra.choice(request, found)]
    wanted = [name for name in (layout.unit_of(request.name), *others) if name not in found.active]
    return [
        Start("start", unit, remarks.get(unit, "motion stays disabled until somebody enables it"))
        for unit in sorted(dict.fromkeys((*restarts, *wanted)), key=lambda unit: unit in remarks)
    ]


def _listed_by(found: Found) -> layout.Manifest:
    """What was installed. Raises InstallError."""
    if found.manifest:
        return found.manifest
    if found.package:
        raise InstallError(
            "failstop is installed as a Debian package here: apt remove failstop (apt purge failstop: all of it)"
        )
    raise InstallError("no installation of `failstop install` is here; --purge removes what an earlier one has left")


def _ends(request: Request, found: Found, units: tuple[str, ...], name: str, gone: Collection[str]) -> list[Command]:
    """The service's end, and that of whoever still tries to stop a board that could not be stopped, because of the end
    just now for one."""
    late = Command("", f"who tries to stop {name}", words=("systemctl", "stop", rows.LATE.replace("@", f"@{name}")))
    return [*_stops(units), *([late] if request.live else []), *_on_undo(request, found, gone)]


def _stops(units: tuple[str, ...]) -> list[Command]:
    """Stop units that run; undone by starting them."""
    again = ("systemctl", "start", "--no-block")
    return [Command("stop", unit, "THE WHEELS STOP", ("systemctl", "stop", unit), (*again, unit)) for unit in units]


def _readers(request: Request, found: Found, changed: Collection[str]) -> list[tuple[str, ...]]:
    """What tells those of the running system that have read these files."""
    told = {
        RELOAD: any(path.startswith(layout.UNITS) for path in changed),
        UDEV_RELOAD: layout.UDEV in changed and found.udev,
    }
    return [words for words, holds in told.items() if holds and request.live]


def _on_undo(request: Request, found: Found, changed: Collection[str]) -> list[Command]:
    """What is to be told of the files once they are back as they were: undone last, so it comes first."""
    return [Command("", " ".join(words), undo=words) for words in _readers(request, found, changed)]


def _told(request: Request, found: Found, changed: Collection[str]) -> list[Command]:
    """Those who are to read the new files, or to find them gone."""
    words = ("journalctl", *(() if request.live else (f"--root={request.root}",)), "--update-catalog")
    catalog = [_run(*words, touches=(layout.CATALOG_DATABASE,))] if layout.CATALOG in changed else []
    return [*catalog, *(_run(*words) for words in _readers(request, found, changed))]


def _name_board() -> list[Command]:
    """Have the new rule name a board that is plugged in, and treat its USB device."""
    settle = ("udevadm", "settle", f"--timeout={SETTLE_S}")
    return [*(_run("udevadm", "trigger", *which) for which in TRIGGERED), _run(*settle, accepted=(0, 1))]


def _run(*words: str, touches: tuple[str, ...] = (), accepted: tuple[int, ...] = (0,)) -> Command:
    """A program of the system, shown as it is called."""
    return Command("run", " ".join(words), words=words, touches=touches, accepted=accepted)


def _make_accounts(sysusers: str, request: Request, found: Found) -> list[Command]:
    """The service's user and its groups, where one is missing."""
    users, memberships = rows.accounts(sysusers)
    passwd = {row[0] for row in found.rows("/etc/passwd")}
    members = {row[0]: row[3].split(",") for row in found.rows("/etc/group")}
    there = passwd.issuperset(users) and members.keys() >= {*users}
    if there and all(user in members.get(group, ()) for user, group in memberships):
        return []
    groups = ", ".join(group for _, group in memberships)
    root = () if request.live else (f"--root={request.root}",)
    return [
        Command(
            "create",
            f"user and group {', '.join(users)}",
            f"the service runs as it{f'; in the groups of {groups}' if groups else ''}",
            ("systemd-sysusers", *root, "--inline", *rows.entries(sysusers)),
            touches=layout.ACCOUNT_FILES,
        )
    ]


def _make_member(request: Request, found: Found) -> list[Command]:
    """The bridge's user may drive."""
    name = request.ros2_user
    members = next((row[3].split(",") for row in found.rows("/etc/group") if row[0] == rows.SERVICE_USER), [])
    if not name or name == "root" or name in members:
        return []
    words = ("usermod", *_prefix(request), "--append", "--groups", rows.SERVICE_USER, name)
    return [
        Command(
            "add", f"user {name} to the group {rows.SERVICE_USER}", "it may drive", words, touches=layout.ACCOUNT_FILES
        )
    ]


def _prefix(request: Request) -> tuple[str, ...]:
    """The option by which the programs for accounts mean another system."""
    return () if request.live else ("--prefix", request.root)


def _purge(request: Request, found: Found) -> list[Step]:
    """What an installation leaves, and what an earlier uninstall has left."""
    steps: list[Step] = [
        Remove("remove", layout.CONFIGURATION, "your configuration"),
        Remove("remove", layout.STATE, "logs and incidents"),
        *([Remove("", layout.RUNTIME)] if request.live else []),
    ]
    # With another home it is a person's, or another program's.
    if any(
        row[0] == rows.SERVICE_USER and row[5] == layout.STATE for row in found.rows("/etc/passwd") if len(row) == 7
    ):
        user, group = (
            ("userdel", *_prefix(request), rows.SERVICE_USER),
            ("groupdel", *_prefix(request), rows.SERVICE_USER),
        )
        steps.append(Command("remove", "user failstop", words=user, touches=layout.ACCOUNT_FILES))
        steps.append(
            Command("", "group failstop", words=group, touches=layout.ACCOUNT_FILES, accepted=(0, NO_SUCH_GROUP))
        )
    return steps


def _check(request: Request) -> Command:
    """That the service's user can run what was installed, before anything is started."""
    who = ("setpriv", "--reuid=failstop", "--regid=failstop", "--clear-groups")
    words = (*who, request.command, "config", "--check", layout.configuration_of(request.name))
    return Command("check", "that the user failstop can run it", words=words)


def _notes(request: Request, found: Found) -> tuple[str, ...]:
    configuration = layout.configuration_of(request.name)
    notes = {
        f"{configuration} is yours and stays as it is": configuration in found.files,
        "udev does not run here: its rule takes effect when it does": request.live and not found.udev,
    }
    return tuple(note for note, holds in notes.items() if holds)
