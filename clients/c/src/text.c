/* Texts for people: causes by the service's own table, and text that a program gives. */
#include "internal.h"

#include <limits.h>
#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define MOST_ARGUMENTS 8

static const struct {
  int number;
  const char *name, *text, *remedy;
} TABLE[] = {CAUSES};
static const size_t ROWS = sizeof TABLE / sizeof *TABLE;

void fsi_add(struct fsi_text *text, const char *from, size_t count) {
  if (text->whole + 1 < text->size) {
    size_t room = text->size - 1 - text->whole;
    memcpy(text->at + text->whole, from, count < room ? count : room);
  }
  text->whole += count;
}

void fsi_adds(struct fsi_text *text, const char *from) { fsi_add(text, from, strlen(from)); }

void fsi_add_named(struct fsi_text *text, const char *from, const char *service) {
  static const char OPTION[] = " --name ", COMMAND[] = "failstop ";
  bool other = strcmp(service, TEXT_DEFAULT_NAME) != 0;
  const char *open, *close;
  while (other && (open = strchr(from, '`')) && (close = strchr(open + 1, '`'))) {
    const char *named = memmem(open, (size_t)(close - open), OPTION, sizeof OPTION - 1);
    fsi_add(text, from, (size_t)(close - from));
    if (!named && !strncmp(open + 1, COMMAND, sizeof COMMAND - 1)) {
      fsi_adds(text, OPTION);
      fsi_adds(text, service);
    }
    fsi_add(text, close, 1);
    from = close + 1;
  }
  fsi_adds(text, from);
}

int fsi_end(struct fsi_text *text) {
  if (text->size) {
    size_t end = text->whole < text->size ? text->whole : fsi_cut(text->at, text->size - 1, text->size - 1);
    text->at[end] = 0;
  }
  return text->whole > INT_MAX ? INT_MAX : (int)text->whole;
}

static int row_of(int number) {
  for (size_t at = 0; at < ROWS; at++)
    if (TABLE[at].number == number) return (int)at;
  return -1;
}

const char *fs_cause_name(int cause) {
  int row = row_of(cause);
  return row < 0 ? NULL : TABLE[row].name;
}

const char *fsi_cause_remedy(int number) {
  int row = row_of(number);
  return row < 0 ? "" : TABLE[row].remedy;
}

/* Numbers are written as in the C locale, whatever the program has set. */
static locale_t plain(void) {
  static _Atomic(locale_t) made;
  locale_t found = atomic_load(&made);
  if (!found) {
    locale_t fresh = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    if (fresh && !atomic_compare_exchange_strong(&made, &found, fresh)) freelocale(fresh);
    found = atomic_load(&made);
  }
  return found;
}

/* A whole number in decimal digits; false if it is none. Not strtoll(), which has another name in every program that a
 * newer C library has compiled, so that an older one could not run it. */
static bool integer(const char *text, long long *value) {
  bool negative = *text == '-';
  unsigned long long found = 0;
  if (negative || *text == '+') text++;
  if (!*text) return false;
  for (; *text; text++) {
    if (*text < '0' || *text > '9' || found > (LLONG_MAX - 9) / 10) return false;
    found = found * 10 + (unsigned long long)(*text - '0');
  }
  *value = negative ? -(long long)found : (long long)found;
  return true;
}

/* One place of a template: its name, its form after the colon, and where it ends. */
struct place {
  const char *name, *form, *end;
  size_t name_size, form_size;
};

static bool next_place(const char *from, const char *until, struct place *found) {
  const char *open = memchr(from, '{', (size_t)(until - from));
  if (!open) return false;
  const char *close = memchr(open, '}', (size_t)(until - open));
  if (!close) return false;
  const char *colon = memchr(open, ':', (size_t)(close - open));
  found->name = open + 1;
  found->name_size = (size_t)((colon ? colon : close) - open - 1);
  found->form = colon ? colon + 1 : close;
  found->form_size = (size_t)(close - found->form);
  found->end = close + 1;
  return true;
}

struct argument {
  const char *text;
  size_t size;
};

/* The row of a packed cause and its arguments; a row of -1 if they don't fit. */
static int unpacked(const uint8_t *packed, size_t size, struct argument *arguments) {
  for (int at = 0; at < MOST_ARGUMENTS; at++) arguments[at] = (struct argument){"", 0};
  if (size < CAUSE_NUMBER_BYTES) return -1;
  int row = row_of(packed[0] | packed[1] << 8);
  if (row < 0) return -1;
  const char *at = (const char *)packed + CAUSE_NUMBER_BYTES, *end = (const char *)packed + size;
  for (int number = 0; number < MOST_ARGUMENTS; number++) {
    const char *between = memchr(at, TEXT_BETWEEN[0], (size_t)(end - at));
    arguments[number] = (struct argument){at, (size_t)((between ? between : end) - at)};
    if (!between) break;
    at = between + 1;
  }
  /* A number must be one. */
  const char *text = TABLE[row].text, *until = text + strlen(text);
  struct place place;
  for (int number = 0; number < MOST_ARGUMENTS && next_place(text, until, &place); number++, text = place.end) {
    char copy[64], *stopped;
    if (!place.form_size || !arguments[number].size) continue;
    if (arguments[number].size >= sizeof copy) return -1;
    memcpy(copy, arguments[number].text, arguments[number].size);
    copy[arguments[number].size] = 0;
    long long ignored;
    if (place.form[place.form_size - 1] != 'f') {
      if (!integer(copy, &ignored)) return -1;
      continue;
    }
    (void)strtod_l(copy, &stopped, plain());
    if (*stopped) return -1;
  }
  return row;
}

int fsi_cause_number(const uint8_t *packed, size_t size) {
  struct argument arguments[MOST_ARGUMENTS];
  int row = unpacked(packed, size, arguments);
  return row < 0 ? CAUSE_UNKNOWN : TABLE[row].number;
}

static void add_argument(struct fsi_text *text, const struct argument *argument, const struct place *place) {
  char kind = place->form_size ? place->form[place->form_size - 1] : 's';
  if (kind == 's') {
    fsi_add(text, argument->text, argument->size);
    return;
  }
  char copy[64] = "0", out[400];
  if (argument->size && argument->size < sizeof copy) {
    memcpy(copy, argument->text, argument->size);
    copy[argument->size] = 0;
  }
  int written, digits = 0;
  long long whole = 0;
  /* The forms of the table: `d`, `04X`, `.2f`. */
  for (size_t at = 0; at + 1 < place->form_size; at++)
    if (place->form[at] >= '0' && place->form[at] <= '9') digits = digits * 10 + (place->form[at] - '0');
  locale_t before = uselocale(plain());
  integer(copy, &whole);
  if (kind == 'f') written = snprintf(out, sizeof out, "%.*f", digits, strtod(copy, NULL));
  else if (kind == 'X') written = snprintf(out, sizeof out, "%0*llX", digits, (unsigned long long)whole);
  else written = snprintf(out, sizeof out, "%lld", whole);
  uselocale(before);
  if (written > 0) fsi_add(text, out, (size_t)written < sizeof out ? (size_t)written : sizeof out - 1);
}

/* A number that is 0 counts as empty, as a text without characters does. */
static bool counts(const struct argument *argument, const struct place *place) {
  if (!place->form_size) return argument->size > 0;
  char copy[64] = "0";
  if (argument->size && argument->size < sizeof copy) {
    memcpy(copy, argument->text, argument->size);
    copy[argument->size] = 0;
  }
  double value = strtod_l(copy, NULL, plain());
  return value > 0 || value < 0 || isnan(value);
}

/* Fill in a part of a template; `number`: the next argument. Returns whether any argument of it counts. */
static bool fill(struct fsi_text *text, const char *from, const char *until, const struct argument *arguments,
                 int *number, bool write) {
  bool any = false;
  struct place place;
  int at = *number;
  while (at < MOST_ARGUMENTS && next_place(from, until, &place)) {
    any = any || counts(&arguments[at], &place);
    if (write) {
      fsi_add(text, from, (size_t)(place.name - 1 - from));
      add_argument(text, &arguments[at], &place);
    }
    at++;
    from = place.end;
  }
  if (write) fsi_add(text, from, (size_t)(until - from));
  *number = at;
  return any;
}

void fsi_add_cause(struct fsi_text *text, const uint8_t *packed, size_t size) {
  struct argument arguments[MOST_ARGUMENTS];
  int row = unpacked(packed, size, arguments);
  if (row < 0) row = row_of(CAUSE_UNKNOWN);
  if (row < 0) return;
  int number = 0;
  const char *at = TABLE[row].text;
  for (bool inside = false;; inside = !inside) {
    const char *until = at + strcspn(at, "[]");
    int here = number;
    bool any = fill(text, at, until, arguments, &here, false);
    if (!inside || any) fill(text, at, until, arguments, &number, true);
    number = here;
    if (!*until) return;
    at = until + 1;
  }
}

/* As Python shows it: the fewest digits that are this number, without an exponent where none is needed. */
void fsi_add_number(struct fsi_text *text, double number) {
  char out[40];
  int digits = 0, exponent;
  locale_t before = uselocale(plain());
  do {
    snprintf(out, sizeof out, "%.*e", digits, number);
    double again = strtod(out, NULL);
    if (again >= number && again <= number) break;
  } while (++digits < 17);
  const char *e = strchr(out, 'e');
  long long power = 0;
  exponent = e && integer(e + 1, &power) ? (int)power : 0;
  if (e && exponent >= -4 && exponent < 16)
    snprintf(out, sizeof out, "%.*f", digits > exponent ? digits - exponent : 1, number);
  uselocale(before);
  fsi_adds(text, out);
}

/* How many bytes the character at the start has; 0: it is no UTF-8. */
static size_t character(const unsigned char *at) {
  size_t size = at[0] < 0x80 ? 1 : at[0] < 0xC2 ? 0 : at[0] < 0xE0 ? 2 : at[0] < 0xF0 ? 3 : at[0] < 0xF5 ? 4 : 0;
  for (size_t n = 1; n < size; n++)
    if ((at[n] & 0xC0) != 0x80) return 0;
  if (size == 3 && ((at[0] == 0xE0 && at[1] < 0xA0) || (at[0] == 0xED && at[1] > 0x9F))) return 0;
  if (size == 4 && ((at[0] == 0xF0 && at[1] < 0x90) || (at[0] == 0xF4 && at[1] > 0x8F))) return 0;
  return size;
}

size_t fsi_clean(char *out, size_t room, const char *text, bool *whole) {
  const unsigned char *at = (const unsigned char *)text;
  size_t used = 0;
  bool space = false;
  *whole = true;
  while (*at) {
    if (*at == ' ' || (*at >= '\t' && *at <= '\r') || (*at >= 0x1C && *at <= 0x1F)) {
      space = used > 0;
      at++;
      continue;
    }
    size_t size = character(at);
    if (used + (space ? 1 : 0) + (size ? size : 1) > room) {
      *whole = false;
      return used;
    }
    if (space) out[used++] = ' ';
    space = false;
    if (size) {
      memcpy(out + used, at, size);
      used += size;
      at += size;
    } else {
      out[used++] = '?';
      at++;
    }
  }
  return used;
}

size_t fsi_cut(const char *text, size_t size, size_t room) {
  if (size < room) room = size;
  size_t start = room;
  while (start && ((unsigned char)text[start - 1] & 0xC0) == 0x80) start--;
  if (start && ((unsigned char)text[start - 1] & 0xC0) == 0xC0) {
    unsigned char head = (unsigned char)text[start - 1];
    size_t needs = head < 0xE0 ? 2 : head < 0xF0 ? 3 : 4;
    if (start - 1 + needs > room) return start - 1;
  }
  return room;
}
