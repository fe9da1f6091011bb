/* Loads a co-simulation FMU's library, makes some steps and prints every output to the last bit.
 *
 *   fmu_steps LIBRARY FMI TOKEN STEPS INPUTS REALS INTEGERS
 *
 * FMI is 2 or 3, TOKEN the GUID or instantiation token; the last three are value references with commas
 * between them. Needs no importer, so that it runs wherever a C program does: under an emulator of another
 * processor. */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STEP_S 0.001

enum { MOST = 256 };

typedef struct {
    size_t count;
    unsigned references[MOST];
} list;

static void *library;
static int fmi;
static void *instance;

static void die(const char *what) {
    fprintf(stderr, "fmu_steps: %s failed\n", what);
    exit(1);
}

static list parsed(const char *text) {
    list made = {0};
    while (*text) {
        char *end;
        if (made.count == MOST)
            die("a list of fewer references");
        made.references[made.count++] = (unsigned)strtoul(text, &end, 10);
        if (end == text)
            die("reading a list");
        text = end + (*end == ',');
    }
    return made;
}

/* Stores a function's address; ISO C has no conversion from an object pointer. */
static void find(const char *name, void *function) {
    void *address = dlsym(library, name);
    if (!address)
        die(name);
    memcpy(function, &address, sizeof address);
}

static void check(int status, const char *what) {
    if (status != 0)
        die(what);
}

static void log_fmi2(void *environment, const char *name, int status, const char *category, const char *text,
                     ...) {
    (void)environment, (void)name, (void)status, (void)category;
    va_list values;
    va_start(values, text);
    vfprintf(stderr, text, values);
    va_end(values);
    fputc('\n', stderr);
}

static void log_fmi3(void *environment, int status, const char *category, const char *text) {
    log_fmi2(environment, "", status, category, "%s", text);
}

static void initialise2(const char *token) {
    static const struct {
        void (*logger)(void *, const char *, int, const char *, const char *, ...);
        void *(*allocate)(size_t, size_t);
        void (*release)(void *);
        void *finished, *environment;
    } callbacks = {log_fmi2, calloc, free, NULL, NULL};
    void *(*instantiate)(const char *, int, const char *, const char *, const void *, int, int);
    int (*set_up)(void *, int, double, double, int, double), (*enter)(void *), (*leave)(void *);
    find("fmi2Instantiate", &instantiate);
    find("fmi2SetupExperiment", &set_up);
    find("fmi2EnterInitializationMode", &enter);
    find("fmi2ExitInitializationMode", &leave);
    instance = instantiate("steps", 1, token, "", &callbacks, 0, 1);
    if (!instance)
        die("fmi2Instantiate");
    check(set_up(instance, 0, 0.0, 0.0, 0, 0.0), "fmi2SetupExperiment");
    check(enter(instance), "fmi2EnterInitializationMode");
    check(leave(instance), "fmi2ExitInitializationMode");
}

static void initialise3(const char *token) {
    void *(*instantiate)(const char *, const char *, const char *, bool, bool, bool, bool, const unsigned *,
                         size_t, void *, void (*)(void *, int, const char *, const char *), void *);
    int (*enter)(void *, bool, double, double, bool, double), (*leave)(void *);
    find("fmi3InstantiateCoSimulation", &instantiate);
    find("fmi3EnterInitializationMode", &enter);
    find("fmi3ExitInitializationMode", &leave);
    instance = instantiate("steps", token, NULL, false, true, false, false, NULL, 0, NULL, log_fmi3, NULL);
    if (!instance)
        die("fmi3InstantiateCoSimulation");
    check(enter(instance, false, 0.0, 0.0, false, 0.0), "fmi3EnterInitializationMode");
    check(leave(instance), "fmi3ExitInitializationMode");
}

static void set_reals(const list *at, const double *values) {
    int (*set2)(void *, const unsigned *, size_t, const double *);
    int (*set3)(void *, const unsigned *, size_t, const double *, size_t);
    if (fmi == 2) {
        find("fmi2SetReal", &set2);
        check(set2(instance, at->references, at->count, values), "fmi2SetReal");
    } else {
        find("fmi3SetFloat64", &set3);
        check(set3(instance, at->references, at->count, values, at->count), "fmi3SetFloat64");
    }
}

static void get(const list *at, const char *name2, const char *name3, void *values) {
    int (*get2)(void *, const unsigned *, size_t, void *);
    int (*get3)(void *, const unsigned *, size_t, void *, size_t);
    if (fmi == 2) {
        find(name2, &get2);
        check(get2(instance, at->references, at->count, values), name2);
    } else {
        find(name3, &get3);
        check(get3(instance, at->references, at->count, values, at->count), name3);
    }
}

static void step(double time_s) {
    int (*step2)(void *, double, double, int);
    int (*step3)(void *, double, double, bool, bool *, bool *, bool *, double *);
    if (fmi == 2) {
        find("fmi2DoStep", &step2);
        check(step2(instance, time_s, STEP_S, 1), "fmi2DoStep");
    } else {
        bool event, terminate, early;
        double last_s;
        find("fmi3DoStep", &step3);
        check(step3(instance, time_s, STEP_S, true, &event, &terminate, &early, &last_s), "fmi3DoStep");
    }
}

int main(int count, char **words) {
    if (count != 8)
        die("reading seven arguments");
    library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL);
    if (!library)
        die(dlerror());
    fmi = atoi(words[2]);
    if (fmi == 2)
        initialise2(words[3]);
    else
        initialise3(words[3]);
    const int steps = atoi(words[4]);
    const list inputs = parsed(words[5]), reals = parsed(words[6]), integers = parsed(words[7]);
    for (int i = 0; i < steps; i++) {
        double in[MOST], out[MOST];
        int32_t counts[MOST];
        for (size_t k = 0; k < inputs.count; k++) { /* changes at every step, and is exact in binary */
            const int least = k + 1 < inputs.count ? -15 : 0; /* the last input is not negative */
            in[k] = (double)((i * 7 + (int)k * 13) % 31 + least) / 32.0;
        }
        set_reals(&inputs, in);
        step(i * STEP_S);
        get(&reals, "fmi2GetReal", "fmi3GetFloat64", out);
        get(&integers, "fmi2GetInteger", "fmi3GetInt32", counts);
        for (size_t k = 0; k < reals.count; k++) {
            uint64_t bits;
            memcpy(&bits, &out[k], sizeof bits);
            printf("%d %u %016llx\n", i, reals.references[k], (unsigned long long)bits);
        }
        for (size_t k = 0; k < integers.count; k++)
            printf("%d %u %d\n", i, integers.references[k], (int)counts[k]);
    }
    return 0;
}
