/* What the shim gives an FMU to call: its logger and its memory. */
#include "cosim.h"

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

const char *cosim_status_name(int status) {
    static const char *const NAME[] = {"ok", "warning", "discard", "error", "fatal", "pending"};
    const bool known = status >= 0 && (size_t)status < sizeof NAME / sizeof *NAME;
    return known ? NAME[status] : "which no standard has";
}

static void take_message(cosim *c, int status, const char *message) {
    if (status >= COSIM_WARNING && status >= c->text_status && !c->failed) {
        c->text_status = status;
        snprintf(c->text, sizeof c->text, "%s", message);
    }
    if (c->prints_log) {
        const char *const kind = status >= COSIM_WARNING ? cosim_status_name(status) : "info";
        fprintf(stderr, "log (%s): ", kind);
        for (const char *letter = message; *letter != '\0'; letter++) {
            fputc(*letter == '\n' ? ' ' : *letter, stderr);
        }
        fputc('\n', stderr);
    }
}

void cosim_log2(void *environment, const char *instance, int status, const char *category,
                const char *message, ...) {
    (void)instance, (void)category;
    if (message != NULL) {
        char text[sizeof((cosim *)NULL)->text];
        va_list arguments;
        va_start(arguments, message);
        vsnprintf(text, sizeof text, message, arguments);
        va_end(arguments);
        take_message(environment, status, text);
    }
}

void cosim_log3(void *environment, int status, const char *category, const char *message) {
    (void)category;
    if (message != NULL) {
        take_message(environment, status, message);
    }
}

void *cosim_allocate(size_t count, size_t size) {
    return calloc(count, size);
}

void cosim_free(void *memory) {
    free(memory);
}
