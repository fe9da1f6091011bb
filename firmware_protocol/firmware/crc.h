/* CRC-16/CCITT-FALSE: polynomial 1021, start FFFF, not reflected, no final XOR; 29B1 over "123456789". */
#ifndef WHEEL_CRC_H
#define WHEEL_CRC_H

#include <stddef.h>
#include <stdint.h>

uint16_t wheel_crc16(const uint8_t *data, size_t length);

#endif
