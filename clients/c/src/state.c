/* The state: what the gate has decided, and what is known of the robot (failstop/api/state.py, failstop/api/robot.py). */
#include "internal.h"

#include <math.h>

static const char *const LINK[] = {LINKS};

/* The gate's word for why nothing moves. */
static int block_of(const struct fsi_value *text) {
  static const struct {
    const char *text;
    int block;
  } each[] = {
      {TEXT_BLOCK_DISABLED, FS_BLOCK_DISABLED},
      {TEXT_BLOCK_HELD, FS_BLOCK_HELD},
      {TEXT_BLOCK_NO_COMMAND, FS_BLOCK_NO_COMMAND},
      {TEXT_BLOCK_NO_SCAN, FS_BLOCK_NO_SCAN},
  };
  if (text->kind == FSI_NIL) return FS_MAY_MOVE;
  for (size_t at = 0; at < sizeof each / sizeof *each; at++)
    if (fsi_is(text, each[at].text)) return each[at].block;
  return FS_BLOCK_LATCHED;
}

static int numbers(struct fsi_packed *in, const struct fsi_value *array, double *to, int most) {
  int count = 0;
  for (uint32_t at = 0; array->kind == FSI_ARRAY && at < array->count && !in->bad; at++) {
    struct fsi_value value = fsi_next(in);
    fsi_skip(in, &value);
    if (count < most) to[count++] = value.number;
  }
  return count;
}

/* What this handle's source does, and who drives. */
struct judged {
  bool known, held, driver_is_own;
  bool driven;
  const char *who;
  uint32_t who_size;
};

static void read_sources(const fs_robot *robot, struct fsi_packed *in, const struct fsi_value *rows, struct judged *judged) {
  int own = atomic_load_explicit(&robot->source, memory_order_relaxed);
  const struct fsi_run *run = robot->run;
  for (uint32_t row = 0; rows->kind == FSI_ARRAY && row < rows->count && !in->bad; row++) {
    struct fsi_value map = fsi_next(in), source = {0}, who = {0}, state = {0};
    for (uint32_t pair = 0; map.kind == FSI_MAP && pair < map.count && !in->bad; pair++) {
      struct fsi_value key = fsi_next(in);
      fsi_skip(in, &key);
      struct fsi_value value = fsi_next(in);
      if (fsi_is(&key, "source")) source = value;
      if (fsi_is(&key, "who")) who = value;
      if (fsi_is(&key, "state")) state = value;
      fsi_skip(in, &value);
    }
    bool ours = own >= 0 && source.kind == FSI_STR && source.count == run->source[own].size &&
                memcmp(source.text, run->source[own].text, source.count) == 0;
    if (ours) {
      judged->known = true;
      judged->held = fsi_is(&state, "held");
    }
    if (!judged->driven && fsi_is(&state, "drives")) {
      judged->driven = true;
      judged->driver_is_own = ours;
      judged->who = who.kind == FSI_STR ? who.text : "";
      judged->who_size = who.kind == FSI_STR ? who.count : 0;
    }
  }
}

/* Far longer than the gate takes from its decision until it has written it. */
#define DECIDED_NS UINT64_C(20000000)

/* Whether this handle's newest command no longer counts at this time. */
static bool is_expired(const fs_robot *robot, int source, uint64_t at_ns) {
  uint64_t wanted_ns = atomic_load_explicit(&robot->wanted_ns, memory_order_relaxed);
  uint64_t timeout_ns = robot->run->source[source].timeout_ns;
  return timeout_ns && at_ns > wanted_ns && at_ns - wanted_ns > timeout_ns;
}

/* What becomes of this handle's newest command, as Robot.drive() says it (failstop/api/robot.py, judge). */
static void judge(const fs_robot *robot, const struct judged *judged, struct fsi_decided *decided) {
  int source = atomic_load_explicit(&robot->source, memory_order_relaxed);
  if (source < 0 || robot->slot < 0) {
    decided->answer = FS_ANSWER_NONE;
    return;
  }
  decided->taken = judged->known || is_expired(robot, source, fsi_now_ns());
  /* The gate's decision has no expired command, so its source's row is another program's then. */
  decided->expired = decided->t_ns > DECIDED_NS && is_expired(robot, source, decided->t_ns - DECIDED_NS);
  decided->answer = FS_BLOCKED;
  if (decided->block == FS_BLOCK_LATCHED || decided->block == FS_BLOCK_DISABLED) {
    decided->answer_block = decided->block;
  } else if (decided->expired ? !judged->driven : !judged->known) {
    decided->answer_block = FS_BLOCK_NO_COMMAND;
  } else if (!decided->expired && judged->held) {
    decided->answer_block = FS_BLOCK_HELD;
  } else if (judged->driven && (decided->expired || !judged->driver_is_own)) {
    decided->answer = FS_PREEMPTED;
    decided->by = judged->who;
    decided->by_size = judged->who_size;
  } else if (decided->block != FS_MAY_MOVE) {
    decided->answer_block = decided->block;
  } else {
    decided->answer = FS_DRIVING;
  }
}

static void read_state(const fs_robot *robot, const struct fsi_entry *entry, struct fsi_decided *decided,
                       struct judged *judged) {
  struct fsi_packed in = {entry->data, entry->data + entry->size, false};
  struct fsi_value map = fsi_next(&in);
  decided->t_ns = entry->t_ns;
  for (uint32_t pair = 0; map.kind == FSI_MAP && pair < map.count && !in.bad; pair++) {
    struct fsi_value key = fsi_next(&in);
    fsi_skip(&in, &key);
    struct fsi_value value = fsi_next(&in);
    if (fsi_is(&key, "enabled")) {
      decided->enabled = value.integer != 0;
    } else if (fsi_is(&key, "enabled_ns")) {
      decided->enabled_ns = value.natural;
    } else if (fsi_is(&key, "limit")) {
      decided->limit = (int)value.integer;
    } else if (fsi_is(&key, "blocked")) {
      decided->block = block_of(&value);
    } else if (fsi_is(&key, "estop") && value.kind == FSI_BIN && value.count) {
      decided->packed = (const uint8_t *)value.text;
      decided->packed_size = value.count;
    } else if (fsi_is(&key, "body_vel")) {
      numbers(&in, &value, decided->velocity, 3);
      continue;
    } else if (fsi_is(&key, "wheels_rps")) {
      decided->speed_count = numbers(&in, &value, decided->speeds, MOST_SPEEDS);
      continue;
    } else if (fsi_is(&key, "sources")) {
      read_sources(robot, &in, &value, judged);
      continue;
    }
    fsi_skip(&in, &value);
  }
}

void fsi_decide(const fs_robot *robot, struct fsi_decided *decided) {
  struct fsi_run *run = robot->run;
  struct fsi_entry entry;
  struct judged judged = {0};
  memset(decided, 0, offsetof(struct fsi_decided, latched));
  decided->limit = 100;
  decided->block = FS_BLOCK_DISABLED;
  decided->t_ns = run->began_ns;
  decided->dead = fsi_over(run);
  /* Read before the gate's record, so that a newer epoch is no sign of a stop. */
  decided->epoch = fsi_word(run->supervisor.map + AT_SUPERVISOR_EPOCH);
  atomic_thread_fence(memory_order_seq_cst);
  if (fsi_read(&run->state, decided->buffer, &entry)) read_state(robot, &entry, decided, &judged);
  bool own = decided->packed != NULL;
  if (own) decided->cause = fsi_cause_number(decided->packed, decided->packed_size);
  if (fsi_read(&run->latch, decided->latched, &entry) && entry.size >= N_LATCH && fsi_u64(entry.data + F_LATCH_EPOCH)) {
    decided->packed = entry.data + N_LATCH;
    decided->packed_size = entry.size - N_LATCH;
    decided->cause = fsi_cause_number(decided->packed, decided->packed_size);
  }
  if (!decided->cause && decided->dead) {
    static const uint8_t died[] = {CAUSE_DIED & 0xFF, CAUSE_DIED >> 8, 's', 'u', 'p', 'e', 'r', 'v', 'i', 's', 'o', 'r'};
    decided->cause = CAUSE_DIED;
    decided->packed = died;
    decided->packed_size = sizeof died;
  }
  if (!decided->cause && decided->enabled) {
    uint64_t now_ns = fsi_now_ns(), beat_ns = fsi_word(run->supervisor.map + AT_SUPERVISOR_BEAT_NS);
    if (now_ns > beat_ns && now_ns - beat_ns > run->lease_ns) {
      static const uint8_t silent[] = {CAUSE_SILENT & 0xFF, CAUSE_SILENT >> 8};
      decided->cause = CAUSE_SILENT;
      decided->packed = silent;
      decided->packed_size = sizeof silent;
    }
  }
  /* A stop that the gate has not followed yet is in force all the same: nothing of an older epoch is admitted. */
  if (decided->cause && !own) {
    decided->enabled = false;
    decided->enabled_ns = 0;
    memset(decided->velocity, 0, sizeof decided->velocity);
    memset(decided->speeds, 0, sizeof decided->speeds);
    judged = (struct judged){0};
  }
  if (decided->cause) decided->block = FS_BLOCK_LATCHED;
  judge(robot, &judged, decided);
}

static double age_s(uint64_t now_ns, uint64_t t_ns) { return now_ns > t_ns ? (double)(now_ns - t_ns) / 1e9 : 0; }

static void doubles(double *to, const uint8_t *from, int count) {
  for (int at = 0; at < count; at++) to[at] = fsi_double(from + 8 * at);
}

static void read_wheels(struct fsi_run *run, uint64_t now_ns, fs_state *state) {
  uint8_t buffer[2 * CELL_BYTES(CAP_TELEMETRY_WHEELS)];
  struct fsi_entry entry;
  if (!fsi_read(&run->wheels_seen, buffer, &entry) || entry.size != N_WHEELS) return;
  uint64_t read_ns = fsi_u64(entry.data + F_WHEELS_READ_NS);
  int does = entry.data[F_WHEELS_DOES], count = entry.data[F_WHEELS_COUNT];
  /* A reading that is too old says nothing about now. */
  if ((now_ns <= read_ns || now_ns - read_ns <= OLD_READING_NS) && does) {
    state->turning = does == WHEELS_STILL ? FS_STILL : does == WHEELS_TURNING ? FS_TURNING : FS_TURNING_UNKNOWN;
    state->turning_unexpected = entry.data[F_WHEELS_UNEXPECTED] != 0;
  }
  if (read_ns) state->measured_age_s = age_s(now_ns, read_ns);
  const double turn = 2 * 3.14159265358979323846;
  for (int given = 0; given < 2; given++) {
    double by_id[MOST_WHEELS], *to = given ? state->turned_rad : state->measured_radps;
    bool whole = count > 0 && count <= MOST_WHEELS;
    doubles(by_id, entry.data + (given ? F_WHEELS_TURNS : F_WHEELS_RPS), MOST_WHEELS);
    for (int at = 0; whole && at < count; at++) whole = !isnan(by_id[at]);
    for (int wheel = 0; whole && wheel < run->wheels.count; wheel++)
      if (run->wheels.id[wheel] < count) to[wheel] = by_id[run->wheels.id[wheel]] * run->wheels.sign[wheel] * turn + 0.0;
  }
}

static void read_telemetry(struct fsi_run *run, uint64_t now_ns, fs_state *state) {
  uint8_t buffer[2 * CELL_BYTES(CAP_TELEMETRY_ODOMETRY)];
  struct fsi_entry entry;
  _Static_assert(CAP_TELEMETRY_ODOMETRY >= CAP_TELEMETRY_IMU && CAP_TELEMETRY_ODOMETRY >= CAP_TELEMETRY_BATTERY, "room");
  if (fsi_read(&run->imu, buffer, &entry) && entry.size == N_IMU) {
    doubles(state->acceleration, entry.data + F_IMU_ACCELERATION, 3);
    doubles(state->rate, entry.data + F_IMU_RATE, 3);
    state->imu_age_s = age_s(now_ns, entry.t_ns);
  }
  if (fsi_read(&run->battery, buffer, &entry) && entry.size == N_BATTERY) {
    uint32_t millivolts;
    memcpy(&millivolts, entry.data + F_BATTERY_MV, sizeof millivolts);
    if (millivolts) state->battery_v = millivolts / 1000.0;
    state->battery_age_s = age_s(now_ns, entry.t_ns);
  }
  if (fsi_read(&run->odometry, buffer, &entry) && entry.size == N_ODOMETRY) {
    doubles(state->pose, entry.data + F_ODOMETRY_POSE, 3);
    doubles(state->twist, entry.data + F_ODOMETRY_TWIST, 3);
    state->odometry_measured = entry.data[F_ODOMETRY_SOURCE] == BY_ROLLING;
    state->odometry_age_s = age_s(now_ns, entry.t_ns);
  }
}

static void read_board(struct fsi_run *run, fs_state *state) {
  uint8_t buffer[2 * CELL_BYTES(CAP_PORT_OWNER_PORT)];
  struct fsi_entry entry;
  /* A run begins with an open port, which its supervisor has; later the port owner reports it. */
  state->port_open = 1;
  if (fsi_read(&run->port, buffer, &entry) && entry.size >= N_PORT) state->port_open = entry.data[F_PORT_STATE] == PORT_OPEN;
  if (fsi_read(&run->link, buffer, &entry))
    for (size_t at = 0; at < sizeof LINK / sizeof *LINK; at++)
      if (entry.size == strlen(LINK[at]) && memcmp(entry.data, LINK[at], entry.size) == 0) state->link = (int32_t)at;
}

static void nothing_known(fs_state *state) {
  memset(state, 0, sizeof *state);
  state->block = FS_BLOCK_DISABLED;
  double *unknown[] = {&state->age_s, &state->steering_rad, &state->measured_age_s, &state->imu_age_s,
                       &state->battery_v, &state->battery_age_s, &state->odometry_age_s};
  for (size_t at = 0; at < sizeof unknown / sizeof *unknown; at++) *unknown[at] = NAN;
  for (int at = 0; at < FS_MOST_WHEELS; at++) state->measured_radps[at] = state->turned_rad[at] = NAN;
  for (int at = 0; at < 3; at++) state->acceleration[at] = state->rate[at] = state->pose[at] = state->twist[at] = NAN;
}

/* No later version's struct is larger; a size that was never set often is. */
#define MOST_STATE_BYTES 65536

int fs_get_state(const fs_robot *robot, fs_state *given) {
  fs_state state;
  struct fsi_decided decided;
  if (!robot || !given || given->size < offsetof(fs_state, epoch) || given->size > MOST_STATE_BYTES) return FS_INVALID;
  uint32_t size = given->size;
  int result = FS_NO_SERVICE;
  nothing_known(&state);
  if (fsi_is_forked(robot)) {
    result = FS_FORKED;
  } else if (robot->run) {
    struct fsi_run *run = robot->run;
    fsi_decide(robot, &decided);
    uint64_t now_ns = fsi_now_ns();
    result = decided.dead ? FS_NO_SERVICE : FS_OK;
    state.enabled = decided.enabled;
    state.latched = decided.cause != 0;
    state.cause = decided.cause;
    state.block = decided.block;
    state.answer = decided.answer;
    state.answer_block = decided.answer_block;
    state.epoch = decided.epoch;
    state.enabled_ns = decided.enabled_ns;
    state.age_s = age_s(now_ns, decided.t_ns);
    state.ready = !decided.dead && fsi_word(run->supervisor.map + AT_SUPERVISOR_READY) == 1;
    memcpy(state.velocity, decided.velocity, sizeof state.velocity);
    bool turns = false;
    for (int wheel = 0; wheel < run->wheels.count; wheel++) {
      double rps = decided.speeds[run->wheels.id[wheel]];
      turns = turns || rps > 0 || rps < 0;
      state.wheels_radps[wheel] = rps * run->wheels.sign[wheel] * (2 * 3.14159265358979323846) + 0.0;
    }
    state.moving = turns && decided.block == FS_MAY_MOVE;
    if (run->wheels.steered && turns && decided.speed_count) state.steering_rad = decided.speeds[decided.speed_count - 1];
    state.speed_limit = decided.limit / 100.0;
    read_board(run, &state);
    read_wheels(run, now_ns, &state);
    read_telemetry(run, now_ns, &state);
  } else {
    result = robot->unattached;
  }
  if (size > sizeof state) memset((uint8_t *)given + sizeof state, 0, size - sizeof state);
  state.size = size;
  memcpy(given, &state, size < sizeof state ? size : sizeof state);
  return result == FS_OK ? FS_OK : fsi_fail(robot, result);
}

static const char *block_text(int block) {
  switch (block) {
    case FS_BLOCK_DISABLED: return "motion is disabled";
    case FS_BLOCK_HELD: return "a program commanded before motion was enabled, so it must send zero or pause";
    case FS_BLOCK_NO_COMMAND: return "no program sends commands";
    case FS_BLOCK_NO_SCAN: return "the obstacle sensor is silent";
    default: return "";
  }
}

/* What the gate has decided, for a text of `size` bytes at `out`. Returns an fs_result. */
static int decide_for_text(const fs_robot *robot, const char *out, size_t size, struct fsi_decided *decided) {
  if (!robot || (!out && size)) return FS_INVALID;
  if (fsi_is_forked(robot)) return fsi_fail(robot, FS_FORKED);
  if (!robot->run) return fsi_fail(robot, robot->unattached);
  fsi_decide(robot, decided);
  return FS_OK;
}

int fs_why(const fs_robot *robot, char *out, size_t size) {
  struct fsi_text text = {out, size, 0};
  struct fsi_decided decided;
  int result = decide_for_text(robot, out, size, &decided);
  if (result != FS_OK) return result;
  int block = decided.answer == FS_BLOCKED ? decided.answer_block : decided.block;
  if (decided.cause) {
    fsi_add_cause(&text, decided.packed, decided.packed_size);
  } else if (decided.answer == FS_PREEMPTED) {
    fsi_add(&text, decided.by, decided.by_size);
    fsi_adds(&text, decided.expired ? " drives, and this program sends no commands" : " drives, as a source of higher priority");
  } else if (decided.answer == FS_BLOCKED && block == FS_BLOCK_NO_COMMAND && !decided.taken) {
    fsi_adds(&text, "the gate has not taken the command yet");
  } else if (decided.answer == FS_BLOCKED && block == FS_BLOCK_NO_COMMAND && decided.block != block) {
    fsi_adds(&text, "this program sends no commands");
  } else if (decided.answer == FS_BLOCKED && block == FS_BLOCK_HELD) {
    fsi_adds(&text, "commanded before motion was enabled: send zero or pause, then drive");
  } else {
    fsi_adds(&text, block_text(block));
  }
  return fsi_end(&text);
}

int fs_remedy(const fs_robot *robot, char *out, size_t size) {
  struct fsi_text text = {out, size, 0};
  struct fsi_decided decided;
  int result = decide_for_text(robot, out, size, &decided);
  if (result != FS_OK) return result;
  if (decided.cause) fsi_add_named(&text, fsi_cause_remedy(decided.cause), robot->places.name);
  return fsi_end(&text);
}

int fs_wheel_count(const fs_robot *robot) {
  if (!robot) return FS_INVALID;
  return robot->run ? robot->run->wheels.count : fsi_fail(robot, robot->unattached);
}

const char *fs_wheel_name(const fs_robot *robot, int index) {
  bool there = robot && robot->run && index >= 0 && index < robot->run->wheels.count;
  return there ? robot->run->wheels.names[index] : NULL;
}

int fs_setting(const fs_robot *robot, const char *key, char *out, size_t size) {
  struct fsi_text text = {out, size, 0};
  struct fsi_value found;
  if (!robot || !key || (!out && size)) return FS_INVALID;
  if (!robot->run) return fsi_fail(robot, robot->unattached);
  if (!fsi_find(robot->run->settings, robot->run->settings_size, key, &found, NULL)) return fsi_fail(robot, FS_UNDECLARED);
  if (found.kind == FSI_STR) {
    fsi_add(&text, found.text, found.count);
  } else if (found.kind == FSI_FLOAT) {
    fsi_add_number(&text, found.number);
  } else {
    char digits[24];
    size_t at = sizeof digits;
    uint64_t left = found.integer < 0 ? (uint64_t)-found.integer : (uint64_t)found.integer;
    do digits[--at] = (char)('0' + left % 10);
    while ((left /= 10) != 0);
    if (found.integer < 0) digits[--at] = '-';
    fsi_add(&text, digits + at, sizeof digits - at);
  }
  return fsi_end(&text);
}

static int declared(const fs_robot *robot, const char *key, const char *name) {
  struct fsi_value found;
  struct fsi_packed rest;
  if (!robot || !name) return FS_INVALID;
  if (!robot->run) return fsi_fail(robot, robot->unattached);
  if (!fsi_find(robot->run->rules, robot->run->rules_size, key, &found, &rest)) return 0;
  for (uint32_t at = 0; found.kind == FSI_ARRAY && at < found.count; at++) {
    struct fsi_value value = fsi_next(&rest);
    if (fsi_is(&value, name)) return 1;
  }
  return 0;
}

int fs_has_source(const fs_robot *robot, const char *name) { return declared(robot, "sources", name); }
int fs_has_interlock(const fs_robot *robot, const char *name) { return declared(robot, "interlocks", name); }
