"""What an installation would do, or taking it away, from rows, what is wanted and what is there. Nothing is done."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import PurePosixPath

from failstop import config
from failstop.discovery import BOARD_VID, LINK
from failstop.fleet.settings import PLACE
from failstop.install import InstallError, rows
from failstop.install.do import Discard, Put, Run, Start, Step
from failstop.install.rows import EXTRAS, FLEET, OWN, PORT_GROUP, UNITS, USER, Extra, Row
from failstop.install.system import MANIFEST, MANIFEST_NAME, PREFIX, RUNTIME, STATE, Content, Manifest, System, sha256
from failstop.install.tree import Entry, Environment
from failstop.instances import unit_of
from failstop.policy.settings import BY_KEY
from failstop.shm.instance import DEFAULT_NAME
from failstop.version import VERSION

DEVICE = "device.path"
NAME_BOARD = (
    ("udevadm", "trigger", "--subsystem-match=tty"),
    ("udevadm", "trigger", "--subsystem-match=usb", f"--attr-match=idVendor={BOARD_VID:04x}"),
    ("udevadm", "settle", "--timeout=5"),
)
"""Have the new rule name a board that is plugged in, and treat its USB device; where that takes longer the service
waits for it."""
NO_SUCH_GROUP = 6
"""groupdel's exit code, when userdel has taken the group along."""
ACCOUNT_FILES = (
    *(f"/etc/{name}{backup}" for name in ("passwd", "group", "shadow", "gshadow") for backup in ("", "-")),
    "/etc/.pwd.lock",
)
CATALOG_DATABASE = "/var/lib/systemd/catalog/database"


@dataclasses.dataclass(frozen=True)
class Request:
    """What the user asked for."""

    name: str = DEFAULT_NAME
    device: str = ""
    """The board's port; empty: the setting's default."""
    start: bool = True
    command: str = rows.UNIT_COMMAND
    """What the units call; another than the default: no environment is made."""
    extras: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """The words of the extras that are asked for, by option."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """The steps in their order, and what to say besides."""

    steps: tuple[Step, ...]
    notes: tuple[str, ...] = ()
    restarts: tuple[str, ...] = ()
    """Units that run now and are stopped for it: the wheels stop, and motion has to be enabled again."""


def install(texts: Mapping[str, str], request: Request, environment: Environment | None, system: System) -> Plan:
    """The steps to what is wanted; without an environment the units call another one. Raises InstallError, and
    SettingError where this version refuses the settings that are there."""
    before = system.manifest or Manifest()
    there = chosen(request, system)
    wanted = _wanted(texts, request, there, system)
    _refuse(request, wanted, system)
    settings = _settings(texts, request, there, system)
    files = {put.subject: sha256(put.content) for put in wanted if isinstance(put.content, bytes)}
    links = {put.subject: put.content for put in wanted if isinstance(put.content, str)}
    gone = [_put(path, None, system, "of another version") for path in before.files if path not in files]
    puts = _differing([*gone, *wanted, *settings], system)
    changed = {put.subject for put in puts}
    if environment and environment.is_at(system.at(PREFIX), MANIFEST_NAME):
        environment = None
    running = active(system)
    restarts = running if environment or any(rows.unit_file(unit) in changed for unit in running) else ()
    accounts = _make_accounts(system)
    paths = (PREFIX, *(put.subject for put in (*wanted, *settings)))
    folders = {str(folder) for path in paths for folder in PurePosixPath(path).parents}
    made = {folder for folder in folders if not os.path.isdir(system.at(folder))}
    directories = tuple(sorted({*before.directories, *made}))
    manifest = Manifest(VERSION, request.command, files, {**before.links, **links}, directories)
    undoing, told = _telling(changed, system)
    steps = [
        *_stops(restarts),
        *undoing,
        # First the list: what was cut short by a power failure can be taken away, or done again.
        *_listing(manifest, environment, system),
        *puts,
        *accounts,
        *told,
        *(_run(*words, accepted=(0, 1)) for words in NAME_BOARD if rows.UDEV in changed and system.udev),
        *([_check(request)] if system.live and (environment or accounts or changed - links.keys()) else ()),
        *(_starts(request, there, running, restarts) if system.live and request.start else ()),
    ]
    configuration = config.file_of(request.name)
    notes = {
        f"{configuration} is yours and stays as it is": configuration not in {put.subject for put in settings},
        "udev does not run here: its rule takes effect when it does": system.live and not system.udev,
    }
    return Plan(tuple(steps), tuple(note for note, holds in notes.items() if holds), restarts)


def uninstall(system: System, purge: bool = False) -> Plan:
    """The steps that take everything away, configuration and logs only with `purge`. Raises InstallError."""
    if system.manifest is None and purge and not system.package:
        return Plan(tuple(_purge(system)))
    manifest, running = _listed_by(system), active(system)
    own = manifest.command == rows.UNIT_COMMAND
    steps = [
        *_take([*manifest.links, *manifest.files], running, "*", system),
        Discard("remove", PREFIX, "the Python environment" if own else "the list of what was installed"),
        *(_purge(system) if purge else ()),
        *(Discard("", path, only_empty=True) for path in reversed(manifest.directories)),
    ]
    kept = f"{config.FOLDER}, {STATE} and the user {USER} stay; --purge removes them too"
    return Plan(tuple(steps), () if purge else (kept,), running)


def uninstall_instance(name: str, system: System, purge: bool = False) -> Plan:
    """The steps that take one instance away and leave the rest. Raises InstallError."""
    manifest, unit = _listed_by(system), unit_of(name)
    gone = [path for path in manifest.links if path.startswith(UNITS) and path.endswith(f"/{unit}")]
    if not gone:
        raise InstallError(f"no instance {name!r} is installed")
    running = tuple(found for found in active(system) if found == unit)
    left = {path: target for path, target in manifest.links.items() if path not in gone}
    steps: list[Step] = [
        *_take(gone, running, name, system, "no longer starts at boot"),
        *_listing(dataclasses.replace(manifest, links=left), None, system),
    ]
    if purge:
        steps += _differing([_put(config.file_of(name), None, system, "your settings")], system)
        steps.append(Discard("remove", f"{STATE}/{name}", "logs and incidents"))
    return Plan(tuple(steps), (), running)


def chosen(request: Request, system: System) -> dict[Row, str]:
    """The rows that are to be there; of the extras those that are asked for, or are there, each with its word. Raises
    InstallError where one can't be."""
    found: dict[Row, str] = dict.fromkeys(OWN, "")
    for extra in EXTRAS:
        if word := request.extras.get(extra.option, ""):
            if request.name != DEFAULT_NAME:
                only = f"its unit is for the robot {DEFAULT_NAME!r} alone, not {request.name!r}"
                raise InstallError(f"{extra.option}: {only}")
            if problem := extra.problem(word, system):
                raise InstallError(f"{extra.option}{problem}")
            found[extra] = word
        elif system.manifest and extra.place in system.manifest.files:
            text = system.content(extra.place)
            found[extra] = extra.word_of(text.decode() if isinstance(text, bytes) else "")
    return found


def active(system: System) -> tuple[str, ...]:
    """The units of failstop that run."""
    return system.active((rows.SERVICE, "failstop@*.service", *(extra.source for extra in EXTRAS)))


def configured_device(request: Request, system: System) -> str:
    """What the instance's settings say of the board's port; empty: it has none. Raises SettingError."""
    path = system.at(config.file_of(request.name))
    return str(config.load(path).flat()[DEVICE]) if os.path.exists(path) else ""


def device_of(request: Request, system: System) -> str:
    """The board's port, as the service will have it: by the name that outlives a replug, where the rule gives one."""
    named = request.device or configured_device(request, system)
    return named or (LINK if system.board else str(BY_KEY[DEVICE].default))


def refuse_absent(request: Request, system: System) -> None:
    """Raise InstallError where the service could not be started for want of its board."""
    device = device_of(request, system)
    # A name that only the rule makes is there when the rule is.
    if device == LINK or os.path.exists(device) or unit_of(request.name) in active(system):
        return
    if system.live and request.start:
        raise InstallError(
            f"no device {device}: plug the board in, name another port with "
            "--device PATH, or say --no-start, and the service is started at the next boot"
        )


def _refuse(request: Request, wanted: Collection[Put], system: System) -> None:
    if system.package:
        raise InstallError(
            "the Debian package of failstop is installed here: it is the service already; "
            "remove it first (apt remove failstop) if you want another one"
        )
    configuration = config.file_of(request.name)
    if not system.manifest and system.holds(PREFIX):
        raise InstallError(f"{PREFIX} is there, and is not an installation's: remove it, or move it away")
    for put in (Put("", PREFIX), *wanted, Put("", configuration)):
        path, found = put.subject, system.content(put.subject)
        if isinstance(found, bytes) and isinstance(put.content, str):
            raise InstallError(f"{path} is a file, and is not an installation's: remove it, or move it away")
        if isinstance(found, str) and not isinstance(put.content, str):
            masked = found == os.devnull and path.startswith(UNITS)
            remedy = f"systemctl unmask {os.path.basename(path)}" if masked else "remove it"
            raise InstallError(f"{path} is a link to {found}, and is not an installation's: {remedy}")
    if system.manifest and system.manifest.command != request.command:
        raise InstallError(
            f"an installation that runs {system.manifest.command} is here, this one would run {request.command}: "
            "`failstop uninstall` first; it keeps your configuration"
        )
    configured = configured_device(request, system)
    if request.name != DEFAULT_NAME and not request.device and not configured:
        raise InstallError(f"robot {request.name!r} needs a board of its own: name its port with --device PATH")
    if request.device and configured not in ("", request.device):
        raise InstallError(
            f"{configuration} says device.path = {configured!r}: "
            f"change it there to {request.device!r}, and call this without --device"
        )


def _wanted(texts: Mapping[str, str], request: Request, there: Mapping[Row, str], system: System) -> list[Put]:
    """Every file but the settings, and every link: the command's, and those of what starts with the machine."""
    files, links = [], [_put(rows.COMMAND_LINK, request.command, system, "the command")]
    listed = system.manifest.files if system.manifest else {}
    for row, word in there.items():
        text, remark = row.filled(texts[row.source], word, system)
        if row.place.startswith(UNITS):
            text = text.replace(rows.UNIT_COMMAND, request.command)
        old = system.content(row.place)
        by_hand = isinstance(old, bytes) and sha256(old) != listed.get(row.place)
        files.append(_put(row.place, text.encode(), system, remark + "; it was changed by hand" * by_hand))
        if row.boot:
            unit = unit_of(request.name) if row.source == rows.SERVICE else row.source
            source = rows.unit_file(unit)
            for target in rows.wanted_by(texts[os.path.basename(source)]):
                why = "before a sleep" if target == "sleep.target" else "starts at boot"
                links.append(_put(f"{UNITS}/{target}.wants/{unit}", source, system, why))
    return files + links


def _settings(texts: Mapping[str, str], request: Request, there: Collection[Row], system: System) -> list[Put]:
    """The examples, where there are no settings: those are the user's, and stay as they are."""
    device = device_of(request, system)
    # What JSON writes a text as, TOML reads as that text.
    said = json.dumps(device, ensure_ascii=False)
    text = texts[rows.SETTINGS].replace(json.dumps(BY_KEY[DEVICE].default), said, 1)
    examples = [_put(config.file_of(request.name), text.encode(), system, f"your settings; the board at {device}")]
    if FLEET in there:
        text = texts[rows.FLEET_SETTINGS]
        examples.append(_put(PLACE, text.encode(), system, "where its broker is: look at it"))
    return [put for put in examples if put.verb == "create"]


def _put(path: str, content: Content, system: System, remark: str = "") -> Put:
    """The step to a file, a link or nothing at a path."""
    verb = "remove" if content is None else "create" if system.content(path) is None else "replace"
    return Put(verb, path, remark, content)


def _differing(puts: Sequence[Put], system: System) -> list[Put]:
    """Those of which something else is there."""
    return [put for put in puts if put.content != system.content(put.subject)]


def _listing(manifest: Manifest, environment: Environment | None, system: System) -> list[Put]:
    """The list of what is installed: in the new environment; or alone, and not shown."""
    listed = manifest.dump()
    if not environment:
        return _differing([Put("", MANIFEST, content=listed)], system)
    whole = dataclasses.replace(environment, entries=(*environment.entries, Entry(MANIFEST_NAME, listed)))
    verb = "replace" if system.holds(PREFIX) else "create"
    return [Put(verb, PREFIX, "failstop and what it needs, copied from here", whole)]


def _listed_by(system: System) -> Manifest:
    """What was installed. Raises InstallError."""
    if system.manifest:
        return system.manifest
    if system.package:
        raise InstallError(
            "failstop is installed as a Debian package here: apt remove failstop (apt purge failstop: all of it)"
        )
    raise InstallError("no installation of `failstop install` is here; --purge removes what an earlier one has left")


def _starts(
    request: Request, there: Collection[Row], running: Collection[str], restarts: Collection[str]
) -> list[Start]:
    """Of what is to run and does not, or is stopped for it: the service first. systemd makes its directories, and
    leaves them."""
    remarks = {row.source: row.started for row in there if isinstance(row, Extra)}
    units = [*restarts, *(unit for unit in (unit_of(request.name), *remarks) if unit not in running)]
    service = "motion stays disabled until somebody enables it"
    return [
        Start("start", unit, remarks.get(unit, service), undo=("systemctl", "stop", unit), changes=(STATE, RUNTIME))
        for unit in sorted(units, key=lambda unit: unit in remarks)
    ]


def _take(gone: Collection[str], units: Collection[str], name: str, system: System, remark: str = "") -> list[Step]:
    """Files and links go, after the service's end, and that of whoever still tries to stop a board that could not be
    stopped, because of the end just now for one."""
    late = Run("", f"who tries to stop {name}", words=("systemctl", "stop", rows.LATE.replace("@", f"@{name}")))
    undoing, told = _telling(gone, system)
    removing = _differing([_put(path, None, system, remark) for path in gone], system)
    return [*_stops(units), *([late] if system.live else []), *undoing, *removing, *told]


def _stops(units: Collection[str]) -> list[Run]:
    """Stop units that run; undone by starting them."""
    again = ("systemctl", "start", "--no-block")
    return [Run("stop", unit, "THE WHEELS STOP", ("systemctl", "stop", unit), (*again, unit)) for unit in units]


def _telling(changed: Collection[str], system: System) -> tuple[list[Run], list[Run]]:
    """Who has read these files is told: when they are back as they were, which is undone last and so comes first; and
    when they are new, or gone."""
    readers = {
        ("systemctl", "daemon-reload"): system.live and any(path.startswith(UNITS) for path in changed),
        ("udevadm", "control", "--reload"): system.udev and rows.UDEV in changed,
    }
    told = [words for words, holds in readers.items() if holds]
    catalog = ("journalctl", *system.root_option, "--update-catalog")
    new = [_run(*catalog, changes=(CATALOG_DATABASE,))] if rows.CATALOG in changed else []
    return [Run("", " ".join(words), undo=words) for words in told], [*new, *(_run(*words) for words in told)]


def _run(*words: str, changes: tuple[str, ...] = (), accepted: tuple[int, ...] = (0,)) -> Run:
    """A program of the system, shown as it is called."""
    return Run("run", " ".join(words), words=words, changes=changes, accepted=accepted)


def _make_accounts(system: System) -> list[Run]:
    """The service's user and its groups, where one is missing."""
    there = all(USER in system.accounts(kind) for kind in ("passwd", "group"))
    if there and USER in system.members(PORT_GROUP):
        return []
    remark = f"the service runs as it; in the groups of {PORT_GROUP}"
    words = ("systemd-sysusers", *system.root_option, os.path.basename(rows.SYSUSERS))
    return [Run("create", f"user and group {USER}", remark, words, changes=ACCOUNT_FILES)]


def _purge(system: System) -> list[Step]:
    """What an installation leaves, and what an earlier uninstall has left."""
    steps: list[Step] = [
        Discard("remove", config.FOLDER, "your configuration"),
        Discard("remove", STATE, "logs and incidents"),
        *([Discard("", RUNTIME)] if system.live else []),
    ]
    # With another home it is a person's, or another program's.
    if system.accounts("passwd").get(USER, [])[5:6] == [STATE]:
        prefix = () if system.live else ("--prefix", system.root)
        user, group = ((program, *prefix, USER) for program in ("userdel", "groupdel"))
        steps.append(Run("remove", f"user {USER}", words=user, changes=ACCOUNT_FILES))
        accepted = (0, NO_SUCH_GROUP)
        steps.append(Run("", f"group {USER}", words=group, changes=ACCOUNT_FILES, accepted=accepted))
    return steps


def _check(request: Request) -> Run:
    """That the service's user can run what was installed, before anything is started."""
    who = ("setpriv", f"--reuid={USER}", f"--regid={USER}", "--clear-groups")
    words = (*who, request.command, "config", "--check", config.file_of(request.name))
    return Run("check", f"that the user {USER} can run it", words=words)
