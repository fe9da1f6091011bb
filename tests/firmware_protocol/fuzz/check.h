/* What the fuzzers check with. */
#ifndef FUZZ_CHECK_H
#define FUZZ_CHECK_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition)                                                                                     \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                                  \
            abort();                                                                                         \
        }                                                                                                    \
    } while (0)

/* Memory of exactly this size, so that the sanitizer sees a read or write beyond it. */
static inline uint8_t *exactly(const uint8_t *bytes, size_t size) {
    uint8_t *copy = malloc(size + (size == 0u));
    CHECK(copy != NULL);
    memcpy(copy, bytes, size);
    return copy;
}

#endif
