#include "robot.h"

#include <stdio.h>

static const double GRAVITY_M_S2 = 9.81;
static const double TWO_PI = 6.283185307179586476925286766559;
static const double UPRIGHT[4] = {1.0, 0.0, 0.0, 0.0};
static const double ALONG_AXLE[4] = {0.70710678118654752440084436210485, 0.70710678118654752440084436210485,
                                     0.0, 0.0};
static const char *const NAMES[MECANUM_WHEELS] = {"fl", "fr", "rr", "rl"};
static const double AHEAD[MECANUM_WHEELS] = {1.0, 1.0, -1.0, -1.0};
static const double LEFT[MECANUM_WHEELS] = {1.0, -1.0, -1.0, 1.0};

/* Square of the cosine of the angle at which the rollers stand to straight ahead: 45 degrees, or where they
 * lose way sideways more. */
static double cosine_squared(const mecanum_parameters *p) {
    const double slant = 1.0 / (1.0 - p->sideways_loss);
    return 1.0 / (1.0 + slant * slant);
}

static double wheel_radius_m(const mecanum_parameters *p, int wheel) {
    return p->wheel_radius_m * p->wheel_radius_factor[wheel];
}

/* Added to the body's six inertias where it stands on blocks [kg, kg m2]: no wheel's torque moves it then.
 * With far more the solver, whose tolerance follows the mean inertia, no longer lets a wheel stick. */
static const double HELD_BY = 1e4;

static const mjtSize ARENA_BYTES = 1 << 20; /* what MuJoCo works in */

/* Where the wheel's inertia sits: in part in its rollers, which have to have some. Hub and rollers together
 * weigh little, because the paper's yaw inertia leaves no room for heavy wheels. */
static const double ROLLERS_SHARE = 0.05;
static const double ROLLER_RADIUS_RATIO = 0.2;

/* An ellipsoid of revolution whose axis lies across the wheel's radius. */
typedef struct {
    double ring_m;   /* the axle to the roller's centre */
    double radius_m; /* across its axis */
    double half_m;   /* along its axis */
    double mass_kg;
    double axial_kg_m2;
    double across_kg_m2;
} roller;

typedef struct {
    roller roller;
    double hub_mass_kg;
    double hub_axial_kg_m2;
    double hub_across_kg_m2;
    double chassis_mass_kg;
    double chassis_com_m[3]; /* from the robot's centre at the height of the axles */
    double chassis_yaw_kg_m2;
} masses;

/* The roller whose lowest point is as low in the middle of its turn as where the next one takes over. With
 * the axle above the ground by h, at the angle f from there: h = ring cos f + sqrt(radius^2 + (half^2 -
 * radius^2) sin^2 f c), with c the squared cosine of the roller's axis to the wheel's plane. In between it is
 * lower by 0.06 % of the wheel's radius. */
static roller roller_shape(const mecanum_parameters *p, double wheel_m) {
    const double radius = ROLLER_RADIUS_RATIO * wheel_m;
    const double ring = wheel_m - radius;
    const double over = TWO_PI / (2.0 * ROLLERS);
    const double there = wheel_m - ring * cos(over);
    const double part = sin(over) * sin(over) * cosine_squared(p);
    const double half_squared = radius * radius + (there * there - radius * radius) / part;
    return (roller){.ring_m = ring, .radius_m = radius, .half_m = sqrt(half_squared)};
}

/* Shares out masses and inertias so that the whole is what the parameters say. */
static bool shared_out(const mecanum_parameters *p, masses *to, char *problem, size_t size) {
    const double along = 1.0 - cosine_squared(p); /* of a roller's axis with the axle */
    roller r = roller_shape(p, p->wheel_radius_m);
    /* Of a roller that weighs 1 kg. */
    const double axial = 0.4 * r.radius_m * r.radius_m;
    const double across = 0.2 * (r.radius_m * r.radius_m + r.half_m * r.half_m);
    const double about_axle = r.ring_m * r.ring_m + along * axial + (1.0 - along) * across;
    r.mass_kg = ROLLERS_SHARE * p->wheel_inertia_kg_m2 / (ROLLERS * about_axle);
    r.axial_kg_m2 = axial * r.mass_kg;
    r.across_kg_m2 = across * r.mass_kg;
    to->roller = r;
    to->hub_mass_kg = ROLLERS * r.mass_kg;
    to->hub_axial_kg_m2 = (1.0 - ROLLERS_SHARE) * p->wheel_inertia_kg_m2;
    to->hub_across_kg_m2 = 0.6 * to->hub_axial_kg_m2; /* a disc's is half, and more with its width */

    const double wheel_mass = to->hub_mass_kg + ROLLERS * r.mass_kg;
    to->chassis_mass_kg = p->mass_kg - MECANUM_WHEELS * wheel_mass;
    if (!(to->chassis_mass_kg > 0.5 * p->mass_kg)) {
        snprintf(
            problem, size,
            "mass_kg = %.10g; wheels of this inertia and radius weigh %.3g already, expected a robot that "
            "weighs at least twice that",
            p->mass_kg, MECANUM_WHEELS * wheel_mass);
        return false;
    }
    const double ratio = p->mass_kg / to->chassis_mass_kg;
    to->chassis_com_m[0] = ratio * p->com_x_m;
    to->chassis_com_m[1] = ratio * p->com_y_m;
    to->chassis_com_m[2] = ratio * (p->com_height_m - p->wheel_radius_m);

    /* About the upright through its centre a ring of rollers has half of what its trace leaves. */
    const double trace = axial + 2.0 * across + 2.0 * r.ring_m * r.ring_m;
    const double wheel_yaw = to->hub_across_kg_m2 + ROLLERS * r.mass_kg * 0.5 * (trace - about_axle);
    const double com2 = p->com_x_m * p->com_x_m + p->com_y_m * p->com_y_m;
    const double arm2 = p->half_length_m * p->half_length_m + p->half_width_m * p->half_width_m;
    const double wheels_yaw = MECANUM_WHEELS * (wheel_yaw + wheel_mass * (arm2 + com2));
    const double offset2 = (ratio - 1.0) * (ratio - 1.0) * com2;
    const double others = wheels_yaw + to->chassis_mass_kg * offset2;
    to->chassis_yaw_kg_m2 = p->inertia_kg_m2 - others;
    if (!(to->chassis_yaw_kg_m2 > 0.0)) {
        snprintf(problem, size,
                 "inertia_kg_m2 = %.10g; the wheels where they are have %.3g already, expected more",
                 p->inertia_kg_m2, others);
        return false;
    }
    return true;
}

/* Axis of the roller on the ground, body frame: seen from below, X and O are each other's picture. */
static void ground_axis(const mecanum_parameters *p, int wheel, double axis[3]) {
    const double x_sign = p->rollers == MECANUM_ROLLERS_X ? -1.0 : 1.0;
    axis[0] = sqrt(cosine_squared(p));
    axis[1] = x_sign * AHEAD[wheel] * LEFT[wheel] * sqrt(1.0 - cosine_squared(p));
    axis[2] = 0.0;
}

static void set_options(mjSpec *spec, const mecanum_parameters *p) {
    mjOption *const option = &spec->option;
    const double down = GRAVITY_M_S2 * sin(p->slope_rad);
    option->gravity[0] = -down * cos(p->slope_direction_rad);
    option->gravity[1] = -down * sin(p->slope_direction_rad);
    option->gravity[2] = -GRAVITY_M_S2 * cos(p->slope_rad);
    option->timestep = p->longest_step_s;
    option->integrator = mjINT_IMPLICITFAST;
    option->solver = mjSOL_NEWTON;
    option->cone = mjCONE_ELLIPTIC; /* a pyramid's slip begins elsewhere */
    option->impratio = 10.0;        /* less creep while a contact sticks */
    /* A robot that was thrown out of its range stops with an error; it does not start anew by itself. */
    option->disableflags |= mjDSBL_AUTORESET;
    option->disableflags |= mjDSBL_ISLAND;
    option->jacobian = mjJAC_SPARSE; /* with the line above 40 % faster, the same numbers */
    spec->compiler.inertiafromgeom = mjINERTIAFROMGEOM_FALSE;
    spec->memory = ARENA_BYTES;
}

static void add_ground(mjSpec *spec) {
    mjsGeom *const ground = mjs_addGeom(mjs_findBody(spec, "world"), NULL);
    ground->type = mjGEOM_PLANE;
    ground->size[0] = ground->size[1] = 10.0; /* what a viewer shows; the plane has no end */
    ground->size[2] = 1.0;
    ground->contype = 1;
    ground->conaffinity = 0;
    ground->condim = 3;
}

/* A shape for the eye alone. */
static mjsGeom *add_picture(mjsBody *body, mjtGeom type, double x, double y, double z) {
    mjsGeom *const geom = mjs_addGeom(body, NULL);
    geom->type = type;
    geom->size[0] = x;
    geom->size[1] = y;
    geom->size[2] = z;
    geom->contype = geom->conaffinity = 0;
    geom->group = 1;
    return geom;
}

/* Gives a body its inertia, so that MuJoCo infers nothing from its shapes, about
 * its origin. The third of the principal axes is the one that `along` turns z to. */
static void set_inertia(mjsBody *body, double mass_kg, double across_kg_m2, double axial_kg_m2,
                        const double along[4]) {
    body->explicitinertial = true;
    body->mass = mass_kg;
    body->inertia[0] = body->inertia[1] = across_kg_m2;
    body->inertia[2] = axial_kg_m2;
    mju_zero3(body->ipos);
    mju_copy4(body->iquat, along);
}

static mjsBody *add_chassis(mjSpec *spec, const mecanum_parameters *p, const masses *m) {
    mjsBody *const chassis = mjs_addBody(mjs_findBody(spec, "world"), NULL);
    mjs_setName(chassis->element, "chassis");
    mjsJoint *const joint = mjs_addFreeJoint(chassis);
    joint->armature = is_held(p) ? HELD_BY : 0.0;
    chassis->pos[2] = p->wheel_radius_m;
    /* Pitch and roll are no parameters: those of a flat box, a little more than half its yaw inertia. */
    set_inertia(chassis, m->chassis_mass_kg, 0.6 * m->chassis_yaw_kg_m2, m->chassis_yaw_kg_m2, UPRIGHT);
    mju_copy3(chassis->ipos, m->chassis_com_m);
    mjsSite *const centre = mjs_addSite(chassis, NULL);
    mjs_setName(centre->element, "centre");
    add_picture(chassis, mjGEOM_BOX, p->half_length_m, 0.7 * p->half_width_m, 0.5 * p->wheel_radius_m);
    return chassis;
}

static void add_roller(mjsBody *wheel, const mecanum_parameters *p, const roller *r, int place, int number) {
    const double angle =
        TWO_PI * number / ROLLERS; /* how far the wheel has turned when it is on the ground */
    mjsBody *const body = mjs_addBody(wheel, NULL);
    body->pos[0] = r->ring_m * sin(angle);
    body->pos[1] = 0.0;
    body->pos[2] = -r->ring_m * cos(angle);
    body->quat[0] = cos(-angle / 2.0); /* about the axle: -angle brings it there, angle back */
    body->quat[2] = sin(-angle / 2.0);

    double axis[3];
    double along[4]; /* from z to the axis */
    ground_axis(p, place, axis);
    mju_quatZ2Vec(along, axis);
    set_inertia(body, r->mass_kg, r->across_kg_m2, r->axial_kg_m2, along);

    mjsJoint *const joint = mjs_addJoint(body, NULL);
    joint->type = mjJNT_HINGE;
    mju_copy3(joint->axis, axis);

    mjsGeom *const geom = mjs_addGeom(body, NULL);
    geom->type = mjGEOM_ELLIPSOID;
    geom->size[0] = geom->size[1] = r->radius_m;
    geom->size[2] = r->half_m;
    mju_copy4(geom->quat, along);
    geom->contype = 0;
    geom->conaffinity = is_lifted(p, place) ? 0 : 1;
    geom->condim = 3;
    geom->priority = 1; /* the roller's friction counts, not the larger of its and the ground's */
    geom->friction[0] = p->grip_coefficient * p->wheel_grip_factor[place];
    geom->solref[0] = 0.005; /* time constant of a contact [s]: the stiffness */
}

/* The block in the place of a lifted wheel: it carries the corner, and slides along the ground without
 * friction. */
static void add_block(mjsBody *chassis, const mecanum_parameters *p, int place) {
    mjsGeom *const geom = add_picture(chassis, mjGEOM_SPHERE, p->wheel_radius_m, 0.0, 0.0);
    geom->pos[0] = AHEAD[place] * p->half_length_m;
    geom->pos[1] = LEFT[place] * p->half_width_m;
    geom->conaffinity = 1;
    geom->condim = 1;
    geom->priority = 1;
    geom->solref[0] = 0.005;
}

/* A wheel of another radius than the nominal one has its axle higher or lower, so that the robot stands
 * level; its rollers weigh as much. */
static void add_wheel(mjSpec *spec, mjsBody *chassis, const mecanum_parameters *p, const masses *m,
                      int place) {
    mjsBody *const wheel = mjs_addBody(chassis, NULL);
    const double radius_m = wheel_radius_m(p, place);
    roller shape = roller_shape(p, radius_m);
    shape.mass_kg = m->roller.mass_kg;
    shape.axial_kg_m2 = m->roller.axial_kg_m2;
    shape.across_kg_m2 = m->roller.across_kg_m2;
    mjs_setName(wheel->element, NAMES[place]);
    wheel->pos[0] = AHEAD[place] * p->half_length_m;
    wheel->pos[1] = LEFT[place] * p->half_width_m;
    wheel->pos[2] = radius_m - p->wheel_radius_m;
    set_inertia(wheel, m->hub_mass_kg, m->hub_across_kg_m2, m->hub_axial_kg_m2, ALONG_AXLE);

    mjsJoint *const axle = mjs_addJoint(wheel, NULL);
    mjs_setName(axle->element, NAMES[place]);
    axle->type = mjJNT_HINGE;
    axle->axis[0] = axle->axis[2] = 0.0;
    axle->axis[1] = 1.0; /* forward is positive */
    axle->damping[0] = p->viscous_n_m_s_rad * p->wheel_friction_factor[place];
    axle->frictionloss =
        p->friction_coefficient * p->mass_kg * GRAVITY_M_S2 * cos(p->slope_rad) * radius_m / MECANUM_WHEELS;
    axle->frictionloss *= p->wheel_friction_factor[place];

    /* Ten times stiffer than usual: on a slope a robot that sticks creeps by less than 0.1 mm/s. */
    axle->solref_friction[0] = 0.005;
    axle->solimp_friction[0] = axle->solimp_friction[1] = 0.99;

    mjsActuator *const motor = mjs_addActuator(spec, NULL);
    mjs_setName(motor->element, NAMES[place]);
    mjs_setToMotor(motor);
    motor->trntype = mjTRN_JOINT;
    mjs_setString(motor->target, NAMES[place]);

    mjsGeom *const hub = add_picture(wheel, mjGEOM_CYLINDER, 0.9 * shape.ring_m, 0.5 * shape.half_m, 0.0);
    mju_copy4(hub->quat, ALONG_AXLE);
    for (int number = 0; number < ROLLERS; number++) {
        add_roller(wheel, p, &shape, place, number);
    }
}

mjSpec *robot_specification(const mecanum_parameters *p, char *problem, size_t size) {
    masses m;
    if (!shared_out(p, &m, problem, size)) {
        return NULL;
    }
    mjSpec *const spec = mj_makeSpec();
    mjs_setString(spec->modelname, MECANUM_MODEL_NAME);
    set_options(spec, p);
    add_ground(spec);
    mjsBody *const chassis = add_chassis(spec, p, &m);
    for (int place = 0; place < MECANUM_WHEELS; place++) {
        add_wheel(spec, chassis, p, &m, place);
        /* A body that nothing moves needs no blocks, and their contacts would shake it. */
        if (is_lifted(p, place) && !is_held(p)) {
            add_block(chassis, p, place);
        }
    }
    mjsSensor *const accelerometer = mjs_addSensor(spec);
    accelerometer->type = mjSENS_ACCELEROMETER;
    accelerometer->objtype = mjOBJ_SITE;
    mjs_setString(accelerometer->objname, "centre");
    return spec;
}

void robot_rolling(const mecanum_parameters *p, double velocity[VELOCITIES]) {
    const double cos_heading = cos(p->start_heading_rad);
    const double sin_heading = sin(p->start_heading_rad);
    const double forward = cos_heading * p->start_vx_m_s + sin_heading * p->start_vy_m_s;
    const double left = -sin_heading * p->start_vx_m_s + cos_heading * p->start_vy_m_s;
    const double yaw_rate = p->start_yaw_rate_rad_s;
    mju_zero(velocity, VELOCITIES);
    velocity[0] = p->start_vx_m_s;
    velocity[1] = p->start_vy_m_s;
    velocity[5] = yaw_rate;
    for (int place = 0; place < MECANUM_WHEELS; place++) {
        const double radius_m = wheel_radius_m(p, place);
        const roller r = roller_shape(p, radius_m);
        double axis[3];
        ground_axis(p, place, axis);
        /* The hub's velocity; less the wheel's speed times its radius it has no part along the roller's axis,
         * and the roller's own spin takes up what it has across. */
        const double hub[2] = {forward - yaw_rate * LEFT[place] * p->half_width_m,
                               left + yaw_rate * AHEAD[place] * p->half_length_m};
        const double rolled = (axis[0] * hub[0] + axis[1] * hub[1]) / axis[0];
        const double spin = (axis[1] * (hub[0] - rolled) - axis[0] * hub[1]) / r.radius_m;
        double *const wheel = velocity + wheel_velocity(place);
        wheel[0] = rolled / radius_m;
        for (int number = 1; number <= ROLLERS; number++) {
            wheel[number] = spin;
        }
    }
}
