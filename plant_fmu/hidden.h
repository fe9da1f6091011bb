/* What the source files share is declared between these two and is no part of the library's interface, with
 * whatever flags they are compiled: only the functions of FMI are exported. Windows exports nothing unasked.
 */
#ifndef PLANT_HIDDEN_H
#define PLANT_HIDDEN_H

#if defined __GNUC__ && !defined _WIN32
#define HIDDEN_BEGIN _Pragma("GCC visibility push(hidden)")
#define HIDDEN_END _Pragma("GCC visibility pop")
#else
#define HIDDEN_BEGIN
#define HIDDEN_END
#endif

#endif
