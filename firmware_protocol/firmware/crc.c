#include "crc.h"

/* The remainders of the sixteen nibbles: 32 bytes of flash, half the speed of a 512-byte table. */
static const uint16_t remainders[16] = {
    0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
    0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF,
};

static uint32_t take_nibble(uint32_t crc, uint32_t nibble) {
    return ((crc << 4) & 0xFFFFu) ^ remainders[((crc >> 12) ^ nibble) & 0xFu];
}

uint16_t wheel_crc16(const uint8_t *data, size_t length) {
    uint32_t crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc = take_nibble(crc, data[i] >> 4u);
        crc = take_nibble(crc, data[i]);
    }
    return (uint16_t)crc;
}
