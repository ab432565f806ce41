/* The death notice: a robust futex in this client's slot, held by a thread that only sleeps (shm/futex.py).
 *
 * When the thread dies, the kernel marks the futex and wakes the service's waiter before it frees the memory of this
 * process. The list that the kernel walks is the thread's own and not the C library's, because with that one only the
 * thread that locked a mutex may unlock it. */
#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/futex.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#define STACK_BYTES ((size_t)128 * 1024)

struct fsi_life {
  pthread_t thread;
  sem_t held, end;
  struct fsi_owned file;
  off_t at;
  uint8_t *page;
  size_t page_bytes;
  uint8_t *word;
};

static void *live(void *given) {
  struct fsi_life *life = given;
  prctl(PR_SET_NAME, "failstop");
  /* Among a process's dying threads, the kernel then runs this one first. It sleeps until then, and delays nobody. */
  struct sched_param first = {.sched_priority = 1};
  sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &first);
  /* This stack keeps both as long as the thread lives, and the kernel looks into it when it dies. */
  struct robust_list entry;
  struct robust_list_head head = {{&entry}, (long)((intptr_t)life->word - (intptr_t)&entry), NULL};
  entry.next = &head.list;
  void *before = NULL;
  size_t before_size = 0;
  bool known = syscall(SYS_get_robust_list, 0, &before, &before_size) == 0 && before;
  bool listed = known && syscall(SYS_set_robust_list, &head, sizeof head) == 0;
  if (listed) {
    uint32_t holder = (uint32_t)syscall(SYS_gettid) | FUTEX_WAITERS;
    listed = pwrite(life->file.fd, &holder, sizeof holder, life->at) == (ssize_t)sizeof holder;
  }
  sem_post(&life->held);
  while (sem_wait(&life->end) && errno == EINTR) continue;
  if (known) syscall(SYS_set_robust_list, before, before_size);
  return NULL;
}

struct fsi_life *fsi_hold(int fd, off_t at) {
  struct fsi_life *life = calloc(1, sizeof *life);
  if (!life) return NULL;
  life->page_bytes = (size_t)sysconf(_SC_PAGESIZE);
  off_t start = at - at % (off_t)life->page_bytes;
  life->at = at;
  /* The kernel alone reaches the word through this mapping, so a truncated file causes no SIGBUS. */
  void *page = mmap(NULL, life->page_bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, start);
  if (page == MAP_FAILED) goto no_page;
  life->page = page;
  life->word = life->page + (at - start);
  /* A descriptor of its own: the number of the caller's may soon name another file. */
  fsi_own(&life->file, fcntl(fd, F_DUPFD_CLOEXEC, STDERR_FILENO + 1));
  if (life->file.fd < 0) goto no_descriptor;
  sem_init(&life->held, 0, 0);
  sem_init(&life->end, 0, 0);

  sigset_t all, mask;
  pthread_attr_t attributes;
  /* Signals are for the program's own threads; the thread inherits this mask. */
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &mask);
  pthread_attr_init(&attributes);
  pthread_attr_setstacksize(&attributes, STACK_BYTES);
  int failed = pthread_create(&life->thread, &attributes, live, life);
  /* A program with much thread-local storage needs a larger stack. */
  if (failed == EINVAL) failed = pthread_create(&life->thread, NULL, live, life);
  pthread_attr_destroy(&attributes);
  pthread_sigmask(SIG_SETMASK, &mask, NULL);
  if (failed) goto no_thread;
  while (sem_wait(&life->held) && errno == EINTR) continue;
  return life;

no_thread:
  sem_destroy(&life->held);
  sem_destroy(&life->end);
  fsi_disown(&life->file);
no_descriptor:
  munmap(life->page, life->page_bytes);
no_page:
  free(life);
  return NULL;
}

void fsi_let_go(struct fsi_life *life) {
  if (!life) return;
  sem_post(&life->end);
  pthread_join(life->thread, NULL);
  fsi_forget(life);
}

void fsi_in_child(struct fsi_life *life) {
  if (life) fsi_disown(&life->file);
}

void fsi_forget(struct fsi_life *life) {
  if (!life) return;
  fsi_in_child(life);
  sem_destroy(&life->held);
  sem_destroy(&life->end);
  munmap(life->page, life->page_bytes);
  free(life);
}
