/* A stage: three planar legs that tilt and lift a platform. C99, or C++, with nothing but math.h.

   @ORIGIN@

   `stage_inverse` and `stage_tilt` give the actuators' readings for a normal of the platform and a height,
   `stage_forward` the platform's place for readings, near a known state. Nothing is allocated or kept, and no loop is
   without a bound. A result is written only where the status is STAGE_OK: what was commanded stays as it was.

   Metres and radians. The base's frame {b} has Z upwards, the platform's {p} is level where its axes are those of {b}.
   A reading is the length of an RPS leg, the place of a PRS leg's carriage on its slide, or the angle of an RRS leg's
   crank, 0 outwards and pi/2 upwards, nearest to `middle`. Numbers are float, or double with STAGE_DOUBLE defined. */

#ifndef STAGE_H
#define STAGE_H

#include <math.h>

#ifdef __FAST_MATH__
#error "-ffast-math breaks the checks for NaN and infinity: compile without it"
#endif

enum {
    STAGE_OK = 0,
    STAGE_UNREACHABLE = 1,   /* a ball is out of its leg's reach, or no platform has this normal */
    STAGE_BEYOND_LIMITS = 2, /* a reading is below its minimum or above its maximum */
    STAGE_SINGULAR = 3,      /* beyond a singularity of a leg or platform, or so near, or far, that digits are lost */
    STAGE_UNSAFE = 4,        /* the way from the state `near` is not proved to be regular */
    STAGE_BAD_INPUT = -1     /* no finite numbers, degrees, a zero normal, or a `near` that is no state */
};

enum { STAGE_RPS, STAGE_PRS, STAGE_RRS };

/* A slope is how far a ball moves along its rod per unit of the reading, over the most possible; the amplification is
   how far balls move, over the sides, at a relative error of what places they have in the planes. Within these bounds
   results are right to 1e-5, or 1e-12. */
#ifdef STAGE_DOUBLE
typedef double stage_real;
#define STAGE_R(number) number
#define STAGE_M(function) function
#define STAGE_EPSILON 2.3e-16
#define STAGE_LEAST_SLOPE 1e-3
#define STAGE_MOST_AMPLIFIED 2e3
#define STAGE_ROUNDING @LIMIT_ROUNDING@
#else
typedef float stage_real;
#define STAGE_R(number) number##f
#define STAGE_M(function) function##f
#define STAGE_EPSILON 1.2e-7f
#define STAGE_LEAST_SLOPE 0.1f
#define STAGE_MOST_AMPLIFIED 200.0f
#define STAGE_ROUNDING 1e-6f /* of limits and states `near` */
#endif
#define STAGE_NO_LIMIT ((stage_real)INFINITY)
#define STAGE_TURN STAGE_R(@MOST_TURNED@) /* more is degrees */
#define STAGE_MOST_STEPS 1000 /* of `stage_forward` */

/* A leg moves in a plane, in which x is outwards and z upwards from the pivot. */
typedef struct {
    stage_real pivot[3], outward[3], upward[3]; /* origin, x and z of the plane, in {b} */
    stage_real ball[3];                         /* its centre, in {p} */
    stage_real crank, rod;                      /* lengths: PRS legs have no crank, RPS legs neither */
    stage_real slide[2];                        /* direction of a PRS leg's slide: x and z */
    stage_real sign;                            /* working mode: -1 has the knee outwards, the carriage behind */
    stage_real offset, minimum, maximum;        /* of the reading; STAGE_NO_LIMIT is infinite */
    stage_real middle;                          /* of the limits: a crank's reading is nearest to it */
} stage_leg;

typedef struct {
    int kind;
    stage_real up;          /* 1, or -1 where the platform hangs on its rods */
    stage_real home_height; /* of the level platform with its legs in the middle of their limits */
    stage_leg legs[3];
} stage_geometry;

typedef struct {
    stage_real rotation[9]; /* from {p} to {b}, row by row: the last column is the normal */
    stage_real position[3]; /* of {p}'s origin in {b} */
    stage_real readings[3];
} stage_state;

static const stage_geometry stage_machine = {
@MACHINE@
};

/* The circles in the planes of the legs that readings leave to the balls. */
typedef struct {
    stage_real x[3], z[3], radius[3];
} stage_circles;

/* Three balls on their circles. */
typedef struct {
    stage_real places[6];          /* x and z in the planes */
    stage_real balls[9], moves[9]; /* and how they move as their legs turn outwards */
    stage_real inverse[9];         /* of the derivative of half the squared sides 12, 23, 31 by these turns */
    stage_real norm;               /* of the inverse: the largest sum of a row's magnitudes */
    int is_home;                   /* no singularity is between this and the level platform */
} stage_triangle;

static inline stage_real stage_dot(const stage_real *a, const stage_real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void stage_cross(const stage_real *a, const stage_real *b, stage_real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Write a - b and return its length. */
static inline stage_real stage_minus(const stage_real *a, const stage_real *b, stage_real *c)
{
    int k;
    for (k = 0; k < 3; ++k) {
        c[k] = a[k] - b[k];
    }
    return STAGE_M(sqrt)(stage_dot(c, c));
}

static inline stage_real stage_larger(stage_real a, stage_real b)
{
    return a > b ? a : b;
}

/* Write where the balls of a state are in the planes of their legs. */
static inline void stage_put_places(const stage_geometry *m, const stage_state *s, stage_real *places)
{
    stage_real arm[3];
    int i, k;
    for (i = 0; i < 3; ++i) {
        const stage_leg *leg = &m->legs[i];
        for (k = 0; k < 3; ++k) {
            arm[k] = s->position[k] + stage_dot(s->rotation + 3 * k, leg->ball) - leg->pivot[k];
        }
        places[2 * i] = stage_dot(arm, leg->outward);
        places[2 * i + 1] = stage_dot(arm, leg->upward);
    }
}

/* Write the reading of a leg from its ball's place; return 0 where that is out of reach. */
static inline int stage_put_reading(int kind, const stage_leg *leg, const stage_real *place, stage_real *reading)
{
    stage_real x = place[0], z = place[1], along = 0, beside = x * x + z * z, far = STAGE_M(sqrt)(beside), c, s;
    if (kind == STAGE_PRS) {
        along = leg->slide[0] * z - leg->slide[1] * x;
        beside = (leg->rod - along) * (leg->rod + along);
        along = leg->slide[0] * x + leg->slide[1] * z;
    } else if (kind == STAGE_RRS) {
        along = beside + (leg->crank - leg->rod) * (leg->crank + leg->rod);
        beside = (leg->crank + leg->rod - far) * (leg->crank + leg->rod + far) * (far - leg->crank + leg->rod)
                * (far + leg->crank - leg->rod);
    }
    if (!(beside >= 0)) {
        return 0;
    }
    beside = leg->sign * STAGE_M(sqrt)(beside);
    if (kind == STAGE_RRS) { /* the knee is along and beside the line from pivot to ball */
        c = x * along - z * beside, s = z * along + x * beside;
        along = leg->middle - leg->offset, x = STAGE_M(cos)(along), z = STAGE_M(sin)(along);
        beside = STAGE_M(atan2)(x * s - z * c, x * c + z * s);
    }
    *reading = (kind == STAGE_RPS ? far : along + beside) + leg->offset;
    return 1;
}

static inline void stage_put_circles(const stage_geometry *m, const stage_real *readings, stage_circles *on)
{
    int i;
    for (i = 0; i < 3; ++i) {
        const stage_leg *leg = &m->legs[i];
        stage_real q = readings[i] - leg->offset;
        int turns = m->kind == STAGE_RRS;
        on->x[i] = turns ? leg->crank * STAGE_M(cos)(q) : leg->slide[0] * q;
        on->z[i] = turns ? leg->crank * STAGE_M(sin)(q) : leg->slide[1] * q;
        on->radius[i] = m->kind == STAGE_RPS ? q : leg->rod;
    }
}

/* Write the triangle of balls near these places, which are moved onto the circles. */
static inline void stage_put_triangle(const stage_geometry *m, const stage_circles *on,
        const stage_real *places, stage_triangle *t)
{
    stage_real c[2][3], side[3], determinant; /* (b_i - b_j) . moves_i for the next ball j, and for the last */
    int i, k, negative = 0;
    for (i = 0; i < 3; ++i) {
        const stage_leg *leg = &m->legs[i];
        stage_real x = places[2 * i] - on->x[i], z = places[2 * i + 1] - on->z[i];
        stage_real scale = on->radius[i] / STAGE_M(sqrt)(x * x + z * z);
        x *= scale, z *= scale;
        t->places[2 * i] = on->x[i] + x;
        t->places[2 * i + 1] = on->z[i] + z;
        for (k = 0; k < 3; ++k) {
            t->balls[3 * i + k] = leg->pivot[k] + (on->x[i] + x) * leg->outward[k]
                    + (on->z[i] + z) * leg->upward[k];
            t->moves[3 * i + k] = m->up * (z * leg->outward[k] - x * leg->upward[k]);
        }
    }
    for (i = 0; i < 3; ++i) {
        for (k = 0; k < 2; ++k) {
            stage_minus(t->balls + 3 * i, t->balls + (i + k + 1) % 3 * 3, side);
            c[k][i] = stage_dot(side, t->moves + 3 * i);
            negative += c[k][i] < 0;
        }
    }
    determinant = c[0][0] * c[0][1] * c[0][2] + c[1][0] * c[1][1] * c[1][2];
    for (i = 0; i < 3; ++i) {
        int j = (i + 1) % 3, l = (i + 2) % 3;
        t->inverse[4 * i] = c[0][j] * c[0][l] / determinant;
        t->inverse[3 * j + i] = c[1][l] * c[1][i] / determinant;
        t->inverse[3 * l + i] = -c[0][j] * c[1][i] / determinant;
    }
    for (i = 0, t->norm = 0; i < 9; i += 3) {
        const stage_real *row = t->inverse + i;
        t->norm = stage_larger(t->norm, STAGE_M(fabs)(row[0]) + STAGE_M(fabs)(row[1]) + STAGE_M(fabs)(row[2]));
    }
    t->is_home = determinant > 0 && determinant - determinant == 0 && negative <= 1;
}

/* Write the turns of Newton's step, to be taken off, and return the largest. */
static inline stage_real stage_put_turns(const stage_geometry *m, const stage_real *balls,
        const stage_real *inverse, stage_real *turns)
{
    stage_real errors[3], side[3], length, own, largest = 0;
    int i;
    for (i = 0; i < 3; ++i) {
        length = stage_minus(balls + 3 * i, balls + (i + 1) % 3 * 3, side);
        own = stage_minus(m->legs[i].ball, m->legs[(i + 1) % 3].ball, side);
        errors[i] = (length - own) * (length + own) / 2;
    }
    for (i = 0; i < 3; ++i) {
        turns[i] = stage_dot(inverse + 3 * i, errors);
        largest = stage_larger(largest, STAGE_M(fabs)(turns[i]));
    }
    return largest;
}

/* Newton's method from the balls of a triangle; returns whether it converged. */
static inline int stage_solve(const stage_geometry *m, const stage_circles *on, stage_triangle *t)
{
    stage_real turns[3], size = 1, last;
    int step, i;
    for (step = 0; step < 20 && size > 4 * STAGE_EPSILON; ++step) {
        stage_put_triangle(m, on, t->places, t);
        last = size;
        size = stage_put_turns(m, t->balls, t->inverse, turns);
        if (!(size < 1)) {
            return 0;
        }
        for (i = 0; i < 3; ++i) {
            stage_real x = t->places[2 * i] - on->x[i], z = t->places[2 * i + 1] - on->z[i];
            t->places[2 * i] -= m->up * turns[i] * z;
            t->places[2 * i + 1] += m->up * turns[i] * x;
        }
        /* Only rounding errors are left. */
        if (2 * size > last && step > 2) {
            break;
        }
    }
    stage_put_triangle(m, on, t->places, t);
    return size < STAGE_MOST_AMPLIFIED * 8 * STAGE_EPSILON;
}

/* Return whether one solution is near balls all along a step in which their circles move in straight lines from `start`
   to `end`, by the theorem of Newton and Kantorovich: the norm of the inverse, the Lipschitz constant of the derivative
   and Newton's first step multiply to at most 1/2, with room for what these change on the way. */
static inline int stage_is_safe(const stage_geometry *m, const stage_circles *start, const stage_circles *end,
        const stage_triangle *now)
{
    stage_triangle middle, last;
    stage_circles between;
    stage_real turns[3], side[3], moved = 0, grown = 0, lipschitz = 0, longest = 0, step;
    int i;
    for (i = 0; i < 3; ++i) {
        int j = (i + 1) % 3;
        stage_real a = end->radius[i], b = end->radius[j];
        stage_real x = end->x[i] - start->x[i], z = end->z[i] - start->z[i], radius = a - start->radius[i];
        /* Centres are at most as far apart as both radii and the side of the triangle reach. */
        stage_real reach = stage_minus(m->legs[i].ball, m->legs[j].ball, side) + a + b;
        longest = stage_larger(longest, reach);
        lipschitz = stage_larger(lipschitz, reach * (a + b) + 4 * a * b);
        moved = stage_larger(moved, STAGE_M(sqrt)(x * x + z * z));
        grown = stage_larger(grown, STAGE_M(fabs)(radius));
        between.x[i] = start->x[i] + x / 2;
        between.z[i] = start->z[i] + z / 2;
        between.radius[i] = start->radius[i] + radius / 2;
    }
    moved += grown;
    stage_put_triangle(m, &between, now->places, &middle);
    stage_put_triangle(m, end, now->places, &last);
    step = stage_larger(stage_put_turns(m, last.balls, last.inverse, turns),
            stage_put_turns(m, middle.balls, last.inverse, turns));
    return last.norm * moved * (longest + 2 * moved) * 8 <= 1 && last.norm * lipschitz * step * 8 <= 1;
}

/* Return the status of a state without limits, and write its triangle. */
static inline int stage_check(const stage_geometry *m, const stage_state *s, stage_triangle *t)
{
    stage_circles on;
    stage_real places[6], side[3], longest = 0, above = 0;
    int i;
    stage_put_circles(m, s->readings, &on);
    stage_put_places(m, s, places);
    stage_put_triangle(m, &on, places, t);
    for (i = 0; i < 3; ++i) {
        const stage_leg *leg = &m->legs[i];
        stage_real x = t->places[2 * i], z = t->places[2 * i + 1], slope = 1;
        if (m->kind == STAGE_PRS) {
            slope = -leg->sign * (leg->slide[0] * (x - on.x[i]) + leg->slide[1] * (z - on.z[i])) / leg->rod;
        } else if (m->kind == STAGE_RRS) {
            slope = -leg->sign * (on.x[i] * z - on.z[i] * x) / (leg->crank * leg->rod);
        }
        if (!(slope >= STAGE_LEAST_SLOPE && on.radius[i] > 0)) {
            return STAGE_SINGULAR;
        }
        above += z - on.z[i];
        longest = stage_larger(longest, on.radius[i] * (stage_minus(leg->ball, m->legs[(i + 1) % 3].ball, side)
                + STAGE_M(fabs)(x) + STAGE_M(fabs)(z)));
    }
    return t->is_home && m->up * above > 0 && s->rotation[8] > 0 && t->norm * longest <= STAGE_MOST_AMPLIFIED
            ? STAGE_OK : STAGE_SINGULAR;
}

/* Return 0 where all readings are within their limits, up to rounding, or the number from 1 to 3 of the first beyond. */
static inline int stage_beyond_limits(const stage_geometry *m, const stage_real readings[3])
{
    int i;
    for (i = 0; i < 3; ++i) {
        stage_real low = m->legs[i].minimum, high = m->legs[i].maximum;
        stage_real rounding = STAGE_ROUNDING * stage_larger(low - low == 0 ? STAGE_M(fabs)(low) : 0,
                high - high == 0 ? STAGE_M(fabs)(high) : 0);
        if (!(readings[i] >= low - rounding && readings[i] <= high + rounding)) {
            return i + 1;
        }
    }
    return 0;
}

/* Inverse: write the state in which the platform has a normal, of any length, and its origin a height, in closed form.
   The platform moves aside and turns about its normal as the legs make it. */
static inline int stage_inverse(const stage_geometry *m, const stage_real normal[3], stage_real height,
        stage_state *state)
{
    stage_state s;
    stage_triangle t;
    stage_real turn[3][3], u[3], v[3], weights[3], p[3], q[3], first[3], second[3], rest[3], places[6];
    stage_real x, y, z, a, b, c, square, root;
    int i, k, status;
    for (k = 0, a = height - height; k < 3; ++k) {
        a += STAGE_M(fabs)(normal[k]);
    }
    if (!(a > 0 && a - a == 0)) {
        return STAGE_BAD_INPUT;
    }
    x = normal[0] / a, y = normal[1] / a, z = normal[2] / a; /* first, as squares underflow */
    a = STAGE_M(sqrt)(x * x + y * y + z * z);
    x /= a, y /= a, z /= a;
    if (!(z > 0)) {
        return STAGE_UNREACHABLE;
    }
    /* The turn about a level axis that takes Z to the normal leaves one about the normal, psi, and a shift x, y, in
       which the equations of the three planes are linear: first cos psi + second sin psi + u x + v y = rest. */
    a = 1 / (1 + z);
    turn[0][0] = 1 - a * x * x, turn[0][1] = -a * x * y, turn[0][2] = x;
    turn[1][0] = -a * x * y, turn[1][1] = 1 - a * y * y, turn[1][2] = y;
    turn[2][0] = -x, turn[2][1] = -y, turn[2][2] = z;
    for (i = 0; i < 3; ++i) {
        const stage_leg *leg = &m->legs[i];
        stage_cross(leg->outward, leg->upward, p);
        for (k = 0; k < 3; ++k) {
            q[k] = p[0] * turn[0][k] + p[1] * turn[1][k] + p[2] * turn[2][k];
        }
        first[i] = q[0] * leg->ball[0] + q[1] * leg->ball[1];
        second[i] = q[1] * leg->ball[0] - q[0] * leg->ball[1];
        rest[i] = stage_dot(p, leg->pivot) - q[2] * leg->ball[2] - p[2] * height;
        u[i] = p[0];
        v[i] = p[1];
    }
    stage_cross(u, v, weights); /* under which the shift drops out */
    a = stage_dot(weights, first), b = stage_dot(weights, second), c = stage_dot(weights, rest);
    square = a * a + b * b;
    root = square - c * c;
    if (!(root >= 0 && square > 0)) {
        return STAGE_UNREACHABLE;
    }
    /* Of two solutions the one that turns less. */
    root = b < 0 ? -STAGE_M(sqrt)(root) : STAGE_M(sqrt)(root);
    x = (a * c + b * root) / square;
    y = (b * c - a * root) / square;
    for (i = 0; i < 3; ++i) {
        rest[i] -= first[i] * x + second[i] * y;
        s.rotation[3 * i] = turn[i][0] * x + turn[i][1] * y;
        s.rotation[3 * i + 1] = turn[i][1] * x - turn[i][0] * y;
        s.rotation[3 * i + 2] = turn[i][2];
    }
    stage_cross(v, weights, p);
    stage_cross(weights, u, q);
    square = stage_dot(weights, weights);
    s.position[0] = stage_dot(p, rest) / square;
    s.position[1] = stage_dot(q, rest) / square;
    s.position[2] = height;
    stage_put_places(m, &s, places);
    for (i = 0; i < 3; ++i) {
        if (!stage_put_reading(m->kind, &m->legs[i], places + 2 * i, &s.readings[i])) {
            return STAGE_UNREACHABLE;
        }
    }
    status = stage_check(m, &s, &t);
    if (status == STAGE_OK && stage_beyond_limits(m, s.readings)) {
        status = STAGE_BEYOND_LIMITS;
    }
    if (status == STAGE_OK) {
        *state = s;
    }
    return status;
}

/* The same from a tilt, and its azimuth: where the normal leans to, from X towards Y. */
static inline int stage_tilt(const stage_geometry *m, stage_real tilt, stage_real azimuth, stage_real height,
        stage_state *state)
{
    stage_real normal[3];
    if (STAGE_M(fabs)(tilt) > STAGE_TURN / 2 || STAGE_M(fabs)(azimuth) > STAGE_TURN) {
        return STAGE_BAD_INPUT;
    }
    normal[0] = STAGE_M(sin)(tilt) * STAGE_M(cos)(azimuth);
    normal[1] = STAGE_M(sin)(tilt) * STAGE_M(sin)(azimuth);
    normal[2] = STAGE_M(cos)(tilt);
    return stage_inverse(m, normal, height, state);
}

/* Forward: write the state of readings at the end of the way from a state `near` on which all readings change in
   proportion. For limits see stage_beyond_limits. `near` and `state` may be the same. */
static inline int stage_forward(const stage_geometry *m, const stage_real readings[3], const stage_state *near,
        stage_state *state)
{
    stage_state s;
    stage_triangle t, tried;
    stage_circles start, end;
    stage_real now[3][3], own[3][3], dual[2][3], turns[3], share = 0, after, step, longest = 0;
    int i, k, left = STAGE_MOST_STEPS, status;
    if (stage_check(m, near, &t) != STAGE_OK
            || !(stage_put_turns(m, t.balls, t.inverse, turns) <= STAGE_ROUNDING * 30)) {
        return STAGE_BAD_INPUT;
    }
    for (i = 0; i < 3; ++i) {
        step = STAGE_M(fabs)(readings[i] - near->readings[i]);
        if (!(step - step == 0)
                || (m->kind == STAGE_RRS && STAGE_M(fabs)(readings[i] - m->legs[i].offset) > STAGE_TURN)) {
            return STAGE_BAD_INPUT;
        }
        longest = stage_larger(longest, step);
    }
    /* The arc of a knee is replaced by chords of at most 0.1 rad. */
    longest = m->kind == STAGE_RRS && longest * 10 > 1 ? 1 / (longest * 10) : 1;
    stage_put_circles(m, near->readings, &start);
    for (step = longest; share < 1; step = step < longest ? step : longest) {
        after = share + step < 1 ? share + step : 1;
        for (i = 0; i < 3; ++i) {
            s.readings[i] = after < 1 ? near->readings[i] + after * (readings[i] - near->readings[i]) : readings[i];
        }
        stage_put_circles(m, s.readings, &end);
        tried = t;
        if (stage_is_safe(m, &start, &end, &t) && stage_solve(m, &end, &tried)) {
            t = tried;
            share = after;
            step *= 2;
            start = end;
        } else {
            step /= 2;
        }
        if (--left < 0) {
            return STAGE_UNSAFE;
        }
    }
    /* The rotation takes two sides of the triangle and its normal from {p} to {b}. */
    for (k = 0; k < 2; ++k) {
        stage_minus(m->legs[k + 1].ball, m->legs[0].ball, own[k]);
        stage_minus(t.balls + 3 * k + 3, t.balls, now[k]);
    }
    stage_cross(own[0], own[1], own[2]);
    stage_cross(now[0], now[1], now[2]);
    stage_cross(own[1], own[2], dual[0]);
    stage_cross(own[2], own[0], dual[1]);
    for (k = 0; k < 3; ++k) {
        s.position[k] = (t.balls[k] + t.balls[k + 3] + t.balls[k + 6]) / 3;
        for (i = 0; i < 3; ++i) {
            s.rotation[3 * k + i] = (now[0][k] * dual[0][i] + now[1][k] * dual[1][i] + now[2][k] * own[2][i])
                    / stage_dot(own[2], own[2]);
        }
        for (i = 0; i < 3; ++i) {
            s.position[k] -= stage_dot(s.rotation + 3 * k, m->legs[i].ball) / 3;
        }
    }
    status = stage_check(m, &s, &t);
    if (status == STAGE_OK) {
        *state = s;
    }
    return status;
}

#endif
