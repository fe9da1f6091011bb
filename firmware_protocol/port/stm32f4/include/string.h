/* The part of <string.h> that the firmware uses (C11, 7.24), so that no C library is needed: memory.c. */
#ifndef STM32F4_STRING_H
#define STM32F4_STRING_H

#include <stddef.h>

void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memmove(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);
int memcmp(const void *one, const void *other, size_t size);

#endif
