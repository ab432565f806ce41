/* Handles: the slot of this client, its commands and its requests (failstop/api/client.py, failstop/api/session.py). */
#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/random.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* A command that repeats the one before it this soon wakes nobody: the gate looks for it at its tick. */
#define REPEAT_NS UINT64_C(45000000)
#define LOOK_NS UINT64_C(5000000)
#define POLL_NS UINT64_C(300000)
#define LONGEST_WAIT_S 3600.0

/* All handles of this process, for its forks. */
static pthread_mutex_t handles_lock = PTHREAD_MUTEX_INITIALIZER;
static fs_robot *handles;
static pthread_once_t prepared = PTHREAD_ONCE_INIT;

static void before_fork(void) { pthread_mutex_lock(&handles_lock); }
static void after_fork(void) { pthread_mutex_unlock(&handles_lock); }

/* While a slot is taken or given back. A fork waits: its child would hold the claim by a descriptor that in_child() does
 * not know. Nor may the thread be cancelled meanwhile. */
static int begin_slot(void) {
  int cancels;
  pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, &cancels);
  pthread_mutex_lock(&handles_lock);
  return cancels;
}

static void end_slot(int cancels) {
  pthread_mutex_unlock(&handles_lock);
  pthread_setcancelstate(cancels, NULL);
}

static void disown_slot(fs_robot *robot) {
  fsi_disown(&robot->claims);
  fsi_disown(&robot->bell);
  fsi_disown(&robot->segment);
}

/* In the child: the slot is the parent's, and the child must not hold it when the parent has died. */
static void in_child(void) {
  for (fs_robot *robot = handles; robot; robot = robot->next) {
    atomic_store(&robot->forked, true);
    fsi_in_child(robot->life);
    disown_slot(robot);
  }
  pthread_mutex_unlock(&handles_lock);
}

static void prepare(void) { pthread_atfork(before_fork, after_fork, in_child); }

static void enlist(fs_robot *robot) {
  pthread_once(&prepared, prepare);
  pthread_mutex_lock(&handles_lock);
  robot->next = handles;
  handles = robot;
  pthread_mutex_unlock(&handles_lock);
}

/* With the lock held. */
static void unlist(fs_robot *robot) {
  for (fs_robot **at = &handles; *at; at = &(*at)->next) {
    if (*at == robot) {
      *at = robot->next;
      break;
    }
  }
}

int fsi_fail(const fs_robot *robot, int code) {
  atomic_store_explicit(&((fs_robot *)(uintptr_t)robot)->last, code, memory_order_relaxed);
  return code;
}

int fsi_fail_with(fs_robot *robot, int code, const char *why) {
  struct fsi_text text = {robot->error, sizeof robot->error, 0};
  pthread_mutex_lock(&robot->texts);
  robot->told = code;
  fsi_add_named(&text, why, robot->places.name);
  fsi_end(&text);
  pthread_mutex_unlock(&robot->texts);
  return fsi_fail(robot, code);
}

bool fsi_is_forked(const fs_robot *robot) {
  return atomic_load_explicit(&robot->forked, memory_order_relaxed) || getpid() != robot->owner;
}

/* -- The slot ------------------------------------------------------------------------------------------------------ */

static void writer(fs_robot *robot, struct fsi_writer *writer, const char *record, size_t at, size_t capacity) {
  char name[48];
  snprintf(name, sizeof name, "client.%d.%s", robot->slot, record);
  *writer = (struct fsi_writer){robot->segment.fd, (off_t)at, capacity, fsi_seed(name, robot->run->incarnation), 0};
}

/* Empty the slot, except for the goodbyes: a goodbye that the gate has not seen would look like a death. */
static void wipe(int fd) {
  static const uint8_t zeros[4096];
  struct stat file;
  if (fstat(fd, &file)) return;
  for (off_t at = AT_CLIENT_HELD; at < file.st_size;) {
    off_t left = file.st_size - at;
    ssize_t done = pwrite(fd, zeros, left < (off_t)sizeof zeros ? (size_t)left : sizeof zeros, at);
    if (done <= 0) return;
    at += done;
  }
}

/* Whether wipe() may: the kernel ends a program that writes more into a file than its limit. */
static bool may_write(int fd) {
  struct rlimit most;
  struct stat file;
  return !getrlimit(RLIMIT_FSIZE, &most) && !fstat(fd, &file) && (rlim_t)file.st_size <= most.rlim_cur;
}

static int claim(int fd, int slot, bool take) {
  struct flock lock = {.l_type = (short)(take ? F_WRLCK : F_UNLCK), .l_whence = SEEK_SET, .l_start = slot, .l_len = 1};
  return fcntl(fd, F_OFD_SETLK, &lock);
}

static void ring_slot(const fs_robot *robot, int *error) {
  uint8_t byte = (uint8_t)robot->slot;
  *error = fsi_send(robot->bell.fd, &byte, 1);
}

static void say_goodbye(fs_robot *robot) {
  uint8_t raw[2 * CELL_BYTES(CAP_CLIENT_LEFT)], goodbyes[8 * GOODBYES] = {0};
  struct fsi_entry before;
  memcpy(goodbyes, &robot->session, sizeof robot->session);
  robot->left.seq = 0;
  if (pread(robot->segment.fd, raw, sizeof raw, AT_CLIENT_LEFT) == (ssize_t)sizeof raw &&
      fsi_newest(raw, sizeof raw / 2, robot->left.seed, &before)) {
    robot->left.seq = before.seq;
    if (before.size == sizeof goodbyes) memcpy(goodbyes + 8, before.data, sizeof goodbyes - 8);
  }
  fsi_put(&robot->left, goodbyes, sizeof goodbyes, fsi_now_ns());
}

/* Give the slot back; a command in it stops counting at once. */
static void leave(fs_robot *robot, bool in_order) {
  if (robot->slot >= 0 && !fsi_is_forked(robot)) {
    int ignored;
    /* Nobody reads the slot of a run that is over. It also looks so to a program that has closed the descriptors. */
    if (!fsi_over(robot->run)) {
      if (in_order) say_goodbye(robot);
      wipe(robot->segment.fd);
      ring_slot(robot, &ignored);
    }
    fsi_let_go(robot->life);
    /* A child that was forked by another library may still have a copy of this descriptor. */
    if (fsi_owns(&robot->claims)) claim(robot->claims.fd, robot->slot, false);
  } else {
    fsi_forget(robot->life);
  }
  robot->life = NULL;
  robot->slot = -1;
  atomic_store(&robot->source, -1);
  atomic_store(&robot->enabled, false);
  disown_slot(robot);
}

static uint64_t pid_namespace(void) {
  struct stat found;
  return stat("/proc/self/ns/pid", &found) ? 0 : (uint64_t)found.st_ino;
}

static int going_away(fs_robot *robot) {
  char why[400];
  snprintf(why, sizeof why, "the service '%s' is ending: try again", robot->places.name);
  return fsi_fail_with(robot, FS_NO_SERVICE, why);
}

static int open_for_drivers(fs_robot *robot, const char *file, int flags, bool pipe, struct fsi_owned *opened) {
  struct fsi_refusal refusal;
  char why[400];
  fsi_own(opened, fsi_open_in(&robot->places, robot->run->which, file, flags, pipe, &refusal));
  if (opened->fd >= 0) return FS_OK;
  if (refusal.why == EACCES || refusal.why == EPERM) {
    snprintf(why, sizeof why, "this user may stop '%s' but not drive it: join the group `failstop`, or run as the service's user",
             robot->places.name);
    return fsi_fail_with(robot, FS_NO_PERMISSION, why);
  }
  if (refusal.why == ENOENT || refusal.why == ENXIO) return going_away(robot);
  fsi_describe(why, sizeof why, &robot->places, robot->run->which, file, &refusal);
  return fsi_fail_with(robot, refusal.why == EMFILE || refusal.why == ENFILE ? FS_SYSTEM : FS_DAMAGED, why);
}

static int take_slot(fs_robot *robot) {
  char why[400] = "", name[16];
  int damaged = 0;
  for (int slot = 0; slot < CLIENT_SLOTS; slot++) {
    uint64_t size;
    if (claim(robot->claims.fd, slot, true)) continue;
    snprintf(name, sizeof name, "client.%d", slot);
    int fd = fsi_open_segment(robot->run, name, true, why, sizeof why);
    int result = fd > 0 ? fsi_check_segment(fd - 1, name, robot->run->incarnation, &size, why, sizeof why) : fd;
    if (result == FS_OK && size < AT_CLIENT_SAID + 2 * CELL_BYTES(CAP_CLIENT_SAID)) result = FS_DAMAGED;
    if (result == FS_OK && !may_write(fd - 1)) {
      snprintf(why, sizeof why, "this program may not write files as large as its client slot: raise `ulimit -f`");
      result = FS_SYSTEM;
    }
    if (result == FS_OK) {
      robot->slot = slot;
      fsi_own(&robot->segment, fd - 1);
      return FS_OK;
    }
    if (fd > 0) close(fd - 1);
    claim(robot->claims.fd, slot, false);
    if (result == FS_NO_PERMISSION || result == FS_SYSTEM || result == FS_OTHER_LAYOUT) return fsi_fail_with(robot, result, why);
    damaged++;
  }
  int used = snprintf(why, sizeof why, "all %d client slots of '%s' are taken", CLIENT_SLOTS, robot->places.name);
  if (damaged)
    used += snprintf(why + used, sizeof why - (size_t)used, ", %d of them damaged by a client: restart the service", damaged);
  snprintf(why + used, sizeof why - (size_t)used, "; close a client: `failstop status` lists them");
  return fsi_fail_with(robot, FS_NO_SLOT, why);
}

static int greet(fs_robot *robot) {
  uint8_t hello[CAP_CLIENT_HELLO];
  size_t name = fsi_cut(robot->client, strlen(robot->client), CAP_CLIENT_HELLO - N_HELLO);
  uint32_t pid = (uint32_t)robot->owner;
  uint64_t space = pid_namespace();
  memcpy(hello + F_HELLO_SESSION, &robot->session, 8);
  memcpy(hello + F_HELLO_PID, &pid, 4);
  memcpy(hello + F_HELLO_NAMESPACE, &space, 8);
  memcpy(hello + N_HELLO, robot->client, name);
  int error = fsi_put(&robot->hello, hello, N_HELLO + name, fsi_now_ns());
  if (!error) ring_slot(robot, &error);
  return error;
}

static int attach_to(fs_robot *robot) {
  struct fsi_refusal refusal;
  char why[400];
  int which, stop = fsi_open_stop(&robot->places, &which, &refusal);
  if (stop < 0) {
    if (refusal.why == ENOENT || refusal.why == ENXIO || refusal.why == ENOTDIR) {
      fsi_no_service(why, sizeof why, &robot->places);
      return fsi_fail_with(robot, FS_NO_SERVICE, why);
    }
    fsi_describe(why, sizeof why, &robot->places, which, "stop", &refusal);
    int code = refusal.why == EMFILE || refusal.why == ENFILE ? FS_SYSTEM : refusal.why == EACCES ? FS_NO_PERMISSION : FS_DAMAGED;
    return fsi_fail_with(robot, code, why);
  }
  if (!fsi_owns(&robot->stop)) {
    fsi_own(&robot->stop, stop);
  } else {
    /* The number stays, because a signal handler may be about to write to it. */
    int kept = robot->stop.fd;
    fsi_own(&robot->newer_stop, stop);
    dup3(stop, kept, O_CLOEXEC);
    fsi_own(&robot->stop, kept);
    fsi_disown(&robot->newer_stop);
  }
  int result = fsi_attach(&robot->run, &robot->places, which, why, sizeof why);
  return result == FS_OK ? FS_OK : fsi_fail_with(robot, result, why);
}

static int attach(fs_robot *robot) { return robot->unattached = attach_to(robot); }

int fs_open(fs_robot **made, const char *service, const char *client) {
  if (!made) return FS_INVALID;
  *made = NULL;
  fs_robot *robot = calloc(1, sizeof *robot);
  if (!robot) return FS_SYSTEM;
  if (fsi_places(&robot->places, service ? service : TEXT_DEFAULT_NAME) != FS_OK) {
    free(robot);
    return FS_INVALID;
  }
  bool whole;
  const char *name = client && *client ? client : program_invocation_short_name;
  robot->client[fsi_clean(robot->client, WHO_BYTES, name, &whole)] = 0;
  if (!*robot->client) memcpy(robot->client, "program", sizeof "program");
  robot->owner = getpid();
  robot->slot = -1;
  struct fsi_owned *none[] = {&robot->claims, &robot->bell, &robot->segment, &robot->stop, &robot->newer_stop};
  for (size_t at = 0; at < sizeof none / sizeof *none; at++) fsi_own(none[at], -1);
  atomic_init(&robot->source, -1);
  pthread_mutexattr_t inherits;
  pthread_mutexattr_init(&inherits);
  /* A real-time thread that posts a request waits here at most for another thread's write. */
  pthread_mutexattr_setprotocol(&inherits, PTHREAD_PRIO_INHERIT);
  pthread_mutex_init(&robot->writing, &inherits);
  pthread_mutexattr_destroy(&inherits);
  pthread_mutex_init(&robot->turn, NULL);
  pthread_mutex_init(&robot->texts, NULL);
  enlist(robot);
  *made = robot;
  return attach(robot);
}

static int connect_slot(fs_robot *robot) {
  if (robot->run && fsi_over(robot->run)) {
    leave(robot, true);
    fsi_detach(robot->run);
    robot->run = NULL;
  }
  if (robot->slot >= 0) return FS_OK;
  int result = robot->run ? FS_OK : attach(robot);
  if (result == FS_OK) result = open_for_drivers(robot, "claims", O_RDWR, false, &robot->claims);
  if (result == FS_OK) result = open_for_drivers(robot, "bell", O_WRONLY, true, &robot->bell);
  if (result == FS_OK) result = take_slot(robot);
  if (result == FS_OK) {
    if (getrandom(&robot->session, sizeof robot->session, 0) != (ssize_t)sizeof robot->session)
      robot->session = fsi_now_ns() ^ (uint64_t)robot->owner << 32;
    robot->session |= 1;
    wipe(robot->segment.fd);
    writer(robot, &robot->left, "left", AT_CLIENT_LEFT, CAP_CLIENT_LEFT);
    writer(robot, &robot->hello, "hello", AT_CLIENT_HELLO, CAP_CLIENT_HELLO);
    writer(robot, &robot->command, "command", AT_CLIENT_COMMAND, CAP_CLIENT_COMMAND);
    writer(robot, &robot->sensed, "sensed", AT_CLIENT_SENSED, CAP_CLIENT_SENSED);
    writer(robot, &robot->interlocks, "interlocks", AT_CLIENT_INTERLOCKS, CAP_CLIENT_INTERLOCKS);
    writer(robot, &robot->request, "request", AT_CLIENT_REQUEST, CAP_CLIENT_REQUEST);
    writer(robot, &robot->seen, "seen", AT_CLIENT_SEEN, CAP_CLIENT_SEEN);
    writer(robot, &robot->said, "said", AT_CLIENT_SAID, CAP_CLIENT_SAID);
    robot->number = 0;
    robot->commanded_ns = 0;
    robot->life = fsi_hold(robot->segment.fd, AT_CLIENT_HELD);
    if (greet(robot)) {
      leave(robot, true);
      return going_away(robot);
    }
    /* What was said of an earlier connection is over. */
    fsi_fail_with(robot, FS_OK, "");
    return FS_OK;
  }
  leave(robot, true);
  return result;
}

int fs_connect(fs_robot *robot) {
  if (!robot) return FS_INVALID;
  if (fsi_is_forked(robot)) return fsi_fail(robot, FS_FORKED);
  int cancels = begin_slot();
  int result = connect_slot(robot);
  end_slot(cancels);
  return result;
}

/* Whether the gate leaves motion enabled when this handle's program has died: it ends only the motion of a program that
 * has driven, and with the setting "stay" not that either. */
static bool outlived(const fs_robot *robot) {
  char setting[8] = "";
  fs_setting(robot, "gate.driver_death", setting, sizeof setting);
  return !robot->commanded_ns || !strcmp(setting, "stay");
}

/* When the motion was enabled that is enabled now; 0 if there is none. Not inlined, so that its large buffer takes no room
 * on the stacks of its callers. */
static __attribute__((noinline)) unsigned long long enabled_since(const fs_robot *robot) {
  struct fsi_decided decided;
  fsi_decide(robot, &decided);
  return decided.enabled_ns;
}

/* Whether the motion that is enabled now may be what this handle has enabled, and not what somebody else has enabled
 * since. The time is 0 if motion is disabled, and also while the supervisor is silent: then nobody knows. */
static bool is_own_motion(const fs_robot *robot) {
  unsigned long long own_ns = atomic_load(&robot->enabled_ns), now_ns = own_ns ? enabled_since(robot) : 0;
  return !own_ns || !now_ns || now_ns == own_ns;
}

static void end(fs_robot *robot, bool in_order) {
  if (!robot) return;
  bool whole = !fsi_is_forked(robot) && robot->slot >= 0 && !fsi_over(robot->run);
  bool disables = whole && atomic_load(&robot->enabled) && !atomic_load(&robot->keep_enabled);
  if (disables && is_own_motion(robot) && (in_order || outlived(robot))) fs_disable(robot, FS_DEFAULT_TIMEOUT);
  int cancels = begin_slot();
  leave(robot, in_order);
  unlist(robot);
  end_slot(cancels);
  fsi_detach(robot->run);
  fsi_disown(&robot->stop);
  pthread_mutex_destroy(&robot->turn);
  pthread_mutex_destroy(&robot->writing);
  pthread_mutex_destroy(&robot->texts);
  free(robot);
}

void fs_close(fs_robot *robot) { end(robot, true); }

void fs_abandon(fs_robot *robot) { end(robot, false); }

int fs_keep_enabled(fs_robot *robot) {
  if (!robot) return FS_INVALID;
  atomic_store(&robot->keep_enabled, true);
  return FS_OK;
}

/* -- Commands ------------------------------------------------------------------------------------------------------ */

/* FS_OK if this handle has a slot of a run that lives. */
static int usable(const fs_robot *robot) {
  if (!robot) return FS_INVALID;
  if (fsi_is_forked(robot)) return fsi_fail(robot, FS_FORKED);
  if (robot->slot < 0) return fsi_fail(robot, FS_NOT_CONNECTED);
  return fsi_over(robot->run) ? fsi_fail(robot, FS_NO_SERVICE) : FS_OK;
}

static int put(fs_robot *robot, struct fsi_writer *writer, const void *payload, size_t size, uint64_t t_ns) {
  int error = fsi_put(writer, payload, size, t_ns);
  return error ? fsi_fail(robot, error == EMSGSIZE ? FS_INVALID : FS_DAMAGED) : FS_OK;
}

static int ring(fs_robot *robot) {
  int error;
  ring_slot(robot, &error);
  return error ? fsi_fail(robot, FS_NO_SERVICE) : FS_OK;
}

static int source_of(const struct fsi_run *run, const char *name) {
  if (!name) return run->first_source;
  size_t size = strlen(name);
  for (int at = 0; at < run->sources; at++)
    if (run->source[at].size == size && memcmp(run->source[at].text, name, size) == 0) return at;
  return -1;
}

static int command(fs_robot *robot, const double *velocity, bool manual, const char *name, uint64_t wanted_ns) {
  int result = usable(robot);
  if (result != FS_OK) return result;
  if (!isfinite(velocity[0]) || !isfinite(velocity[1]) || !isfinite(velocity[2])) return fsi_fail(robot, FS_INVALID);
  int source = source_of(robot->run, name);
  if (source < 0 || robot->run->source[source].size > SOURCE_BYTES) return fsi_fail(robot, FS_UNDECLARED);
  uint8_t payload[CAP_CLIENT_COMMAND] = {0};
  _Static_assert(N_COMMAND + SOURCE_BYTES == CAP_CLIENT_COMMAND, "a command fills its record");
  memcpy(payload + F_COMMAND_SESSION, &robot->session, 8);
  memcpy(payload + F_COMMAND_VX, &velocity[0], 8);
  memcpy(payload + F_COMMAND_VY, &velocity[1], 8);
  memcpy(payload + F_COMMAND_WZ, &velocity[2], 8);
  payload[F_COMMAND_FLAGS] = manual ? BY_HAND : 0;
  memcpy(payload + N_COMMAND, robot->run->source[source].text, robot->run->source[source].size);
  uint64_t now_ns = fsi_now_ns();
  result = put(robot, &robot->command, payload, sizeof payload, wanted_ns ? wanted_ns : now_ns);
  if (result != FS_OK) return result;
  atomic_store_explicit(&robot->wanted_ns, wanted_ns && wanted_ns < now_ns ? wanted_ns : now_ns, memory_order_relaxed);
  atomic_store_explicit(&robot->source, source, memory_order_relaxed);
  bool repeats = robot->commanded_ns && memcmp(robot->commanded, payload, sizeof payload) == 0 &&
                 now_ns - robot->commanded_ns <= REPEAT_NS;
  memcpy(robot->commanded, payload, sizeof payload);
  robot->commanded_ns = now_ns;
  return repeats ? FS_OK : ring(robot);
}

int fs_drive(fs_robot *robot, double vx, double vy, double wz) {
  double velocity[3] = {vx, vy, wz};
  return command(robot, velocity, false, NULL, 0);
}

/* Whether it has the fields of the first version, which has all that is read here. */
static bool is_command(const fs_velocity *given) {
  return given->size >= offsetof(fs_velocity, wanted_ns) + sizeof given->wanted_ns;
}

int fs_command(fs_robot *robot, const fs_velocity *given) {
  if (!given || !is_command(given)) return robot ? fsi_fail(robot, FS_INVALID) : FS_INVALID;
  double velocity[3] = {given->vx, given->vy, given->wz};
  return command(robot, velocity, given->manual != 0, given->source, given->wanted_ns);
}

int fs_drive_wheels(fs_robot *robot, const double *radps, size_t count, double steering_rad, const fs_velocity *given) {
  int result = usable(robot);
  if (result != FS_OK) return result;
  const struct fsi_wheels *wheels = &robot->run->wheels;
  bool fits = radps && count == (size_t)wheels->count && wheels->known && (!given || is_command(given)) &&
              (isnan(steering_rad) || (wheels->steered && isfinite(steering_rad)));
  for (size_t at = 0; fits && at < count; at++) fits = isfinite(radps[at]);
  if (!fits) return fsi_fail(robot, FS_INVALID);
  double velocity[3];
  fsi_of_wheels(wheels, radps, steering_rad, velocity);
  return command(robot, velocity, given && given->manual, given ? given->source : NULL, given ? given->wanted_ns : 0);
}

int fs_sensed(fs_robot *robot) {
  int result = usable(robot);
  return result == FS_OK ? put(robot, &robot->sensed, &robot->session, N_ASSERTED, fsi_now_ns()) : result;
}

int fs_assert_interlocks(fs_robot *robot, const char *const *names, size_t count) {
  int result = usable(robot);
  if (result != FS_OK) return result;
  if (!names && count) return fsi_fail(robot, FS_INVALID);
  uint8_t payload[N_ASSERTED + HELD_BYTES];
  size_t size = N_ASSERTED;
  memcpy(payload, &robot->session, 8);
  for (size_t at = 0; at < count; at++) {
    if (!names[at]) return fsi_fail(robot, FS_INVALID);
    if (fs_has_interlock(robot, names[at]) != 1) return fsi_fail(robot, FS_UNDECLARED);
    size_t length = strlen(names[at]);
    if (size + (at ? 1 : 0) + length > sizeof payload) return fsi_fail(robot, FS_INVALID);
    if (at) payload[size++] = '\n';
    memcpy(payload + size, names[at], length);
    size += length;
  }
  return put(robot, &robot->interlocks, payload, size, fsi_now_ns());
}

int fs_say(fs_robot *robot, const char *sees, const char *wrong) {
  int result = usable(robot);
  if (result != FS_OK) return result;
  uint8_t payload[N_SAID + 2 * SAID_BYTES + 1];
  bool whole;
  memcpy(payload, &robot->session, 8);
  size_t size = N_SAID + fsi_clean((char *)payload + N_SAID, SAID_BYTES, sees ? sees : "", &whole);
  payload[size++] = '\n';
  size += fsi_clean((char *)payload + size, SAID_BYTES, wrong ? wrong : "", &whole);
  return put(robot, &robot->said, payload, size, fsi_now_ns());
}

/* -- Requests ------------------------------------------------------------------------------------------------------ */

/* Send a request; its number, or 0 and *result. */
static uint64_t send_request(fs_robot *robot, int verb, uint64_t seen, uint64_t asked_ns, int *result) {
  uint8_t payload[N_REQUEST], about[N_SEEN];
  pthread_mutex_lock(&robot->writing);
  uint64_t number = ++robot->number;
  *result = FS_OK;
  if (verb == VERB_RESET) {
    memcpy(about + F_SEEN_SESSION, &robot->session, 8);
    memcpy(about + F_SEEN_EPOCH, &seen, 8);
    *result = put(robot, &robot->seen, about, sizeof about, asked_ns);
  }
  memcpy(payload + F_REQUEST_SESSION, &robot->session, 8);
  memcpy(payload + F_REQUEST_NUMBER, &number, 8);
  payload[F_REQUEST_VERB] = (uint8_t)verb;
  if (*result == FS_OK) *result = put(robot, &robot->request, payload, sizeof payload, asked_ns);
  pthread_mutex_unlock(&robot->writing);
  if (*result == FS_OK) *result = ring(robot);
  return *result == FS_OK ? number : 0;
}

/* The reply to this request, if it has come: its `done`, else -1. A refusal's text goes to the last error. */
static int reply_to(fs_robot *robot, uint64_t number) {
  uint8_t buffer[2 * CELL_BYTES(CAP_GATE_REPLY)];
  struct fsi_entry entry;
  if (!fsi_read(&robot->run->reply[robot->slot], buffer, &entry) || entry.size < N_REPLY + 2) return -1;
  if (fsi_u64(entry.data + F_REPLY_SESSION) != robot->session) return -1;
  uint64_t answered = fsi_u64(entry.data + F_REPLY_NUMBER);
  if (answered < number) return -1;
  atomic_thread_fence(memory_order_seq_cst); /* the state then shows what the request has changed */
  if (answered > number) {
    fsi_fail_with(robot, FS_REFUSED, "replaced by a later request of this program");
    return REPLY_REFUSED;
  }
  int done = entry.data[F_REPLY_DONE];
  if (done == REPLY_REFUSED) {
    char why[640];
    struct fsi_text text = {why, sizeof why, 0};
    uint16_t length;
    memcpy(&length, entry.data + N_REPLY, 2);
    const char *said = (const char *)entry.data + N_REPLY + 2, *end = said + length;
    if ((size_t)length > entry.size - N_REPLY - 2) return -1;
    const char *mark = memmem(said, length, TEXT_CAUSE_MARK, strlen(TEXT_CAUSE_MARK));
    if (mark) {
      fsi_add(&text, said, (size_t)(mark - said));
      fsi_add_cause(&text, (const uint8_t *)end, entry.size - N_REPLY - 2 - length);
      said = mark + strlen(TEXT_CAUSE_MARK);
    }
    fsi_add(&text, said, (size_t)(end - said));
    fsi_end(&text);
    fsi_fail_with(robot, FS_REFUSED, why);
  }
  return done;
}

static void nap(uint64_t ns) {
  struct timespec left = {(time_t)(ns / 1000000000), (long)(ns % 1000000000)};
  while (nanosleep(&left, &left) && errno == EINTR) continue;
}

static int ask_once(fs_robot *robot, int verb, uint64_t seen, double timeout_s) {
  if (!robot) return FS_INVALID;
  if (fsi_is_forked(robot)) return fsi_fail(robot, FS_FORKED);
  if (isnan(timeout_s)) return fsi_fail(robot, FS_INVALID);
  int result = usable(robot);
  if (result != FS_OK) return result;
  uint64_t asked_ns = fsi_now_ns();
  bool enables = verb == VERB_ENABLE, before = atomic_load(&robot->enabled);
  unsigned long long before_ns = atomic_load(&robot->enabled_ns);
  if (enables) atomic_store(&robot->enabled_ns, 0);
  if (timeout_s >= 0 && timeout_s <= 0) {
    if (enables) atomic_store(&robot->enabled, true);
    send_request(robot, verb, seen, asked_ns, &result);
    return result;
  }
  uint64_t wait_ns = timeout_s < 0 ? ANSWER_WITHIN_NS : (uint64_t)(fmin(timeout_s, LONGEST_WAIT_S) * 1e9);
  pthread_mutex_lock(&robot->turn);
  bool mine = true;
  if (enables) atomic_store(&robot->enabled, true); /* it may be granted even if nobody waits for the answer any more */
  uint64_t number = send_request(robot, verb, seen, asked_ns, &result);
  uint64_t begun_ns = fsi_now_ns(), until_ns = begun_ns + wait_ns;
  while (result == FS_OK) {
    int done = reply_to(robot, number);
    uint64_t now_ns = fsi_now_ns();
    if (done == REPLY_DONE) break;
    if (done == REPLY_REFUSED) {
      result = FS_REFUSED;
      if (enables) {
        atomic_store(&robot->enabled, before);
        atomic_store(&robot->enabled_ns, before_ns);
      }
      break;
    }
    if (done == REPLY_UNDER_WAY) {
      /* It takes its time, such as an arm's move. Other requests may pass, which is how it can be given up. */
      until_ns = now_ns + wait_ns;
      if (mine) pthread_mutex_unlock(&robot->turn);
      mine = false;
    }
    if (fsi_over(robot->run)) {
      result = fsi_fail(robot, FS_NO_SERVICE);
    } else if (now_ns > until_ns) {
      result = fsi_fail_with(robot, FS_NO_ANSWER, "the service did not answer in time: see `failstop status`");
    } else {
      uint64_t pause_ns = (now_ns - begun_ns) / 8;
      nap(pause_ns < POLL_NS ? POLL_NS : pause_ns > LOOK_NS ? LOOK_NS : pause_ns);
    }
  }
  if (mine) pthread_mutex_unlock(&robot->turn);
  if (result == FS_OK && verb == VERB_DISABLE) atomic_store(&robot->enabled, false);
  if (result == FS_OK && enables) atomic_store(&robot->enabled_ns, enabled_since(robot));
  return result;
}

/* A thread that is cancelled meanwhile ends afterwards, because it has the locks. */
static int ask(fs_robot *robot, int verb, uint64_t seen, double timeout_s) {
  int cancels;
  pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, &cancels);
  int result = ask_once(robot, verb, seen, timeout_s);
  pthread_setcancelstate(cancels, NULL);
  return result;
}

int fs_enable(fs_robot *robot, double timeout_s) { return ask(robot, VERB_ENABLE, 0, timeout_s); }
int fs_disable(fs_robot *robot, double timeout_s) { return ask(robot, VERB_DISABLE, 0, timeout_s); }
int fs_reset(fs_robot *robot, uint64_t seen, double timeout_s) { return ask(robot, VERB_RESET, seen, timeout_s); }

/* -- Texts --------------------------------------------------------------------------------------------------------- */

const char *fs_version(void) { return FS_VERSION_TEXT; }

const char *fs_result_text(int result) {
  switch (result) {
    case FS_OK: return "ok";
    case FS_NO_SERVICE: return "no service";
    case FS_NO_PERMISSION: return "no permission";
    case FS_OTHER_LAYOUT: return "the service is of another version";
    case FS_NO_SLOT: return "all client slots are taken";
    case FS_NOT_CONNECTED: return "not connected";
    case FS_REFUSED: return "refused";
    case FS_NO_ANSWER: return "no answer in time";
    case FS_UNDECLARED: return "not in the service's settings";
    case FS_INVALID: return "invalid argument";
    case FS_FORKED: return "a handle of the parent process";
    case FS_DAMAGED: return "damaged";
    case FS_SYSTEM: return "out of memory, descriptors or threads";
    default: return "unknown result";
  }
}

static const char *sentence(int code) {
  switch (code) {
    case FS_NO_SERVICE: return "the service has ended: start it, then call fs_connect(), or open a new handle";
    case FS_NOT_CONNECTED: return "this handle has no client slot: call fs_connect() first";
    case FS_UNDECLARED: return "the service's settings don't name it: add it there and restart the service";
    case FS_INVALID: return "an argument is NULL, not finite, too long, or its size is not set; nothing was sent";
    case FS_FORKED: return "this process is a fork of the one that opened the handle: open a handle of its own";
    default: return fs_result_text(code);
  }
}

int fs_last_error(const fs_robot *given, char *out, size_t size) {
  struct fsi_text text = {out, size, 0};
  fs_robot *robot = (fs_robot *)(uintptr_t)given;
  if (!robot || (!out && size)) return FS_INVALID;
  int code = atomic_load(&robot->last);
  if (fsi_is_forked(robot)) { /* nobody knows which thread of the parent held the lock */
    fsi_adds(&text, code ? sentence(code) : "");
    return fsi_end(&text);
  }
  pthread_mutex_lock(&robot->texts);
  if (code) fsi_adds(&text, robot->told == code ? robot->error : sentence(code));
  pthread_mutex_unlock(&robot->texts);
  return fsi_end(&text);
}
