#include "robot_faults.h"

#include <math.h>
#include <stdbool.h>

static void count(robot_faults *f, const robot_fault *row) {
    robot_fault_account *const account = &f->account[row->account];
    if (account->newest_tick != f->ticks + 1u) {
        account->newest_tick = f->ticks + 1u;
        account->applied++;
    }
}

/* Whether the row's point of the body is in its circle. */
static bool is_inside(const robot_faults *f, const robot_fault *row) {
    const double c = cos(f->pose[2]), s = sin(f->pose[2]);
    const double x_m = f->pose[0] + c * row->forward_m - s * row->left_m - row->x_m;
    const double y_m = f->pose[1] + s * row->forward_m + c * row->left_m - row->y_m;
    return x_m * x_m + y_m * y_m <= row->radius_m * row->radius_m;
}

/* Finds the rows that act in this tick. */
static void find_acting(robot_faults *f) {
    const uint64_t t = f->ticks - f->origin;
    for (robot_fault *row = f->row; row < f->row + f->rows; row++) {
        const bool in_place = !(row->radius_m > 0.0) || is_inside(f, row);
        const int32_t acts = row->first <= t && t < row->end && in_place;
        row->changes = acts != row->acts;
        row->acts = acts;
    }
}

/* Gives a variable what the last row that acts on it says. */
static int set(robot_faults *f, const robot_fault *changed) {
    double value = changed->base;
    for (const robot_fault *row = f->row; row < f->row + f->rows; row++) {
        if (row->kind == ROBOT_FAULT_SET && row->place == changed->place && row->acts) {
            value = row->value;
        }
    }
    return f->set(f->context, changed->place, value);
}

/* Does what is done before a tick. Returns 0, or 1 when the plant refused a variable. */
static int begin_tick(robot_faults *f, wheel_drive *drive) {
    find_acting(f);
    for (const robot_fault *row = f->row; row < f->row + f->rows; row++) {
        if (row->kind == ROBOT_FAULT_SET) {
            if (row->changes && set(f, row) != 0) {
                return 1;
            }
            if (row->acts && row->value != row->base) {
                count(f, row);
            }
        } else if (row->kind == ROBOT_FAULT_RESET && row->acts && row->changes) {
            f->is_off = 1;
            count(f, row);
        } else if (row->kind == ROBOT_FAULT_DEAD_MOTOR && row->acts) {
            float *const torque = &drive->torque_n_m[row->place], *const duty = &drive->duty[row->place];
            if (*torque != 0.0f || *duty != 0.0f) {
                count(f, row);
            }
            *torque = *duty = 0.0f;
        }
    }
    return 0;
}

/* Lets the plant go on for the milliseconds that a slow clock misses. */
static int go_on(robot_faults *f, const wheel_drive *drive, wheel_sense *sense) {
    for (const robot_fault *row = f->row; row < f->row + f->rows; row++) {
        if (row->kind != ROBOT_FAULT_SLOW_CLOCK || !row->acts) {
            continue;
        }
        f->owed_ticks += row->value * 1e-6;
        if (f->owed_ticks >= 1.0) {
            f->owed_ticks -= 1.0;
            f->extra_ticks++;
            f->account[row->account].applied++;
            if (f->exchange(f->context, drive, sense) != 0) {
                return 1;
            }
        }
    }
    return 0;
}

/* What the robot's electronics see of it, as it is wired. */
static void wire(const robot_wiring *wiring, wheel_sense *sense) {
    const wheel_sense plant = *sense;
    for (int i = 0; i < 4; i++) {
        sense->count[i] = (uint16_t)(wiring->encoder_sign[i] * plant.count[wiring->encoder_channel[i]]);
    }
    for (int i = 0; i < 3; i++) {
        const float sign = (float)wiring->imu_sign[i];
        sense->gyro_rad_s[i] = sign * plant.gyro_rad_s[wiring->imu_axis[i]];
        sense->acceleration_m_s2[i] = sign * plant.acceleration_m_s2[wiring->imu_axis[i]];
    }
}

static void spoil(robot_faults *f, wheel_sense *sense) {
    double part[4] = {0.0, 0.0, 0.0, 0.0}; /* of its counts that an encoder loses */
    for (const robot_fault *row = f->row; row < f->row + f->rows; row++) {
        if (!row->acts) {
            continue;
        }
        if (row->kind == ROBOT_FAULT_GYRO_BIAS) {
            sense->gyro_rad_s[2] += (float)row->value;
            count(f, row);
        } else if (row->kind == ROBOT_FAULT_LOST_COUNTS) {
            part[row->place] = fmax(part[row->place], row->value);
            if (sense->count[row->place] != f->count[row->place]) {
                count(f, row);
            }
        }
    }
    for (int i = 0; i < 4; i++) {
        const uint16_t counted = sense->count[i];
        f->owed[i] += part[i] * (int16_t)(counted - f->count[i]);
        const double whole = trunc(f->owed[i]);
        f->owed[i] -= whole;
        f->lost[i] = (uint16_t)(f->lost[i] + (int)whole);
        f->count[i] = counted;
        sense->count[i] = (uint16_t)(counted - f->lost[i]);
    }
}

/* One tick with rows to apply. */
static int pass_with_rows(robot_faults *f, const wheel_drive *drive, wheel_sense *sense) {
    wheel_drive held = *drive;
    if (f->has_begun && begin_tick(f, &held) != 0) {
        return 1;
    }
    if (f->is_off) {
        held = (wheel_drive){.tick = drive->tick};
    }
    return f->exchange(f->context, &held, sense) != 0 || (f->has_begun && go_on(f, &held, sense) != 0);
}

int robot_faults_exchange(void *context, const wheel_drive *drive, wheel_sense *sense) {
    robot_faults *const f = context;
    const bool passes = drive != NULL && f->rows > 0u;
    if ((passes ? pass_with_rows(f, drive, sense) : f->exchange(f->context, drive, sense)) != 0) {
        return 1;
    }
    if (drive == NULL) {
        sense->tick = (uint32_t)f->boot_ticks; /* the plant may have gone on through a reset */
    }
    if (f->wiring.differs) {
        wire(&f->wiring, sense);
    }
    spoil(f, sense);
    f->ticks += drive != NULL;
    f->boot_ticks += drive != NULL;
    return 0;
}

void robot_faults_begin(robot_faults *f, uint32_t tick) {
    f->origin = f->ticks - f->boot_ticks + tick;
    f->has_begun = 1;
}

void robot_faults_power_on(robot_faults *f) {
    f->boot_ticks = 0;
    f->is_off = 0;
}
