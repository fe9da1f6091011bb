#include "cobs.h"

size_t wheel_cobs_encode(const uint8_t *data, size_t length, uint8_t *encoded) {
    size_t code_at = 0;
    size_t end = 1;
    uint8_t code = 1;
    for (size_t i = 0; i < length; i++) {
        if (code == 0xFFu) { /* a full block: 254 bytes and no zero */
            encoded[code_at] = code;
            code_at = end++;
            code = 1;
        }
        if (data[i] == 0) {
            encoded[code_at] = code;
            code_at = end++;
            code = 1;
        } else {
            encoded[end++] = data[i];
            code++;
        }
    }
    encoded[code_at] = code;
    return end;
}

bool wheel_cobs_decode(uint8_t *bytes, size_t *length) {
    const size_t encoded = *length;
    size_t read = 0;
    size_t end = 0; /* never beyond `read`: a block decodes to no more bytes than it has */
    while (read < encoded) {
        const uint8_t code = bytes[read++];
        if (code == 0 || code - 1u > encoded - read) {
            return false;
        }
        for (uint8_t i = 1; i < code; i++) {
            if (bytes[read] == 0) {
                return false;
            }
            bytes[end++] = bytes[read++];
        }
        if (code != 0xFFu && read < encoded) {
            bytes[end++] = 0;
        }
    }
    *length = end;
    return true;
}
