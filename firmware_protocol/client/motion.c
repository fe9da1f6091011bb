/* What the wheels of a robot do, and will do by the time a command acts. */
#include "wheel_motion.h"

#include <math.h>
#include <string.h>

#define OLD_S 0.05 /* speeds further apart than this say nothing of the acceleration now */

/* What a value will be after so many steps like the last one, but never nearer to zero than it is now: a
 * wheel that was let go slows down fast, and would spin again with all of its torque. Of what the steps add,
 * a part of the size `blind` may be made by the encoder alone, and does not count. */
static double coming(double now, double before, double steps, double blind) {
    const double added = steps * (now - before);
    if (!(steps > 0.0 && (now - before) * now > 0.0) || fabs(added) <= blind) {
        return now;
    }
    return now + (blind > 0.0 ? added - copysign(blind, added) : added);
}

/* Whether every value is from -limit to limit; NaN is not. */
static bool are_within(const double four[4], double limit) {
    bool result = true;
    for (unsigned i = 0; i < 4u; i++) {
        result = result && fabs(four[i]) <= limit;
    }
    return result;
}

/* The speeds of wheels that roll: H Rᵀ twist / r. */
static void roll(const wheel_motion *motion, const double twist[3], double heading_rad,
                 double rolling_rad_s[4]) {
    const double c = cos(heading_rad);
    const double s = sin(heading_rad);
    const double forward = c * twist[0] + s * twist[1];
    const double left = c * twist[1] - s * twist[0];
    const double turn = motion->lever_m * twist[2];
    rolling_rad_s[0] = (forward - left - turn) / motion->wheel_radius_m;
    rolling_rad_s[1] = (forward + left + turn) / motion->wheel_radius_m;
    rolling_rad_s[2] = (forward - left + turn) / motion->wheel_radius_m;
    rolling_rad_s[3] = (forward + left - turn) / motion->wheel_radius_m;
}

/* Notes lagging_rad_s, of a twist at `twist_ns`. */
static void note_past(wheel_motion *m, int64_t twist_ns) {
    m->newest = (m->newest + 1u) % WHEEL_MOTION_PAST;
    memcpy(m->past_rad_s[m->newest], m->lagging_rad_s, sizeof m->lagging_rad_s);
    m->past_ns[m->newest] = twist_ns;
    if (m->count < WHEEL_MOTION_PAST) {
        m->count++;
    }
}

/* How far the speed of a wheel is from all that it may have had since `older_s`, if it rolls at `now_rad_s`.
 */
static double beyond(const wheel_motion *m, unsigned wheel, double now_rad_s, int64_t twist_ns) {
    double low = fmin(m->lagging_rad_s[wheel], now_rad_s);
    double high = fmax(m->lagging_rad_s[wheel], now_rad_s);
    bool reaches_back = false;
    for (unsigned back = 0; back < m->count && !reaches_back; back++) {
        const unsigned at = (m->newest + WHEEL_MOTION_PAST - back) % WHEEL_MOTION_PAST;
        low = fmin(low, m->past_rad_s[at][wheel]);
        high = fmax(high, m->past_rad_s[at][wheel]);
        /* The first one that is older still counts: the speed may be of a time in between. */
        reaches_back = (double)(twist_ns - m->past_ns[at]) * 1e-9 >= m->older_s + m->lag_s;
    }
    if (!reaches_back) {
        low = fmin(low, 0.0); /* a wheel of which nothing is noted stood still */
        high = fmax(high, 0.0);
    }
    const double speed_rad_s = m->speed_rad_s[wheel];
    return speed_rad_s > high ? speed_rad_s - high : speed_rad_s < low ? speed_rad_s - low : 0.0;
}

/* Works out slip. `before_ns` is the time of the measurement before. */
static void add_slip(wheel_motion *m, const double twist[3], double heading_rad, int64_t before_ns,
                     double blind) {
    double now_rad_s[4];
    roll(m, twist, heading_rad, now_rad_s);
    const bool was_reset = m->time_ns < before_ns;
    const bool goes_on = !was_reset && m->has_slip && m->slip_ns == before_ns;
    /* The measured speeds lag behind by two filters in a row, so what they are compared with must do so too.
     */
    const double follows = goes_on ? -expm1(-2e-9 * (double)(m->time_ns - before_ns) / m->lag_s) : 1.0;
    const bool is_old = m->older_s > 0.0;
    const int64_t twist_ns = m->time_ns + (is_old ? (int64_t)(m->older_s * 1e9) : 0);
    if (!goes_on) {
        m->count = 0;
    }
    for (unsigned i = 0; i < 4u; i++) {
        if (goes_on) {
            m->rolling_rad_s[i] += follows * (now_rad_s[i] - m->rolling_rad_s[i]);
            m->lagging_rad_s[i] += follows * (m->rolling_rad_s[i] - m->lagging_rad_s[i]);
        } else {
            /* The filters of a robot that was reset begin at rest, whatever its wheels do, and so must these.
             */
            m->rolling_rad_s[i] = m->lagging_rad_s[i] = was_reset ? m->speed_rad_s[i] : now_rad_s[i];
        }
        const double slip =
            is_old ? beyond(m, i, now_rad_s[i], twist_ns) : m->speed_rad_s[i] - m->lagging_rad_s[i];
        m->coming_slip_rad_s[i] = goes_on && !is_old ? coming(slip, m->slip_rad_s[i], m->steps, blind) : slip;
        m->slip_rad_s[i] = slip;
    }
    note_past(m, twist_ns);
    m->has_slip = true;
    m->slip_ns = m->time_ns;
}

bool wheel_motion_add(wheel_motion *m, const double speed_rad_s[4], int64_t time_ns, const double twist[3],
                      double heading_rad, double latency_s) {
    const int64_t before_ns = m->time_ns;
    const double apart_s = (double)(time_ns - before_ns) * 1e-9;
    double before_rad_s[4];
    memcpy(before_rad_s, m->speed_rad_s, sizeof before_rad_s);
    m->steps = m->has_speed && apart_s > 0.0 && apart_s < OLD_S ? (m->ahead_s + latency_s) / apart_s : 0.0;
    memcpy(m->speed_rad_s, speed_rad_s, sizeof m->speed_rad_s);
    m->time_ns = time_ns;
    m->has_speed = isfinite(speed_rad_s[0] + speed_rad_s[1] + speed_rad_s[2] + speed_rad_s[3]);
    if (!m->has_speed || are_within(speed_rad_s, m->still_rad_s)) {
        return false;
    }
    const double blind = fmax(m->blind_rad_s + m->steps * m->blind_rad_s_a_step, 0.0);
    for (unsigned i = 0; i < 4u; i++) {
        m->coming_rad_s[i] = coming(speed_rad_s[i], before_rad_s[i], m->steps, blind);
    }
    bool slips = false;
    if (isfinite(m->most_slip_rad_s)) {
        add_slip(m, twist, heading_rad, before_ns, blind);
        slips = !are_within(m->coming_slip_rad_s, m->most_slip_rad_s);
    }
    return slips || m->is_near || !are_within(m->coming_rad_s, m->most_rad_s);
}
