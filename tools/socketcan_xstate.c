/* Lets Debian's user-mode Linux 6.1 run on processors with AMX; tools/socketcan.py preloads it.
 *
 * That kernel sets the extended registers of its processes (XSAVE) with 2696 bytes, which holds AVX-512. The
 * host's kernel takes a whole state alone, and with AMX that is 11,008 bytes: it refuses, and the guest dies.
 * So a shorter state is laid over the one that is there, and both are set. Newer kernels of user-mode Linux
 * ask for the size themselves. */
#define _GNU_SOURCE
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static long call(long request, long process, void *address, void *data) {
    return syscall(SYS_ptrace, request, process, address, data);
}

long ptrace(enum __ptrace_request request, ...) {
    static uint8_t state[65536]; /* the guest's kernel has one thread */
    va_list arguments;
    va_start(arguments, request);
    const long process = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (request == PTRACE_SETREGSET && (uintptr_t)address == NT_X86_XSTATE) {
        const struct iovec *given = data;
        struct iovec whole = {state, sizeof state};
        if (call(PTRACE_GETREGSET, process, address, &whole) == 0 && whole.iov_len > given->iov_len) {
            memcpy(state, given->iov_base, given->iov_len);
            return call(request, process, address, &whole);
        }
    }
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        long value = 0; /* the system call writes it, and C's function returns it */
        if (call(request, process, address, &value) < 0) {
            return -1;
        }
        errno = 0;
        return value;
    }
    return call(request, process, address, data);
}
