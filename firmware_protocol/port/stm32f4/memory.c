/* What the compiler and the core need of a C library. */
#include <stdint.h>
#include <string.h>

void *memcpy(void *restrict to, const void *restrict from, size_t size) {
    unsigned char *d = to;
    const unsigned char *s = from;
    while (size-- > 0u) {
        *d++ = *s++;
    }
    return to;
}

void *memmove(void *to, const void *from, size_t size) {
    unsigned char *d = to;
    const unsigned char *s = from;
    if ((uintptr_t)d <= (uintptr_t)s) {
        for (size_t i = 0; i < size; i++) {
            d[i] = s[i];
        }
        return to;
    }
    while (size-- > 0u) {
        d[size] = s[size];
    }
    return to;
}

void *memset(void *to, int value, size_t size) {
    unsigned char *d = to;
    while (size-- > 0u) {
        *d++ = (unsigned char)value;
    }
    return to;
}

int memcmp(const void *one, const void *other, size_t size) {
    const unsigned char *a = one;
    const unsigned char *b = other;
    for (size_t i = 0; i < size; i++) {
        if (a[i] != b[i]) {
            return a[i] < b[i] ? -1 : 1;
        }
    }
    return 0;
}

/* The names by which clang calls them ("Run-time ABI for the Arm Architecture", 4.3.4); 4 and 8 tell
 * alignment. */
void __aeabi_memcpy(void *restrict to, const void *restrict from, size_t size);
void __aeabi_memclr(void *to, size_t size);

void __aeabi_memcpy(void *restrict to, const void *restrict from, size_t size) {
    (void)memcpy(to, from, size);
}

void __aeabi_memclr(void *to, size_t size) {
    (void)memset(to, 0, size);
}

#define ALSO(name) __attribute__((alias(#name)))
ALSO(__aeabi_memcpy) void __aeabi_memcpy4(void *restrict to, const void *restrict from, size_t size);
ALSO(__aeabi_memcpy) void __aeabi_memcpy8(void *restrict to, const void *restrict from, size_t size);
ALSO(__aeabi_memclr) void __aeabi_memclr4(void *to, size_t size);
ALSO(__aeabi_memclr) void __aeabi_memclr8(void *to, size_t size);
