/* A mutator for streams of the serial line that gets past the checks of the line: it repairs what random
 * changes break, lengths, CRCs and COBS, and writes plausible frames of its own. All fuzzers use it. */
#ifndef WIRE_MUTATOR_H
#define WIRE_MUTATOR_H

#include <stddef.h>
#include <stdint.h>

/* Given by the fuzzer: how many bytes precede the stream, and the check that arms its robot. */
extern const size_t wire_header_size;
uint8_t wire_parameter_check(void);

size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size);
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#endif
