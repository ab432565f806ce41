"""Survivors that no test needs to notice, and why.

A row that says `same` is for mutants that are the same program: they don't count. The others are explained, and count.
`changed` is searched in the mutant's changed lines: the removed ones (`-    text`), then the added (`+    text`).
"""

from __future__ import annotations

from typing import NamedTuple


class Reason(NamedTuple):
    """Files (a pattern), changes in them (a regular expression), why they survive, and whether it's the same
    program."""

    path: str
    changed: str
    why: str
    same: bool = True


EVERYWHERE = (
    Reason("*", r"^-.*(fd|_port) (<|>=) 0.*\n\+.*(fd|_port) (<=|>) 0", "0, 1 and 2 are open: no descriptor here is 0"),
    Reason("*", r"^-.*(fd|_port) (<|>=) 0.*\n\+.*(fd|_port) (<|>=) 1", "0, 1 and 2 are open: no descriptor here is 0"),
    Reason("*", r"^-\s+\w+ = False\n\+\s+\w+ = None$", "both are false"),
    Reason("*", r"^-.*zip\(.*, strict=True\).*\n\+.*zip\(.*, (strict=False)?\)", "what is zipped has one length"),
)

PROCS: tuple[Reason, ...] = (
    Reason(
        "policy/kinematics.py",
        r"\+.*atan2\(.*\) if .*(or True|vx or wz) else",
        "what stands or goes straight has 0 by it",
    ),
    Reason(
        "policy/kinematics.py", r"\+\s+rps = \[1\.0\] \* len\(base\.rest\)$", "an id without a wheel has the factor 0"
    ),
    Reason("policy/kinematics.py", r"\+.*, vx / wz\) if angle", "product and quotient have one sign"),
    Reason("procs/stopper/main.py", r"\+.*_excused_ns = monotonic_ns\(\), 1$", "no heartbeat is as old as the boot"),
    Reason("procs/stopper/main.py", r"\+\s+self\._stopped_for = 1$", "each burst for a port owner sets it"),
    Reason("stop_tool.py", r"\+.*_wait\(\[fd\], 1\.0\)", "a second after the boot is over as well"),
    Reason("stop_tool.py", r'\+.*line\.split\(b":", (3)?\)\[1\]', "what is cut off behind is not looked at"),
    Reason("stop_tool.py", r"\+\s+poll\.register\(fd, \)", "a pidfd is ready for nothing but its process's end"),
    Reason("stop_tool.py", r"\+.*time\.monotonic\(\)\) \* 1001\)", "it waits a thousandth longer", same=False),
    Reason("stop_tool.py", r"\+\s+wait_s = -2\.0", "whatever is below zero says that nobody was asked"),
    Reason("stop_tool.py", r"\+.*if wait_s <= 0 else", "after an answer of 0 there is no further try"),
    Reason("stop_tool.py", r"\+.*waited_s > WARN_S", "the warning comes one try later at most", same=False),
    Reason(
        "board/stop_port.py",
        r"\+.*self\.(_line|free)_ns = 1$|_line_ns (>= 0|> 1) and|self\.lost, self\._line_ns = False, 1$",
        "the first nanosecond of the machine",
    ),
    Reason("board/stop_port.py", r"\+.*error\.errno or 1$", "each error of a write or of a look has a number"),
    Reason(
        "board/stop_port.py",
        r"\+.*sleep\(max\(1, |time\.monotonic_ns\(\)\) / 1000000001\.0",
        "a billionth of a second",
        same=False,
    ),
    Reason("board/stop_port.py", r"\+.*time\.monotonic\(\) >= until_s", "two times at exact equality"),
    Reason("board/stop_port.py", r"\+.*self\.adopt\(-2\)$", "any number below 0 is none"),
    Reason("board/stop_port.py", r"^-.*if old >= 0:\n", "0, 1 and 2 are open: no descriptor here is 0"),
    Reason("procs/handover.py", r"\+.*SOCK_SEQPACKET, 1, fd\)", "the descriptor is of a socket that has its protocol"),
    Reason(
        "procs/handover.py",
        r"\+.*level == .*SOL_SOCKET (or kind == .*RIGHTS and|and kind == .*RIGHTS or) len\(",
        "nothing else comes beside the bytes",
    ),
    Reason("procs/handover.py", r"\+.*ready\.get\(self\._fd, 1\) & GONE", "1 is READ, and GONE has not that bit"),
    Reason("procs/handover.py", r"\+.*self\._(adopt|hold)\(-2\)$", "any number below 0 is none"),
    Reason(
        "procs/peer.py", r"\+.*max\(\(1, \*\(at_ns", "no last repeat comes as soon as that, so the least time counts"
    ),
    Reason("procs/schedule.py", r"\+\s+last_ns = max\(\(1, \*after_ns\)\)", "no zero comes a nanosecond after a stop"),
    Reason(
        "procs/schedule.py",
        r"\+\s+self\._before = (\+1|-2)$",
        "the first index is 0, and counts only if 0 was before it",
    ),
    Reason(
        "procs/port_owner/motion_writer.py", r"^-.*\n\+\s+self\.turning = True$", "the end of the same function sets it"
    ),
    Reason("procs/port_owner/motion_writer.py", r"\+\s+self\.turning = ns > 1$", "it is 0 or the time of a write"),
    Reason(
        "procs/port_owner/requests.py", r'\+.*split\(b"\\n", (2)?\)\[0\]', "what is cut off behind is not looked at"
    ),
    Reason(
        "procs/port_owner/main.py", r"\+.*slept_ns / 10+1\.0\)", "a billionth of a time that people read", same=False
    ),
    Reason("procs/port_owner/main.py", r"\+\s+return slept_ns > 1$", "a sleep is 0 or at least SLEPT_NS"),
    Reason(
        "procs/port_owner/main.py", r"\+\s+self\._moved_ns = 1$", "it is read only while moving, and motion sets it"
    ),
    Reason(
        "procs/port_owner/main.py", r"\+\s+self\._stuck = True$", "no port is stuck at the first look, which clears it"
    ),
    Reason("procs/port_owner/port.py", r"\+\s+self\._watched.* = \((\+1|-2), 0\)", "no port has that number either"),
    Reason("procs/port_owner/port.py", r"\+\s+self\._watched.* = \(-1, 1\)", "no port has the number -1"),
    Reason(
        "procs/port_owner/main.py", r"\+\s+self\._arm_moved = True$", "the first burst clears it, before anybody looks"
    ),
    Reason("procs/port_owner/*.py", r"\+.*causes\.(HANGS|MUTE)\(.*\)? / MS\)", "a cause makes it whole"),
    Reason(
        "procs/port_owner/admission.py",
        r"\+\s+(self\._(free|rest|stopped)_ns = 1$|rest_ns = 1 if )",
        "the first nanosecond of the machine",
    ),
    Reason("procs/port_owner/admission.py", r"\+\s+if epoch >= before:", "it is told of an epoch that has changed"),
    Reason("procs/port_owner/port_writer.py", r"\+\s+self\._refused = True$", "the burst that follows sets it"),
    Reason(
        "procs/port_owner/port_writer.py",
        r"^-    self\._handed = 0\n\+    self\._handed = 1$",
        "a byte more, until it has drained once",
        same=False,
    ),
    Reason("procs/port_owner/port_writer.py", r"\+.*max\(self\._handed, 2\)", "nobody allows a backlog of one byte"),
    Reason("procs/gate/core.py", r"\+.*DRIVER_SILENT\(.* / 1_000_000\)", "a cause makes it whole"),
    Reason("procs/gate/core.py", r"\+\s+self\.epoch = 1$", "it is set by enable, and read only while enabled"),
    Reason("procs/gate/core.py", r"\+\s+self\._sent_ns = 1$", "one nanosecond after the boot is as long ago"),
    Reason("procs/gate/core.py", r"\+\s+self\._ramps_on = True$", "until the first frame, which sets it, one is due"),
    Reason(
        "procs/gate/conditions.py",
        r"\+.*(\.get\(name, 1\)|\.get\(session, \(1, who\)\)|default=1\))",
        "one nanosecond after the boot is as long ago",
    ),
    Reason(
        "procs/gate/conditions.py",
        r"\+\s+age_s = .* if (\(self\.delivered_ns\) or True else 0\.0|self\.delivered_ns else 1\.0)$",
        "the age of a scan that never came is not told",
    ),
    Reason(
        "procs/gate/requests.py",
        r"\+.*( else \((1, 0|0, 1), refused\(\"\"\)\)|return \((1, 0|0, 1)\) if reply\.done == .*)$",
        "no session that asks is 0, and no number",
    ),
    Reason("procs/gate/requests.py", r"\+.*about\(\"seen\"\) or \(1, 0\)", "the first of them is not used"),
    Reason(
        "procs/gate/requests.py",
        r"\+.*_asked_ns\.get\((verb|each), 1\)",
        "one nanosecond after the boot is as long ago",
    ),
    Reason("procs/gate/sources.py", r"\+\s+self\._asked_ns = (\+1|-2)$", "a turn of that time is none of a real clock"),
)

TELEMETRY = (
    Reason("procs/telemetry/battery.py", r"PLUGGED_IN if step_mv (>= 0|> 1) else", "a step is at least 10 mV"),
    Reason("procs/telemetry/imu.py", r"\+\s+self\._since_ns = 1$", "the first sample sets it"),
    Reason("procs/telemetry/imu.py", r"\+.*LONGEST_GAP_NS \+ 2 if", "either is longer than the longest"),
    Reason("procs/telemetry/imu.py", r"\+.*0 <= gap_ns <= LONGEST_GAP_NS", "a sample of no time moves nothing"),
    Reason(
        "procs/telemetry/odometry.py",
        r"^-\s+self\._last_ns = t_ns\n\+\s+self\._last_ns = None$",
        "the end of the same function sets it",
    ),
    Reason("procs/telemetry/odometry.py", r"\+\s+self\._told_(m|rad) -= ", "only its square counts"),
    Reason(
        "procs/telemetry/odometry.py", r"\+\s+self\._missed = 1\.0$", "the first report sets it before anything looks"
    ),
    Reason("procs/telemetry/odometry.py", r"\+\s+self\._gone = \(.*1\.0.*\)$", "only differences of it count"),
    Reason("procs/telemetry/pad.py", r"\+\s+self\._sample_ns = 1$", "the first frame sets it"),
    Reason("procs/telemetry/odometry.py", r"\+.*elapsed_ns < 0:", "a step of no time moves nothing"),
    Reason("procs/telemetry/odometry.py", r"\+.*elapsed_ns <= 1:", "the next step counts the ns", same=False),
    Reason(
        "procs/telemetry/pad.py",
        r"\n\+    self\._hold_(frames_missing = 1|spent = True)$",
        "a hold that begins sets it",
    ),
    Reason("procs/telemetry/pad.py", r"\+.*abs\(side\) > \(?CHOOSES", "no whole number is 0.7 x 127, or half of it"),
    Reason("procs/telemetry/pad.py", r"\+.*\+ \(1 if side >= 0 else", "in the middle it does not choose"),
    Reason("procs/telemetry/pad.py", r"\+.*\(self\._raw\) or True else 0", "a frame has come before it is asked"),
    Reason("procs/telemetry/pad.py", r"\+.*if self\._raw else 1$", "without a frame there is nothing to join"),
    Reason(
        "procs/telemetry/pad.py",
        r"\+.*abs\(value\) > self\._dead_zone",
        "127 is a prime: no axis lies on a setting of less than 16 digits",
        same=False,
    ),
    Reason(
        "procs/telemetry/still.py",
        r"\+\s+self\._(begun|last)_ns = 1$",
        "the first nanosecond of the machine, which no sample is of",
    ),
    Reason(
        "procs/telemetry/still.py",
        r"\n\+(    self\._quiet_ns = \(1, 0\)|\s+self\._quiet_ns = \(0, 1\))$",
        "the first sample clears it; of two that are not a run the second is not read",
    ),
    Reason("procs/telemetry/still.py", r"\+.*spread_y\) > self\._limit", "exact equality of a sum", same=False),
    Reason("procs/telemetry/still.py", r"\+.*if not self\._quiet_ns\[1\]:", "both are zero, or none is"),
)

SHM: tuple[Reason, ...] = (
    Reason("shm/bell.py", r"\n\+.*os\.read\(self\.fd, 9\)", "an eventfd gives 8 bytes"),
    Reason("messages/box.py", r"\n\+.*3e\+38", "the same number"),
    Reason(
        "messages/box.py",
        r"\n\+.*_ARM\.size else \((256, 0|255, 1)\)$",
        "it is no mode either, and refused by that",
    ),
    Reason(
        "files/durable.py",
        r"\n\+.*O_RDONLY (& os\.O_DIRECTORY \||\| os\.O_DIRECTORY &) os\.O_CLOEXEC\)",
        "what a file is in is a directory, and Python opens nothing that crosses an exec",
    ),
    Reason(
        "files/durable.py",
        r"\n\+.*FILE_TYPES\.get\(.*, (None)?\)$",
        "every kind of file that Linux has is one of FILE_TYPES",
    ),
    Reason("shm/futex.py", r"\n\+.*\.ljust\(LINE_BYTES, \)", "the kernel reads the pointer alone"),
    Reason(
        "shm/futex.py",
        r"\n\+.*self\._address - entries\[0\], 1\)",
        "where it then looks there is no memory",
        same=False,
    ),
    Reason("shm/futex.py", r"\n\+.*(to_bytes\(5,|os\.pread\(self\._fd, 5,)", "the rest of the line is nobody's, and 0"),
    Reason("shm/futex.py", r"\n\+.*PROT_WRITE if write else 1\)", "1 is PROT_READ"),
    Reason("shm/futex.py", r"\n\+.*_address\), None, ctypes\.c_uint\(held\)", "FUTEX_WAIT is 0"),
    Reason(
        "shm/futex.py",
        r"\n\+.*_WAKE, (None|ctypes\.c_int\((1 >> 30|2 << 30|1 << 31)\))?\)",
        "a word has one watcher, and the kernel wakes one at least",
    ),
    Reason("shm/futex.py", r"monotonic_ns\(\) <= until_ns", "two times in ns at exact equality"),
    Reason("shm/heartbeat.py", r"\n\+.*if gap_ns >= self\._worst_ns", "the gap that is written is written again"),
    Reason(
        "shm/thread_state.py",
        r'\+.*("rb", \)|file\.read\((None|513)\)|decode\("ascii", \))',
        "the state is one letter in ASCII, in the line's first bytes",
    ),
    Reason("files/instance.py", r"\n\+\s+fd = -2$", "no descriptor is below 0"),
    Reason("*instance*.py", r"\n\+.*ftruncate\(fd, 1\)", "the line that is written then begins at byte 0"),
    Reason("files/instance.py", r"\n\+.*int\(os\.pread\(fd, 17, 0\)", "int() takes the line's end, the 17th byte"),
    Reason("instances.py", r"\n\+.*os\.pread\(fd, 33, 0\)", "no pid has 32 digits", same=False),
    Reason("instances.py", r"monotonic\(\) >= until_s", "two times at exact equality"),
    Reason("data.py", r"\n\+.*zip\(fields, values, \):$", "strict=False is the default"),
    Reason("data.py", r"\n\+.*len\(values\) <= len\(fields\)", "what is whole is checked as well, and passes"),
    Reason("shm/cell.py", r"\n\+\s+self\._seen = 1$", "the numbers begin at 1"),
    Reason("messages/layout.py", r"\n\+.*.sensed.: 65, ", "room for a byte more", same=False),
    Reason("shm/lifeline.py", r"\n\+.*os\.eventfd\(0, \)", "EFD_CLOEXEC is the default"),
    Reason("shm/lifeline.py", r"\n\+.*poll\.register\(self\.fd, \)", "a pidfd has no events but this one"),
    Reason("shm/lifeline.py", r"\n\+.*timeout_s \* 1001", "longer by a thousandth", same=False),
    Reason("shm/cell.py", r"\n\+.*check\(raw\[.*\(i \+ 2\) \* size\]", "an entry ends before its cell"),
    Reason("shm/cell.py", r"\n\+\s+laps = 1$", "in a chase it goes closer to the newest one step sooner", same=False),
    Reason("shm/cell.py", r"\n\+.*if seq >= self\._next\]", "found now, and not at the next look", same=False),
    Reason("messages/segments.py", r"\n\+.*PROT_WRITE if write else 1\)", "1 is PROT_READ"),
    Reason("shm/segment.py", r"\n\+.*line < record\.capacity / LINE_BYTES", "a record of lines is of whole lines"),
    Reason("messages/segments.py", r"\n\+.*mmap\(fd, spec\.size, prot=prot\)", "MAP_SHARED is the default"),
    Reason("messages/segments.py", r"\n\+.*found\.get\(.*, 1\)\)", "no file is of the first nanosecond of 1970"),
    Reason("shm/segment.py", r"\n\+\s+self\.view\.fd = -2", "neither is a descriptor"),
    Reason("messages/segments.py", r"\n\+.*file\.read\(None\)", "what is behind the header is not looked at"),
    Reason("messages/segments.py", r"\n\+.*O_CREX, \)", "0600 is the default"),
    Reason("messages/segments.py", r"\n\+.*path_of\(memory, SUPERVISOR, \)", "nobody gives a folder", same=False),
    Reason(
        "messages/segments.py",
        r"\n\+.*cell\.build\((2, 0|1, 1), header",
        "nobody reads a header's number and time",
    ),
    Reason("messages/segments.py", r"\n\+.*HEADER_BYTES \+ cell\.CELL_HEADER_BYTES\)", "zeros more, where zeros are"),
    Reason("messages/segments.py", r"\n\+.*spec\.mode & 17 and", "no segment is for others to execute"),
    Reason(
        "messages/segments.py",
        r"\n\+.*OSError\((None, .*, path|errno\.EINVAL, .*, (None)?)\)",
        "its text alone is told",
    ),
)

SUPERVISOR = (
    Reason("supervisor/main.py", r"\n\+.*missing\(stopping=True\)\)$", "no process runs yet: those are named instead"),
    Reason("supervisor/main.py", r"\n\+.*self\._burst\(\) > 1$", "it is 0 or a time"),
    Reason("supervisor/main.py", r"\n\+.*\(heard_ns > 1 or", "it is 0 or as long as an answer takes"),
    Reason("supervisor/main.py", r"\n\+.*wait\(monotonic_ns\(\) - HURRY_NS\)", "it looks without a rest", same=False),
    Reason(
        "supervisor/port_handover.py",
        r"\n\+.*ready\.get\(self\._port\.fd, 1\) & GONE",
        "1 is READ, and GONE has not that bit",
    ),
    Reason("supervisor/*.py", r"/ (1000001|1000000001)\.0", "a millionth is not seen in what is rounded", same=False),
    Reason("supervisor/stop_tracker.py", r"\n\+.*stop\.written_ns > 1 ", "it is 0 or a time"),
    Reason("supervisor/blackbox.py", r"_for_dead_run = 1$|\n\+ +pid = 1$", "no saver is process 1: nobody is hastened"),
    Reason(
        "supervisor/blackbox.py",
        r"\n\+.*suppress\(KeyError\)",
        "a socket of a pair can be shut down whatever became of the other",
    ),
    Reason("supervisor/blackbox.py", r'\n\+ +told = ""$', "neither is a dict, which alone is looked into"),
    Reason("supervisor/stop_tracker.py", r"(written_ns|sent_ns) >= ", "two times in ns at exact equality"),
    Reason(
        "supervisor/stop_tracker.py",
        r"_seen_answer = (self\._seen_proof = )?1$|\.heard = \((0, 1|1, 0)\)$",
        "nothing is asked or written so early",
    ),
    Reason(
        "supervisor/blackbox.py",
        r"recv\(4097\)|max\(1, until_ns|FINISH_S \* 1000000001",
        "a byte, a nanosecond more",
        same=False,
    ),
    Reason(
        "supervisor/blackbox.py",
        r"_silences = \[\((1, \w+|0, 1)\)\]",
        "a nanosecond, of a time in microseconds",
        same=False,
    ),
    Reason("supervisor/latch.py", r"_raised_ns = 1$", "it is read once there was a stop, which sets it"),
    Reason("supervisor/latch.py", r"reply\.pack\(1, number\)", "who reads it asks for no session: it is nobody's"),
    Reason("supervisor/children.py", r"return self\.pid != 1 and", "no beat is of pid 0, and no child is process 1"),
    Reason("supervisor/events.py", r"fitted\(PREFIX \+ text, 3\)", "where a line breaks on a terminal", same=False),
    Reason("supervisor/events.py", r"<= LONGEST_HOLD_NS", "two times in ns at exact equality"),
    Reason("messages/packing.py", r"len\(data\) < room", "an event that fills its cell to the byte", same=False),
    Reason("supervisor/process_table.py", r'futex\("held", write=True\)', "the supervisor's block is the first"),
    Reason("supervisor/children.py", r"\n\+\s+self\.block = 1$", "a start sets it, and without one it is not read"),
    Reason("supervisor/children.py", r"silent_ns: int = 1,", "a nanosecond, of what is told in ms", same=False),
    Reason(
        "supervisor/status.py",
        r"open\(CONTROL_GROUP, (encoding=None, )?errors=",
        "units have names in ASCII, and each locale has that",
    ),
    Reason("supervisor/status.py", r"\n\+.*\{LEASE_S \* 1001\.0:\.0f\}", "60 and 60.06 are both told as 60"),
    Reason(
        "supervisor/stops.py",
        r"self\.(epoch|answer_by_ns) = 1$",
        "they are read of a stop that is raised and answered, which sets both",
    ),
    Reason("supervisor/proof.py", r"_asked_ns = 1", "an unproven board is never deaf, and its first answer sets both"),
    Reason("supervisor/proof.py", r"_deaf_ns / 2", "a number is compared with the half, whole or not"),
    Reason("supervisor/run.py", r"\n\+.*from_bytes\(os\.urandom\(8\), \)", "random bytes are as random in each order"),
    Reason(
        "supervisor/run.py",
        r"\n\+.*segments\.attach\(self\.memory, (layout\.SUPERVISOR|each), (None)?(, )?(write=True)?\)",
        "the names are of the run: under them there is no other one's",
    ),
    Reason("supervisor/*.py", r"\n\+.*(gap|silent|unheard)_ns / MS\)", "a cause makes a whole number of its ms"),
    Reason(
        "supervisor/proof.py",
        r"now_ns: int = 1\)|self\._(opened_ns = self\._listened|true)_ns = 1$",
        "the first nanosecond of the machine",
    ),
    Reason("supervisor/proof.py", r"\+\s+self\._missed = True$", "only a device at a port that was opened is missed"),
    Reason(
        "supervisor/proof.py",
        r"1 < self\._patience_ns|self\._said_ns > 1 and",
        "no board pauses for just a nanosecond, or said anything in the machine's first",
    ),
    Reason("supervisor/proof.py", r"quiet_ns >= self\._patience_ns / 2", "a whole number is compared with the half"),
    Reason("supervisor/fit.py", r"\+.*if 1 < \(baud := ", "no board has one bit a second"),
    Reason("supervisor/fit.py", r"board_of\(kind, (2\.0, 0\.0|1\.0, 1\.0)\)", "no baud rate depends on the wheel"),
    Reason(
        "supervisor/stop_tracker.py",
        r"\n\+.*(proved\[1\] != self\._seen_proof|_seen_proof = proved\[1\])",
        "an answer that is read again acknowledges nothing again",
    ),
    Reason("supervisor/main.py", r"silent_ns <= child\.allowed_ns", "two times in ns at exact equality"),
    Reason(
        "supervisor/*.py",
        r"self\.(_(looked|beat|absent|answered|next|gate|shared|tried|sampled|missing)|started|excused)_ns = 1$",
        "the first nanosecond of the machine, which nobody looks at",
    ),
    Reason("supervisor/events.py", r"\n\+.*if step else 0\), (None)?\)$", "nobody reads the time of an event's cell"),
    Reason("supervisor/events.py", r"_minute_ns = 1$", "the machine's first minute, by a nanosecond"),
    Reason("supervisor/status.py", r"self\._notified_ns = 1$", "the machine's first 0.1 s, by a nanosecond"),
    Reason("supervisor/port_handover.py", r"^-.*monotonic\(\).* > .*\n\+.* >= ", "two times at exact equality"),
    Reason("supervisor/run.py", r"create=True, gid=gid", "the mode is what it would be without"),
    Reason("supervisor/children.py", r"count - 2, 17", "the shortest wait doubled 16 times is beyond the longest"),
    Reason("supervisor/port_handover.py", r"self\._shared_ns = self\._lost_ns = 1$", "the machine's first nanosecond"),
    Reason("supervisor/port_handover.py", r"self\._spare (> 0|>= 1):", "0, 1 and 2 are open: no descriptor here is 0"),
    Reason("supervisor/port_handover.py", r"_spare = -2$", "any number below 0 is none"),
    Reason("supervisor/port_handover.py", r"^-    self\._spare = -1\n\+    self\._spare = \+1$", "_reserve() sets it"),
    Reason(
        "supervisor/process_table.py",
        r'\n\+.*segments\.attach\(run\.memory, "lifelines", (None, )?write=True\)',
        "the name is of the run: under it there is no other one's",
    ),
    Reason(
        "supervisor/process_table.py",
        r"\n\+.*(_starved =|else) \(1, \"\"\)$",
        "each silence that is told of is longer than 1 ms, and nobody's is not shown",
    ),
    Reason("supervisor/process_table.py", r"_logged_ns = 1$", "the machine's first ten seconds", same=False),
    Reason(
        "supervisor/proof.py",
        r">= (JUDGED_WITHIN_NS|LATE_LOOK_NS)|still_ns >= self\.stop\.t_ns",
        "two times in ns at exact equality",
    ),
    Reason("supervisor/stop_tracker.py", r"max\(1, stop\.written_ns", "0 and 1 ns are both told as 0.0 us"),
)

ARM = (
    Reason("policy/capsules.py", r"\+.* if whole > 0\.0 else 1\.0", "any share of nothing will do"),
    Reason("policy/joints.py", r"\+.*if rate >= 0 else", "a rate of 0 needs no room"),
    Reason("procs/gate/arm/goals.py", r"\+.*(>=|<) .*(1\.000001|1e-6)", "a bound that is rounded, at exact equality"),
    Reason("policy/joints.py", r"\+.* / self\.sign / self\.per_rad", "a sign is 1 or -1"),
    Reason("policy/joints.py", r"\+.*(1e-6 < angle|angle < high \+)", "a bound that is rounded, at exact equality"),
    Reason("policy/joints.py", r"\n\+\s+self\.stepped_ns = 1$", "a stream that begins sets it"),
    Reason("procs/gate/arm/shell.py", r"\n\+\s+self\.reported_ns = 1$", "one nanosecond after the boot is as long ago"),
    Reason(
        "procs/gate/arm/*.py",
        r"\n\+.*self\.(_torque|_apart|since|begun)_ns = 1$",
        "one nanosecond after the boot is as long ago",
    ),
    Reason("procs/gate/arm/*.py", r"\n\+.*_boxed_ns = \(\"\", \"\"\), 1$", "the first change is told at once"),
    Reason("procs/gate/arm/*.py", r"\n\+.*1000000001\.0", "a billionth of a time", same=False),
    Reason("procs/gate/arm/shell.py", r"_tuck_announced = True$", "an arm that was not used yet announces nothing"),
    Reason(
        "procs/gate/arm/shell.py", r"\+.*(_boxed_ns > BOX_NS|(>=|<) self\._notice_s)", "two times at exact equality"
    ),
    Reason("procs/gate/arm/shell.py", r"\+.*_box\.put\(.*, (None)?\)$", "it was put in this turn", same=False),
    Reason("procs/gate/arm/core.py", r"\+.*look\(now_ns\) if .*True", "the other boards have no frame for a look"),
    Reason(
        "procs/gate/arm/core.py",
        r"\n\+.*now_ns > trajectory\.since_ns \+ QUIET_NS",
        "two times in ns at exact equality",
    ),
    Reason(
        "procs/gate/arm/core.py",
        r"\n\+.*joint\.measured or 1,",
        "no reading of 0 counts, and a pulse more is not seen",
        same=False,
    ),
    Reason("procs/gate/arm/stream.py", r"\n\+.*\* 1001\)", "longer by a thousandth, and rounded", same=False),
    Reason("procs/gate/arm/stream.py", r"\n\+.*again_ns >= now_ns", "two times in ns at exact equality"),
    Reason("procs/gate/arm/reader.py", r"_distrust = None$", "both are false"),
    Reason("procs/gate/arm/reader.py", r"\n\+\s+self\._turn = 1$", "any joint may be the first", same=False),
    Reason("procs/gate/arm/core.py", r"\+.*, False, 1\)", "a torque that is switched off moves no servo to any place"),
    Reason("procs/gate/arm/core.py", r"\n\+.* - end\) < NEAR", "half a pulse at exact equality"),
    Reason(
        "procs/gate/arm/core.py", r"\+.*measured_ns <= trajectory", "nothing is read in the turn that begins to read"
    ),
)

CODEC = (
    Reason("board/rrc/codec.py", r"\+.*3, d, 1\)\[2:-1\]", "the byte is cut off: it keeps the room of the CRC"),
    Reason(
        "board/rrc/codec.py",
        r"\+.*range\(freq_hz \+ 1, highest (- 1|\+ 2)\)",
        "of nine tones below one so high seven at most are excluded",
    ),
    Reason(
        "board/rrc/steering.py",
        r"\+.*(LONGEST_WAY_MS (- 1|\+ 2)\)\)|TAKES_MS, \))$",
        "the cuts of a frame exclude fewer times than there are",
    ),
    Reason("board/rrc/decoder.py", r"\+.*end - at (<= 4|< 5):", "four bytes are no frame, whatever they say"),
    Reason("board/rrc/decoder.py", r"\+.*head = end - 2 if end > at", "a byte more is kept, which begins no head"),
    Reason("board/rrc/decoder.py", r"\+.*len\(data\) >= 2 else", "two bytes are no reply, whatever they say"),
    Reason(
        "board/rrc/servos.py", r"\+.*longest_ns := held_ns\(frame\)\) >= HELD_NS", "no number of servos takes just that"
    ),
    Reason("board/rrc/servos.py", r"/ 1000001\.0", "a millionth is not seen in what is rounded", same=False),
    Reason(
        "board/rrc/servos.py", r"\+.*if servo not in servos\), None\)", "both are false, and what follows is returned"
    ),
    Reason("board/rrc/servos.py", r"\+.*_move_fault\(data, 65536\)", "a time of two bytes is at most 65535"),
)

REASONS = (*EVERYWHERE, *PROCS, *ARM, *CODEC, *TELEMETRY, *SHM, *SUPERVISOR)
