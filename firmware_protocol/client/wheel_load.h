/* The load of a line: in the newest window of 100 ms, in the worst one, and in total. No I/O, allocation or
 * static data.
 */
#ifndef WHEEL_LOAD_H
#define WHEEL_LOAD_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* cffi: begin */
#define WHEEL_LOAD_BUCKET_NS 10000000 /* length of a bucket [ns]; they begin at its multiples */
#define WHEEL_LOAD_BUCKETS 10         /* buckets in a window */

/* Begin with zeros, and `unit_percent`, the load of a window in which there is one unit [%]. The rest is only
 * to be read. What occupies the line may be counted in any unit, such as bytes. */
typedef struct {
    double unit_percent;
    double total;                      /* how much there was so far */
    double most;                       /* in the worst window */
    double before;                     /* the total before the newest window */
    int64_t next_ns;                   /* when the next bucket begins */
    double totals[WHEEL_LOAD_BUCKETS]; /* at the ends of the newest buckets: of number n at n modulo 10 */
} wheel_load;

/* Sets how much there was so far; returns the load of the window that ends now [%]. A time before that of the
 * last call, such as the stamp of a bus's frame, counts in the present bucket. */
double wheel_load_count(wheel_load *load, int64_t now_ns, double total);
/* cffi: end */

#ifdef __cplusplus
}
#endif

#endif
