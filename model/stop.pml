/* The stop protocol, for Spin: who may write to the board, and in which order, when processes die, hang and wake.
 *
 * Run ./check. model/README.md says what each part stands for in the code, and what the model leaves out.
 *
 * One step is one look at, or one change of, what processes share. A process that hangs stays at its step until it wakes
 * (`provided`); one that is killed leaves its sequence from any step (`unless`).
 */

#ifdef NO_FENCE
#define NO_STOPPER_FENCE
#endif
#ifndef FAULTS
#define FAULTS 2        /* kills, hangs, stop requests and unplugs in a run */
#endif

/* Processes. */
#define SUP 0
#define PO 1
#define GATE 2
#define STP 3

/* What a process is doing. */
#define RUNS 0
#define STARTS 1        /* started, and has not said yet that it runs */
#define HUNG 2          /* stopped where it is; may wake until the world is calm */
#define KILLED 3        /* SIGKILL has come: a write that it is in may still be done, wholly or in part */
#define DEAD 4

/* Descriptors of the port. */
#define NONE 0
#define GOOD 1
#define BROKEN 2        /* its device has gone */

/* What the service's processes share. */
byte state[4];
bit silent[4];          /* the heartbeat is older than every deadline */
byte epoch = 1;
byte stopped_word;      /* the epoch that the port owner has answered */
bit ready;
bit stops;              /* news for the supervisor in the port owner's ring of stops */
bit request;            /* bytes in the stop FIFO */
byte ring;              /* epoch of the newest motion frame in the gate's ring; 0: none */
bit ring_stop;          /* a stop is in the ring, before that frame */
byte fd[4];
byte opened;            /* the port that the supervisor's opener has opened and stopped, and its loop has not taken yet */
byte passed_po, passed_stp;     /* the descriptor that waits in the control socket */
bit port_open;          /* the port owner's port record names the port that the supervisor has */
bit fencing;            /* the stopper is about to do the second half of its fencing */
bit answered_death;     /* the port owner has written since the supervisor died */
bit po_died_sup, po_died_stp, gate_died_sup, gate_died_po, stp_died;    /* lifelines that have not been looked at */
bit po_writing;         /* the port owner's loop holds the lock in which it looks whether it may write, and writes */
bit told_gate, told_sup;        /* its threads have stopped for a death that the loop has not looked at */

/* The board and the world. The kernel passes bytes on in the order of the writes: the write orders everything. */
bit plugged = 1;
bit moves;              /* the last speed that the board was told is not zero */
bit cut;                /* the board is inside a frame that nobody will complete */
byte faults = FAULTS;
bit calm;               /* from here on nothing more goes wrong, nobody commands, and what hangs stays hung */
bit told;               /* the stop tool has written */

#ifdef REPORTS
/* What the board reports of its wheels, and what telemetry makes of it. A report may be true, lie, come late, or never. */
bit turn_said;          /* the newest report says that the wheels turn */
bit unasked;            /* telemetry's record says that they turn although they were told zero */
bit again_asked;        /* an entry without a cause in telemetry's ring: the stop is to be written again */
#endif

#ifdef GARBLES
/* A board that takes a stop only alone on the line, between idle gaps: two writes that touch are both lost. */
#define QUIET 0
#define STOPS 1
#define DRIVES 2
#define NOISE 3         /* two writes, of one writer or of two, without a gap between */
byte line;              /* what was written since the line was last idle */
bit again[4];           /* a writer's stop is still to be repeated */
#endif

#ifdef GARBLES
#define no_repeat(p) again[p] = 0
#else
#define no_repeat(p) skip
#endif

/* A motion frame, and what it comes from: the gate's permission, the gate's ring, the port owner's copy, the wheels. */
byte under;             /* the epoch in which the gate has motion enabled; 0: disabled */
byte po_seen, gate_seen;        /* the epoch that each has seen last */
byte stopped_in;        /* the newest epoch in which the port owner stopped on its own */
byte frame;             /* the epoch of the frame that the port owner is about to write; 0: none */

/* Ghosts: read by assertions only. What a stop or a cause has made invalid until the next enable. */
#define FRESH 0
#define EARLY 1         /* a stop was written beside a port owner that may be in a write */
#define FINAL 2         /* a stop was written by the port owner, or while no port owner could be in a write */
byte gate_mark, ring_mark, frame_mark;
bit caused;             /* something that must stop the wheels has happened since the last enable */
bit strayed;

#define awake(p) (state[p] != HUNG)
/* A turn that begins late begins with the beat: what else it does late, it did when it was stopped in it. */
#define beats(p) (!silent[p])
#define acts(p) (state[p] == RUNS && !silent[p])
#define usable(p) (fd[p] == GOOD && plugged)

inline kill_po() { if :: state[PO] != DEAD -> state[PO] = KILLED; caused = 1 :: else fi }

inline disable() { under = 0; gate_mark = FRESH }

inline kill_gate() {
  if
  :: state[GATE] != DEAD -> state[GATE] = DEAD; caused = 1; disable(); gate_died_sup = 1; gate_died_po = 1
  :: else
  fi
}

inline kill_stp() {
  if
  :: state[STP] != DEAD ->
    state[STP] = DEAD; caused = 1; fd[STP] = NONE; fencing = 0; stp_died = 1; no_repeat(STP)
  :: else
  fi
}

inline kill_sup() { state[SUP] = DEAD; caused = 1; fd[SUP] = NONE; no_repeat(SUP) }

#ifdef GARBLES
inline write_stop(p) { line = (line == QUIET -> STOPS : NOISE); again[p] = 1 }
#else
inline write_stop(p) {
#ifdef SINGLE_STOP
  if :: cut -> cut = 0 :: else -> moves = 0 fi
#else
  cut = 0; moves = 0
#endif
}
#endif

/* A burst that is on its way to the board. */
inline stopped(p) {
  d_step {
    write_stop(p);
    strayed = 0;
    if
    :: p == PO || state[PO] == DEAD || state[PO] == STARTS ->
      gate_mark = (under -> FINAL : FRESH); ring_mark = (ring -> FINAL : FRESH); frame_mark = (frame -> FINAL : FRESH)
    :: else ->
      if :: under && gate_mark == FRESH -> gate_mark = EARLY :: else fi;
      if :: ring && ring_mark == FRESH -> ring_mark = EARLY :: else fi;
      if :: frame && frame_mark == FRESH -> frame_mark = EARLY :: else fi
    fi
  }
}

#ifdef HEEDS_REPORTS
/* Wheels that are reported to stand are not stopped. */
inline burst(p) { if :: usable(p) && turn_said -> stopped(p) :: else fi }
#else
inline burst(p) { if :: usable(p) -> stopped(p) :: else fi }
#endif

/* The burst for the port owner's death. Where a successor has begun, it is the echo of a stop that was written before. */
inline death_burst(p) {
  if
  :: state[PO] == DEAD -> burst(p)
  :: else -> if :: usable(p) -> write_stop(p) :: else fi
  fi
}

/* The port owner's frame, taken wholly by the kernel. */
inline motion() {
  if
  :: usable(PO) && cut -> cut = 0
  :: usable(PO) && !cut ->
#ifdef GARBLES
    line = (line == QUIET -> DRIVES : NOISE);
    no_repeat(PO);
#else
    moves = 1;
#endif
    assert(!told);                                                    /* S3 */
    assert(frame_mark != FINAL);                                      /* S1 */
    assert(frame_mark != EARLY || !strayed);                          /* S2 */
    if :: frame_mark == EARLY -> strayed = 1 :: else fi
  :: else
  fi
}

inline no_ring() { ring = 0; ring_mark = FRESH }

inline no_frame() { frame = 0; frame_mark = FRESH }

/* ---- procs/port_owner/main.py */

inline refuse() {
  drives = 0;
#ifndef NO_STOPPED_IN
  stopped_in = epoch
#endif
}

#define lapsed (silent[GATE] || silent[SUP])
#ifdef NO_EPOCH
#define current (frame && seen > stopped_in)
#else
#define current (frame == seen && seen > stopped_in)
#endif
#if defined(NO_EPOCH) || defined(NO_RECHECK)
#define recheck true
#else
#define recheck (epoch == frame)
#endif

#ifdef NO_BAR
#define may_write true
#else
#define may_write !barred
#endif
#ifdef NO_LOCK
#define unlocked true
#else
#define unlocked !po_writing
#endif

/* What a turn answers before it looks into the ring. */
#define barred ((told_gate && gate_died_po) || (told_sup && !answered_death))
#define causes (request || gate_died_po || (state[SUP] == DEAD && !orphan) || (drives && lapsed) || epoch != seen || \
  fd[PO] == BROKEN)

proctype port_owner() provided (awake(PO))
{
  bit drives, orphan;
#define seen po_seen
begin:
  {
    atomic { seen = epoch; burst(PO) };
    atomic {
      stopped_word = seen; port_open = (fd[PO] == GOOD); silent[PO] = 0;
      if :: state[PO] == STARTS -> state[PO] = RUNS :: else fi
    };
end_turn:
    if
    :: d_step { beats(PO) && request -> burst(PO) };
      d_step { request = 0; refuse() };
      stops = 1
#ifdef REPORTS
    :: d_step { beats(PO) && again_asked -> again_asked = 0; if :: usable(PO) -> write_stop(PO) :: else fi }
#endif
    :: d_step { beats(PO) && gate_died_po -> burst(PO) };
      d_step { gate_died_po = 0; told_gate = 0; refuse() };
      stops = 1
    :: d_step { beats(PO) && state[SUP] == DEAD && !orphan -> burst(PO) };
      d_step { orphan = 1; answered_death = 1; refuse() }
    :: d_step { beats(PO) && drives && lapsed -> burst(PO) };
lapse:
      atomic { refuse() };
      stops = 1
    :: atomic { beats(PO) && epoch != seen ->
        if :: stopped_in >= seen && !drives :: else -> burst(PO); drives = 0 fi;
        seen = epoch };
      stopped_word = seen
    :: d_step { beats(PO) && fd[PO] == BROKEN -> fd[PO] = NONE; refuse() };
      d_step { stops = 1; port_open = 0 }
    :: atomic { beats(PO) && (ring || ring_stop) && !causes ->
        frame = ring; frame_mark = ring_mark;
#ifndef RING_KEPT
        no_ring();
#endif
        /* A frame behind that stop is of a newer enable: the stop is not for it. */
        if :: ring_stop -> ring_stop = 0; drives = 0; if :: usable(PO) -> write_stop(PO) :: else fi :: else fi;
        if
        :: current && lapsed -> no_frame(); burst(PO); goto lapse
        :: current && !lapsed
        :: else -> no_frame(); goto end_turn
        fi };
      atomic { if :: recheck && may_write -> po_writing = 1 :: else -> no_frame(); goto end_turn fi };
      d_step { motion(); drives = 1; po_writing = 0; no_frame() }
#ifdef NEW_HIDES_LOSS
    :: d_step { beats(PO) && passed_po && fd[PO] != GOOD -> fd[PO] = passed_po; passed_po = NONE; burst(PO) };
#else
    :: d_step { beats(PO) && passed_po && fd[PO] == NONE -> fd[PO] = passed_po; passed_po = NONE; burst(PO) };
#endif
      port_open = (fd[PO] == GOOD)
    :: d_step { beats(PO) && passed_po && fd[PO] == GOOD -> passed_po = NONE }
    :: silent[PO] -> silent[PO] = 0
    fi;
    goto end_turn
  } unless { state[PO] == KILLED };
dies:
  atomic {
    if
    :: po_writing -> if :: motion() :: usable(PO) -> cut = 1 :: true fi
    :: else
    fi;
    seen = 0; stopped_in = 0; no_frame(); drives = 0; orphan = 0; po_writing = 0;
    told_gate = 0; told_sup = 0; no_repeat(PO);
    fd[PO] = NONE; state[PO] = DEAD; po_died_sup = 1; po_died_stp = 1
  };
end_dead:
  atomic { if :: state[PO] == STARTS -> goto begin :: state[PO] == KILLED -> goto dies fi }
}

/* ---- shm/lifeline.py: the port owner's threads, to which a death is told before its loop has woken. Those of supervisor and
 * stopper write nothing that their loops would not, at no other moment: they stop for a port owner that is dead. */

proctype news() provided (awake(PO))
{
end_waits:
  do
  :: d_step { state[PO] == RUNS && gate_died_po && !told_gate && unlocked -> told_gate = 1; burst(PO) }
  :: d_step { state[PO] == RUNS && state[SUP] == DEAD && !answered_death && !told_sup && unlocked -> told_sup = 1; burst(PO) }
  od
}

/* ---- procs/gate/main.py; without its latch: a client may reset it as soon as the epoch is newer */

proctype gate() provided (awake(GATE))
{
#undef seen
#define seen gate_seen
end_turn:
  do
  :: d_step { state[GATE] == STARTS -> seen = epoch; state[GATE] = RUNS; silent[GATE] = 0 }
  :: d_step { acts(GATE) && epoch != seen -> seen = epoch; disable() }
  :: d_step { acts(GATE) && !under && !calm && ready -> under = seen; gate_mark = FRESH; caused = 0 }
  :: d_step { acts(GATE) && under && !calm && (ring != under || ring_mark != gate_mark) ->
      ring = under; ring_mark = gate_mark }
#ifdef DISABLE
  :: d_step { acts(GATE) && under && !calm -> caused = 1; disable(); ring_stop = 1; no_ring() }
#endif
#ifdef REPORTS
  :: d_step { acts(GATE) && under && unasked && !calm -> caused = 1; disable(); ring_stop = 1; no_ring() }
#endif
  :: state[GATE] == RUNS && silent[GATE] -> silent[GATE] = 0
  od
}

#ifdef REPORTS
/* ---- procs/telemetry: whatever a report says, it may raise a cause, have the stop written again, and tell the gate */

proctype telemetry()
{
end_reads:
  do
  :: d_step { !calm && turn_said != unasked -> unasked = turn_said }
  :: d_step { faults && !calm && !told && turn_said && !request -> faults--; request = 1; caused = 1 }
  :: d_step { !calm && turn_said && !again_asked -> again_asked = 1 }
  od
}
#endif

/* ---- supervisor/main.py */

/* Epochs are only ever compared: those that nothing holds any more are numbered away, so that recoveries meet again. */
#define held(v) (epoch == v || po_seen == v || gate_seen == v || stopped_in == v || stopped_word == v || under == v || \
  ring == v || frame == v)
#define lower(x, v) x = (x > v -> x - 1 : x)

inline renumber(v) {
  if
  :: epoch > v && !held(v) ->
    lower(epoch, v); lower(po_seen, v); lower(gate_seen, v); lower(stopped_in, v); lower(stopped_word, v);
    lower(under, v); lower(ring, v); lower(frame, v)
  :: else
  fi
}

inline renumber_all() { renumber(6); renumber(5); renumber(4); renumber(3); renumber(2); renumber(1) }

#define raise_epoch epoch++; unanswered = 1; renumber_all(); assert(epoch < 8)
/* What the supervisor knows: a death counts when it has been noticed. */
#define runs(p, news) (state[p] != STARTS && (state[p] != DEAD || news))
#ifdef READY_EARLY
#define answered !unanswered
#else
#define answered (!unanswered && stopped_word == epoch)
#endif
#define all_run (runs(PO, po_died_sup) && runs(GATE, gate_died_sup) && runs(STP, stp_died) && port_open && answered)
#define hangs(p) (silent[p] && (state[p] == RUNS || state[p] == HUNG))

proctype supervisor() provided (awake(SUP))
{
  bit unanswered, missing;
  {
    skip;
end_turn:
    if
    :: d_step { beats(SUP) && po_died_sup -> po_died_sup = 0;
#ifndef NO_SECOND_BURST
        death_burst(SUP)
#endif
      };
raise:
      ready = 0;
      d_step { raise_epoch }
    :: atomic { beats(SUP) && (stops || gate_died_sup || stp_died) -> stops = 0; gate_died_sup = 0; stp_died = 0; goto raise }
    :: beats(SUP) && fd[SUP] == BROKEN -> fd[SUP] = NONE
    :: d_step { beats(SUP) && opened ->
        fd[SUP] = opened; passed_stp = opened; opened = NONE; port_open = 0;
#ifdef GARBLES
        again[SUP] = 1;         /* of the opener's */
#endif
        if :: state[PO] != DEAD -> passed_po = fd[SUP] :: else fi }
    :: d_step { beats(SUP) && unanswered && stopped_word == epoch -> unanswered = 0 }
    :: d_step { beats(SUP) && unanswered && stopped_word != epoch -> unanswered = 0;
#ifdef NO_SECOND_BURST
        if :: state[PO] == DEAD :: else -> burst(SUP) fi
#else
        burst(SUP)
#endif
      }
#ifndef NO_FENCE
#ifdef BURST_FIRST
    :: d_step { beats(SUP) && hangs(PO) -> burst(SUP) };
      ready = 0;
      d_step { raise_epoch };
      d_step { kill_po() }
#else
    :: d_step { beats(SUP) && hangs(PO) -> kill_po() };
      atomic { burst(SUP); goto raise }
#endif
#endif
    :: d_step { beats(SUP) && hangs(GATE) -> ready = 0 };
      d_step { raise_epoch };
      d_step { kill_gate() }
    :: d_step { beats(SUP) && hangs(STP) -> ready = 0 };
      d_step { raise_epoch };
      d_step { kill_stp() }
#ifndef STAYS_DOWN
    :: d_step { beats(SUP) && state[PO] == DEAD && !po_died_sup -> state[PO] = STARTS; fd[PO] = fd[SUP] }
#endif
    :: d_step { beats(SUP) && state[GATE] == DEAD && !gate_died_sup -> state[GATE] = STARTS }
    :: d_step { beats(SUP) && state[STP] == DEAD && !stp_died -> state[STP] = STARTS; fd[STP] = fd[SUP] }
    :: d_step { beats(SUP) && ready != all_run -> missing = !all_run };
      d_step { ready = !missing; missing = 0; renumber_all() }
    :: silent[SUP] -> silent[SUP] = 0
    fi;
    goto end_turn
  } unless { state[SUP] == DEAD };
  d_step { kill_gate() }                        /* PR_SET_PDEATHSIG */
}

/* ---- supervisor/port_handover.py: a thread of the supervisor's, which stops the board before anybody hears of the port */

proctype opener() provided (awake(SUP))
{
end_looks:
  do
  :: d_step { state[SUP] != DEAD && fd[SUP] == NONE && opened == NONE && plugged -> opened = GOOD;
#ifndef NO_RETURN_BURST
      stopped(SUP)
#endif
    }
  od
}

/* ---- procs/stopper/main.py */

/* Its pidfd names one port owner: once that has died, there is nobody to kill, and the burst answers the death. */
#define named (!po_died_stp)
#define idle (acts(STP) && !fencing)

#if defined(NO_STOPPER_FENCE)
#define fence_first burst(STP)
#define fence_then skip
#elif defined(BURST_FIRST)
#define fence_first burst(STP)
#define fence_then if :: named -> kill_po() :: else fi
#else
#define fence_first if :: named -> kill_po() :: else fi
#define fence_then if :: named -> burst(STP) :: else -> death_burst(STP) fi
#endif

proctype stopper() provided (awake(STP))
{
  bit orphan;
  bit late;             /* it wrote beside a port owner that had not answered the supervisor's death */
end_turn:
  do
  :: d_step { state[STP] == STARTS -> state[STP] = RUNS; silent[STP] = 0 }
  :: d_step { fencing -> fencing = 0; fence_then }
  :: d_step { idle && po_died_stp -> po_died_stp = 0;
#ifndef NO_SECOND_BURST
      death_burst(STP)
#endif
    }
  :: d_step { idle && state[SUP] == DEAD && !orphan && (answered_death || state[PO] == DEAD) -> orphan = 1; burst(STP) }
  :: d_step { idle && state[SUP] == DEAD && !orphan && !answered_death && state[PO] != DEAD ->
      orphan = 1; late = 1; burst(STP) }
  :: d_step { idle && late && !answered_death && state[PO] != DEAD -> late = 0; fencing = 1; fence_first }
  :: d_step { idle && !orphan && hangs(PO) && named -> fencing = 1; fence_first }
  :: d_step { idle && fd[STP] == BROKEN -> fd[STP] = NONE }
  :: d_step { idle && passed_stp -> fd[STP] = passed_stp; passed_stp = NONE }
  :: state[STP] == RUNS && silent[STP] -> silent[STP] = 0
  od
}

/* ---- systemd: the watchdog; ExecStopPost with the stop tool, once the supervisor is dead */

proctype systemd()
{
end_watch:
  if
  :: d_step { hangs(SUP) -> kill_sup() }; goto end_watch
  :: state[SUP] == DEAD
  fi;
#ifndef NO_TOOL_KILL
  d_step { kill_po(); kill_stp() };
  state[PO] == DEAD && state[GATE] == DEAD && state[STP] == DEAD;
#endif
  d_step { plugged -> fd[SUP] = GOOD; burst(SUP); told = 1 };
#ifdef GARBLES
  d_step { line == QUIET -> write_stop(SUP) }
#endif
}

#ifdef GARBLES
/* ---- the line to such a board, and the repeats of each writer, at times of its own: no two writers' touch twice in a row */

#define due(p) (again[p] && line == QUIET && state[p] == RUNS && usable(p))
#ifdef SAME_TIMES
#define alone(p) (due(SUP) + due(PO) + due(STP) == 1)
#else
#define alone(p) true
#endif

inline repeat(p) { again[p] = 0; line = STOPS }

proctype board()
{
end_quiet:
  do
  :: d_step { line != QUIET ->
      if :: line == STOPS -> cut = 0; moves = 0 :: line == DRIVES -> moves = 1 :: else -> cut = 0 fi;
      line = QUIET }
#ifndef NO_REPEATS
  :: d_step { due(SUP) && alone(SUP) -> repeat(SUP) }
  :: d_step { due(PO) && alone(PO) -> repeat(PO) }
  :: d_step { due(STP) && alone(STP) -> repeat(STP) }
#ifdef SAME_TIMES
  :: d_step { due(SUP) + due(PO) + due(STP) > 1 -> again[SUP] = 0; again[PO] = 0; again[STP] = 0; line = NOISE }
#endif
#endif
  od
}
#endif

/* ---- what may happen at any time; and the judge, when nothing is left to happen */

#define may_fail (faults && !calm && !told)

proctype world()
{
end_world:
  do
#ifndef NO_KILLS
  :: d_step { may_fail && state[SUP] < KILLED -> faults--; kill_sup() }
  :: d_step { may_fail && state[PO] < KILLED -> faults--; kill_po() }
  :: d_step { may_fail && state[GATE] < KILLED -> faults--; kill_gate() }
  :: d_step { may_fail && state[STP] < KILLED -> faults--; kill_stp() }
#endif
#ifndef NO_HANGS
  :: d_step { may_fail && state[SUP] < HUNG -> faults--; state[SUP] = HUNG }
  :: d_step { may_fail && state[PO] < HUNG -> faults--; state[PO] = HUNG }
  :: d_step { may_fail && state[GATE] < HUNG -> faults--; state[GATE] = HUNG }
  :: d_step { may_fail && state[STP] < HUNG -> faults--; state[STP] = HUNG }
#endif
#ifndef NO_REQUESTS
  :: d_step { may_fail && !request -> faults--; request = 1; caused = 1 }
#endif
#ifndef NO_UNPLUGS
  :: d_step { may_fail && plugged -> faults--; plugged = 0; cut = 0;
      /* What the kernel held is lost, stops too: the worst that the board may have been told last. */
      moves = 1;
      caused = 1;
#ifdef GARBLES
      line = QUIET; again[SUP] = 0; again[PO] = 0; again[STP] = 0;
#endif
      if :: fd[SUP] == GOOD -> fd[SUP] = BROKEN :: else fi;
      if :: fd[PO] == GOOD -> fd[PO] = BROKEN :: else fi;
      if :: fd[STP] == GOOD -> fd[STP] = BROKEN :: else fi;
      if :: opened == GOOD -> opened = BROKEN :: else fi;
      if :: passed_po == GOOD -> passed_po = BROKEN :: else fi;
      if :: passed_stp == GOOD -> passed_stp = BROKEN :: else fi }
#endif
#ifdef REPORTS
  :: d_step { !calm -> turn_said = 1 - turn_said }
#endif
  :: d_step { !plugged -> plugged = 1 }
  :: d_step { !calm -> calm = 1; faults = 0 }
  :: d_step { state[SUP] == HUNG && !calm -> state[SUP] = RUNS }
  :: d_step { state[PO] == HUNG && !calm -> state[PO] = RUNS }
  :: d_step { state[GATE] == HUNG && !calm -> state[GATE] = RUNS }
  :: d_step { state[STP] == HUNG && !calm -> state[STP] = RUNS }
  /* A heartbeat is old some time after its process has stopped to run; it is new when the process beats again. */
  :: d_step { !silent[SUP] && !awake(SUP) -> silent[SUP] = 1 }
  :: d_step { !silent[PO] && !awake(PO) -> silent[PO] = 1 }
  :: d_step { !silent[GATE] && !awake(GATE) -> silent[GATE] = 1 }
  :: d_step { !silent[STP] && !awake(STP) -> silent[STP] = 1 }
  :: atomic { timeout -> assert(calm && (!moves || (!caused && under == epoch))); break }    /* L */
  od
}

init {
  atomic {
    fd[SUP] = GOOD; fd[PO] = GOOD; fd[STP] = GOOD;
    run supervisor(); run opener(); run port_owner(); run news(); run gate(); run stopper(); run systemd(); run world();
#ifdef GARBLES
    run board();
#endif
#ifdef REPORTS
    run telemetry();
#endif
    skip
  }
}

/* With the check of end states this makes L whole: once the world is calm, no run goes on for ever, fair or not. */
#ifdef ENDS
ltl ends { !(<>[] calm) }
#endif
