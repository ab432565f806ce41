/* The stop: one line into the service's pipe. It reads no shared memory, so it works with a service of any version, and
 * everything here may run in a signal handler. */
#include "internal.h"

#include <errno.h>
#include <signal.h>
#include <time.h>
#include <unistd.h>

int fsi_send(int fd, const void *data, size_t size) {
  sigset_t pipe, before, pending;
  struct timespec now = {0, 0};
  /* A pipe whose reader has died raises SIGPIPE, which would end the program. It is held back, and taken away if this
   * write has raised it. */
  sigemptyset(&pipe);
  sigaddset(&pipe, SIGPIPE);
  pthread_sigmask(SIG_BLOCK, &pipe, &before);
  int error = write(fd, data, size) < 0 ? errno : 0;
  if (error == EPIPE && !sigismember(&before, SIGPIPE)) {
    sigpending(&pending);
    if (sigismember(&pending, SIGPIPE))
      while (sigtimedwait(&pipe, NULL, &now) < 0 && errno == EINTR) continue;
  }
  pthread_sigmask(SIG_SETMASK, &before, NULL);
  /* A full pipe rings as well: its reader finds other requests in it. */
  return error == EAGAIN ? 0 : error;
}

size_t fsi_stop_line(char *out, const char *reason, const char *client, pid_t pid) {
  bool whole;
  size_t size = fsi_clean(out, ASKED_BYTES, reason ? reason : "", &whole);
  if (!whole) {
    const size_t left_out = strlen(TEXT_LEFT_OUT);
    size = fsi_clean(out, ASKED_BYTES - left_out, reason, &whole);
    memcpy(out + size, TEXT_LEFT_OUT, left_out);
    size += left_out;
  }
  out[size++] = '\t';
  size += fsi_clean(out + size, WHO_BYTES, client, &whole);
  out[size++] = '\t';
  char digits[12];
  size_t count = 0;
  for (long left = pid; left > 0 || !count; left /= 10) digits[count++] = (char)('0' + left % 10);
  while (count) out[size++] = digits[--count];
  out[size++] = '\n';
  return size;
}

/* The pipe that the handle keeps, or -1 if there is none: the program may have closed it, and have another file, or a pipe
 * of its own, under the number. */
static int kept(const fs_robot *robot) {
  int fd = robot ? robot->stop.fd : -1;
  return fd >= 0 && (fsi_still(fd, &robot->stop) || fsi_still(fd, &robot->newer_stop)) ? fd : -1;
}

/* `robot`: the handle, or NULL. */
static int send_line(const struct fsi_places *places, const fs_robot *robot, const char *client, const char *reason) {
  char line[FSI_STOP_LINE];
  struct fsi_refusal refusal;
  int which, result = FS_NO_SERVICE, cancels;
  /* A thread that was cancelled would end at the first of these calls, and the stop would not be sent. */
  pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, &cancels);
  size_t size = fsi_stop_line(line, reason, client, getpid());
  /* The pipe of the service that runs now. The kept one is for a program that can't open another. */
  int fd = fsi_open_stop(places, &which, &refusal);
  if (fd >= 0) {
    if (!fsi_send(fd, line, size)) result = FS_OK;
    close(fd);
  } else if ((fd = kept(robot)) >= 0 && !fsi_send(fd, line, size)) {
    result = FS_OK;
  } else if (refusal.why == EMFILE || refusal.why == ENFILE) {
    result = FS_SYSTEM;
  }
  pthread_setcancelstate(cancels, NULL);
  return result;
}

int fs_stop(const fs_robot *robot, const char *reason) {
  if (!robot) return FS_INVALID;
  int before = errno; /* of the code that a signal handler has interrupted */
  int result = send_line(&robot->places, robot, robot->client, reason);
  errno = before;
  return result == FS_OK ? FS_OK : fsi_fail(robot, result);
}

int fs_stop_service(const char *service, const char *client, const char *reason) {
  struct fsi_places places;
  char who[WHO_BYTES + 1];
  bool whole;
  int result = fsi_places(&places, service ? service : TEXT_DEFAULT_NAME);
  if (result != FS_OK) return result;
  who[fsi_clean(who, WHO_BYTES, client ? client : program_invocation_short_name, &whole)] = 0;
  return send_line(&places, NULL, *who ? who : "program", reason);
}
