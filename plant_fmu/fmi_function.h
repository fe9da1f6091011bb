/* How a function of FMI, of either version, is named and exported.
 *
 * In a shared library the functions carry the standard's names. Who compiles the sources into a program gives
 * them a prefix, which is mecanum_: FMI2_FUNCTION_PREFIX in FMI 2.0 (section 2.1.1), FMI3_FUNCTION_PREFIX in
 * FMI 3.0, unless FMI3_OVERRIDE_FUNCTION_PREFIX puts FMI3_ACTUAL_FUNCTION_PREFIX or nothing in its place
 * (section 2.2.1). The prefix is on the functions of both versions. */
#ifndef FMI_FUNCTION_H
#define FMI_FUNCTION_H

#if !defined FMI3_OVERRIDE_FUNCTION_PREFIX && defined FMI3_FUNCTION_PREFIX
#define FMI_PREFIX FMI3_FUNCTION_PREFIX
#elif defined FMI3_OVERRIDE_FUNCTION_PREFIX && defined FMI3_ACTUAL_FUNCTION_PREFIX
#define FMI_PREFIX FMI3_ACTUAL_FUNCTION_PREFIX
#elif defined FMI2_FUNCTION_PREFIX
#define FMI_PREFIX FMI2_FUNCTION_PREFIX
#endif

#ifdef FMI_PREFIX
#define FMI_PASTE_(a, b) a##b
#define FMI_PASTE(a, b) FMI_PASTE_(a, b)
#define FMI_NAME(name) FMI_PASTE(FMI_PREFIX, name)
#else
#define FMI_NAME(name) name
#endif

#if defined _WIN32
#define FMI_EXPORT __declspec(dllexport)
#else
#define FMI_EXPORT __attribute__((visibility("default")))
#endif

/* Declares a function and begins its definition: FMI(type, name, parameters) { ... } */
#define FMI(type, name, ...)                                                                                 \
    FMI_EXPORT type FMI_NAME(name)(__VA_ARGS__);                                                             \
    FMI_EXPORT type FMI_NAME(name)(__VA_ARGS__)

#endif
