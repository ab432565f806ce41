/* Cells: values in shared memory that are wider than a word (shm/cell.py has the rules).
 *
 *     crc32 u32 | length u32 | seq u64 | t_mono_ns u64 | payload
 *
 * A reader copies a cell and believes the copy only if its CRC fits, so it needs no lock, and a writer that dies in the
 * middle leaves the value before. */
#include "internal.h"

#include <errno.h>
#include <unistd.h>

static uint32_t crc_table[8][256];

/* Before the constructors of a program that has linked the static library: one of those may open a handle already. */
__attribute__((constructor(101))) static void make_table(void) {
  for (uint32_t n = 0; n < 256; n++) {
    uint32_t crc = n;
    for (int bit = 0; bit < 8; bit++) crc = crc & 1 ? crc >> 1 ^ UINT32_C(0xEDB88320) : crc >> 1;
    crc_table[0][n] = crc;
  }
  for (int slice = 1; slice < 8; slice++) {
    for (uint32_t n = 0; n < 256; n++) {
      uint32_t before = crc_table[slice - 1][n];
      crc_table[slice][n] = before >> 8 ^ crc_table[0][before & 0xFF];
    }
  }
}

/* As zlib's crc32(), eight bytes at a time: a state of the gate has about 1000. */
uint32_t fsi_crc(const void *data, size_t size, uint32_t start) {
  const uint8_t *at = data;
  uint32_t crc = ~start;
  for (; size >= 8; size -= 8, at += 8) {
    uint64_t word = fsi_u64(at) ^ crc;
    crc = crc_table[7][word & 0xFF] ^ crc_table[6][word >> 8 & 0xFF] ^ crc_table[5][word >> 16 & 0xFF] ^
          crc_table[4][word >> 24 & 0xFF] ^ crc_table[3][word >> 32 & 0xFF] ^ crc_table[2][word >> 40 & 0xFF] ^
          crc_table[1][word >> 48 & 0xFF] ^ crc_table[0][word >> 56];
  }
  for (; size; size--, at++) crc = crc >> 8 ^ crc_table[0][(crc ^ *at) & 0xFF];
  return ~crc;
}

uint32_t fsi_seed(const char *record, uint64_t incarnation) {
  return fsi_crc(record, strlen(record), fsi_crc(&incarnation, sizeof incarnation, 0));
}

size_t fsi_build(uint8_t *out, uint64_t seq, uint64_t t_ns, const void *payload, size_t size, uint32_t seed) {
  uint32_t length = (uint32_t)size;
  memcpy(out + 4, &length, 4);
  memcpy(out + 8, &seq, 8);
  memcpy(out + 16, &t_ns, 8);
  if (size) memcpy(out + CELL_HEADER_BYTES, payload, size);
  uint32_t crc = fsi_crc(out + 4, CELL_HEADER_BYTES - 4 + size, seed);
  memcpy(out, &crc, 4);
  return CELL_HEADER_BYTES + size;
}

bool fsi_check(const uint8_t *raw, size_t room, uint32_t seed, struct fsi_entry *found) {
  uint32_t crc, length;
  if (room < CELL_HEADER_BYTES) return false;
  memcpy(&crc, raw, 4);
  memcpy(&length, raw + 4, 4);
  uint64_t seq = fsi_u64(raw + 8);
  if (seq == 0 || length > room - CELL_HEADER_BYTES) return false;
  if (fsi_crc(raw + 4, CELL_HEADER_BYTES - 4 + length, seed) != crc) return false;
  *found = (struct fsi_entry){seq, fsi_u64(raw + 16), raw + CELL_HEADER_BYTES, length};
  return true;
}

bool fsi_newest(const uint8_t *raw, size_t cell, uint32_t seed, struct fsi_entry *found) {
  /* The number that looks newer is checked first: then the other cell needs no check. */
  size_t first = fsi_u64(raw + 8) >= fsi_u64(raw + cell + 8) ? 0 : cell;
  return fsi_check(raw + first, cell, seed, found) || fsi_check(raw + (cell - first), cell, seed, found);
}

static bool is_blank(const uint8_t *raw, size_t size) {
  for (size_t at = 0; at < size; at++)
    if (raw[at]) return false;
  return true;
}

bool fsi_read(struct fsi_reader *reader, uint8_t *buffer, struct fsi_entry *found) {
  uint64_t seen = atomic_load_explicit(&reader->seen, memory_order_relaxed);
  bool whole = false;
  /* Two writes that overtake the copy leave it without a whole value, or with one older than a value seen before. */
  for (int look = 0; look < 3; look++) {
    memcpy(buffer, reader->at, 2 * reader->cell);
    /* The copy is what is checked and used. Without this, a compiler that sees through all the calls (LTO) may read the
     * shared memory again instead, after the check. */
    __asm__ volatile("" : : "r"(buffer) : "memory");
    whole = fsi_newest(buffer, reader->cell, reader->seed, found);
    if ((whole && found->seq >= seen) || (!whole && is_blank(buffer, 2 * reader->cell))) break;
    /* Without this barrier, the loads of the next copy may be as old as those of this one. */
    atomic_thread_fence(memory_order_seq_cst);
  }
  if (whole) atomic_store_explicit(&reader->seen, found->seq, memory_order_relaxed);
  return whole;
}

int fsi_put(struct fsi_writer *writer, const void *payload, size_t size, uint64_t t_ns) {
  uint8_t cell[CELL_HEADER_BYTES + FSI_MOST_PAYLOAD];
  if (size > writer->capacity || size > FSI_MOST_PAYLOAD) return EMSGSIZE;
  uint64_t seq = writer->seq + 1;
  size_t whole = fsi_build(cell, seq, t_ns, payload, size, writer->seed);
  off_t at = writer->at + (off_t)(seq % 2 * CELL_BYTES(writer->capacity));
  atomic_thread_fence(memory_order_seq_cst);
  /* Through the file, because a client that truncates it would otherwise kill this program with SIGBUS. */
  if (pwrite(writer->fd, cell, whole, at) != (ssize_t)whole) return errno ? errno : EIO;
  writer->seq = seq;
  return 0;
}
