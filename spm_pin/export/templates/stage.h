/* A stage: three planar legs that tilt and lift a platform. C99, or C++, with nothing but math.h.

   {{origin}}

   `{{prefix}}inverse` and `{{prefix}}tilt` give the actuators' readings for a normal of the platform and a height,
   `{{prefix}}forward` the platform's place for readings, near a known state. Nothing is allocated or kept, and no loop is
   without a bound. A result is written only where the status is {{PREFIX}}OK: what was commanded stays as it was.

   Metres and radians. The base's frame {b} has Z upwards, the platform's {p} is level where its axes are those of {b}.
   A reading is the length of an RPS leg, the place of a PRS leg's carriage on its slide, or the angle of an RRS leg's
   crank, 0 outwards and pi/2 upwards, nearest to `middle`. Numbers are float, or double with {{PREFIX}}DOUBLE defined. */

#ifndef {{guard}}
#define {{guard}}

#include <math.h>

#ifdef __FAST_MATH__
#error "-ffast-math breaks the checks for NaN and infinity: compile without it"
#endif

enum {
    {{PREFIX}}OK = 0,
    {{PREFIX}}UNREACHABLE = 1,   /* a ball is out of its leg's reach, or no platform has this normal */
    {{PREFIX}}BEYOND_LIMITS = 2, /* a reading is below its minimum or above its maximum */
    {{PREFIX}}SINGULAR = 3,      /* beyond a singularity of a leg or platform, or so near, or far, that digits are lost */
    {{PREFIX}}UNSAFE = 4,        /* the way from the state `near` is not proved to be regular */
    {{PREFIX}}BAD_INPUT = -1     /* no finite numbers, degrees, a zero normal, or a `near` that is no state */
};

enum { {{PREFIX}}RPS, {{PREFIX}}PRS, {{PREFIX}}RRS };

/* A slope is how far a ball moves along its rod per unit of the reading, over the most possible; the amplification is
   how far balls move, over the sides, at a relative error of what places they have in the planes. Within these bounds
   results are right to 1e-5, or 1e-12. */
#ifdef {{PREFIX}}DOUBLE
typedef double {{prefix}}real;
#define {{PREFIX}}R(number) number
#define {{PREFIX}}M(function) function
#define {{PREFIX}}EPSILON 2.3e-16
#define {{PREFIX}}LEAST_SLOPE 1e-3
#define {{PREFIX}}MOST_AMPLIFIED 2e3
#define {{PREFIX}}ROUNDING {{limit_rounding}}
#else
typedef float {{prefix}}real;
#define {{PREFIX}}R(number) number##f
#define {{PREFIX}}M(function) function##f
#define {{PREFIX}}EPSILON 1.2e-7f
#define {{PREFIX}}LEAST_SLOPE 0.1f
#define {{PREFIX}}MOST_AMPLIFIED 200.0f
#define {{PREFIX}}ROUNDING 1e-6f /* of limits and states `near` */
#endif
#define {{PREFIX}}NO_LIMIT (({{prefix}}real)INFINITY)
#define {{PREFIX}}TURN {{PREFIX}}R({{most_turned}}) /* more is degrees */
#define {{PREFIX}}MOST_STEPS 1000 /* of `{{prefix}}forward` */

/* A leg moves in a plane, in which x is outwards and z upwards from the pivot. */
typedef struct {
    {{prefix}}real pivot[3], outward[3], upward[3]; /* origin, x and z of the plane, in {b} */
    {{prefix}}real ball[3];                         /* its centre, in {p} */
    {{prefix}}real crank, rod;                      /* lengths: PRS legs have no crank, RPS legs neither */
    {{prefix}}real slide[2];                        /* direction of a PRS leg's slide: x and z */
    {{prefix}}real sign;                            /* working mode: -1 has the knee outwards, the carriage behind */
    {{prefix}}real offset, minimum, maximum;        /* of the reading; {{PREFIX}}NO_LIMIT is infinite */
    {{prefix}}real middle;                          /* of the limits: a crank's reading is nearest to it */
} {{prefix}}leg;

typedef struct {
    int kind;
    {{prefix}}real up;          /* 1, or -1 where the platform hangs on its rods */
    {{prefix}}real home_height; /* of the level platform with its legs in the middle of their limits */
    {{prefix}}leg legs[3];
} {{prefix}}geometry;

typedef struct {
    {{prefix}}real rotation[9]; /* from {p} to {b}, row by row: the last column is the normal */
    {{prefix}}real position[3]; /* of {p}'s origin in {b} */
    {{prefix}}real readings[3];
} {{prefix}}state;

static const {{prefix}}geometry {{prefix}}machine = {
    {{PREFIX}}{{kind}}, {{reals(numbers[:2])}},
    {
{% for leg in numbers[2:].reshape(3, -1) %}
        { {{- "{" ~ reals(leg[:3])}}}, { {{- reals(leg[3:6]) -}} }, { {{- reals(leg[6:9]) -}} },
            { {{- reals(leg[9:12]) -}} }, {{reals(leg[12:14])}}, { {{- reals(leg[14:16]) -}} }, {{reals(leg[16:])}}}{{"," if not loop.last}}
{% endfor %}
    }
};

/* The circles in the planes of the legs that readings leave to the balls. */
typedef struct {
    {{prefix}}real x[3], z[3], radius[3];
} {{prefix}}circles;

/* Three balls on their circles. */
typedef struct {
    {{prefix}}real places[6];          /* x and z in the planes */
    {{prefix}}real balls[9], moves[9]; /* and how they move as their legs turn outwards */
    {{prefix}}real inverse[9];         /* of the derivative of half the squared sides 12, 23, 31 by these turns */
    {{prefix}}real norm;               /* of the inverse: the largest sum of a row's magnitudes */
    int is_home;                   /* no singularity is between this and the level platform */
} {{prefix}}triangle;

static inline {{prefix}}real {{prefix}}dot(const {{prefix}}real *a, const {{prefix}}real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void {{prefix}}cross(const {{prefix}}real *a, const {{prefix}}real *b, {{prefix}}real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Write a - b and return its length. */
static inline {{prefix}}real {{prefix}}minus(const {{prefix}}real *a, const {{prefix}}real *b, {{prefix}}real *c)
{
    int k;
    for (k = 0; k < 3; ++k) {
        c[k] = a[k] - b[k];
    }
    return {{PREFIX}}M(sqrt)({{prefix}}dot(c, c));
}

static inline {{prefix}}real {{prefix}}larger({{prefix}}real a, {{prefix}}real b)
{
    return a > b ? a : b;
}

/* Write where the balls of a state are in the planes of their legs. */
static inline void {{prefix}}put_places(const {{prefix}}geometry *m, const {{prefix}}state *s, {{prefix}}real *places)
{
    {{prefix}}real arm[3];
    int i, k;
    for (i = 0; i < 3; ++i) {
        const {{prefix}}leg *leg = &m->legs[i];
        for (k = 0; k < 3; ++k) {
            arm[k] = s->position[k] + {{prefix}}dot(s->rotation + 3 * k, leg->ball) - leg->pivot[k];
        }
        places[2 * i] = {{prefix}}dot(arm, leg->outward);
        places[2 * i + 1] = {{prefix}}dot(arm, leg->upward);
    }
}

/* Write the reading of a leg from its ball's place; return 0 where that is out of reach. */
static inline int {{prefix}}put_reading(int kind, const {{prefix}}leg *leg, const {{prefix}}real *place, {{prefix}}real *reading)
{
    {{prefix}}real x = place[0], z = place[1], along = 0, beside = x * x + z * z, far = {{PREFIX}}M(sqrt)(beside), c, s;
    if (kind == {{PREFIX}}PRS) {
        along = leg->slide[0] * z - leg->slide[1] * x;
        beside = (leg->rod - along) * (leg->rod + along);
        along = leg->slide[0] * x + leg->slide[1] * z;
    } else if (kind == {{PREFIX}}RRS) {
        along = beside + (leg->crank - leg->rod) * (leg->crank + leg->rod);
        beside = (leg->crank + leg->rod - far) * (leg->crank + leg->rod + far) * (far - leg->crank + leg->rod)
                * (far + leg->crank - leg->rod);
    }
    if (!(beside >= 0)) {
        return 0;
    }
    beside = leg->sign * {{PREFIX}}M(sqrt)(beside);
    if (kind == {{PREFIX}}RRS) { /* the knee is along and beside the line from pivot to ball */
        c = x * along - z * beside, s = z * along + x * beside;
        along = leg->middle - leg->offset, x = {{PREFIX}}M(cos)(along), z = {{PREFIX}}M(sin)(along);
        beside = {{PREFIX}}M(atan2)(x * s - z * c, x * c + z * s);
    }
    *reading = (kind == {{PREFIX}}RPS ? far : along + beside) + leg->offset;
    return 1;
}

static inline void {{prefix}}put_circles(const {{prefix}}geometry *m, const {{prefix}}real *readings, {{prefix}}circles *on)
{
    int i;
    for (i = 0; i < 3; ++i) {
        const {{prefix}}leg *leg = &m->legs[i];
        {{prefix}}real q = readings[i] - leg->offset;
        int turns = m->kind == {{PREFIX}}RRS;
        on->x[i] = turns ? leg->crank * {{PREFIX}}M(cos)(q) : leg->slide[0] * q;
        on->z[i] = turns ? leg->crank * {{PREFIX}}M(sin)(q) : leg->slide[1] * q;
        on->radius[i] = m->kind == {{PREFIX}}RPS ? q : leg->rod;
    }
}

/* Write the triangle of balls near these places, which are moved onto the circles. */
static inline void {{prefix}}put_triangle(const {{prefix}}geometry *m, const {{prefix}}circles *on,
        const {{prefix}}real *places, {{prefix}}triangle *t)
{
    {{prefix}}real c[2][3], side[3], determinant; /* (b_i - b_j) . moves_i for the next ball j, and for the last */
    int i, k, negative = 0;
    for (i = 0; i < 3; ++i) {
        const {{prefix}}leg *leg = &m->legs[i];
        {{prefix}}real x = places[2 * i] - on->x[i], z = places[2 * i + 1] - on->z[i];
        {{prefix}}real scale = on->radius[i] / {{PREFIX}}M(sqrt)(x * x + z * z);
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
            {{prefix}}minus(t->balls + 3 * i, t->balls + (i + k + 1) % 3 * 3, side);
            c[k][i] = {{prefix}}dot(side, t->moves + 3 * i);
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
        const {{prefix}}real *row = t->inverse + i;
        t->norm = {{prefix}}larger(t->norm, {{PREFIX}}M(fabs)(row[0]) + {{PREFIX}}M(fabs)(row[1]) + {{PREFIX}}M(fabs)(row[2]));
    }
    t->is_home = determinant > 0 && determinant - determinant == 0 && negative <= 1;
}

/* Write the turns of Newton's step, to be taken off, and return the largest. */
static inline {{prefix}}real {{prefix}}put_turns(const {{prefix}}geometry *m, const {{prefix}}real *balls,
        const {{prefix}}real *inverse, {{prefix}}real *turns)
{
    {{prefix}}real errors[3], side[3], length, own, largest = 0;
    int i;
    for (i = 0; i < 3; ++i) {
        length = {{prefix}}minus(balls + 3 * i, balls + (i + 1) % 3 * 3, side);
        own = {{prefix}}minus(m->legs[i].ball, m->legs[(i + 1) % 3].ball, side);
        errors[i] = (length - own) * (length + own) / 2;
    }
    for (i = 0; i < 3; ++i) {
        turns[i] = {{prefix}}dot(inverse + 3 * i, errors);
        largest = {{prefix}}larger(largest, {{PREFIX}}M(fabs)(turns[i]));
    }
    return largest;
}

/* Newton's method from the balls of a triangle; returns whether it converged. */
static inline int {{prefix}}solve(const {{prefix}}geometry *m, const {{prefix}}circles *on, {{prefix}}triangle *t)
{
    {{prefix}}real turns[3], size = 1, last;
    int step, i;
    for (step = 0; step < 20 && size > 4 * {{PREFIX}}EPSILON; ++step) {
        {{prefix}}put_triangle(m, on, t->places, t);
        last = size;
        size = {{prefix}}put_turns(m, t->balls, t->inverse, turns);
        if (!(size < 1)) {
            return 0;
        }
        for (i = 0; i < 3; ++i) {
            {{prefix}}real x = t->places[2 * i] - on->x[i], z = t->places[2 * i + 1] - on->z[i];
            t->places[2 * i] -= m->up * turns[i] * z;
            t->places[2 * i + 1] += m->up * turns[i] * x;
        }
        /* Only rounding errors are left. */
        if (2 * size > last && step > 2) {
            break;
        }
    }
    {{prefix}}put_triangle(m, on, t->places, t);
    return size < {{PREFIX}}MOST_AMPLIFIED * 8 * {{PREFIX}}EPSILON;
}

/* Return whether one solution is near balls all along a step in which their circles move in straight lines from `start`
   to `end`, by the theorem of Newton and Kantorovich: the norm of the inverse, the Lipschitz constant of the derivative
   and Newton's first step multiply to at most 1/2, with room for what these change on the way. */
static inline int {{prefix}}is_safe(const {{prefix}}geometry *m, const {{prefix}}circles *start, const {{prefix}}circles *end,
        const {{prefix}}triangle *now)
{
    {{prefix}}triangle middle, last;
    {{prefix}}circles between;
    {{prefix}}real turns[3], side[3], moved = 0, grown = 0, lipschitz = 0, longest = 0, step;
    int i;
    for (i = 0; i < 3; ++i) {
        int j = (i + 1) % 3;
        {{prefix}}real a = end->radius[i], b = end->radius[j];
        {{prefix}}real x = end->x[i] - start->x[i], z = end->z[i] - start->z[i], radius = a - start->radius[i];
        /* Centres are at most as far apart as both radii and the side of the triangle reach. */
        {{prefix}}real reach = {{prefix}}minus(m->legs[i].ball, m->legs[j].ball, side) + a + b;
        longest = {{prefix}}larger(longest, reach);
        lipschitz = {{prefix}}larger(lipschitz, reach * (a + b) + 4 * a * b);
        moved = {{prefix}}larger(moved, {{PREFIX}}M(sqrt)(x * x + z * z));
        grown = {{prefix}}larger(grown, {{PREFIX}}M(fabs)(radius));
        between.x[i] = start->x[i] + x / 2;
        between.z[i] = start->z[i] + z / 2;
        between.radius[i] = start->radius[i] + radius / 2;
    }
    moved += grown;
    {{prefix}}put_triangle(m, &between, now->places, &middle);
    {{prefix}}put_triangle(m, end, now->places, &last);
    step = {{prefix}}larger({{prefix}}put_turns(m, last.balls, last.inverse, turns),
            {{prefix}}put_turns(m, middle.balls, last.inverse, turns));
    return last.norm * moved * (longest + 2 * moved) * 8 <= 1 && last.norm * lipschitz * step * 8 <= 1;
}

/* Return the status of a state without limits, and write its triangle. */
static inline int {{prefix}}check(const {{prefix}}geometry *m, const {{prefix}}state *s, {{prefix}}triangle *t)
{
    {{prefix}}circles on;
    {{prefix}}real places[6], side[3], longest = 0, above = 0;
    int i;
    {{prefix}}put_circles(m, s->readings, &on);
    {{prefix}}put_places(m, s, places);
    {{prefix}}put_triangle(m, &on, places, t);
    for (i = 0; i < 3; ++i) {
        const {{prefix}}leg *leg = &m->legs[i];
        {{prefix}}real x = t->places[2 * i], z = t->places[2 * i + 1], slope = 1;
        if (m->kind == {{PREFIX}}PRS) {
            slope = -leg->sign * (leg->slide[0] * (x - on.x[i]) + leg->slide[1] * (z - on.z[i])) / leg->rod;
        } else if (m->kind == {{PREFIX}}RRS) {
            slope = -leg->sign * (on.x[i] * z - on.z[i] * x) / (leg->crank * leg->rod);
        }
        if (!(slope >= {{PREFIX}}LEAST_SLOPE && on.radius[i] > 0)) {
            return {{PREFIX}}SINGULAR;
        }
        above += z - on.z[i];
        longest = {{prefix}}larger(longest, on.radius[i] * ({{prefix}}minus(leg->ball, m->legs[(i + 1) % 3].ball, side)
                + {{PREFIX}}M(fabs)(x) + {{PREFIX}}M(fabs)(z)));
    }
    return t->is_home && m->up * above > 0 && s->rotation[8] > 0 && t->norm * longest <= {{PREFIX}}MOST_AMPLIFIED
            ? {{PREFIX}}OK : {{PREFIX}}SINGULAR;
}

/* Return 0 where all readings are within their limits, up to rounding, or the number from 1 to 3 of the first beyond. */
static inline int {{prefix}}beyond_limits(const {{prefix}}geometry *m, const {{prefix}}real readings[3])
{
    int i;
    for (i = 0; i < 3; ++i) {
        {{prefix}}real low = m->legs[i].minimum, high = m->legs[i].maximum;
        {{prefix}}real rounding = {{PREFIX}}ROUNDING * {{prefix}}larger(low - low == 0 ? {{PREFIX}}M(fabs)(low) : 0,
                high - high == 0 ? {{PREFIX}}M(fabs)(high) : 0);
        if (!(readings[i] >= low - rounding && readings[i] <= high + rounding)) {
            return i + 1;
        }
    }
    return 0;
}

/* Inverse: write the state in which the platform has a normal, of any length, and its origin a height, in closed form.
   The platform moves aside and turns about its normal as the legs make it. */
static inline int {{prefix}}inverse(const {{prefix}}geometry *m, const {{prefix}}real normal[3], {{prefix}}real height,
        {{prefix}}state *state)
{
    {{prefix}}state s;
    {{prefix}}triangle t;
    {{prefix}}real turn[3][3], u[3], v[3], weights[3], p[3], q[3], first[3], second[3], rest[3], places[6];
    {{prefix}}real x, y, z, a, b, c, square, root;
    int i, k, status;
    for (k = 0, a = height - height; k < 3; ++k) {
        a += {{PREFIX}}M(fabs)(normal[k]);
    }
    if (!(a > 0 && a - a == 0)) {
        return {{PREFIX}}BAD_INPUT;
    }
    x = normal[0] / a, y = normal[1] / a, z = normal[2] / a; /* first, as squares underflow */
    a = {{PREFIX}}M(sqrt)(x * x + y * y + z * z);
    x /= a, y /= a, z /= a;
    if (!(z > 0)) {
        return {{PREFIX}}UNREACHABLE;
    }
    /* The turn about a level axis that takes Z to the normal leaves one about the normal, psi, and a shift x, y, in
       which the equations of the three planes are linear: first cos psi + second sin psi + u x + v y = rest. */
    a = 1 / (1 + z);
    turn[0][0] = 1 - a * x * x, turn[0][1] = -a * x * y, turn[0][2] = x;
    turn[1][0] = -a * x * y, turn[1][1] = 1 - a * y * y, turn[1][2] = y;
    turn[2][0] = -x, turn[2][1] = -y, turn[2][2] = z;
    for (i = 0; i < 3; ++i) {
        const {{prefix}}leg *leg = &m->legs[i];
        {{prefix}}cross(leg->outward, leg->upward, p);
        for (k = 0; k < 3; ++k) {
            q[k] = p[0] * turn[0][k] + p[1] * turn[1][k] + p[2] * turn[2][k];
        }
        first[i] = q[0] * leg->ball[0] + q[1] * leg->ball[1];
        second[i] = q[1] * leg->ball[0] - q[0] * leg->ball[1];
        rest[i] = {{prefix}}dot(p, leg->pivot) - q[2] * leg->ball[2] - p[2] * height;
        u[i] = p[0];
        v[i] = p[1];
    }
    {{prefix}}cross(u, v, weights); /* under which the shift drops out */
    a = {{prefix}}dot(weights, first), b = {{prefix}}dot(weights, second), c = {{prefix}}dot(weights, rest);
    square = a * a + b * b;
    root = square - c * c;
    if (!(root >= 0 && square > 0)) {
        return {{PREFIX}}UNREACHABLE;
    }
    /* Of two solutions the one that turns less. */
    root = b < 0 ? -{{PREFIX}}M(sqrt)(root) : {{PREFIX}}M(sqrt)(root);
    x = (a * c + b * root) / square;
    y = (b * c - a * root) / square;
    for (i = 0; i < 3; ++i) {
        rest[i] -= first[i] * x + second[i] * y;
        s.rotation[3 * i] = turn[i][0] * x + turn[i][1] * y;
        s.rotation[3 * i + 1] = turn[i][1] * x - turn[i][0] * y;
        s.rotation[3 * i + 2] = turn[i][2];
    }
    {{prefix}}cross(v, weights, p);
    {{prefix}}cross(weights, u, q);
    square = {{prefix}}dot(weights, weights);
    s.position[0] = {{prefix}}dot(p, rest) / square;
    s.position[1] = {{prefix}}dot(q, rest) / square;
    s.position[2] = height;
    {{prefix}}put_places(m, &s, places);
    for (i = 0; i < 3; ++i) {
        if (!{{prefix}}put_reading(m->kind, &m->legs[i], places + 2 * i, &s.readings[i])) {
            return {{PREFIX}}UNREACHABLE;
        }
    }
    status = {{prefix}}check(m, &s, &t);
    if (status == {{PREFIX}}OK && {{prefix}}beyond_limits(m, s.readings)) {
        status = {{PREFIX}}BEYOND_LIMITS;
    }
    if (status == {{PREFIX}}OK) {
        *state = s;
    }
    return status;
}

/* The same from a tilt, and its azimuth: where the normal leans to, from X towards Y. */
static inline int {{prefix}}tilt(const {{prefix}}geometry *m, {{prefix}}real tilt, {{prefix}}real azimuth, {{prefix}}real height,
        {{prefix}}state *state)
{
    {{prefix}}real normal[3];
    if ({{PREFIX}}M(fabs)(tilt) > {{PREFIX}}TURN / 2 || {{PREFIX}}M(fabs)(azimuth) > {{PREFIX}}TURN) {
        return {{PREFIX}}BAD_INPUT;
    }
    normal[0] = {{PREFIX}}M(sin)(tilt) * {{PREFIX}}M(cos)(azimuth);
    normal[1] = {{PREFIX}}M(sin)(tilt) * {{PREFIX}}M(sin)(azimuth);
    normal[2] = {{PREFIX}}M(cos)(tilt);
    return {{prefix}}inverse(m, normal, height, state);
}

/* Forward: write the state of readings at the end of the way from a state `near` on which all readings change in
   proportion. For limits see {{prefix}}beyond_limits. `near` and `state` may be the same. */
static inline int {{prefix}}forward(const {{prefix}}geometry *m, const {{prefix}}real readings[3], const {{prefix}}state *near,
        {{prefix}}state *state)
{
    {{prefix}}state s;
    {{prefix}}triangle t, tried;
    {{prefix}}circles start, end;
    {{prefix}}real now[3][3], own[3][3], dual[2][3], turns[3], share = 0, after, step, longest = 0;
    int i, k, left = {{PREFIX}}MOST_STEPS, status;
    if ({{prefix}}check(m, near, &t) != {{PREFIX}}OK
            || !({{prefix}}put_turns(m, t.balls, t.inverse, turns) <= {{PREFIX}}ROUNDING * 30)) {
        return {{PREFIX}}BAD_INPUT;
    }
    for (i = 0; i < 3; ++i) {
        step = {{PREFIX}}M(fabs)(readings[i] - near->readings[i]);
        if (!(step - step == 0)
                || (m->kind == {{PREFIX}}RRS && {{PREFIX}}M(fabs)(readings[i] - m->legs[i].offset) > {{PREFIX}}TURN)) {
            return {{PREFIX}}BAD_INPUT;
        }
        longest = {{prefix}}larger(longest, step);
    }
    /* The arc of a knee is replaced by chords of at most 0.1 rad. */
    longest = m->kind == {{PREFIX}}RRS && longest * 10 > 1 ? 1 / (longest * 10) : 1;
    {{prefix}}put_circles(m, near->readings, &start);
    for (step = longest; share < 1; step = step < longest ? step : longest) {
        after = share + step < 1 ? share + step : 1;
        for (i = 0; i < 3; ++i) {
            s.readings[i] = after < 1 ? near->readings[i] + after * (readings[i] - near->readings[i]) : readings[i];
        }
        {{prefix}}put_circles(m, s.readings, &end);
        tried = t;
        if ({{prefix}}is_safe(m, &start, &end, &t) && {{prefix}}solve(m, &end, &tried)) {
            t = tried;
            share = after;
            step *= 2;
            start = end;
        } else {
            step /= 2;
        }
        if (--left < 0) {
            return {{PREFIX}}UNSAFE;
        }
    }
    /* The rotation takes two sides of the triangle and its normal from {p} to {b}. */
    for (k = 0; k < 2; ++k) {
        {{prefix}}minus(m->legs[k + 1].ball, m->legs[0].ball, own[k]);
        {{prefix}}minus(t.balls + 3 * k + 3, t.balls, now[k]);
    }
    {{prefix}}cross(own[0], own[1], own[2]);
    {{prefix}}cross(now[0], now[1], now[2]);
    {{prefix}}cross(own[1], own[2], dual[0]);
    {{prefix}}cross(own[2], own[0], dual[1]);
    for (k = 0; k < 3; ++k) {
        s.position[k] = (t.balls[k] + t.balls[k + 3] + t.balls[k + 6]) / 3;
        for (i = 0; i < 3; ++i) {
            s.rotation[3 * k + i] = (now[0][k] * dual[0][i] + now[1][k] * dual[1][i] + now[2][k] * own[2][i])
                    / {{prefix}}dot(own[2], own[2]);
        }
        for (i = 0; i < 3; ++i) {
            s.position[k] -= {{prefix}}dot(s.rotation + 3 * k, m->legs[i].ball) / 3;
        }
    }
    status = {{prefix}}check(m, &s, &t);
    if (status == {{PREFIX}}OK) {
        *state = s;
    }
    return status;
}

#endif
