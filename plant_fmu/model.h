/* What the files of the plant share: constants that follow from the parameters, and the parts of one
 * evaluation.
 *
 * model.c     constants, and the forces that are not the wheels'
 * motor.c     motors and battery
 * contact.c   rollers that do not slip, and rollers that do
 * tip.c       how near the robot is to tipping over
 * friction.c  which wheels stand still, and the steps up to where one comes to rest
 * mecanum.c   start, derivative, integrator, outputs */
#ifndef MECANUM_MODEL_H
#define MECANUM_MODEL_H

#include "hidden.h"
#include "mecanum.h"

HIDDEN_BEGIN

/* How fast a drive's current limiter regulates. */
#define MECANUM_LIMITER_RATE_1_S 4000.0
/* Rolling resistance changes its sign over this speed across a roller's axis. */
#define MECANUM_RESISTANCE_SPEED_M_S 0.01

typedef struct {
    double at[3][3];
} mecanum_matrix;

struct mecanum_model {
    const mecanum_parameters *p;
    double wheel_x_m[MECANUM_WHEELS]; /* where the wheels stand, body frame */
    double wheel_y_m[MECANUM_WHEELS];
    double radius_m[MECANUM_WHEELS];
    double roller_slant[MECANUM_WHEELS]; /* s: the lower roller's axis is c (1, s), of length 1 */
    double roller_cosine;                /* c */
    double rolling[MECANUM_WHEELS][3];   /* wheel speed of a wheel that does not slip = this row x body twist;
                                            0 for a lifted one */
    bool lifted[MECANUM_WHEELS];         /* off the ground, a block in its place */
    bool hangs[MECANUM_WHEELS];          /* the same without a block: the other wheels carry its load */
    bool any_hangs;
    bool any_lifted;
    bool is_uneven; /* the wheels' radii differ from the nominal one, or the rollers' angle from 45 degrees */
    bool is_held;   /* all are lifted: the body stands on blocks */
    double wheel_inertia_kg_m2; /* of a wheel with its rotor */
    double carried_kg;    /* what the turning wheels add to the mass, k = 4 J / r^2; 0 with slip contact */
    double turning_kg_m2; /* yaw inertia about the robot's centre, with what the turning wheels add */
    mecanum_matrix inverse_mass;
    double coriolis_kg;        /* mass in the forces of the turning frame; 0 with the paper's term C */
    double gravity_in_plane_n; /* of the whole weight */
    double gravity_upright_n;
    double load_n[MECANUM_WHEELS];       /* at rest on level ground, for the friction; never negative */
    double friction_n_m[MECANUM_WHEELS]; /* Coulomb's, at each axle */
    double viscous_n_m_s_rad[MECANUM_WHEELS];
    double axle_constant[MECANUM_WHEELS]; /* of motor and gear, N m / A and V s / rad */
    bool has_friction;
};

/* What the drives do in one state. */
typedef struct {
    double torque_n_m[MECANUM_WHEELS]; /* at the axle */
    double current_a[MECANUM_WHEELS];
    double current_rate_a_s[MECANUM_WHEELS];
    double battery_v;
    double battery_a;
    double supplied_w;
    double lost_w;
} mecanum_drive;

/* What the ground does in one state; slip contact alone. */
typedef struct {
    double force_x_n[MECANUM_WHEELS]; /* on the robot, body frame */
    double force_y_n[MECANUM_WHEELS];
    double load_n[MECANUM_WHEELS];
    double slip_m_s[MECANUM_WHEELS];
    double deflection_rate_m_s[MECANUM_WHEELS];
    double lost_w;
} mecanum_contact;

/* What the friction does during a step: against the speed of a wheel that turns, and as much as it takes, but
 * not more than it can, for one that stands still. */
typedef struct {
    double sign[MECANUM_WHEELS]; /* of the speed; 0 at rest */
    bool at_rest[MECANUM_WHEELS];
    bool any_at_rest;
    mecanum_matrix projector; /* rigid: takes from a body acceleration what would turn wheels at rest */
} mecanum_modes;

/* model.c */

void mecanum_prepare(mecanum_model *model, const mecanum_parameters *p);

/* Loads of four equally stiff wheels that carry the weight with these first moments about the centre, along x
 * and y. A wheel that would lift carries nothing; what would tip over stands on the wheels that are left. */
void mecanum_share_load(const mecanum_model *model, double pitch_n_m, double roll_n_m,
                        double load_n[MECANUM_WHEELS]);

void mecanum_wheel_speeds(const mecanum_model *model, const mecanum_state *state,
                          double speed_rad_s[MECANUM_WHEELS]);

/* Force and moment, body frame, of all but wheels and ground: the push, gravity, the turning of the frame. */
void mecanum_body_force(const mecanum_model *model, const mecanum_inputs *u, const mecanum_state *state,
                        double force[3]);

/* result = matrix x vector */
void mecanum_apply(const mecanum_matrix *matrix, const double vector[3], double result[3]);

/* motor.c */

void mecanum_drives(const mecanum_model *model, const mecanum_inputs *u, const mecanum_state *state,
                    const double speed_rad_s[MECANUM_WHEELS], mecanum_drive *drive);

/* contact.c */

/* Body acceleration of the robot whose wheels do not slip, from the torques at the wheels. */
void mecanum_rigid_acceleration(const mecanum_model *model, const double body_force[3],
                                const double torque_n_m[MECANUM_WHEELS], double acceleration[3]);

/* Forces of the ground on wheels that slip; a wheel at rest is held by as much torque as it takes. */
void mecanum_ground(const mecanum_model *model, const mecanum_modes *modes, const mecanum_state *state,
                    const double torque_n_m[MECANUM_WHEELS], mecanum_contact *contact);

/* Body acceleration of the robot on these forces. */
void mecanum_slip_acceleration(const mecanum_model *model, const double body_force[3],
                               const mecanum_contact *contact, double acceleration[3]);

/* tip.c */

/* What of a state decides whether the robot tips: body twist, and the wheels' angular momentum. */
typedef struct {
    double twist[3];
    double spin_n_m_s;
} mecanum_motion;

mecanum_motion mecanum_motion_of(const mecanum_model *model, const mecanum_state *state);

/* Lets the robot tip or come back during a step, from the mean of the accelerations: `before` is its motion
 * at the beginning, `state` its state at the end. With a step of 0 s only the margin is written, as it is
 * without acceleration. */
void mecanum_tip(const mecanum_model *model, const mecanum_inputs *u, const mecanum_motion *before,
                 double step_s, mecanum_state *state);

/* friction.c */

/* Decides which wheels stand still, and makes those stand exactly still. */
void mecanum_settle(const mecanum_model *model, const mecanum_inputs *u, mecanum_state *state,
                    mecanum_modes *modes);

/* One internal step, interrupted at each instant where a wheel comes to rest. */
void mecanum_step(const mecanum_model *model, const mecanum_inputs *u, double step_s, mecanum_state *state);

/* mecanum.c */

/* Writes the time derivative of the state, and the body acceleration that is part of it. */
void mecanum_derivative(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                        const mecanum_state *state, mecanum_state *derivative);

/* One step of the classical Runge-Kutta method of fourth order, with fixed modes. */
void mecanum_integrate(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                       double step_s, mecanum_state *state);

HIDDEN_END

#endif
