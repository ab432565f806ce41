"""What an installation would do, from what is wanted and what is found. Pure: nothing is read and nothing is done."""

from __future__ import annotations

import dataclasses

from failstop.discovery import LINK
from failstop.install import InstallError
from failstop.install.extras import EXTRAS
from failstop.install.layout import (
    ACCOUNT_FILES,
    CATALOG,
    CATALOG_DATABASE,
    COMMAND_LINK,
    COMPLETIONS,
    MANIFEST,
    MANUAL,
    PREFIX,
    SYSUSERS,
    UDEV,
    UNITS,
    Manifest,
    configuration_of,
    parents,
    sha256,
    unit_file,
    unit_of,
)
from failstop.install.parts import OWN_UNITS, SLEEP, UNIT_COMMAND, Parts, accounts, wanted_by
from failstop.install.steps import Command, Directory, File, Link, Plan, Remove, Start, Step, Tree
from failstop.shm.instance import DEFAULT_NAME

OWN_COMMAND = f"{PREFIX}/bin/failstop"
MASK = "/dev/null"
RELOAD = ("systemctl", "daemon-reload")
UDEV_RELOAD = ("udevadm", "control", "--reload")
SETTLE_S = 5
"""How long the new rule may take to name a board that is plugged in; else the service waits for it."""


@dataclasses.dataclass(frozen=True)
class Request:
    """What the user asked for."""

    name: str = DEFAULT_NAME
    device: str = ""
    """The board's port; empty: the setting's default."""
    root: str = "/"
    live: bool = True
    """False: files only, the system whose root this is does not run."""
    start: bool = True
    command: str = OWN_COMMAND
    """What the units call; another than the default: no environment is made."""
    ros2_user: str = ""
    """The user of the robot's ROS nodes, whose the bridge is to be; empty: no bridge, or the one that is there."""
    fleet: bool = False
    """The robot is to be published to its fleet's broker; False: it is not, or goes on to be."""
    web: str = ""
    """The operator's page: extras.VIEW or extras.OPERATE; empty: none, or the one that is there."""


@dataclasses.dataclass(frozen=True)
class Found:
    """What is there already. Paths are those of the installed system."""

    files: dict[str, bytes] = dataclasses.field(default_factory=dict)
    links: dict[str, str] = dataclasses.field(default_factory=dict)
    directories: frozenset[str] = frozenset()
    tree: str = ""
    """The digest of the environment."""
    manifest: Manifest | None = None
    active: tuple[str, ...] = ()
    """Units of failstop that run."""
    udev: bool = False
    """udev runs, or could be told to read its rules again."""
    package: bool = False
    """The Debian package is installed."""
    configured_device: str = ""
    """What the instance's configuration, if there is one, says of the board's port."""
    device_there: bool = True
    """The board is plugged in; true if it would be looked for under a name that only the installation's rule makes."""
    board: bool = False
    """A board is plugged in that the rule gives a name."""
    fleet_key: bool = False
    """The fleet's key is where its unit wants it."""
    ros_setup: str = ""
    """What makes the environment of the ROS 2 that is there."""

    def rows(self, path: str) -> list[list[str]]:
        """The fields of a file of accounts, such as /etc/passwd, line by line."""
        lines = self.files.get(path, b"").decode().splitlines()
        return [line.split(":") for line in lines if line.count(":") >= 3]


def device_of(parts: Parts, request: Request, found: Found) -> str:
    """The board's port, as the service will have it: by the name that outlives a replug, where the rule gives one."""
    named = request.device or found.configured_device
    return named or (LINK if found.board else _example_device(parts.example.splitlines())[1])


def _example_device(lines: list[str]) -> tuple[int, str]:
    """Where the example says the board's port is: the line's number, and the path."""
    at = next(number for number, line in enumerate(lines) if line.startswith("path = "))
    return at, lines[at].split('"')[1]


def install(parts: Parts, request: Request, tree: str, found: Found) -> Plan:
    """The steps to what is wanted; `tree` is the digest of the environment to install, empty for none. Raises
    InstallError."""
    _refuse(parts, request, found)
    files, links = _files(parts, request), _links(parts, request)
    for extra in EXTRAS:
        files |= extra.files(parts, request, found)
        links |= extra.links(parts, request, found)
    gone = _outdated(found, files)
    new_tree = bool(tree) and tree != found.tree
    content = _file_steps(files, found) + _configuration(parts, request, found)
    besides = [step for extra in EXTRAS for step in extra.before(parts, request, found)]
    content += [step for step in besides if isinstance(step, File)]
    linking = [_link(path, target, found) for path, target in links.items() if found.links.get(path) != target]
    written = {step.path for step in content}
    reload = any(path.startswith(UNITS) for path in {*written, *(step.path for step in linking), *gone})
    restarts = found.active if new_tree or any(unit_file(unit) in written for unit in found.active) else ()
    missing = _missing_accounts(parts, found)
    directories = _directories(
        [*files, *links, PREFIX if new_tree else MANIFEST, *(step.path for step in content)], found
    )
    steps: list[Step] = [
        *stops(restarts),
        *_on_undo(request, reload, UDEV in written and found.udev),
        *directories,
        # First the list: what was cut short by a power failure can be taken away, or done again.
        *_listed(_manifest(parts, request, tree, found, files, links, directories), new_tree, found),
        *(Remove("remove", path, "of another version", path) for path in gone),
        *content,
        *([_make_accounts(parts, request)] if missing else []),
        *(step for step in besides if isinstance(step, Command)),
        *linking,
    ]
    starts = _starts(request, found, restarts)
    if not (steps or starts):
        return Plan((), _notes(request, found))
    steps += _told(request, found, reload, UDEV in written, CATALOG in written)
    if request.live and (new_tree or missing or content):
        steps.append(_check(request))
    return Plan((*steps, *starts), _notes(request, found), restarts)


def _listed(manifest: bytes, new_tree: bool, found: Found) -> list[Step]:
    """The environment with the list in it; the list alone, or nothing, if these are as they should be."""
    if new_tree:
        return [_tree(found, manifest)]
    return [File("", MANIFEST, "", MANIFEST, manifest)] if found.files.get(MANIFEST) != manifest else []


def _starts(request: Request, found: Found, restarts: tuple[str, ...]) -> list[Start]:
    if not (request.live and request.start):
        return []
    unit = unit_of(request.name)
    others = [extra.unit for extra in EXTRAS if extra.choice(request, found)]
    wanted = [name for name in (unit, *others) if name not in found.active]
    units = dict.fromkeys((*restarts, *wanted))
    remarks = {extra.unit: extra.remark for extra in EXTRAS}
    return [
        Start("start", unit, remarks.get(unit, "motion stays disabled until somebody enables it"), unit)
        for unit in sorted(units, key=lambda unit: unit in remarks)
    ]


def _refuse(parts: Parts, request: Request, found: Found) -> None:
    for extra in EXTRAS:
        extra.refuse(request, found)
    if found.package:
        raise InstallError(
            "the Debian package of failstop is installed here: it is the service already; "
            "remove it first (apt remove failstop) if you want another one"
        )
    if PREFIX in found.links:
        raise InstallError(f"{PREFIX} is a link to {found.links[PREFIX]}: remove it")
    if found.tree and found.manifest is None:
        raise InstallError(f"{PREFIX} is there, and is not an installation's: remove it, or move it away")
    if found.manifest and found.manifest.command != request.command:
        raise InstallError(
            f"an installation that runs {found.manifest.command} is here, this one would run {request.command}: "
            "`failstop uninstall` first; it keeps your configuration"
        )
    for path in (*files_of(), unit_file(unit_of(request.name)), configuration_of(request.name)):
        if (target := found.links.get(path)) == MASK:
            raise InstallError(f"{path} is masked: systemctl unmask {unit_of(request.name)}")
        if target is not None:
            raise InstallError(f"{path} is a link to {target}, and is not an installation's: remove it")
    if request.name != DEFAULT_NAME and not request.device and not found.configured_device:
        raise InstallError(f"robot {request.name!r} needs a board of its own: name its port with --device PATH")
    if request.device and found.configured_device not in ("", request.device):
        raise InstallError(
            f"{configuration_of(request.name)} says device.path = {found.configured_device!r}: "
            f"change it there to {request.device!r}, and call this without --device"
        )
    if not found.device_there and request.live and request.start and unit_of(request.name) not in found.active:
        raise InstallError(
            f"no device {device_of(parts, request, found)}: plug the board in, name another port with "
            "--device PATH, or say --no-start, and the service is started at the next boot"
        )


def files_of() -> tuple[str, ...]:
    """The files that every installation has, whatever its settings."""
    return (
        *(f"{UNITS}/{name}" for name in OWN_UNITS),
        SYSUSERS,
        UDEV,
        CATALOG,
        MANUAL,
        *COMPLETIONS.values(),
    )


def _files(parts: Parts, request: Request) -> dict[str, tuple[bytes, str]]:
    """Content and remark of every file but the configuration."""
    units = [parts.units[name].replace(UNIT_COMMAND, request.command).encode() for name in OWN_UNITS]
    shells = [parts.completions[shell] for shell in COMPLETIONS]
    rest = [text.encode() for text in (parts.sysusers, parts.udev, parts.catalog, parts.manual, *shells)]
    remarks = (
        "the service",
        "services of further robots, failstop@NAME",
        "stops the wheels before the machine sleeps",
        "goes on trying, where an ended service could not stop the wheels",
        "its user and group",
        "the board's port: a name, its rights, nobody else touches it",
        "explanations for journalctl -x",
        "the manual, man failstop",
        *(f"completion for {shell}" for shell in COMPLETIONS),
    )
    return dict(zip(files_of(), zip((*units, *rest), remarks, strict=True), strict=True))


def _links(parts: Parts, request: Request) -> dict[str, str]:
    links = {COMMAND_LINK: request.command}
    for unit in (unit_of(request.name), SLEEP):
        source = unit_file(unit)
        targets = wanted_by(parts.units[source.rpartition("/")[2]])
        links |= {f"{UNITS}/{target}.wants/{unit}": source for target in targets}
    return links


def _file_steps(files: dict[str, tuple[bytes, str]], found: Found) -> list[File]:
    steps = []
    for path, (data, remark) in files.items():
        there = found.files.get(path)
        if there is None:
            steps.append(File("create", path, remark, path, data))
        elif there != data:
            known = found.manifest.files.get(path) if found.manifest else None
            by_hand = "" if sha256(there) == known else "; it was changed by hand"
            steps.append(File("replace", path, remark + by_hand, path, data))
    return steps


def _configuration(parts: Parts, request: Request, found: Found) -> list[File]:
    """The example, unless there is a configuration: that is the user's, and stays as it is."""
    path = configuration_of(request.name)
    if path in found.files:
        return []
    lines = parts.example.splitlines(keepends=True)
    at, _ = _example_device(lines)
    device = device_of(parts, request, found)
    lines[at] = f'path = "{device}"\n'
    return [File("create", path, f"your settings; the board at {device}", path, "".join(lines).encode())]


def _link(path: str, target: str, found: Found) -> Link:
    if path in found.files:
        raise InstallError(f"{path} is a file, and is not an installation's: remove it, or move it away")
    remark = "the command" if path == COMMAND_LINK else "before a sleep" if path.endswith(SLEEP) else "starts at boot"
    return Link("replace" if path in found.links else "create", path, remark, path, target)


def _outdated(found: Found, files: dict[str, tuple[bytes, str]]) -> list[str]:
    """Files of another version that this one has not."""
    return [path for path in found.manifest.files if path not in files] if found.manifest else []


def _directories(paths: list[str], found: Found) -> list[Directory]:
    needed = dict.fromkeys(part for path in paths for part in parents(path) if part not in found.directories)
    return [Directory("", path, "", path) for path in needed]


def _tree(found: Found, manifest: bytes) -> Tree:
    verb = "replace" if found.tree else "create"
    return Tree(verb, PREFIX, "failstop and what it needs, copied from here", PREFIX, manifest)


def stops(units: tuple[str, ...]) -> list[Command]:
    """Stop units that run; undone by starting them."""
    again = ("systemctl", "start", "--no-block")
    return [Command("stop", unit, "THE WHEELS STOP", ("systemctl", "stop", unit), (*again, unit)) for unit in units]


def _on_undo(request: Request, reload: bool, udev: bool) -> list[Command]:
    """What is to be told of the files once they are back as they were: undone last, so it comes first."""
    told: list[tuple[str, ...]] = []
    if request.live and reload:
        told.append(RELOAD)
    if request.live and udev:
        told.append(UDEV_RELOAD)
    return [Command("", " ".join(words), "", (), words) for words in told]


def _missing_accounts(parts: Parts, found: Found) -> bool:
    users, memberships = accounts(parts.sysusers)
    passwd = {row[0] for row in found.rows("/etc/passwd")}
    groups = {row[0]: row[3].split(",") for row in found.rows("/etc/group")}
    return not all(user in passwd and user in groups for user in users) or not all(
        user in groups.get(group, ()) for user, group in memberships
    )


def _make_accounts(parts: Parts, request: Request) -> Command:
    users, memberships = accounts(parts.sysusers)
    lines = [line for line in parts.sysusers.splitlines() if line.strip() and not line.startswith("#")]
    root = () if request.live else (f"--root={request.root}",)
    groups = ", ".join(group for _, group in memberships)
    remark = f"the service runs as it{f'; in the groups of {groups}' if groups else ''}"
    return Command(
        "create",
        f"user and group {', '.join(users)}",
        remark,
        ("systemd-sysusers", *root, "--inline", *lines),
        touches=ACCOUNT_FILES,
    )


def _manifest(
    parts: Parts,
    request: Request,
    tree: str,
    found: Found,
    files: dict[str, tuple[bytes, str]],
    links: dict[str, str],
    directories: list[Directory],
) -> bytes:
    before = found.manifest
    made = [step.path for step in directories]
    return Manifest(
        parts.version,
        request.command,
        tree,
        {path: sha256(data) for path, (data, _) in files.items()},
        {**(before.links if before else {}), **links},
        tuple(dict.fromkeys([*(before.directories if before else ()), *made])),
    ).dump()


def _told(request: Request, found: Found, reload: bool, udev: bool, catalog: bool) -> list[Command]:
    """Those who are to read the new files."""
    told = [update_catalog(request)] if catalog else []
    if request.live and reload:
        told.append(run(*RELOAD))
    if request.live and udev and found.udev:
        told += [run(*UDEV_RELOAD), run("udevadm", "trigger", "--subsystem-match=tty")]
        told.append(run("udevadm", "settle", f"--timeout={SETTLE_S}", accepted=(0, 1)))
    return told


def run(*words: str, accepted: tuple[int, ...] = (0,)) -> Command:
    """A program of the system, shown as it is called."""
    return Command("run", " ".join(words), "", words, accepted=accepted)


def update_catalog(request: Request) -> Command:
    """Have the journal read its catalog."""
    words = ("journalctl", *(() if request.live else (f"--root={request.root}",)), "--update-catalog")
    return Command("run", " ".join(words), "", words, touches=(CATALOG_DATABASE,))


def _check(request: Request) -> Command:
    """That the service's user can run what was installed, before anything is started."""
    who = ("setpriv", "--reuid=failstop", "--regid=failstop", "--clear-groups")
    words = (*who, request.command, "config", "--check", configuration_of(request.name))
    return Command("check", "that the user failstop can run it", "", words)


def _notes(request: Request, found: Found) -> tuple[str, ...]:
    notes = []
    if configuration_of(request.name) in found.files:
        notes.append(f"{configuration_of(request.name)} is yours and stays as it is")
    if request.live and not found.udev:
        notes.append("udev does not run here: its rule takes effect when it does")
    return tuple(notes)
