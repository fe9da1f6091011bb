#include "plant_codec.h"

#include <string.h>

#include "../../firmware/crc.h"

#define HEADER 3u /* id16, sequence8 */
#define CRC 2u

static uint8_t *put16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)(value & 0xFFu);
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put32(uint8_t *at, uint32_t value) {
    return put16(put16(at, (uint16_t)(value & 0xFFFFu)), (uint16_t)(value >> 16));
}

static uint8_t *put_floats(uint8_t *at, const float *value, size_t count) {
    for (size_t i = 0; i < count; i++) {
        uint32_t bits;
        memcpy(&bits, &value[i], sizeof bits);
        at = put32(at, bits);
    }
    return at;
}

static uint16_t get16(const uint8_t **at) {
    const uint16_t value = (uint16_t)((*at)[0] | ((*at)[1] << 8));
    *at += 2;
    return value;
}

static uint32_t get32(const uint8_t **at) {
    const uint32_t low = get16(at);
    return low | (uint32_t)get16(at) << 16;
}

static void get_floats(const uint8_t **at, float *value, size_t count) {
    for (size_t i = 0; i < count; i++) {
        const uint32_t bits = get32(at);
        memcpy(&value[i], &bits, sizeof bits);
    }
}

/* `body` has its payload already, up to `end`. */
static size_t finish(uint8_t *body, uint8_t *end, uint16_t id, uint8_t sequence, uint8_t *out) {
    (void)put16(body, id);
    body[2] = sequence;
    end = put16(end, wheel_crc16(body, (size_t)(end - body)));
    const size_t encoded = wheel_cobs_encode(body, (size_t)(end - body), out);
    out[encoded] = 0;
    return encoded + 1u;
}

size_t plant_encode_sample(uint32_t tick, uint8_t sequence, uint8_t *out) {
    uint8_t body[PLANT_BODY_MAX];
    return finish(body, put32(body + HEADER, tick), PLANT_SAMPLE_ID, sequence, out);
}

size_t plant_encode_drive(const wheel_drive *drive, uint8_t sequence, uint8_t *out) {
    uint8_t body[PLANT_BODY_MAX];
    uint8_t *at = put32(body + HEADER, drive->tick);
    at = put32(at, drive->enabled);
    at = put_floats(at, drive->torque_n_m, 4);
    at = put_floats(at, drive->duty, 4);
    return finish(body, at, PLANT_DRIVE_ID, sequence, out);
}

static bool parse(uint8_t *body, size_t length, wheel_sense *sense) {
    if (!wheel_cobs_decode(body, &length) || length != HEADER + PLANT_SENSE_LENGTH + CRC) {
        return false;
    }
    const uint8_t *at = body;
    const uint8_t *crc_at = body + length - CRC;
    if (wheel_crc16(body, length - CRC) != get16(&crc_at) || get16(&at) != PLANT_SENSE_ID) {
        return false;
    }
    at = body + HEADER;
    sense->tick = get32(&at);
    for (size_t i = 0; i < 4u; i++) {
        sense->count[i] = get16(&at);
    }
    get_floats(&at, sense->current_a, 4);
    get_floats(&at, sense->gyro_rad_s, 3);
    get_floats(&at, sense->acceleration_m_s2, 3);
    get_floats(&at, &sense->battery_v, 1);
    get_floats(&at, &sense->battery_a, 1);
    get_floats(&at, sense->temperature_degc, 4);
    return true;
}

bool plant_deframer_feed(plant_deframer *deframer, uint8_t byte, wheel_sense *sense) {
    if (byte != 0u) {
        if (deframer->length == sizeof deframer->buffer) {
            deframer->overrun = true;
        } else {
            deframer->buffer[deframer->length++] = byte;
        }
        return false;
    }
    const size_t length = deframer->overrun ? 0u : deframer->length;
    deframer->length = 0;
    deframer->overrun = false;
    return parse(deframer->buffer, length, sense);
}
