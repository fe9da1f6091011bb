/* The load of a line. */
#include "wheel_load.h"

/* Goes on to another bucket: whatever lies between has what there was so far. */
static void advance(wheel_load *load, int64_t bucket) {
    const int64_t last = load->next_ns / WHEEL_LOAD_BUCKET_NS - 1;
    for (int64_t number = last; number < bucket && number < last + WHEEL_LOAD_BUCKETS; number++) {
        load->totals[(number + WHEEL_LOAD_BUCKETS) % WHEEL_LOAD_BUCKETS] = load->total;
    }
    load->before = load->totals[bucket % WHEEL_LOAD_BUCKETS];
    load->next_ns = (bucket + 1) * WHEEL_LOAD_BUCKET_NS;
}

double wheel_load_count(wheel_load *load, int64_t now_ns, double total) {
    if (now_ns >= load->next_ns) {
        advance(load, now_ns / WHEEL_LOAD_BUCKET_NS);
    }
    load->total = total;
    const double units = total - load->before;
    if (units > load->most) {
        load->most = units;
    }
    return units * load->unit_percent;
}
