#include "crc.h"

/* A byte at a time, without a table. The polynomial x^16 + x^12 + x^5 + 1 has few terms: what leaves at the
 * top comes back at three places, and once more through its own upper half. */
uint16_t wheel_crc16(const uint8_t *data, size_t length) {
    uint32_t crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        uint32_t leaves = (crc >> 8) ^ data[i];
        leaves ^= leaves >> 4;
        crc = ((crc << 8) ^ (leaves << 12) ^ (leaves << 5) ^ leaves) & 0xFFFFu;
    }
    return (uint16_t)crc;
}
