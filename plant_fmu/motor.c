/* Motors and battery. */
#include <float.h>
#include <string.h>

#include "model.h"

static const int MOST_SECANTS = 10;
static const int MOST_SEARCHES = 60;
/* Below this a battery is empty. A search for its voltage may end at any number next to zero. */
static const double EMPTY_V = 1e-6;

static double clamp(double x, double low, double high) {
    return fmin(fmax(x, low), high);
}

/* The axle constant that a drive knows: the same for all wheels. */
static double believed_constant(const mecanum_parameters *p) {
    return p->gear_ratio * p->motor_constant_n_m_a;
}

/* What the motors are and run on in one state. */
typedef struct {
    const mecanum_parameters *p;
    const double *axle_constant;
    double source_v; /* of the battery without load */
} supply;

/* Voltage of the battery when the motors together take `power_w`: V (U - V) = R P. A battery from which more
 * is asked than it can give is at half of its voltage. */
static double loaded_voltage_v(const supply *s, double power_w) {
    const double source_v = s->source_v;
    const double root = source_v * source_v - 4.0 * s->p->battery_resistance_ohm * power_w;
    return 0.5 * (source_v + sqrt(fmax(root, 0.0)));
}

/* Electrical power of motors that carry `current_a` at `speed_rad_s`, without change of current. */
static double power_w(const supply *s, const double *current_a, const double *speed_rad_s) {
    double sum = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        sum +=
            (s->p->motor_resistance_ohm * current_a[i] + s->axle_constant[i] * speed_rad_s[i]) * current_a[i];
    }
    return sum;
}

static double winding_heat_w(const supply *s, const double *current_a) {
    double sum = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        sum += s->p->motor_resistance_ohm * current_a[i] * current_a[i];
    }
    return sum;
}

static void load_battery(const supply *s, double voltage_v, double power, mecanum_drive *drive) {
    drive->battery_v = voltage_v;
    drive->battery_a = voltage_v > EMPTY_V ? power / voltage_v : 0.0;
    drive->lost_w = s->p->battery_resistance_ohm * drive->battery_a * drive->battery_a;
    drive->supplied_w = power + drive->lost_w;
}

/* The torques are what they are; the battery only shows what a robot would draw. */
static void drive_torque(const supply *s, const mecanum_inputs *u, const double *speed_rad_s,
                         mecanum_drive *drive) {
    double mechanical_w = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        drive->current_a[i] = u->wheel_torque_n_m[i] / believed_constant(s->p);
        drive->torque_n_m[i] = u->wheel_torque_n_m[i] * s->p->wheel_torque_factor[i];
        mechanical_w += drive->torque_n_m[i] * speed_rad_s[i];
    }
    const double power = power_w(s, drive->current_a, speed_rad_s);
    load_battery(s, loaded_voltage_v(s, power), power, drive);
    drive->supplied_w = mechanical_w;
    drive->lost_w = 0.0;
}

/* What motors and battery are at one voltage: the currents as near to the set points as it pushes, and by how
 * much the battery's own voltage under them is above it. */
static double surplus_v(const supply *s, const double *set_a, const double *speed_rad_s, double voltage_v,
                        double *current_a) {
    const double conductance = 1.0 / s->p->motor_resistance_ohm;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double back_emf_v = s->axle_constant[i] * speed_rad_s[i];
        current_a[i] =
            clamp(set_a[i], (-voltage_v - back_emf_v) * conductance, (voltage_v - back_emf_v) * conductance);
    }
    const double battery_a = power_w(s, current_a, speed_rad_s) / voltage_v;
    return s->source_v - s->p->battery_resistance_ohm * battery_a - voltage_v;
}

/* The voltage at which the battery gives just what it pushes, wherever it is: regula falsi with the Illinois
 * rule. Also writes the currents. */
static double searched_voltage_v(const supply *s, const double *set_a, const double *speed_rad_s,
                                 double *current_a) {
    double braking_w = 0.0; /* the most that motors at these speeds can give back */
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double back_emf_v = s->axle_constant[i] * speed_rad_s[i];
        braking_w += 0.25 * back_emf_v * back_emf_v / s->p->motor_resistance_ohm;
    }
    double high_v = loaded_voltage_v(s, -braking_w);
    const double least_v = fmax(1e-9 * high_v, DBL_MIN);
    const double exact_v = 1e-13 * high_v;
    /* A load of constant power has a voltage on either side of the half of the source's: the higher one
     * holds. */
    double low_v = fmax(0.5 * s->source_v, least_v);
    double low = surplus_v(s, set_a, speed_rad_s, low_v, current_a);
    double high = low;
    if (low > 0.0) {
        high = surplus_v(s, set_a, speed_rad_s, high_v, current_a);
    } else {
        high_v = low_v;
        low_v = least_v;
        low = surplus_v(s, set_a, speed_rad_s, low_v, current_a);
        if (low <= 0.0) {
            return low_v; /* wheels that turn brake on a battery that gives nothing */
        }
    }
    double voltage_v = high_v;
    int side = 0;
    for (int i = 0; high < -exact_v && i < MOST_SEARCHES; i++) {
        voltage_v = (low_v * high - high_v * low) / (high - low);
        const double surplus = surplus_v(s, set_a, speed_rad_s, voltage_v, current_a);
        if (fabs(surplus) <= exact_v) {
            break;
        }
        if (surplus > 0.0) {
            low_v = voltage_v;
            low = surplus;
            high *= side > 0 ? 0.5 : 1.0;
            side = 1;
        } else {
            high_v = voltage_v;
            high = surplus;
            low *= side < 0 ? 0.5 : 1.0;
            side = -1;
        }
    }
    return voltage_v;
}

/* The same from a guess, by the secant method: a few steps, where the battery is far from its end and not
 * empty. */
static double pushing_voltage_v(const supply *s, const double *set_a, const double *speed_rad_s,
                                double guess_v, double *current_a) {
    if (guess_v <= EMPTY_V) {
        return searched_voltage_v(s, set_a, speed_rad_s, current_a);
    }
    double before_v = guess_v;
    double before = surplus_v(s, set_a, speed_rad_s, before_v, current_a);
    double now_v = before_v + before;
    for (int i = 0; i < MOST_SECANTS && now_v > 0.5 * s->source_v; i++) {
        const double now = surplus_v(s, set_a, speed_rad_s, now_v, current_a);
        if (fabs(now) <= 1e-13 * now_v) {
            return now_v;
        }
        const double slope = (now - before) / (now_v - before_v);
        if (!(slope < -0.5)) {
            break; /* near the most that the battery can give: no place for guesses */
        }
        before_v = now_v;
        before = now;
        now_v -= now / slope;
    }
    return searched_voltage_v(s, set_a, speed_rad_s, current_a);
}

/* An ideal current loop: the set point at once, within the limit and what the voltage can push. */
static void drive_current(const supply *s, const mecanum_inputs *u, const double *speed_rad_s,
                          mecanum_drive *drive) {
    double *const current_a = drive->current_a;
    double set_a[MECANUM_WHEELS];
    double needed_v = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        set_a[i] = clamp(u->wheel_torque_n_m[i] / believed_constant(s->p), -s->p->current_limit_a,
                         s->p->current_limit_a);
        needed_v = fmax(needed_v,
                        fabs(s->p->motor_resistance_ohm * set_a[i] + s->axle_constant[i] * speed_rad_s[i]));
    }
    memcpy(current_a, set_a, sizeof set_a);
    double power = power_w(s, current_a, speed_rad_s);
    double voltage_v = loaded_voltage_v(s, power);
    const bool too_much = 4.0 * s->p->battery_resistance_ohm * power > s->source_v * s->source_v;
    if (needed_v > voltage_v || too_much) {
        voltage_v = pushing_voltage_v(s, set_a, speed_rad_s, voltage_v, current_a);
        power = power_w(s, current_a, speed_rad_s);
    }
    load_battery(s, voltage_v, power, drive);
    drive->lost_w += winding_heat_w(s, current_a);
}

/* The duty switches the battery onto the winding, L di/dt = u - R i - e. At the limit of the current the
 * drive takes from the voltage what would raise it further. */
static void drive_voltage(const supply *s, const mecanum_inputs *u, const mecanum_state *state,
                          const double *speed_rad_s, mecanum_drive *drive) {
    const double *const current_a = state->x + MECANUM_CURRENT_A;
    double battery_a = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        battery_a += u->wheel_duty[i] * current_a[i];
    }
    /* The bridges' diodes keep it from turning round. */
    const double battery_v = fmax(0.0, s->source_v - s->p->battery_resistance_ohm * battery_a);
    const double inductance_h = s->p->motor_inductance_h;
    double power = 0.0;
    bool limited = false;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double drop_v =
            s->p->motor_resistance_ohm * current_a[i] + s->axle_constant[i] * speed_rad_s[i];
        const double pushed_a_s = (u->wheel_duty[i] * battery_v - drop_v) / inductance_h;
        const double rate_a_s =
            clamp(pushed_a_s, MECANUM_LIMITER_RATE_1_S * (-s->p->current_limit_a - current_a[i]),
                  MECANUM_LIMITER_RATE_1_S * (s->p->current_limit_a - current_a[i]));
        limited = limited || rate_a_s != pushed_a_s;
        drive->current_a[i] = current_a[i];
        drive->current_rate_a_s[i] = rate_a_s;
        power += (drop_v + inductance_h * rate_a_s) * current_a[i];
    }
    load_battery(s, limited ? loaded_voltage_v(s, power) : battery_v, power, drive);
    drive->lost_w += winding_heat_w(s, current_a);
}

/* Motors that are disconnected: what current is left dies away through the diodes, into the battery. */
static void drive_nothing(const supply *s, const mecanum_state *state, const double *speed_rad_s,
                          mecanum_drive *drive) {
    double power = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double current_a = state->x[MECANUM_CURRENT_A + i];
        const double drop_v = s->p->motor_resistance_ohm * current_a + s->axle_constant[i] * speed_rad_s[i];
        drive->current_a[i] = current_a;
        drive->current_rate_a_s[i] = -MECANUM_LIMITER_RATE_1_S * current_a;
        power += (drop_v + s->p->motor_inductance_h * drive->current_rate_a_s[i]) * current_a;
    }
    load_battery(s, loaded_voltage_v(s, power), power, drive);
    drive->lost_w += winding_heat_w(s, drive->current_a);
}

void mecanum_drives(const mecanum_model *model, const mecanum_inputs *u, const mecanum_state *state,
                    const double speed_rad_s[MECANUM_WHEELS], mecanum_drive *drive) {
    const mecanum_parameters *const p = model->p;
    const double fallen_v = p->battery_fall_v_c * state->x[MECANUM_CHARGE_C];
    const supply s = {p, model->axle_constant, fmax(0.0, p->battery_voltage_v - fallen_v)};
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        drive->current_rate_a_s[i] = 0.0;
    }
    if (u->drive_enabled < 0.5) {
        drive_nothing(&s, state, speed_rad_s, drive);
    } else if (p->drive == MECANUM_DRIVE_CURRENT) {
        drive_current(&s, u, speed_rad_s, drive);
    } else if (p->drive == MECANUM_DRIVE_VOLTAGE) {
        drive_voltage(&s, u, state, speed_rad_s, drive);
    } else {
        drive_torque(&s, u, speed_rad_s, drive);
        return;
    }
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        drive->torque_n_m[i] = model->axle_constant[i] * drive->current_a[i];
    }
}
