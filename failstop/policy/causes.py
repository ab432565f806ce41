"""Causes: the table of everything that stops the robot. Each row says what people read, which process notices the
cause, what clears it, and what people must do. A stop for any of these causes is latched.

A stop must not wait for its text. So the process that notices a cause sends only the row's number and the arguments
(`pack`). The process that reports the cause makes the text later, from a template (`str`). A part of the template in
square brackets is left out if all its arguments are empty.

The columns `what` and `remedy` are parts of sentences. `what` continues "stopped since ...". It can contain the
arguments, and also `role` and `names`. `role` says what the process in the argument `process` does. `names` are the
names of the gamepad's pressed buttons. `remedy` continues "first ..." (see `Kind.first`). It can contain a placeholder
(see ADVISED), for example for the names of ROS nodes.
"""

from __future__ import annotations

from functools import cached_property

from failstop.data import Data
from failstop.messages import records
from failstop.messages.records import cut, printable

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.messages.packing import Value

ARGUMENTS_BYTES = 280
"""The most bytes of UTF-8 that the arguments of a cause may have. Longer arguments are cut."""
BETWEEN = "\x1f"
LONGEST_PID = 10
NOT_KNOWN = "not known yet"
"""Stands for a name, for example of a ROS node, in a stop request from a program that does not know the name yet. Once
the program knows the name, it sends the request again."""
A_RESET = "a reset"
SECOND_ROBOT = "a second Robot in the same program"
NEW_RUN = "a new start of the service"
CLIENTS = "gate"
"""The process that watches the clients."""
NUMBER_BYTES = 2
LAST_NODES = ("collision_monitor", "velocity_smoother", "twist_mux")
"""ROS nodes that are usually the last node before a base. If several of these are running, the first one in this list
is taken for the last node."""
INNER_NODES = ("behavior_server", "controller_server", "docking_server", "following_server")
"""Nodes of Nav2 that usually send their velocities to another node, not directly to the base."""
_TYPES = {"": str, "d": int, "X": int, "f": float}

_TELL = (
    "report it with its incident (`failstop incident list`), because either failstop has a bug or memory was damaged"
)
_AGAIN = "if this is not the first time, look at what happened before it (`failstop events`)"
_BUSY = "check the computer's load and failstop's real-time rights (`failstop doctor`), because something held it up"
POWER = "turn the robot's POWER SWITCH off and on, because a stop may not have reached the wheels"
"""What people must do first if the stop may not have reached the wheels. They read this only after a stop for a cause
that has a `doubt`."""
PORT_SHARED = "`failstop doctor` shows whether a login or another program takes the answers from the port"
USE_THE_SWITCH = "use the POWER SWITCH"


class Kind(Data):
    """One row of the table of causes.

    `number` is never used again for another row. `template` has its parameters in braces. No parameter may be
    called "name". `noticed_by` lists the processes that can notice the cause. A row needs a `doubt` if a stop for this
    cause may not reach the wheels. The `doubt` is a clause that is added to `what`, and first() tells people to use the
    power switch. Both are left out if the stop is known to have reached the wheels.
    """

    number: int
    name: str
    template: str
    noticed_by: str
    what: str
    remedy: str
    cleared_by: str = A_RESET
    doubt: str = ""

    def first(self, reached: str = "") -> str:
        """What people must do first. `reached`: how it is known that the stop has reached the wheels; empty if it is
        not known."""
        return f"{POWER}; then {self.remedy}" if self.doubt and not reached else self.remedy

    @cached_property
    def parameters(self) -> tuple[tuple[str, type[Value]], ...]:
        """The name and type of each parameter of `template`. Computed only once, because making a cause must not delay
        the stop."""
        fields = [part.partition("}")[0].partition(":") for part in self.template.split("{")[1:]]
        return tuple((name, _TYPES[form[-1:]]) for name, _, form in fields)

    def __call__(self, *arguments: Value) -> Cause:
        """Make a cause of this kind with these arguments. Raises ValueError if the arguments don't fit the parameters
        in `template`."""
        if len(arguments) != len(self.parameters):
            raise ValueError(f"{self.name} takes {len(self.parameters)} arguments, not {len(arguments)}")
        return Cause(self, tuple(of(given) for (_, of), given in zip(self.parameters, arguments, strict=True)))


class Cause:
    """The cause of a stop: its kind, and the values for this stop, for example how long a process was silent.
    `str(cause)` is the text for people."""

    __slots__ = ("arguments", "kind")

    def __init__(self, kind: Kind, arguments: tuple[Value, ...]) -> None:
        self.kind = kind
        self.arguments = arguments

    def named(self) -> dict[str, Value]:
        """The arguments by name."""
        return {name: value for (name, _), value in zip(self.kind.parameters, self.arguments, strict=True)}

    def alarm(self) -> str:
        """The text that is shown at the stop. If the stop may not have reached the wheels, the text tells people to use
        the power switch."""
        return f"{self}: {USE_THE_SWITCH}" if self.kind.doubt else str(self)

    def as_map(self) -> dict[str, Value]:
        """The cause as a dict for programs: its name and the arguments."""
        return {"name": self.kind.name, **self.named()}

    def fields(self) -> dict[str, str]:
        """The cause as fields of an event: `reason` is the text for people, `cause` the name for programs."""
        return {"reason": str(self), "cause": self.kind.name}

    def __str__(self) -> str:
        return filled(self.kind.template, self.named())

    def __repr__(self) -> str:
        return f"{self.kind.name}{self.arguments!r}"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cause) and (self.kind, self.arguments) == (other.kind, other.arguments)

    def __hash__(self) -> int:
        return hash((self.kind.number, self.arguments))

    def pack(self) -> bytes:
        """Convert the cause to bytes, at most ARGUMENTS_BYTES + 2."""
        texts = (str(value).replace(BETWEEN, "?") for value in self.arguments)
        return self.kind.number.to_bytes(NUMBER_BYTES, "little") + cut(BETWEEN.join(texts), ARGUMENTS_BYTES)


def unpack(payload: bytes) -> Cause:
    """Make a cause from the bytes that pack() has returned. Raises ValueError if the bytes are damaged."""
    number = int.from_bytes(payload[:NUMBER_BYTES], "little")
    if len(payload) < NUMBER_BYTES or number not in BY_NUMBER:
        raise ValueError(f"no cause has the number {number} of {len(payload)} bytes")
    kind = BY_NUMBER[number]
    texts = payload[NUMBER_BYTES:].decode("utf-8", "replace").split(BETWEEN)
    # If the arguments were cut, the missing ones become empty.
    texts += [""] * (len(kind.parameters) - len(texts))
    pairs = zip(kind.parameters, texts, strict=False)
    return Cause(kind, tuple(text if of is str else of(text or 0) for (_, of), text in pairs))


def filled(template: str, arguments: dict[str, Value]) -> str:
    """Fill the arguments into a template. A part in brackets is left out if all arguments in it are empty."""
    parts = template.replace("]", "[").split("[")
    return "".join(
        part.format_map(arguments)
        for at, part in enumerate(parts)
        if not at % 2 or any(value for name, value in arguments.items() if f"{{{name}" in part)
    )


def read(payload: bytes) -> Cause:
    """Make a cause from the bytes that pack() has returned. Damaged bytes give UNKNOWN, because a stop counts even if
    its cause can't be read."""
    try:
        return unpack(payload)
    except ValueError:
        return UNKNOWN()


def of(name: str, arguments: dict[str, Value]) -> Cause:
    """Make the cause with this name and these arguments. The result is UNKNOWN if no cause has this name, or if an
    argument is missing."""
    kind = CAUSE_BY_NAME.get(name)
    if kind is None or {key for key, _ in kind.parameters} - set(arguments):
        return UNKNOWN()
    return kind(*(arguments[key] for key, _ in kind.parameters))


def requested(line: bytes) -> Cause:
    """Make the cause of a stop from a line in the stop pipe. records.asking() makes such lines. The program's name in a
    line may be false, because every local user may write to the pipe."""
    text = line.decode("utf-8", "replace")
    words, _, rest = text.partition("\t")
    who, _, rest = rest.partition("\t")
    pid, _, name = rest.partition("\t")
    row = next((kind for kind in SIGNED if kind.name == name), None) if name else REQUESTED
    if row and who and pid.isascii() and pid.isdigit() and len(pid) <= LONGEST_PID:
        if who.startswith(records.FLEET_PREFIX):
            return FLEET(_quoted(words), _quoted(who.removeprefix(records.FLEET_PREFIX)))
        return row(_quoted(words), _quoted(who), int(pid))
    return PIPED(_quoted(text))


def _quoted(text: str) -> str:
    """Make a text safe to show between quotation marks. Double quotes would end the quotation, and backquotes mark
    failstop's own commands, so both are replaced."""
    return printable(text).replace('"', "'").replace("`", "'")


def unsigned(cause: Cause) -> str:
    """The text of a cause, without the name of the program that requested the stop."""
    return str(cause).rpartition(BY)[0] if cause.kind in SIGNED else str(cause)


def bare(cause: Cause) -> str:
    """Only the words that somebody gave as the reason for a stop."""
    return unsigned(cause).removeprefix(f"{PIPED.template.partition('[')[0]}: ")


def remedied(cause: Cause, reached: str = "") -> str:
    """What people must do first after a stop for this cause, with all placeholders filled in. `reached`: how it is
    known that the stop has reached the wheels; empty if it is not known."""
    return cause.kind.first(reached).format_map({name: advise(cause) for name, advise in ADVISED.items()})


def _to_remap(cause: Cause) -> str:
    """Only one ROS node may publish on the topic, but several do. Return the names of the nodes that must publish on
    another topic. If it is not clear which node may keep the topic, the text is "all but one of" and all names."""
    words = str(cause.named().get("words", ""))
    nodes = [node.rpartition(" (")[0] if node.endswith(" times)") else node for node in words.split(", ")]
    last = next((node for name in LAST_NODES for node in nodes if node.rpartition("/")[2] == name), "")
    if last and len(nodes) > 1:
        return ", ".join(node for node in nodes if node != last)
    inner = [node for node in nodes if node.rpartition("/")[2] in INNER_NODES]
    # An inner node may publish several times before the node that is usually the last one begins to publish.
    alone = len(nodes) - len(inner) <= 1 and all(node in words.split(", ") for node in nodes if node not in inner)
    return ", ".join(inner) if inner and alone else f"all but one of {words}"


ADVISED = {"others": _to_remap}
"""The placeholders that a remedy can contain, each with a function that returns the text to fill in."""
BY = " (says it is "
"""The words between the reason and the program's name in the text of a requested stop."""


def rival_of(who: str, other: str) -> str:
    """The name for the client `other`, which disturbs the client `who`. Both are texts with a name and a pid. If both
    have the same known pid, the result is SECOND_ROBOT, otherwise `other`."""
    pid = who.rpartition(" (pid ")[2]
    known = pid.endswith(")") and pid != "0)"  # 0: the client is in another pid namespace
    return SECOND_ROBOT if known and pid == other.rpartition(" (pid ")[2] else other


def completed(latched: Cause, later: Cause) -> bool:
    """True if `later` repeats the stop request `latched` with a name in the place of NOT_KNOWN."""
    if latched.kind is not later.kind or latched.kind not in SIGNED:
        return False
    (words, *who), (more, *same) = latched.arguments, later.arguments
    return who == same and NOT_KNOWN in str(words) and NOT_KNOWN not in str(more)


DIED = Kind(
    1, "died", "{process} died", "port_owner supervisor",
    "the process {process}, which {role}, died", _AGAIN,
)  # fmt: skip
HANGS = Kind(
    2, "hangs", "{process} hangs: {ms:d} ms silent", "port_owner gate supervisor",
    "the process {process}, which {role}, gave no sign of life for {ms} ms", _BUSY,
)  # fmt: skip
STARVED = Kind(
    3, "starved", "{process} hangs: {ms:d} ms silent (the machine is starved)", "supervisor",
    "the computer was too busy to run the process {process}, which {role}, for {ms} ms",
    "give the service real-time rights (`failstop doctor` has the command), or the machine less to do",
)  # fmt: skip
HELD_UP = Kind(
    4, "held_up", "supervisor was held up for {ms:d} ms", "supervisor",
    "the supervisor could not run for {ms} ms, so nobody watched the other processes", _BUSY,
)  # fmt: skip
MUTE = Kind(
    5, "mute", "gate runs but has sent nothing for {ms:d} ms", "port_owner",
    "the gate was alive, but sent no motor frame for {ms} ms while the wheels turned", _TELL,
)  # fmt: skip
BAD_FRAME = Kind(
    6, "bad_frame", "the gate's frame was refused: {fault}", "port_owner",
    "the gate made a frame that must not reach the board ({fault}), and the port owner refused it", _TELL,
)  # fmt: skip
DEFECT = Kind(
    28, "defect", "internal error: {process}: {event} while {state}", "port_owner supervisor",
    "failstop found a bug of its own in how it runs the process {process}, which {role}: {event} while {state}", _TELL,
)  # fmt: skip
SUSPENDED = Kind(
    7, "suspended", "the machine was suspended for {s:.1f} s", "port_owner",
    "the computer slept for {s:.1f} s, so everything that failstop knew about the robot was old",
    "keep the computer from sleeping while the robot is on (`systemctl mask sleep.target`)",
)  # fmt: skip
SUPERVISOR_SUSPENDED = Kind(
    27, "supervisor_suspended", "supervisor was suspended for {s:.1f} s by a signal", "port_owner gate supervisor",
    "a signal suspended the supervisor for {s:.1f} s, as Ctrl-Z in its terminal does, so nobody watched the other "
    "processes",
    "leave the service running in its terminal, or end it with Ctrl-C",
)  # fmt: skip
REMOVED = Kind(
    8, "removed", "{what} was removed: restart the service", "supervisor",
    "somebody removed {what} while the service was running, but programs need it to find the service",
    "run `failstop doctor`: with RemoveIPC=yes, logind removes it when the service's user logs out",
    NEW_RUN,
)  # fmt: skip
DEVICE_LOST = Kind(
    9, "device_lost", "device lost", "port_owner",
    "the board's USB connection was lost, so the stop could only be written once it was back",
    "check the cable, the plug and the board's power",
)  # fmt: skip
STUCK = Kind(
    10, "stuck", "port does not drain", "port_owner",
    "the port accepted bytes, but did not send them to the board within 0.1 s",
    "check the board and the cable to it",
    doubt="so the board may not have got the stop",
)  # fmt: skip
DEAF = Kind(
    11, "deaf", "the board is deaf", "supervisor",
    "the board stopped answering, or it reported that it obeys a command of zero while motion was written to it",
    f"check the cable to the board; {PORT_SHARED}",
    doubt="so it may not have heard the stop",
)  # fmt: skip
BOARD_SILENT = Kind(
    44, "board_silent", "the board is silent", "supervisor",
    "the board stopped reporting. It lost power, or it hangs, or the wire from it is broken; failstop can't tell these "
    "apart",
    f"check the board's power and its cable; {PORT_SHARED}",
    doubt="so nobody knows whether the wheels stopped",
)  # fmt: skip
NOT_HEARD = Kind(
    48, "not_heard", "no answer from the board for {ms:d} ms (the machine is starved)", "supervisor",
    "the computer was too busy to tell whether the board answers: failstop heard nothing from it for {ms} ms",
    "give the service real-time rights (`failstop doctor` has the command), or the machine less to do",
    doubt="so a stop may not have reached it",
)  # fmt: skip
UNSTILL = Kind(
    12, "unstill", "the wheels do not come to rest", "supervisor telemetry",
    "the wheels kept turning after a stop, as the board reported, or the IMU felt the robot shake as if they did",
    "check whether somebody carried or pushed the robot, because that looks the same",
    doubt="so they may still be turning",
)  # fmt: skip
RUNAWAY = Kind(
    43, "runaway", "the {wheel} wheel ran away: commanded {told:.2f} turns a second, it turned {seen:.2f}", "telemetry",
    "the board reported that the {wheel} wheel turned at {seen:.2f} turns a second, but it was commanded {told:.2f}",
    "check that wheel's motor, encoder and wiring, wheels.sign_* and board.per_rps, and whether the robot is "
    "on a slope",
)  # fmt: skip
UNCOUNTED = Kind(
    54, "uncounted", "the {wheel} wheel is not counted: commanded {told:.2f} turns a second", "telemetry",
    "the board counted no turn of the {wheel} wheel, although it was commanded {told:.2f} turns a second. Without "
    "counts, this board turns a wheel faster and faster",
    "check that wheel's encoder and its plugs, and whether the wheel is blocked",
)  # fmt: skip
WHEEL_MISSING = Kind(
    52, "wheel_missing", "wheel lost: {wheel} does not answer", "telemetry",
    "the {wheel} did not answer while another wheel's did, so the robot would have turned without it",
    "check its plug on the bus, its power and its id; if that wheel still turns, use the POWER SWITCH",
)  # fmt: skip
NOT_FINITE = Kind(
    13, "not_finite", "command from {who} is not finite", CLIENTS,
    "{who} commanded a velocity that is not a number",
    "fix that program before it drives again; a division by zero is a usual reason",
)  # fmt: skip
TWO_PUBLISHERS = Kind(
    14, "two_publishers", "multiple {source} publishers: {who}, {rival}", CLIENTS,
    "{who} and {rival} both commanded as {source}",
    "end one of them (in one program, use one Robot for everything), or give it its own source in the settings "
    "(sources.NAME.priority)",
)  # fmt: skip
BUTTON = Kind(
    15, "button", "gamepad button 0x{buttons:04X}", "telemetry",
    "somebody pressed {names} on the gamepad", "ask the person who holds it",
)  # fmt: skip
KEY = Kind(
    16, "key", "key{key:d}", "telemetry",
    "somebody pressed key {key} on the board", "ask the people near the robot",
)  # fmt: skip
REQUESTED = Kind(
    17, "requested", "stop request[: {words}] (says it is {who}, pid {pid:d})", "port_owner",
    'a program that says it is {who} (pid {pid}) asked for a stop[: "{words}"]',
    "make sure that the reason for the stop is gone",
)  # fmt: skip
PIPED = Kind(
    18, "piped", "stop request[: {words}]", "port_owner",
    'somebody wrote to the stop pipe[: "{words}"]',
    "make sure that the reason for the stop is gone",
)  # fmt: skip
ROS_PUBLISHERS = Kind(
    46, "ros_publishers", "stop request: multiple cmd_vel publishers: {words} (says it is {who}, pid {pid:d})",
    "port_owner",
    'a program that says it is {who} (pid {pid}) asked for a stop: "multiple cmd_vel publishers: {words}"',
    "remap cmd_vel of {others}: for a node of Nav2 to cmd_vel_nav, for another node to an input of twist_mux "
    "(docs/ros2.md, Nav2), and start it again; a node that was killed counts for up to 20 s",
)  # fmt: skip
ROS_ARM_PUBLISHERS = Kind(
    47, "ros_arm_publishers", "stop request: multiple arm/goal publishers: {words} (says it is {who}, pid {pid:d})",
    "port_owner",
    'a program that says it is {who} (pid {pid}) asked for a stop: "multiple arm/goal publishers: {words}"',
    "end all but one of these nodes, because only one may move the arm; a node that was killed counts for up to 20 s",
)  # fmt: skip
ROS_STRANGER = Kind(
    53, "ros_stranger", "stop request: stranger on cmd_vel: {words} (says it is {who}, pid {pid:d})", "port_owner",
    'a program that says it is {who} (pid {pid}) asked for a stop: "stranger on cmd_vel: {words}"',
    "end that node, or add its name to the bridge's allowed_publishers and start the bridge again",
)  # fmt: skip
ROS_NOT_FINITE = Kind(
    49, "ros_not_finite", "stop request: command from {words} is not finite (says it is {who}, pid {pid:d})",
    "port_owner",
    'a program that says it is {who} (pid {pid}) asked for a stop: "command from {words} is not finite"',
    "fix that node before it drives again; a division by zero is a usual reason",
)  # fmt: skip
ROS_ARM_NOT_HELD = Kind(
    50, "ros_arm_not_held", "stop request: the arm could not be held: {words} (says it is {who}, pid {pid:d})",
    "port_owner",
    'a program that says it is {who} (pid {pid}) asked for a stop: "the arm could not be held: {words}"',
    "look at the arm, because it may have moved on to its goal, and at `failstop status`",
)  # fmt: skip
ROS_NO_ANSWER = Kind(
    51, "ros_no_answer", "stop request: no answer from the gate in {words}: wheels stopped "
    "(says it is {who}, pid {pid:d})", "port_owner",
    'a program that says it is {who} (pid {pid}) asked for a stop: '
    '"no answer from the gate in {words}: wheels stopped"',
    _BUSY,
)  # fmt: skip
FLEET = Kind(
    24, "fleet", "stop request[: {words}] (says it is the fleet, for {who})", "port_owner",
    'a program that says it is the fleet asked for a stop for {who}[: "{words}"]',
    "make sure that the reason for the stop is gone",
)  # fmt: skip
BATTERY = Kind(
    23, "battery", "the battery is at {volts:.2f} V", "telemetry",
    "the battery was at {volts:.2f} V, and had been below the setting battery.stop_mv for 5 s or more",
    "charge it; you may reset and drive to the charger, because failstop stops for this again only after the battery "
    "has been charged or swapped, or the service was restarted",
)  # fmt: skip
STOPPING = Kind(
    19, "stopping", "service is stopping", "supervisor",
    "the service was asked to end", "start the service again",
    NEW_RUN,
)  # fmt: skip
ALL_DIED = Kind(
    20, "all_died", "the whole service died", "",
    "every process of the service died at once", _AGAIN,
    NEW_RUN,
)  # fmt: skip
SILENT = Kind(
    21, "silent", "the supervisor is silent", "",
    "the supervisor, which starts and watches the other processes, has been silent for too long", _BUSY,
)  # fmt: skip
UNKNOWN = Kind(
    22, "unknown", "stopped by the supervisor", "",
    "the supervisor stopped the wheels, but the reason can't be read any more",
    "look at `failstop events`, which may still show it",
)  # fmt: skip
DRIVER_DIED = Kind(
    41, "driver_died", "driver died: {who}", CLIENTS,
    "the program {who} crashed or was killed after it had driven",
    "look at that program's log",
)  # fmt: skip
DRIVER_SILENT = Kind(
    42, "driver_silent", "driver silent: {who}, {ms:d} ms", CLIENTS,
    "the program {who} stopped sending commands while it drove, and sent none for {ms} ms",
    "check that program: it may hang, or be suspended (Ctrl-Z)",
)  # fmt: skip
OPERATOR_GONE = Kind(
    40, "operator_gone", "operator gone: {who}, {how}", CLIENTS,
    "the operator {who}, without whom this robot may not move, {how}",
    "have somebody attend again, on the page or with `failstop attend`",
)  # fmt: skip
RESTARTED = Kind(
    45, "restarted", "the board restarted: {sign}", "telemetry",
    "the board restarted while motion was enabled, so it had forgotten its commands ({sign})",
    "check the battery, the motors' supply and the board's plugs, because a dip in the voltage is the usual reason",
)  # fmt: skip
TWO_MOVE_THE_ARM = Kind(
    30, "two_move_the_arm", "multiple arm/goal publishers: {who}, {rival}", CLIENTS,
    "{who} and {rival} both moved the arm",
    "end one of them, because only one program may move the arm at a time",
)  # fmt: skip

BY_NUMBER = {kind.number: kind for kind in tuple(globals().values()) if isinstance(kind, Kind)}
CAUSE_BY_NAME = {kind.name: kind for kind in BY_NUMBER.values()}
SIGNED = (
    REQUESTED,
    ROS_PUBLISHERS,
    ROS_ARM_PUBLISHERS,
    ROS_STRANGER,
    ROS_NOT_FINITE,
    ROS_ARM_NOT_HELD,
    ROS_NO_ANSWER,
)
"""The causes of stops that a program requests, giving a reason, its name and its pid."""
BY_SOMEBODY = (*SIGNED, PIPED, FLEET, BUTTON, KEY)
"""The causes of stops that a person or another program has asked for. A test must not reset them by itself."""


class Reply(Data):
    """The answer to a request. str() of a Reply is its text, in which the placeholder CAUSE (messages/records.py) is
    replaced by the text of `cause`."""

    done: int
    text: str
    cause: Cause | None = None
    refused_for: int = 0

    def __str__(self) -> str:
        return self.text.replace(records.CAUSE, str(self.cause))

    def pack(self, session: int, number: int) -> bytes:
        """Convert the answer to bytes, for request `number` of this client session."""
        cause = self.cause.pack() if self.cause else b""
        return records.REPLY.pack(session, number, self.done, self.refused_for, self.text, cause)


def unpack_reply(payload: bytes) -> tuple[int, int, Reply]:
    """Return (session, number, reply) from the bytes of an answer. Raises ValueError if they are damaged."""
    session, number, done, refused_for, text, cause = records.REPLY.unpack(payload)
    return session, number, Reply(done, text, read(cause) if cause else None, refused_for)


def refused(why: str, latched: Cause | None = None) -> Reply:
    """Refuse a request. `latched`: the cause of the latched stop, which is added to the text; None if no stop is
    latched."""
    if latched is None:
        return Reply(records.REFUSED, why)
    return Reply(records.REFUSED, f"{why} ({records.CAUSE})", latched, records.FOR_THE_LATCH)


def asked_before(cause: Cause) -> Reply:
    """Refuse a request that was made before the last stop, because the client could not know about that stop."""
    return Reply(False, f"asked before the last stop ({records.CAUSE}): deal with that stop, then ask again", cause)
