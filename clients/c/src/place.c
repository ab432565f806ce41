/* Places: opening files in a runtime directory without trusting anyone else (failstop/files/place.py has the rules). */
#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#define BY_OTHERS (S_IWGRP | S_IWOTH)

void fsi_own(struct fsi_owned *owned, int fd) {
  struct stat found = {0};
  if (fd >= 0) fstat(fd, &found);
  atomic_store(&owned->device, (uint64_t)found.st_dev);
  atomic_store(&owned->file, (uint64_t)found.st_ino);
  atomic_store(&owned->kind, (uint64_t)(found.st_mode & S_IFMT));
  atomic_store(&owned->fd, fd);
}

bool fsi_still(int fd, const struct fsi_owned *owned) {
  struct stat found;
  return fd >= 0 && fstat(fd, &found) == 0 && (uint64_t)found.st_dev == atomic_load(&owned->device) &&
         (uint64_t)found.st_ino == atomic_load(&owned->file) && (found.st_mode & S_IFMT) == atomic_load(&owned->kind);
}

bool fsi_owns(const struct fsi_owned *owned) { return fsi_still(atomic_load(&owned->fd), owned); }

void fsi_disown(struct fsi_owned *owned) {
  if (fsi_owns(owned)) close(atomic_load(&owned->fd));
  fsi_own(owned, -1);
}

static bool is_name(const char *name) {
  size_t size = strlen(name);
  return size > 0 && size < FSI_NAME && strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789_-") == size;
}

int fsi_places(struct fsi_places *places, const char *name) {
  memset(places, 0, sizeof *places);
  if (!is_name(name)) return FS_INVALID;
  memcpy(places->name, name, strlen(name) + 1);
  unsigned user = (unsigned)getuid();
  const char *root = secure_getenv("FAILSTOP_ROOT"), *session = secure_getenv("XDG_RUNTIME_DIR");
  char path[3][FSI_PATH];
  int lengths[3];
  lengths[0] = snprintf(path[0], FSI_PATH, "%s/run/failstop", root ? root : "");
  lengths[1] = session && *session ? snprintf(path[1], FSI_PATH, "%s/failstop", session)
                                   : snprintf(path[1], FSI_PATH, "/run/user/%u/failstop", user);
  /* A user without a session, for example in a container; never root. */
  lengths[2] = user ? snprintf(path[2], FSI_PATH, "%s/failstop-%u", TEXT_SHM, user) : FSI_PATH;
  for (int at = 0; at < 3; at++)
    if (lengths[at] > 0 && lengths[at] < FSI_PATH)
      memcpy(places->base[places->count++], path[at], (size_t)lengths[at] + 1);
  return FS_OK;
}

int fsi_above_streams(int fd) {
  if (fd < 0 || fd > STDERR_FILENO) return fd;
  int moved = fcntl(fd, F_DUPFD_CLOEXEC, STDERR_FILENO + 1), error = errno;
  close(fd);
  errno = error;
  return moved;
}

/* The directory that is open as `fd`, if it belongs to root, to this user, to the base's owner, or to a user to whom
 * only root can have given it. In a sticky base nobody can replace what exists. Closes it otherwise. */
static int checked(int fd, const struct stat *base, struct fsi_refusal *refusal) {
  struct stat found, above;
  if (fstat(fd, &found) || (!base && fstatat(fd, "..", &above, 0))) {
    refusal->why = errno;
    close(fd);
    return -1;
  }
  if (base) above = *base;
  bool by_root = above.st_uid == 0 && !(above.st_mode & BY_OTHERS);
  bool ours = found.st_uid == 0 || found.st_uid == geteuid() || by_root || (base && found.st_uid == base->st_uid);
  if (!ours) {
    *refusal = (struct fsi_refusal){FSI_FOREIGN, found.st_uid};
  } else if (found.st_mode & BY_OTHERS && (base || !(found.st_mode & S_ISVTX))) {
    *refusal = (struct fsi_refusal){FSI_OPEN_TO_OTHERS, found.st_uid};
  } else {
    return fd;
  }
  close(fd);
  return -1;
}

int fsi_open_in(const struct fsi_places *places, int which, const char *file, int flags, bool pipe,
                struct fsi_refusal *refusal) {
  const int directory = O_PATH | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC;
  struct stat above, where, found;
  *refusal = (struct fsi_refusal){0, 0};
  int base = open(places->base[which], directory);
  if (base < 0) {
    refusal->why = errno;
    return -1;
  }
  if ((base = checked(base, NULL, refusal)) < 0) return -1;
  int inner = fstat(base, &above) ? -1 : openat(base, places->name, directory);
  refusal->why = errno;
  close(base);
  if (inner < 0 || (inner = checked(inner, &above, refusal)) < 0) return -1;
  const int how = flags | O_NONBLOCK | O_NOFOLLOW | O_NOCTTY | O_CLOEXEC;
  int fd = fstat(inner, &where) ? -1 : fsi_above_streams(openat(inner, file, how));
  refusal->why = errno == ELOOP ? FSI_LINK : errno;
  close(inner);
  if (fd < 0) return -1;
  if (fstat(fd, &found)) {
    refusal->why = errno;
  } else if (found.st_uid != where.st_uid) {
    *refusal = (struct fsi_refusal){FSI_OTHER_OWNER, found.st_uid};
  } else if (pipe ? !S_ISFIFO(found.st_mode) : !S_ISREG(found.st_mode)) {
    *refusal = (struct fsi_refusal){FSI_OTHER_KIND, found.st_uid};
  } else {
    *refusal = (struct fsi_refusal){0, 0};
    return fd;
  }
  close(fd);
  return -1;
}

int fsi_open_stop(const struct fsi_places *places, int *which, struct fsi_refusal *refusal) {
  struct fsi_refusal doubt = {ENOENT, 0}, found;
  *which = 0;
  for (int at = 0; at < places->count; at++) {
    int fd = fsi_open_in(places, at, "stop", O_WRONLY, true, &found);
    if (fd >= 0) {
      *which = at;
      *refusal = found;
      return fd;
    }
    /* A file that is there but not trusted, or a program without descriptors, says more than one that is absent. */
    if (found.why >= FSI_FOREIGN || found.why == EMFILE || found.why == ENFILE || found.why == EACCES) {
      doubt = found;
      *which = at;
    }
  }
  *refusal = doubt;
  return -1;
}

void fsi_describe(char *text, size_t size, const struct fsi_places *places, int which, const char *file,
                  const struct fsi_refusal *refusal) {
  char path[FSI_PATH + FSI_NAME + 32];
  snprintf(path, sizeof path, "%s/%s/%s", places->base[which], places->name, file);
  unsigned uid = (unsigned)refusal->uid;
  switch (refusal->why) {
    case FSI_FOREIGN:
      snprintf(text, size, "the directory of %s belongs to uid %u: not trusted; remove it, or run as that user", path, uid);
      break;
    case FSI_OPEN_TO_OTHERS:
      snprintf(text, size, "the directory of %s may be written by others: chmod go-w it", path);
      break;
    case FSI_LINK:
      snprintf(text, size, "%s is a link: remove it", path);
      break;
    case FSI_OTHER_OWNER:
      snprintf(text, size, "%s belongs to uid %u, its directory to another user: remove it", path, uid);
      break;
    case FSI_OTHER_KIND:
      snprintf(text, size, "%s is not the kind of file that the service makes: remove it", path);
      break;
    default: {
      char reason[128] = "";
      const char *said = strerror_r(refusal->why, reason, sizeof reason);
      snprintf(text, size, "%s can't be opened: %s", path, said);
    }
  }
}
