/* The floor of every kill row: what the kernel, the port and nothing else take.

   floor PORT PRIORITY BYTES-IN-HEX

   A child that does nothing holds a robust mutex. It is told on stdout as a line with its pid, and is killed by whoever
   reads that; this process, blocked on the mutex, writes the bytes to the port. Then the next child, until stdin ends.
   Both run under SCHED_FIFO with their memory locked, where the rights allow it. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <signal.h>
#include <unistd.h>

static void request_rights(int priority) {
    struct sched_param param = {.sched_priority = priority};
    sched_setscheduler(0, SCHED_FIFO, &param);
    mlockall(MCL_CURRENT | MCL_FUTURE);
}

static pid_t start_victim(pthread_mutex_t *mutex, int priority) {
    int held[2];
    char byte;
    if (pipe(held)) return -1;
    pid_t victim = fork();
    if (victim == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        request_rights(priority);
        pthread_mutex_lock(mutex);
        if (write(held[1], "x", 1) != 1) _exit(1);
        for (;;) pause();
    }
    ssize_t got = read(held[0], &byte, 1);
    close(held[0]);
    close(held[1]);
    return got == 1 ? victim : -1;
}

int main(int count, char **words) {
    unsigned char bytes[1024];
    size_t size = 0;
    if (count != 4) return 2;
    for (const char *at = words[3]; at[0] && at[1] && size < sizeof bytes; at += 2) {
        char digits[3] = {at[0], at[1], 0};
        bytes[size++] = strtoul(digits, NULL, 16);
    }
    int priority = atoi(words[2]);
    int port = open(words[1], O_RDWR | O_NOCTTY | O_NONBLOCK);
    pthread_mutex_t *mutex = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (port < 0 || mutex == MAP_FAILED) return 1;
    pthread_mutexattr_t attributes;
    pthread_mutexattr_init(&attributes);
    pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
    pthread_mutexattr_setrobust(&attributes, PTHREAD_MUTEX_ROBUST);
    request_rights(priority);
    char line[16];
    while (fgets(line, sizeof line, stdin)) {
        memset(mutex, 0, sizeof *mutex);
        pthread_mutex_init(mutex, &attributes);
        pid_t victim = start_victim(mutex, priority);
        if (victim < 0) return 1;
        printf("%d\n", victim);
        fflush(stdout);
        int result = pthread_mutex_lock(mutex);
        ssize_t written = write(port, bytes, size);
        if (result != EOWNERDEAD || written != (ssize_t)size) return 1;
        waitpid(victim, NULL, 0);
    }
    return 0;
}
