#include "crc.h"

/* Two bytes at a time, without a table. The remainder of u x^16 by P = x^16 + x^12 + x^5 + 1 is the lower
 * half of q P, where q is the whole part of u x^16 / P, and 1 / P begins with x^-16 (1 + x^-4 + x^-8 + x^-11
 * + x^-12). */
uint16_t wheel_crc16(const uint8_t *data, size_t length) {
    uint32_t crc = 0xFFFFu;
    size_t i = 0;
    for (; i + 1u < length; i += 2u) {
        const uint32_t u = crc ^ ((uint32_t)data[i] << 8) ^ data[i + 1u];
        const uint32_t q = u ^ (u >> 4) ^ (u >> 8) ^ (u >> 11) ^ (u >> 12);
        crc = (q ^ (q << 5) ^ (q << 12)) & 0xFFFFu;
    }
    if (i < length) { /* one byte is left: the upper half of u, so q has two terms */
        const uint32_t u = (crc >> 8) ^ data[i];
        const uint32_t q = u ^ (u >> 4);
        crc = ((crc << 8) ^ q ^ (q << 5) ^ (q << 12)) & 0xFFFFu;
    }
    return (uint16_t)crc;
}
