/* Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999): bytes without a zero, so that a zero can end
 * a frame. */
#ifndef WHEEL_COBS_H
#define WHEEL_COBS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes that encoding `length` bytes takes at most. */
#define WHEEL_COBS_MAX(length) ((length) + (length) / 254u + 1u)

/* Returns the number of bytes written, at most WHEEL_COBS_MAX(length). */
size_t wheel_cobs_encode(const uint8_t *data, size_t length, uint8_t *encoded);

/* Decodes in place and sets the length. False when the bytes are not an encoding; they are then undefined. */
bool wheel_cobs_decode(uint8_t *bytes, size_t *length);

#ifdef __cplusplus
}
#endif

#endif
