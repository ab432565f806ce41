"""The checks of the service: whether it runs, its version and its settings, its clients, and the settings of systemd
and logind."""

from __future__ import annotations

import os
import shlex

from failstop import config
from failstop.api import host, verdict, words
from failstop.api.snapshot import Process, State
from failstop.board.asking import Unknown
from failstop.board.interface import BY_IMU
from failstop.doctor.look import OK, Finding, Look, fail, ok, skip, warn
from failstop.files import root
from failstop.files.instance import option
from failstop.instances import unit_of
from failstop.policy import scale, servos
from failstop.policy.processes import ROLES
from failstop.supervisor.fit import checked_board
from failstop.version import VERSION

FIRST_REGULAR_UID = 1000
"""logind's RemoveIPC does not touch system users, whose uids are below this in Debian and Ubuntu."""
LOGIND = "/etc/systemd/logind.conf.d"
OFF = "cut the motors' power with the POWER SWITCH"
UNIT_USER = "failstop"
"""The user of the service's systemd unit."""
EACH_RUN_S = ("gate.lease_s", "device.path")
HIDES = {"ProtectHome": ("/home/", "/root/", "/run/user/"), "PrivateTmp": ("/tmp/", "/var/tmp/")}
"""The settings of systemd that hide folders from the service."""
UNSEEN = "this user can't see who runs the service (/proc is mounted with hidepid)"
MOST_NAMED = 4
"""How many settings one finding names."""
ALONE = "nothing else on this robot measures its speed, so failstop can't notice if board.per_rps is wrong"
REMOVE_IPC = ("org.freedesktop.login1", "/org/freedesktop/login1", "org.freedesktop.login1.Manager", "RemoveIPC")
"""Where logind's RemoveIPC can be read over D-Bus."""


def settings(look: Look) -> list[Finding]:
    """Check the settings file, who may change it, and whether the running service uses other settings than those in
    it."""
    path, _, _ = look.settings
    if path and (found := _unreadable(look, path)):
        return found
    if problem := _refused(look):
        text = f"{problem}; the service won't start until this is fixed"
        return fail(text, f"failstop config --check {shlex.quote(path)}", "check the file again after you fix it")
    where = look.system.exposed(path) if path else ""
    found = fail(*config.exposed(path, where)) if where else []
    return found + [row for row in _compared(look, path) if not found or row.level != OK]


def _compared(look: Look, path: str) -> list[Finding]:
    """Check whether the running service uses other settings than those in the file."""
    if look.state and (others := _others(look)):
        named = (
            f"{', '.join(others[:MOST_NAMED])}{f' and {len(others) - MOST_NAMED} more' * (len(others) > MOST_NAMED)}"
        )
        if not path:
            return ok(f"no installed file; {look.name!r} runs with settings of its own ({named})")
        text = f"{look.name!r} runs with other settings than those in {path}: {named}"
        return warn(text, "", "restart the service to use the file's; that stops the wheels")
    return ok(path or "no file: every setting has its default")


def unit_user(look: Look) -> str:
    """The name of the user as whom systemd runs the service's unit."""
    return look.unit.get("User", UNIT_USER) or "root"


def _unreadable(look: Look, path: str) -> list[Finding]:
    """Check whether the service's user and this user can read the settings file. Empty if both can."""
    system, path = look.system, os.path.abspath(path)
    by_unit = _starts_with(look, path) and not look.state
    user = unit_user(look) if by_unit else system.owner(f"/proc/{look.pid}")
    uid = system.account(user) if by_unit else system.uid(f"/proc/{look.pid}")
    if uid >= 0 and (closed := system.barrier(path, uid)):
        text = f"{path} can't be read by {user}"
        if closed in (path, os.path.realpath(path)):
            return fail(f"{text}, so the service won't start", f"sudo chmod 644 {shlex.quote(path)}")
        return fail(f"{text}, because {closed} keeps that user out, so the service won't start", *_copied(look, path))
    if hidden := _hidden(look, path):
        place, setting = hidden
        text = f"{path} leads to {place}, which {setting} hides from the service, so the service won't start"
        return fail(text, *_copied(look, path))
    if system.barrier(path, system.uid("/proc/self")):
        return skip(f"this user can't read {path}, so its settings were not checked", f"sudo failstop {look.again()}")
    return []


def _starts_with(look: Look, path: str) -> bool:
    """True if the unit starts the service with this settings file, as far as is known."""
    start = look.unit.get("ExecStart", "")
    return bool(look.unit) and (not start or f"--config {path} " in start)


def _hidden(look: Look, path: str) -> tuple[str, str] | None:
    """The last place on the way to the settings file that systemd hides from the unit's service, and the setting that
    hides it. None if there is no such place."""
    by_unit = not look.state or look.unit.get("MainPID") == look.pid
    if not (by_unit and _starts_with(look, path)):
        return None
    for place in reversed(look.system.through(path)):
        for setting, folders in HIDES.items():
            value = look.unit.get(setting, "no")
            if value not in ("", "no", "read-only") and f"{place}/".startswith(folders):
                return place, f"{setting}={value}"
    return None


def _copied(look: Look, path: str) -> tuple[str, str]:
    """How to put a settings file to a place where the service can read it. Returns (a command, what else to do)."""
    installed, real = config.installed(look.name), os.path.realpath(path)
    if not look.unit or real == installed:
        return "", f"move the file to a folder that the service's user may enter, such as {config.FOLDER}"
    move = f"sudo install -m 644 {shlex.quote(real)} {shlex.quote(installed)}"
    return move, "or let the service in there (the drop-ins in docs/service.md)"


def _refused(look: Look) -> str:
    """Why the service does not start with the settings in the file. Empty if it does."""
    path, found, problem = look.settings
    if not problem:
        try:
            checked_board(found, path)
        except ValueError as error:
            return str(error)
    return problem


def _others(look: Look) -> list[str]:
    """The keys of the settings in which the running service differs from the file. Two keys are left out, because they
    may differ without a fault: the service's rights may change the lease, and an option may set the port."""
    # The service caps the speeds while nobody has confirmed the scale, so a restart would cap the file's too.
    found = scale.capped(look.settings[1], assumed=look.board.scale_assumed).flat()
    return [
        key for key, value in look.active_settings.flat().items() if key not in EACH_RUN_S and found.get(key) != value
    ]


def running(look: Look) -> list[Finding]:
    """Check whether the service and each of its processes run, whether it reaches the board, and what is wrong with its
    IMU, arm and servos."""
    state, version, problem = look.service
    if problem:
        fix = f"sudo systemctl restart {unit_of(look.name)}" if look.unit.get("ActiveState") == "active" else ""
        return fail(problem, fix, "restarting the service helps; it also stops the wheels")
    if state is None:
        return _not_running(look)
    absent = _absent(look, state)
    found = _served(look, state, version)
    return absent + [row for row in found if row.level != OK] if absent else found


def _absent(look: Look, state: State) -> list[Finding]:
    """Find each process of the service that is not running, for example because it is suspended or hangs."""
    found = []
    for name, process in state.processes.items():
        if process.state == "running":
            continue
        ended = f"{'was ' * process.killed}{process.last_exit}" if process.last_exit else ""
        who = f"{name}{f' (pid {process.pid})' if process.pid else ''}"
        text = f"{who} {verdict.absence(process, ended)}; it is the process of {look.name!r} that {ROLES[name]}"
        # A process that is starting needs no help yet.
        found += (warn if process.state == "starting" else fail)(text, *_revived(look, process))
    return found


def _revived(look: Look, process: Process) -> tuple[str, str]:
    """How to get a process back that is not running. Returns (a command, what else to do)."""
    restart = f"sudo systemctl restart {unit_of(look.name)}" if look.unit.get("MainPID") == look.pid else ""
    if process.state == "suspended":
        return f"sudo kill -CONT {process.pid}", "or type `fg` in its terminal"
    if process.state == "dead":
        return host.start(look.name).strip("`"), f"if the wheels turn: {OFF}"
    if process.state == "hanging":
        why = f"failstop why{option(look.name)}"
        return restart or why, "if it does not come back, restart the service; that stops the wheels"
    return f"failstop why{option(look.name)}", "it says what to do next"


def _served(look: Look, state: State, version: str) -> list[Finding]:
    """Check whether a running service reaches the board, and what is wrong with its IMU, arm and servos."""
    user, newer = look.system.owner(f"/proc/{look.pid}"), "" if version == VERSION else f", this command is {VERSION}"
    who = f", user {user}" if user else ""
    where = f"{look.name!r} is running (pid {look.pid}{who}, failstop {version}{newer})"
    if state.device.state != "open":
        return fail(f"{where}, and {verdict.unreached(state)}", f"failstop why --name {look.name}", OFF)
    if state.device.link == "deaf":
        return fail(f"{where}, and the board does not hear", "", f"{OFF}, then check the cable to the board")
    if state.device.link == "silent":
        text = f"{where}, and {verdict.doubt(state)}"
        return fail(text, f"failstop why --name {look.name}", f"{OFF}, then check the board's power and its cable")
    if state.device.link == "unheard":
        text = f"{where}, and {state.device.path} has not answered since it came back: it may not be the board"
        return fail(text, f"failstop why --name {look.name}", OFF)
    if doubt := verdict.doubt(state):
        return fail(f"{where}, and {doubt}", f"failstop why --name {look.name}", OFF)
    if waits := state.waiting_for or (state.device.link == "unproven" and "the board's first answer"):
        return warn(f"{where} and waits for {waits}", f"failstop status --name {look.name}")
    motion = f"a stop is latched: {state.cause}" if state.cause else f"motion {'en' if state.enabled else 'dis'}abled"
    found = ok(f"{where}, device {state.device.state}, {verdict.LINKS[state.device.link]}, {motion}")
    if state.imu is None and look.board.observed_by == BY_IMU:
        text = "no IMU reports, so nothing observes whether the wheels are still"
        off = ok(f"{text} (board.imu is off)")
        found += warn(text, "", 'set board.imu = "off" for a robot without one') if state.device.imu else off
    wrong = [f"the arm: {text}" for text in (state.arm.wrong if state.arm else ())]
    wrong += servos.hot(state.servos, look.active_settings)
    wrong += [f"{part}: {text}" for part, text in state.servos_wrong.items()]
    return found + [row for text in wrong for row in warn(text, f"failstop status --name {look.name}")]


def _not_running(look: Look) -> list[Finding]:
    text = (
        f"no service named {look.name!r} is running, so nothing drives through failstop, and nothing stops the wheels"
    )
    if others := look.system.services():
        text += f" (running: {', '.join(others)})"
    if look.node is None:
        return warn(text, "", "fix the port first")
    if look.unit:
        return warn(text, f"sudo systemctl start {unit_of(look.name)}")
    config = f" --config {shlex.quote(look.settings[0])}" if look.settings[0] else ""
    return warn(text, f"failstop run{option(look.name)}{config} --device {shlex.quote(look.device[0])}")


def wheels_scale(look: Look) -> list[Finding]:
    """Check whether the wheels turn as fast as commanded."""
    fix = f"failstop setup{option(look.name)}"
    if look.state is None:
        if isinstance(look.board, Unknown):
            return []
        if look.board.scale_assumed:
            return warn(scale.cap_text(scale.capped(look.active_settings, assumed=True)), fix)
        return ok(f"board.per_rps is {look.board.per_rps:g}, and the next drive shows whether it is right")
    known = look.state.scale
    if known.capped:
        return warn(known.capped, fix)
    if known.wrong:
        return [row for text in known.wrong for row in warn(text, "", "correct the setting and restart the service")]
    seen = [(known.wheels, "as the board reports them"), (known.turn, "as the gyro measures the turn")]
    said = [f"{share:.2f} times as fast as commanded, {by}" for share, by in seen if share is not None]
    if known.remarks:
        return [row for text in known.remarks for row in ok(text)]
    if said:
        return ok(f"they turn {', and '.join(said)}")
    if isinstance(look.board, Unknown):
        return []  # the check of the board reports this
    independent = look.board.reports.own_scale or look.active_settings.on("board.imu")
    way = "drive" if look.board.reports.own_scale else "curve"
    return ok(f"not compared yet; the next {way} will show it" if independent else ALONE)


def clients(look: Look) -> list[Finding]:
    """Show what clients report about themselves."""
    found = []
    for who, sees, wrong in words.said(look.state) if look.state else ():
        found += warn(f"{who}: {wrong}", f"failstop why --name {look.name}") if wrong else ok(f"{who}: {sees}")
    return found or ok("no program reports anything about itself")


def unit(look: Look) -> list[Finding]:
    """Check the service's systemd unit."""
    name, found = unit_of(look.name), look.unit
    if look.unit_unknown:
        return skip(f"systemd can't be asked about {name}, or takes too long", f"systemctl status {name}")
    if not found:
        none = f"systemd has no unit {name}" if look.system.booted() else "systemd is not running here"
        text = f"{none}, so nothing starts the service at boot or after a crash"
        advice = (
            "install the Debian package, which has the unit (docs/install.md); in a container, let the "
            "container's runtime restart it"
        )
        return warn(text, "", advice)
    active, result, restarts = (found.get(key, "") for key in ("ActiveState", "Result", "NRestarts"))
    if active == "failed" or result not in ("", "success") or restarts not in ("", "0"):
        text = f"{name} is {active} ({found.get('SubState')}; result: {result}; restarted by systemd: {restarts})"
        return (warn if active == "active" else fail)(text, f"journalctl -xeu {name}")
    if found.get("UnitFileState") not in ("enabled", "enabled-runtime", "static"):
        return warn(f"{name} is {active}, but it does not start at boot", f"sudo systemctl enable {name}")
    return ok(f"{name} is {active}, and it starts at boot")


def state_directory(look: Look) -> list[Finding]:
    """Check whether the service can write to its state directory (incidents, the battery's log, the page's keys)."""
    system, process = look.system, f"/proc/{look.pid}"
    by_unit = look.unit and (not look.state or look.unit.get("MainPID") == look.pid)
    environ = {"STATE_DIRECTORY": f"{root.SYSTEM_BASE}/{look.name}"} if by_unit else system.environ(look.pid)
    if environ is None:
        return skip("this user can't see where the service keeps its incidents", f"sudo failstop {look.again()}")
    uid = system.uid(process)
    if uid < 0:
        return skip(f"{UNSEEN}, so its state directory was not checked", f"sudo failstop {look.again()}")
    path = root.state_directory(look.name, environ, writable=lambda folder: system.writable(folder, uid))
    if reason := system.no_room(path):
        return warn(f"{reason}, so incidents can't be saved in {path}", f"df -h {shlex.quote(path)}")
    there = path
    while system.missing(there) and there != os.path.dirname(there):
        there = os.path.dirname(there)
    if system.uid(there) < 0:
        return skip(f"this user can't see {there}, so it was not checked", f"sudo failstop {look.again()}")
    if by_unit:
        if there != path:
            return ok(f"{path} does not exist yet: systemd makes it when the service starts")
        # The service is not running, so there is no process to ask. Use the unit's user.
        uid = system.account(unit_user(look)) if not look.state else uid
    if not system.writable(there, uid):
        text = f"the service's user can't write to {there}, so incidents can't be saved"
        return warn(
            text,
            f"ls -ld {shlex.quote(there)}",
            "give the folder to that user (chown), or run the service as another user",
        )
    return ok(f"{path} has room" if there == path else f"{path} does not exist yet, and can be made")


def remove_ipc(look: Look) -> list[Finding]:
    """Check whether logind would delete the service's shared memory when its user logs out."""
    process = f"/proc/{look.pid}"
    if look.system.uid(process) < 0:
        text = f"{UNSEEN}, so nobody knows whether RemoveIPC matters to it"
        return skip(text, f"sudo failstop {look.again()}")
    # A service that systemd would start runs as a system user.
    if look.system.uid(process) < FIRST_REGULAR_UID or (look.unit and not look.state):
        return ok("the service runs as a system user, so RemoveIPC does not matter")
    said = look.system.said("busctl", "get-property", *REMOVE_IPC)
    if said == "b false\n":
        return ok("RemoveIPC is off")
    if said != "b true\n":
        text = "whether RemoveIPC is on: logind can't be asked, or takes too long"
        return skip(text, f"busctl get-property {' '.join(REMOVE_IPC)}")
    text = f"RemoveIPC is on, so logind deletes the service's shared memory when {look.system.owner(process)} logs out"
    fix = f"sudo mkdir -p {LOGIND} && printf '[Login]\\nRemoveIPC=no\\n' | sudo tee {LOGIND}/failstop.conf"
    return warn(text, fix, "takes effect after the next boot; or run the service as the system user failstop")
