/* Runs: the shared memory of a running service, mapped to read (failstop/messages/segments.py has the rules). */
#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const char HEX[] = "0123456789abcdef";
#define SEGMENT_FLAGS (O_NONBLOCK | O_NOFOLLOW | O_CLOEXEC)

uint64_t fsi_now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (uint64_t)now.tv_sec * UINT64_C(1000000000) + (uint64_t)now.tv_nsec;
}

bool fsi_held(int fd, off_t byte, bool by_writer) {
  struct flock lock = {.l_type = (short)(by_writer ? F_RDLCK : F_WRLCK), .l_whence = SEEK_SET, .l_start = byte, .l_len = 1};
  return fcntl(fd, F_OFD_GETLK, &lock) == 0 && lock.l_type != F_UNLCK;
}

bool fsi_over(const struct fsi_run *run) { return !fsi_owns(&run->life) || !fsi_held(run->life.fd, 0, true); }

static void path_of(char *path, size_t size, const struct fsi_run *run, const char *name) {
  snprintf(path, size, "%s/failstop.%s.%s", TEXT_SHM, run->memory, name);
}

int fsi_open_segment(const struct fsi_run *run, const char *name, bool write, char *why, size_t room) {
  char path[FSI_PATH];
  struct stat found;
  path_of(path, sizeof path, run, name);
  int fd = fsi_above_streams(open(path, (write ? O_RDWR : O_RDONLY) | SEGMENT_FLAGS));
  if (fd < 0) {
    int error = errno;
    char reason[128] = "";
    const char *said = strerror_r(error, reason, sizeof reason);
    if (error == ENOENT) {
      snprintf(why, room, "shared memory %s does not exist: start the service with `failstop run`", name);
      return FS_NO_SERVICE;
    }
    if (error == EACCES || error == EPERM) {
      snprintf(why, room, "no permission on shared memory %s: join the group `failstop`, or run as the service's user", name);
      return FS_NO_PERMISSION;
    }
    snprintf(why, room, "shared memory %s can't be opened (%s): restart the service", name, said);
    return error == EMFILE || error == ENFILE || error == ENOMEM ? FS_SYSTEM : FS_DAMAGED;
  }
  if (fstat(fd, &found) || !S_ISREG(found.st_mode) || found.st_uid != run->owner) {
    snprintf(why, room, "shared memory %s is not the service's: remove %s", name, path);
    close(fd);
    return FS_DAMAGED;
  }
  return fd + 1; /* a number over 0; the results below are not */
}

int fsi_check_segment(int fd, const char *name, uint64_t incarnation, uint64_t *size, char *why, size_t room) {
  uint8_t raw[HEADER_BYTES];
  struct fsi_entry entry;
  struct stat found;
  char own[F_HEADER_CLIENT - F_HEADER_NAME + 1] = "", version[N_HEADER - F_HEADER_VERSION + 1] = "";
  if (pread(fd, raw, sizeof raw, 0) != (ssize_t)sizeof raw || !fsi_check(raw, sizeof raw, fsi_seed("header", 0), &entry) ||
      entry.size != N_HEADER || memcmp(entry.data, TEXT_MAGIC, strlen(TEXT_MAGIC)) != 0) {
    snprintf(why, room, "shared memory %s has an incomplete header: restart the service", name);
    return FS_DAMAGED;
  }
  memcpy(own, entry.data + F_HEADER_NAME, sizeof own - 1);
  memcpy(version, entry.data + F_HEADER_VERSION, sizeof version - 1);
  if (fsi_u64(entry.data + F_HEADER_CLIENT) != CLIENT_HASH) {
    snprintf(why, room,
             "the service is failstop %s, and this libfailstop is %s with another layout: install the same version of both, "
             "and start the service and this program again",
             version, fs_version());
    return FS_OTHER_LAYOUT;
  }
  *size = fsi_u64(entry.data + F_HEADER_SIZE);
  if (strcmp(own, name) != 0 || fsi_u64(entry.data + F_HEADER_INCARNATION) != incarnation || fstat(fd, &found) ||
      (uint64_t)found.st_size < *size || *size > SIZE_MAX / 2) {
    snprintf(why, room, "shared memory %s has the wrong size, name or run: restart the service", name);
    return FS_DAMAGED;
  }
  return FS_OK;
}

static int map_segment(struct fsi_run *run, const char *name, size_t least, struct fsi_segment *segment, char *why,
                       size_t room) {
  uint64_t size;
  int fd = fsi_open_segment(run, name, false, why, room);
  if (fd <= 0) return fd;
  fd--;
  int result = fsi_check_segment(fd, name, run->incarnation, &size, why, room);
  if (result == FS_OK && size < least) {
    snprintf(why, room, "shared memory %s is too small: restart the service", name);
    result = FS_DAMAGED;
  }
  if (result == FS_OK) {
    /* Only the service may write this file, so nobody else can truncate it. */
    void *map = mmap(NULL, (size_t)size, PROT_READ, MAP_SHARED | MAP_POPULATE, fd, 0);
    if (map == MAP_FAILED) {
      snprintf(why, room, "shared memory %s can't be mapped: no memory", name);
      result = FS_SYSTEM;
    } else {
      *segment = (struct fsi_segment){map, (size_t)size};
    }
  }
  close(fd);
  return result;
}

static void reader(struct fsi_reader *reader, const struct fsi_segment *segment, size_t at, size_t capacity,
                   const char *name, uint64_t incarnation) {
  reader->at = segment->map + at;
  reader->cell = CELL_BYTES(capacity);
  reader->seed = fsi_seed(name, incarnation);
  atomic_init(&reader->seen, 0);
}

/* Copy a record that the supervisor wrote once, before it published the run. */
static bool told(const struct fsi_run *run, size_t at, size_t capacity, const char *name, uint8_t *copy, size_t *size,
                 uint64_t *t_ns) {
  struct fsi_reader once;
  struct fsi_entry entry;
  uint8_t *buffer = malloc(2 * CELL_BYTES(capacity));
  if (!buffer) return false;
  reader(&once, &run->supervisor, at, capacity, name, run->incarnation);
  bool whole = fsi_read(&once, buffer, &entry) && entry.size <= capacity;
  if (whole) {
    memcpy(copy, entry.data, entry.size);
    *size = entry.size;
    *t_ns = entry.t_ns;
  }
  free(buffer);
  return whole;
}

static bool read_rules(struct fsi_run *run) {
  struct fsi_value found;
  struct fsi_packed rest;
  if (!fsi_find(run->rules, run->rules_size, "lease_ns", &found, NULL)) return false;
  run->lease_ns = found.natural;
  if (!fsi_find(run->rules, run->rules_size, "sources", &found, &rest) || found.kind != FSI_ARRAY) return false;
  run->first_source = -1;
  for (uint32_t at = 0; at < found.count && run->sources < FSI_MOST_NAMES; at++) {
    struct fsi_value name = fsi_next(&rest);
    if (name.kind != FSI_STR) return false;
    if (fsi_is(&name, TEXT_FIRST_SOURCE)) run->first_source = run->sources;
    run->source[run->sources].text = name.text;
    run->source[run->sources++].size = name.count;
  }
  return !rest.bad;
}

static void read_timeouts(struct fsi_run *run) {
  struct fsi_value found;
  for (int at = 0; at < run->sources; at++) {
    char key[64];
    snprintf(key, sizeof key, "sources.%.*s.timeout_s", (int)run->source[at].size, run->source[at].text);
    bool known = fsi_find(run->settings, run->settings_size, key, &found, NULL) ||
                 fsi_find(run->settings, run->settings_size, "gate.command_timeout_s", &found, NULL);
    run->source[at].timeout_ns = known && found.number > 0 && found.number < 1e6 ? (uint64_t)(found.number * 1e9) : 0;
  }
}

static int attach_all(struct fsi_run *run, char *why, size_t room) {
  int fd = fsi_open_segment(run, TEXT_SUPERVISOR, false, why, room);
  if (fd <= 0) return fd;
  fsi_own(&run->life, fd - 1);
  const struct {
    const char *name;
    size_t least;
    struct fsi_segment *segment;
  } each[] = {
      {TEXT_SUPERVISOR, AT_SUPERVISOR_SETTINGS + 2 * CELL_BYTES(CAP_SUPERVISOR_SETTINGS), &run->supervisor},
      {TEXT_GATE, AT_GATE_REPLY + (size_t)CLIENT_SLOTS * REPLY_STRIDE, &run->gate},
      {TEXT_TELEMETRY, AT_TELEMETRY_ODOMETRY + 2 * CELL_BYTES(CAP_TELEMETRY_ODOMETRY), &run->telemetry},
      {TEXT_PORT_OWNER, AT_PORT_OWNER_PORT + 2 * CELL_BYTES(CAP_PORT_OWNER_PORT), &run->port_owner},
  };
  for (size_t at = 0; at < sizeof each / sizeof *each; at++) {
    int result = map_segment(run, each[at].name, each[at].least, each[at].segment, why, room);
    if (result != FS_OK) return result;
  }
#define READER(field, segment, SEGMENT, RECORD) \
  reader(&run->field, &run->segment, AT_##SEGMENT##_##RECORD, CAP_##SEGMENT##_##RECORD, NAME_##SEGMENT##_##RECORD, run->incarnation)
  READER(latch, supervisor, SUPERVISOR, LATCH);
  READER(link, supervisor, SUPERVISOR, LINK);
  READER(state, gate, GATE, STATE);
  READER(imu, telemetry, TELEMETRY, IMU);
  READER(wheels_seen, telemetry, TELEMETRY, WHEELS);
  READER(battery, telemetry, TELEMETRY, BATTERY);
  READER(odometry, telemetry, TELEMETRY, ODOMETRY);
  READER(port, port_owner, PORT_OWNER, PORT);
#undef READER
  for (int slot = 0; slot < CLIENT_SLOTS; slot++) {
    char name[32];
    snprintf(name, sizeof name, "gate.reply.%d", slot);
    reader(&run->reply[slot], &run->gate, AT_GATE_REPLY + (size_t)slot * REPLY_STRIDE, CAP_GATE_REPLY, name, run->incarnation);
  }
  uint64_t ignored;
  run->settings = malloc(CAP_SUPERVISOR_SETTINGS);
  if (!run->settings) {
    snprintf(why, room, "no memory");
    return FS_SYSTEM;
  }
  if (!told(run, AT_SUPERVISOR_RULES, CAP_SUPERVISOR_RULES, NAME_SUPERVISOR_RULES, run->rules, &run->rules_size, &run->began_ns) ||
      !told(run, AT_SUPERVISOR_SETTINGS, CAP_SUPERVISOR_SETTINGS, NAME_SUPERVISOR_SETTINGS, run->settings, &run->settings_size,
            &ignored) ||
      !read_rules(run) || !fsi_wheels(&run->wheels, run->settings, run->settings_size)) {
    snprintf(why, room, "the service's shared memory is damaged: restart the service");
    return FS_DAMAGED;
  }
  read_timeouts(run);
  return FS_OK;
}

void fsi_no_service(char *why, size_t room, const struct fsi_places *places) {
  bool named = strcmp(places->name, TEXT_DEFAULT_NAME) != 0;
  snprintf(why, room, "no service named '%s' is running: start it with `failstop run%s%s`", places->name,
           named ? " --name " : "", named ? places->name : "");
}

int fsi_attach(struct fsi_run **found, const struct fsi_places *places, int which, char *why, size_t room) {
  struct fsi_refusal refusal;
  char digits[RUN_DIGITS + 1] = "";
  struct stat file;
  *found = NULL;
  int fd = fsi_open_in(places, which, "run", O_RDONLY, false, &refusal);
  if (fd < 0) {
    if (refusal.why == ENOENT || refusal.why == ENOTDIR) {
      fsi_no_service(why, room, places);
      return FS_NO_SERVICE;
    }
    fsi_describe(why, room, places, which, "run", &refusal);
    return refusal.why == EMFILE || refusal.why == ENFILE ? FS_SYSTEM : FS_DAMAGED;
  }
  ssize_t size = pread(fd, digits, RUN_DIGITS, 0);
  int failed = fstat(fd, &file);
  close(fd);
  uint64_t incarnation = 0;
  bool number = size == RUN_DIGITS;
  for (const char *at = digits; *at; at++) {
    const char *digit = memchr(HEX, *at, sizeof HEX - 1);
    number = number && digit;
    incarnation = incarnation << 4 | (uint64_t)(digit ? digit - HEX : 0);
  }
  if (failed || !number) {
    fsi_no_service(why, room, places);
    return FS_NO_SERVICE;
  }
  struct fsi_run *run = calloc(1, sizeof *run);
  if (!run) {
    snprintf(why, room, "no memory");
    return FS_SYSTEM;
  }
  run->incarnation = incarnation;
  run->owner = file.st_uid;
  run->which = which;
  fsi_own(&run->life, -1);
  snprintf(run->memory, sizeof run->memory, "%s.%016llx", places->name, (unsigned long long)incarnation);
  int result = attach_all(run, why, room);
  if (result != FS_OK) {
    fsi_detach(run);
    return result;
  }
  *found = run;
  return FS_OK;
}

void fsi_detach(struct fsi_run *run) {
  if (!run) return;
  struct fsi_segment *each[] = {&run->supervisor, &run->gate, &run->telemetry, &run->port_owner};
  for (size_t at = 0; at < sizeof each / sizeof *each; at++)
    if (each[at]->map) munmap((void *)(uintptr_t)each[at]->map, each[at]->size);
  fsi_disown(&run->life);
  free(run->settings);
  free(run);
}
