#include "counter.h"

#include <math.h>
#include <string.h>

static const double LARGEST = 9007199254740992.0;

int32_t plant_counter(double value) {
    const double bounded = fmin(fmax(floor(value), -LARGEST), LARGEST);
    const uint32_t wrapped = (uint32_t)(uint64_t)(int64_t)bounded;
    int32_t result;
    memcpy(&result, &wrapped, sizeof result);
    return result;
}
