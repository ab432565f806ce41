/* Reading msgpack in place: it makes no memory, never reads outside, and never recurses. */
#include "internal.h"

static uint64_t big(struct fsi_packed *in, unsigned bytes) {
  uint64_t value = 0;
  if ((size_t)(in->end - in->at) < bytes) {
    in->bad = true;
    in->at = in->end;
    return 0;
  }
  while (bytes--) value = value << 8 | *in->at++;
  return value;
}

static struct fsi_value whole(uint64_t natural, int64_t integer, bool negative) {
  double number = negative ? (double)integer : (double)natural;
  return (struct fsi_value){.kind = FSI_INT, .integer = integer, .natural = natural, .number = number};
}

static struct fsi_value bytes(struct fsi_packed *in, enum fsi_kind kind, uint64_t count) {
  struct fsi_value value = {.kind = kind, .text = (const char *)in->at, .count = (uint32_t)count};
  if (count > (uint64_t)(in->end - in->at)) {
    in->bad = true;
    in->at = in->end;
    value.count = 0;
  } else {
    in->at += count;
  }
  return value;
}

static struct fsi_value members(struct fsi_packed *in, enum fsi_kind kind, uint64_t count) {
  /* Each member takes a byte at least, so no count can make a reader spin. */
  if (count > (uint64_t)(in->end - in->at)) {
    in->bad = true;
    count = 0;
  }
  return (struct fsi_value){.kind = kind, .count = (uint32_t)count};
}

struct fsi_value fsi_next(struct fsi_packed *in) {
  static const struct fsi_value nothing = {.kind = FSI_NIL};
  if (in->bad || in->at >= in->end) {
    in->bad = true;
    return nothing;
  }
  unsigned head = *in->at++;
  if (head < 0x80) return whole(head, (int64_t)head, false);
  if (head < 0x90) return members(in, FSI_MAP, head & 0x0F);
  if (head < 0xA0) return members(in, FSI_ARRAY, head & 0x0F);
  if (head < 0xC0) return bytes(in, FSI_STR, head & 0x1F);
  if (head >= 0xE0) return whole(0, (int8_t)head, true);
  switch (head) {
    case 0xC0: return nothing;
    case 0xC2: return (struct fsi_value){.kind = FSI_BOOL, .integer = 0};
    case 0xC3: return (struct fsi_value){.kind = FSI_BOOL, .integer = 1, .natural = 1, .number = 1};
    case 0xC4: case 0xC5: case 0xC6: return bytes(in, FSI_BIN, big(in, 1u << (head - 0xC4)));
    case 0xC7: case 0xC8: case 0xC9: return bytes(in, FSI_OTHER, big(in, 1u << (head - 0xC7)) + 1);
    case 0xCA: {
      uint32_t bits = (uint32_t)big(in, 4);
      float single;
      memcpy(&single, &bits, sizeof single);
      return (struct fsi_value){.kind = FSI_FLOAT, .number = (double)single};
    }
    case 0xCB: {
      uint64_t bits = big(in, 8);
      struct fsi_value value = {.kind = FSI_FLOAT};
      memcpy(&value.number, &bits, sizeof value.number);
      return value;
    }
    case 0xCC: case 0xCD: case 0xCE: case 0xCF: {
      uint64_t value = big(in, 1u << (head - 0xCC));
      return whole(value, value > INT64_MAX ? INT64_MAX : (int64_t)value, false);
    }
    case 0xD0: case 0xD1: case 0xD2: case 0xD3: {
      unsigned size = 1u << (head - 0xD0);
      uint64_t value = big(in, size);
      if (size < 8 && value >> (size * 8 - 1)) value |= ~UINT64_C(0) << size * 8;
      int64_t given;
      memcpy(&given, &value, sizeof given);
      return whole(given < 0 ? 0 : value, given, given < 0);
    }
    case 0xD4: case 0xD5: case 0xD6: case 0xD7: case 0xD8:
      return bytes(in, FSI_OTHER, (UINT64_C(1) << (head - 0xD4)) + 1);
    case 0xD9: case 0xDA: case 0xDB: return bytes(in, FSI_STR, big(in, 1u << (head - 0xD9)));
    case 0xDC: case 0xDD: return members(in, FSI_ARRAY, big(in, 2u << (head - 0xDC)));
    case 0xDE: case 0xDF: return members(in, FSI_MAP, big(in, 2u << (head - 0xDE)));
    default: in->bad = true; return nothing;
  }
}

void fsi_skip(struct fsi_packed *in, const struct fsi_value *value) {
  uint64_t left = 0;
  const struct fsi_value *inside = value;
  struct fsi_value next;
  for (;;) {
    if (inside->kind == FSI_ARRAY) left += inside->count;
    if (inside->kind == FSI_MAP) left += 2 * (uint64_t)inside->count;
    if (!left || in->bad) return;
    left--;
    next = fsi_next(in);
    inside = &next;
  }
}

bool fsi_is(const struct fsi_value *value, const char *text) {
  size_t size = strlen(text);
  return value->kind == FSI_STR && value->count == size && memcmp(value->text, text, size) == 0;
}

bool fsi_find(const uint8_t *data, size_t size, const char *key, struct fsi_value *found, struct fsi_packed *rest) {
  struct fsi_packed in = {data, data + size, false};
  struct fsi_value map = fsi_next(&in);
  if (map.kind != FSI_MAP) return false;
  for (uint32_t pair = 0; pair < map.count && !in.bad; pair++) {
    struct fsi_value name = fsi_next(&in);
    fsi_skip(&in, &name);
    struct fsi_value value = fsi_next(&in);
    if (fsi_is(&name, key)) {
      *found = value;
      if (rest) *rest = in;
      return !in.bad;
    }
    fsi_skip(&in, &value);
  }
  return false;
}
