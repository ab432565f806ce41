/* A driver that knows nothing of failstop: it talks to an Arduino as diffdrive_arduino does. "serial" opens and waits as
 * the library of its main branch does (one byte after the other, each with its own timeout), "exclusive" as LibSerial
 * of its humble branch (TIOCEXCL, and a flush before each line). It prints a line for each round: two counts, and the
 * milliseconds until each of the two answers.
 *
 * usage: diffdrive PATH serial|exclusive LEFT RIGHT HZ [blind|mute|child|system|big]
 *   blind: never waits for an answer; mute: never reads; child: forks a child that keeps the port; system: runs other
 *   programs, which inherit the port; big: 500 MB */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/select.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static int port, exclusive;

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + t.tv_nsec / 1e9;
}

static void die(const char *what) {
  printf("error %s: %s\n", what, strerror(errno));
  fflush(stdout);
  exit(1);
}

static void open_port(const char *path) {
  port = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (port < 0) die("open");
  if (exclusive && ioctl(port, TIOCEXCL) < 0) die("TIOCEXCL");
  struct termios options;
  if (tcgetattr(port, &options) < 0) die("tcgetattr");
  options.c_cflag |= CLOCAL | CREAD;
  options.c_lflag &= ~(ICANON | ECHO | ECHOE | ECHOK | ECHONL | ISIG | IEXTEN);
  options.c_oflag &= ~OPOST;
  options.c_iflag &= ~(INLCR | IGNCR | ICRNL | IGNBRK | IXON | IXOFF | IXANY);
  cfsetispeed(&options, B57600);
  cfsetospeed(&options, B57600);
  options.c_cc[VMIN] = 0;
  options.c_cc[VTIME] = 0;
  if (tcsetattr(port, TCSANOW, &options) < 0) die("tcsetattr");
}

static int readable(double seconds) {
  fd_set set;
  struct timeval t = {(long)seconds, (long)((seconds - (long)seconds) * 1e6)};
  FD_ZERO(&set);
  FD_SET(port, &set);
  return select(port + 1, &set, NULL, NULL, &t) > 0;
}

/* The answer, without its end; empty after a second without a byte. */
static const char *ask(const char *line, int wait) {
  static char answer[256];
  size_t length = 0;
  answer[0] = 0;
  if (exclusive) tcflush(port, TCIOFLUSH);
  if (write(port, line, strlen(line)) < 0) {
    if (errno != EAGAIN) die("write");
    return answer;
  }
  if (!exclusive) tcdrain(port);
  while (wait && length < sizeof answer - 1 && readable(1.0)) {
    char byte;
    ssize_t got = read(port, &byte, 1);
    if (got < 0 && errno == EAGAIN) continue;
    if (got <= 0) die("read");
    if (byte == '\n') break;
    if (byte != '\r') answer[length++] = byte;
    answer[length] = 0;
  }
  return answer;
}

int main(int argc, char **argv) {
  if (argc < 6) return 2;
  const char *how = argc > 6 ? argv[6] : "";
  int blind = !strcmp(how, "blind"), mute = !strcmp(how, "mute");
  char line[64];
  exclusive = !strcmp(argv[2], "exclusive");
  if (!strcmp(how, "big")) {
    size_t size = 500u << 20;
    char *memory = malloc(size);
    if (!memory) die("malloc");
    memset(memory, 1, size);
  }
  open_port(argv[1]);
  int system_too = !strcmp(how, "system");
  if (system_too && system("sleep 0.1")) die("system");
  printf("start %s|", ask("\r", !mute));
  printf("%s\n", ask("u 30:20:0:100\r", !mute));
  fflush(stdout);
  if (!strcmp(how, "child") && fork() == 0) {
    /* Until nobody reads the output any more: a test that ends leaves no process behind. */
    struct pollfd output = {.fd = STDOUT_FILENO};
    poll(&output, 1, -1);
    _exit(0);
  }
  double period = 1.0 / atof(argv[5]), due = now();
  for (;;) {
    double begun = now();
    char counts[256];
    strcpy(counts, ask("e\r", !blind && !mute));
    double between = now();
    snprintf(line, sizeof line, "m %d %d\r", atoi(argv[3]), atoi(argv[4]));
    const char *answer = ask(line, !blind && !mute);
    printf("%s|%s|%.3f|%.3f\n", counts, answer, (between - begun) * 1e3, (now() - between) * 1e3);
    fflush(stdout);
    if (system_too && system(":")) die("system");
    due += period;
    double rest = due - now();
    if (rest > 0) usleep(rest * 1e6); else due = now();
  }
}
