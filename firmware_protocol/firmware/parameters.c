#include "parameters.h"

#include <string.h>

#include "../generated/wheel_messages.h"

#define ROW(name, type, minimum, maximum) {#name, WP_TYPE_##type, minimum, maximum},
const wheel_parameter_info wheel_parameter_table[WHEEL_PARAMETER_COUNT] = {WP_PARAMETERS(ROW)};
#undef ROW

_Static_assert(sizeof(wheel_parameters) == WHEEL_PARAMETER_COUNT * sizeof(float),
               "the table and the structure have the same entries");

#define HEADER_SIZE 12u

static const uint8_t MARK[4] = {'W', 'H', 'P', '2'};

static uint32_t crc32(uint32_t crc, const uint8_t *bytes, size_t length) {
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        for (unsigned bit = 0; bit < 8u; bit++) {
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
        }
    }
    return crc;
}

static void put_u32(uint8_t *bytes, uint32_t value) {
    for (unsigned i = 0; i < 4u; i++) {
        bytes[i] = (uint8_t)(value >> (8u * i));
    }
}

static uint32_t get_u32(const uint8_t *bytes) {
    uint32_t value = 0;
    for (unsigned i = 0; i < 4u; i++) {
        value |= (uint32_t)bytes[i] << (8u * i);
    }
    return value;
}

static uint32_t bits_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static float float_of(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

float wheel_parameter_get(const wheel_parameters *parameters, size_t index) {
    float value;
    memcpy(&value, (const unsigned char *)parameters + index * sizeof value, sizeof value);
    return value;
}

float wheel_parameter_maximum(const wheel_parameters *board_maximum, size_t index) {
    const float table = wheel_parameter_table[index].maximum;
    const float board = board_maximum != NULL ? wheel_parameter_get(board_maximum, index) : table;
    return board < table ? board : table;
}

static bool in_range(const wheel_parameters *board_maximum, size_t index, float value) {
    /* Written so that NaN fails too. */
    return value >= wheel_parameter_table[index].minimum &&
           value <= wheel_parameter_maximum(board_maximum, index);
}

bool wheel_parameter_set(wheel_parameters *parameters, const wheel_parameters *board_maximum, size_t index,
                         float value) {
    if (!in_range(board_maximum, index, value)) {
        return false;
    }
    memcpy((unsigned char *)parameters + index * sizeof value, &value, sizeof value);
    return true;
}

uint32_t wheel_parameter_bits(size_t index, float value) {
    return wheel_parameter_table[index].type == WP_TYPE_UINT32 ? (uint32_t)value : bits_of(value);
}

bool wheel_parameter_from_bits(size_t index, uint32_t bits, float *value) {
    if (wheel_parameter_table[index].type != WP_TYPE_UINT32) {
        *value = float_of(bits);
        return true;
    }
    /* Whole numbers up to here are floats too. */
    *value = (float)bits;
    return bits <= 0x1000000u;
}

int wheel_parameters_invalid(const wheel_parameters *parameters) {
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        if (!in_range(NULL, i, wheel_parameter_get(parameters, i))) {
            return (int)i;
        }
    }
    return -1;
}

uint32_t wheel_parameters_hash(const wheel_parameters *parameters) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        uint8_t bytes[4];
        put_u32(bytes, bits_of(wheel_parameter_get(parameters, i)));
        crc = crc32(crc, bytes, sizeof bytes);
    }
    return crc ^ 0xFFFFFFFFu;
}

/* What comes before the values: bytes that other tables, other boards and other versions do not have. */
static void put_header(uint8_t *bytes, uint16_t board) {
    memcpy(bytes, MARK, sizeof MARK);
    put_u32(bytes + 4, WP_PARAMETER_TABLE_HASH);
    put_u32(bytes + 8, board | (uint32_t)WHEEL_PARAMETER_COUNT << 16);
}

void wheel_parameters_store(const wheel_parameters *parameters, uint16_t board,
                            uint8_t bytes[WHEEL_STORED_SIZE]) {
    put_header(bytes, board);
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        put_u32(bytes + HEADER_SIZE + 4u * i, bits_of(wheel_parameter_get(parameters, i)));
    }
    put_u32(bytes + WHEEL_STORED_SIZE - 4u, crc32(0xFFFFFFFFu, bytes, WHEEL_STORED_SIZE - 4u) ^ 0xFFFFFFFFu);
}

bool wheel_parameters_load(wheel_parameters *parameters, const wheel_parameters *board_maximum,
                           uint16_t board, const uint8_t bytes[WHEEL_STORED_SIZE]) {
    const uint32_t crc = crc32(0xFFFFFFFFu, bytes, WHEEL_STORED_SIZE - 4u) ^ 0xFFFFFFFFu;
    uint8_t header[HEADER_SIZE];
    put_header(header, board);
    if (memcmp(bytes, header, sizeof header) != 0 || get_u32(bytes + WHEEL_STORED_SIZE - 4u) != crc) {
        return false;
    }
    wheel_parameters loaded;
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        const float value = float_of(get_u32(bytes + HEADER_SIZE + 4u * i));
        if (!wheel_parameter_set(&loaded, board_maximum, i, value)) {
            return false;
        }
    }
    *parameters = loaded;
    return true;
}
