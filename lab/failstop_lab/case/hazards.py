"""Hazards: what can go wrong around a robot that failstop stops; what stopping adds, and the tool itself, are among
them."""

from __future__ import annotations

import dataclasses

SOFTWARE = "software fails"
OUTSIDE = "what no software here can stop"
OF_STOPPING = "stopping itself"
PEOPLE = "people and settings"
HAZARD_CLASSES = (SOFTWARE, OUTSIDE, OF_STOPPING, PEOPLE)

NOTHING_HELPS = "nothing helps here"
"""The answer to a hazard that no claim covers begins with this."""


@dataclasses.dataclass(frozen=True)
class Hazard:
    """One row."""

    name: str
    kind: str
    """One of HAZARD_CLASSES."""
    what: str
    how: str
    """The way in which it comes about."""
    does: str
    """The answer of failstop; begins with NOTHING_HELPS where no claim carries the hazard."""
    remains: str
    helps: str
    """Hardware or a way of working that helps."""
    claims: tuple[str, ...] = ()


HAZARDS = (
    Hazard(
        "H-DIES", SOFTWARE, "The robot drives on when a program dies",
        "a crash, a kill or a failed allocation, in the driving program or in a process of the service",
        "it stops the wheels within milliseconds of the death",
        "the robot rolls for these milliseconds, and while it brakes",
        "lower limits", ("DEATH-1", "SEVERAL-1", "CLIENT-1"),
    ),
    Hazard(
        "H-HANGS", SOFTWARE, "The robot drives on when a program hangs",
        "an endless loop, a lock, a debugger, a machine that swaps",
        "it stops the wheels when the process has been silent for longer than its deadline",
        "the robot drives on until the deadline, and again when the program wakes up, unless you set "
        "gate.driver_silence",
        "lower limits; shorter timeouts", ("HANG-1", "CLIENT-1", "SEVERAL-1"),
    ),
    Hazard(
        "H-RUNS-ON", SOFTWARE, "The wheels turn again after a stop",
        "a frame that was already on its way, a process that is restarted, a program that resets",
        "it refuses motion that was commanded before the stop; a start, a reset or the return of the board enables "
        "nothing",
        "one frame may follow that had passed its last check, and the next stop ends it",
        "a relay that a person has to close again", ("MOVE-1", "MOVE-2", "START-1", "END-1"),
    ),
    Hazard(
        "H-FAST", SOFTWARE, "The robot drives faster than anybody wants",
        "a program that commands too much, or a value that is not a number; a wheel that runs away",
        "it limits speed and acceleration; a value that is not a number stops the robot, and so does a wheel that "
        "is reported faster than commanded",
        "a motor without its encoder may turn at full speed, and a board that reports nothing can't show a runaway",
        "limits at which an impact is acceptable", ("LIMIT-1", "CLIENT-1", "RUNAWAY-1"),
    ),
    Hazard(
        "H-BLIND", SOFTWARE, "A program drives without its obstacle sensor",
        "a sensor, its driver or its cable that fails",
        "it blocks programs until the sensor delivers",
        "the sensor may deliver and see nothing",
        "bumpers", ("SENSOR-1",),
    ),
    Hazard(
        "H-STARVED", SOFTWARE, "The stop comes late",
        "a busy machine, missing rights, memory or disk space, a sleep of the machine",
        "it runs with real-time rights, prepares everything that a stop needs, and reports what it lacks",
        "a program of higher priority may take every core, and the machine may sleep without announcing it",
        "`failstop doctor`; a machine with nothing else to do", ("ASK-2", "TIME-1", "HANG-1"),
    ),
    Hazard(
        "H-DRIVER", SOFTWARE, "A driver at the guard port drives on after it has died",
        "a program that knows nothing about failstop dies, hangs or starts again at the guard port",
        "it plays the board: it accepts what the board would accept, answers in the right order, drops the bytes of "
        "a dead driver, and lets the driver move something only after an enable",
        "a driver whose controller adds up its error while it is refused starts with a jump (`guard.hang_up`); a "
        "child process that keeps the port open hides the driver's death if /proc does not show the driver",
        "run the guard as the user who runs the driver", ("GUARD-1", "CLIENT-1"),
    ),
    Hazard(
        "H-HOSTILE", SOFTWARE, "Somebody else on the machine drives, or prevents a stop",
        "another user, a broken client, overwritten memory",
        "it lets everybody stop, and only the group drive; it trusts no memory that others can write",
        "a member of the group can pretend to be another client, within the limits; root can do anything",
        "few members in the group", ("ACCESS-1", "MEMORY-1", "ASK-1"),
    ),
    Hazard(
        "H-CABLE", OUTSIDE, "The cable is unplugged and the wheels keep turning",
        "a plug that shakes loose, a hub without power",
        "it stops the wheels as soon as the board is back; if the board has its own watchdog, failstop arms it",
        "without such a watchdog the robot drives on until somebody stops it",
        "a relay that opens when the computer's signal stops changing; a watchdog in the firmware; the power switch",
        ("PORT-1", "WATCHDOG-1"),
    ),
    Hazard(
        "H-DEAF", OUTSIDE, "The board is deaf, full or does not obey",
        "a firmware that hangs, a broken motor driver or encoder",
        "it reports it within a second if the board can answer, repeats the stop, and runs `still.command`",
        "the wheels turn until the power is cut",
        "the power switch; a relay that `still.command` opens", ("BOARD-1", "SILENCE-1", "BOARD-2", "PROOF-1"),
    ),
    Hazard(
        "H-FROZEN", OUTSIDE, "The machine is frozen or its kernel is dead",
        "a kernel panic, a hypervisor, overheating",
        "if the board has its own watchdog, failstop arms it beforehand; it stops the wheels when the machine runs "
        "again",
        "without such a watchdog the robot drives on until somebody stops it",
        "a relay that opens when the computer's signal stops changing; a hardware watchdog for the computer",
        ("WATCHDOG-1", "TIME-1"),
    ),
    Hazard(
        "H-BYPASS", OUTSIDE, "Something else commands the board",
        "a gamepad or Bluetooth at the board, another computer on its bus",
        "`failstop doctor` names the other ways to command each board; while the robot is stopped, failstop writes "
        "zero again and again",
        "the wheels may turn between two zeros",
        "switch the other way off in the firmware", ("BOARD-1",),
    ),
    Hazard(
        "H-SLOPE", OF_STOPPING, "The robot rolls after a stop",
        "a slope, a push, a board that lets its motors coast",
        f"{NOTHING_HELPS}: if a board does not brake, zero speed does not hold the robot",
        "the robot rolls",
        "brakes; a self-locking gear; no slopes",
    ),
    Hazard(
        "H-COASTS", OF_STOPPING, "The robot stops later than the times suggest",
        "a board that coasts instead of braking, a heavy load",
        "it shows the stopping distance that follows from the limits, the times and a deceleration",
        "the distance is only as right as the deceleration that you measured",
        "lower limits; measure with the load on", ("DISTANCE-1",),
    ),
    Hazard(
        "H-DROPS", OF_STOPPING, "The arm drops what it holds",
        "a stop that switches the torque off; a supply that fails",
        "at a stop it keeps the torque on, and holds the joints where they are",
        "the power switch and a relay take the torque away",
        "a brake or a spring in the arm; a separate supply for the arm", ("ARM-1",),
    ),
    Hazard(
        "H-PLACE", OF_STOPPING, "The robot stops where it must not stand",
        "a stop in a doorway, in a lift, under a load, on a road",
        f"{NOTHING_HELPS}: failstop does not know where the robot is",
        "the robot stands there until a person moves it",
        "a way to move it by hand; routes that avoid such places",
    ),
    Hazard(
        "H-BEHIND", OF_STOPPING, "Somebody behind the robot does not stop",
        "robots in a row, a person who walks behind the robot",
        "it stops every robot of a fleet when a person asks for it, each as soon as the network has delivered the "
        "request",
        "everybody behind the robot has to keep their distance",
        "distance; a light that shows a stop", ("ASK-1",),
    ),
    Hazard(
        "H-TIPS", OF_STOPPING, "The robot tips over, or its load slides, when it stops",
        "a high centre of mass, a fast drive",
        f"{NOTHING_HELPS}: the board decides how hard a stop is",
        "the robot tips over",
        "lower limits; a low and fixed load",
    ),
    Hazard(
        "H-OFTEN", OF_STOPPING, "The robot stops so often that people work around failstop",
        "deadlines that are missed on a busy machine",
        "it shows each cause and what to do about it; the deadlines are longer than the pauses of a busy machine",
        "people may enable without looking, or remove failstop",
        "a machine with less to do", ("CAUSE-1",),
    ),
    Hazard(
        "H-TRUST", PEOPLE, "A person trusts the screen and goes near the robot",
        "a page that shows STOPPED although a wheel turns",
        "it shows what is proved (written, acknowledged, observed) and what the wheels are seen to do now, and says "
        "when nothing sees them or a picture is old",
        "the wheels may turn although a stop is acknowledged",
        "look at the robot; the power switch", ("PROOF-1", "BOARD-1"),
    ),
    Hazard(
        "H-UNHEARD", PEOPLE, "A person's STOP does not reach the robot",
        "a phone without network, a page in the background, a gamepad out of reach",
        "the page says that it can't reach the robot; with `attend.required` the robot stops without its operator",
        "without `attend.required` the robot goes on with its program",
        "the power switch; `attend.required`", ("ATTEND-1",),
    ),
    Hazard(
        "H-RESET", PEOPLE, "The wrong person resets",
        "somebody who does not see the robot clears its stop",
        "a reset moves nothing; it is refused if a newer stop has come; to drive, somebody also has to enable motion",
        "a person may reset and enable without seeing the robot",
        "let few people be in the group, and pair few devices", ("MOVE-2", "ACCESS-1"),
    ),
    Hazard(
        "H-SETTINGS", PEOPLE, "The settings are wrong",
        "signs, sizes or limits of another robot; the wrong board",
        "it checks each value and each pair of values that must fit, asks the board what it is, and tries each "
        "wheel in `failstop prove`",
        "a wrong size makes every speed wrong",
        "`failstop prove` after each change", ("LIMIT-1", "PROOF-1"),
    ),
    Hazard(
        "H-TWO", PEOPLE, "Two programs use the board",
        "a second service, the vendor's driver, a serial monitor",
        "it opens the port for itself alone, and says which other program has it open; a second service is refused",
        "a program that runs as root may still write into the port",
        "remove the vendor's driver", ("ACCESS-1", "BOARD-2"),
    ),
    Hazard(
        "H-TOOL", PEOPLE, "failstop itself is wrong",
        "a bug; an update; a part that was never tried on this machine",
        "it is tested as these pages show; if the core finds itself in a state that can't happen, it stops the robot",
        "bugs that none of the tests looks for",
        "`failstop prove` after each update; an emergency-stop circuit", ("MOVE-1", "MOVE-2", "CAUSE-1"),
    ),
    Hazard(
        "H-LATE-CUT", PEOPLE, "A person needs more than a software stop",
        "people near a robot that can hurt them",
        f"{NOTHING_HELPS}: failstop is not an emergency stop",
        "everything that the motors' power can do",
        "an emergency-stop circuit (ISO 13850)",
    ),
)  # fmt: skip
"""Every hazard that is known, each with claims or with NOTHING_HELPS."""
