/* What the wheels of a robot do, and will do by the time a command acts: their speeds, and how much faster
 * than the floor they turn. For a limiter of torques; no I/O, allocation or static data. Times are [ns] of
 * the robot's clock.
 */
#ifndef WHEEL_MOTION_H
#define WHEEL_MOTION_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* cffi: begin */
enum { WHEEL_MOTION_PAST = 32 }; /* measurements that a range of speeds is made of, at most */
/* Begin with zeros, and set the first ten. The rest is only to be read. Wheels are FL, FR, RR, RL. */
typedef struct {
    double wheel_radius_m;
    double lever_m; /* half the length plus half the width between the wheel centres */
    double ahead_s; /* from a measurement to the next one, plus lag_s */
    double lag_s;   /* of a measured speed: two filters in a row, each of half of it */
    double older_s; /* by which the oldest of the four speeds may be older than the twist; 0 if all are of its
                       time */
    double still_rad_s; /* while no wheel is faster, only speeds are noted, and nothing is near */
    double most_rad_s;  /* the greatest speed, now or when a command acts, that is not near a limit */
    double
        most_slip_rad_s; /* the same of slip; infinity if it does not matter, which is then not worked out */
    double blind_rad_s;  /* what a coarse encoder may add to a speed, less what is tolerated; 0 or less */
    double blind_rad_s_a_step; /* the same of the difference of two speeds: so much of a change is not seen */
    bool is_near;              /* set while something has to be looked at whatever the wheels do */
    bool has_speed;
    bool has_slip;
    int64_t time_ns; /* of the newest measurement */
    int64_t slip_ns; /* of the newest one that slip was worked out of */
    double steps;    /* until a command acts, of the time between the last two; 0 if that says nothing */
    double speed_rad_s[4];                   /* as measured */
    double coming_rad_s[4];                  /* the same when a command acts */
    double rolling_rad_s[4];                 /* of wheels that roll, behind the first filter */
    double lagging_rad_s[4];                 /* the same behind the second */
    double past_rad_s[WHEEL_MOTION_PAST][4]; /* the newest lagging_rad_s, in turn */
    int64_t past_ns[WHEEL_MOTION_PAST];      /* the time of the twist of each */
    unsigned newest;                         /* which one is that */
    unsigned count;                          /* how many there are */
    double slip_rad_s[4]; /* how far speed_rad_s is from what a wheel that rolls may have */
    double coming_slip_rad_s[4];
} wheel_motion;

/* Takes the wheel speeds measured at `time_ns`, and the estimate of twist (vx, vy [m/s] in the world frame,
 * yaw rate [rad/s]) and heading [rad] `older_s` later. `latency_s` is from the measurement to the effect of a
 * command. A wheel that rolls has lagging_rad_s. With an `older_s`, each speed is of some time since, or up
 * to `lag_s` before, for what the wire and a maker's filter add: it slips only beyond all that lagging_rad_s
 * was in that time, and the twist's own speed. Returns false while no wheel is faster than `still_rad_s`, or
 * if a speed is not finite. Else returns whether `is_near` is set, or a wheel's speed is above `most_rad_s`
 * or its slip above `most_slip_rad_s`, or will be `ahead_s + latency_s` later if it goes on to change as it
 * did since the last measurement. What falls counts as constant: a wheel that slows down is near its limit
 * until it is below it.
 */
bool wheel_motion_add(wheel_motion *motion, const double speed_rad_s[4], int64_t time_ns,
                      const double twist[3], double heading_rad, double latency_s);
/* cffi: end */

#ifdef __cplusplus
}
#endif

#endif
