/* Closed-chain kinematics of a {{title}}; see the header.

   {{origin}}

   First come formulas, written by the code generator of CasADi; from `read_pose` on what checks arguments, iterates and
   decides. Readings leave each ball on a circle, and the three balls of a stage are the corners of a triangle. In a
   given pose a ball lies in the plane of its leg: its two coordinates there are unknowns, and six equations in six of
   them, all quadratic, hold the machine. */

#include "{{prefix}}kinematics.h"

#include <float.h>
#include <math.h>

#ifdef __FAST_MATH__
#error "-ffast-math breaks the checks for NaN and infinity: compile without it"
#endif

static double larger(double x, double y)
{
    return x > y ? x : y;
}

static double smaller(double x, double y)
{
    return x < y ? x : y;
}

{{formulas}}
#define ROUNDED 1e-6            /* largest error of R^T R, and of a state to begin from in units of d */
#define FARTHEST 1e5            /* largest length in units of E + C + d */
#define SINGULAR_RATIO {{singular}}
#define CHORD {{chord}} /* rad; a crank turns by no more while the end of it is taken for its chord's */
#define MOST_TURNED {{most_turned}} /* rad */
#define LEGS(g) {% for name in fields %}(g)->{{name}}{{", " if not loop.last}}{% endfor %}


/* Of each leg: what every reading without its offset is beyond, and whether it is an angle. */
static const double least[6] = { {{- numbers(legs.least_readings) -}} }, turns[6] = { {{- numbers(turns) -}} };

const {{prefix}}geometry {{prefix}}machine = {
{{table(fields.values())}}
};

{% if bodies is not none %}
const double {{prefix}}bodies[32] = { {{- numbers(bodies) -}} };

{% endif %}
const char *const {{prefix}}branch_names[8] = {"TT+", "TT-", "TF+", "TF-", "FT+", "FT-", "FF+", "FF-"};

const char *{{prefix}}status_name(int status)
{
    switch (status) {
{% for name in statuses %}
    case {{PREFIX}}{{name}}: return "{{name|lower|replace("_", " ")}}";
{% endfor %}
    default: return "unknown status";
    }
}

static void copy(const double *from, double *to, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        to[i] = from[i];
    }
}

static void put_nan(double *to, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        to[i] = NAN;
    }
}

/* Return whether numbers are within a bound; NaN is not. */
static int are_within(const double *numbers, int count, double most)
{
    int i;
    for (i = 0; i < count; ++i) {
        if (!(fabs(numbers[i]) <= most)) {
            return 0;
        }
    }
    return 1;
}

static double farthest(const {{prefix}}geometry *g)
{
    return FARTHEST * (g->dimensions[0] + g->dimensions[1] + g->dimensions[2]);
}

static int check_numbers(const double *numbers, int count, double most)
{
    return !are_within(numbers, count, DBL_MAX) ? {{PREFIX}}NOT_FINITE
            : !are_within(numbers, count, most) ? {{PREFIX}}OUT_OF_RANGE : {{PREFIX}}OK;
}

static int check_geometry(const {{prefix}}geometry *g)
{
    double areas[2], is_valid;
    const double *const in[] = {LEGS(g)};
    double *const out[] = {areas, &is_valid};
    int i;
    for (i = 0; i < 6; ++i) {
        const double *axis = g->axes + 3 * i;
        if (!(g->minimum[i] >= least[i] && g->minimum[i] < g->maximum[i]) || !(fabs(axis[2]) <= 0.9)
                || !(fabs(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2] - 1.0) <= 2e-6)) {
            return {{PREFIX}}BAD_GEOMETRY;
        }
    }
    if (!are_within(g->pivots, 18, 1e9) || !are_within(g->balls, 18, 1e9) || !are_within(g->offsets, 6, 1e9)) {
        return {{PREFIX}}BAD_GEOMETRY;
    }
    numbers_of_machine(in, out);
    return areas[0] > 1e-6 && areas[1] > 1e-6 && is_valid > 0.0 ? {{PREFIX}}OK : {{PREFIX}}BAD_GEOMETRY;
}

/* Return whether the legs are nominal, to rounding. */
static int is_nominal(const {{prefix}}geometry *g)
{
    double error;
    const double *const in[] = {LEGS(g)};
    double *const out[] = {&error};
    drawing_error(in, out);
    return error <= 64.0 * DBL_EPSILON;
}

static int check_state(const {{prefix}}geometry *g, const {{prefix}}state *s)
{
    int status = check_geometry(g);
    status = status != {{PREFIX}}OK ? status : check_numbers(s->rotation, 9, 2.0);
    status = status != {{PREFIX}}OK ? status : check_numbers(s->position, 3, farthest(g));
    return status != {{PREFIX}}OK ? status : check_numbers(s->joints, 9, farthest(g));
}

/* Write R^T R and return the largest entry of R^T R - I. */
static double products_of_columns(const double *r, double *products)
{
    double largest = 0.0;
    int i, j;
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j) {
            double error;
            products[3 * i + j] = r[i] * r[j] + r[3 + i] * r[3 + j] + r[6 + i] * r[6 + j];
            error = fabs(products[3 * i + j] - (i == j ? 1.0 : 0.0));
            largest = error > largest ? error : largest;
        }
    }
    return largest;
}

/* Check a pose, and take the nearest rotation where one is rounded, to second order and twice. */
static int read_pose(const {{prefix}}geometry *g, const double *rotation, const double *position, double *r, double *o)
{
    double products[9], from[9], error;
    int turn, i, j, status = check_geometry(g);
    status = status != {{PREFIX}}OK ? status : check_numbers(rotation, 9, DBL_MAX);
    status = status != {{PREFIX}}OK ? status : check_numbers(position, 3, farthest(g));
    if (status != {{PREFIX}}OK) {
        return status;
    }
    copy(rotation, r, 9);
    copy(position, o, 3);
    for (turn = 0; turn < 2; ++turn) {
        error = products_of_columns(r, products);
        if (!(error <= ROUNDED)) {
            return {{PREFIX}}NOT_A_ROTATION;
        }
        if (error <= 16.0 * DBL_EPSILON) {
            break;
        }
        copy(r, from, 9);
        for (i = 0; i < 3; ++i) {
            for (j = 0; j < 3; ++j) {
                r[3 * i + j] = 1.5 * from[3 * i + j] - 0.5 * (from[3 * i] * products[j]
                        + from[3 * i + 1] * products[3 + j] + from[3 * i + 2] * products[6 + j]);
            }
        }
    }
    return r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) + r[2] * (r[3] * r[7] - r[4] * r[6])
            > 0.0 ? {{PREFIX}}OK : {{PREFIX}}NOT_A_ROTATION;
}

/* Solve (6, 6) equations by Gauss and Jordan, the largest pivot of a column first. A row of `rows` is one of the matrix
   and of the right sides; these become the solutions. Returns 0 where the matrix is singular. */
static int eliminate(double *rows, int columns)
{
    int i, j, k;
    for (k = 0; k < 6; ++k) {
        double *row = rows + columns * k, *best = row, scale;
        for (i = k + 1; i < 6; ++i) {
            double *other = rows + columns * i;
            best = fabs(other[k]) > fabs(best[k]) ? other : best;
        }
        if (!(fabs(best[k]) > 0.0)) {
            return 0;
        }
        scale = 1.0 / best[k];
        for (j = k; j < columns; ++j) {
            double moved = best[j];
            best[j] = row[j];
            row[j] = moved * scale;
        }
        for (i = 0; i < 6; ++i) {
            double *other = rows + columns * i, factor = other[k];
            for (j = k; j < columns && i != k; ++j) {
                other[j] -= factor * row[j];
            }
        }
    }
    return 1;
}

/* Write the inverse of a matrix (6, 6); return whether there is one. */
static int invert(const double *matrix, double *inverse)
{
    double rows[72];
    int i, j;
    for (i = 0; i < 6; ++i) {
        copy(matrix + 6 * i, rows + 12 * i, 6);
        for (j = 0; j < 6; ++j) {
            rows[12 * i + 6 + j] = i == j ? 1.0 : 0.0;
        }
    }
    if (!eliminate(rows, 12)) {
        return 0;
    }
    for (i = 0; i < 6; ++i) {
        copy(rows + 12 * i + 6, inverse + 6 * i, 6);
    }
    return are_within(inverse, 36, DBL_MAX);
}

/* Return the length of the longest of three vectors in the planes of the legs. */
static double longest(const double *vectors)
{
    double most = 0.0;
    int i;
    for (i = 0; i < 6; i += 2) {
        double square = vectors[i] * vectors[i] + vectors[i + 1] * vectors[i + 1];
        most = square > most ? square : most;
    }
    return sqrt(most);
}

/* What G makes of errors, and at most makes of errors of these sizes. */
static double image(const double *inverse, const double *errors, int are_sizes)
{
    double vectors[6];
    int i, j;
    for (i = 0; i < 6; ++i) {
        vectors[i] = 0.0;
        for (j = 0; j < 6; ++j) {
            vectors[i] += (are_sizes ? fabs(inverse[6 * i + j]) : inverse[6 * i + j]) * errors[j];
        }
    }
    return longest(vectors);
}

/* Six equations for the lower balls in a machine whose platform moves, from t = 0 to t = 1. */
typedef struct {
    const {{prefix}}geometry *geometry;
    double rotation[9], position[3], turn[3], shift[3]; /* of the platform; the turn as a vector */
    double end[9], angle;                               /* R at t = 1 */
} way;

typedef struct {
    double errors[6], jacobian[36];
    double curvature[6]; /* bounds of the second-order terms, for changes of length 1 */
    double tilt[6];      /* bounds of the change of `jacobian` per radian */
    double lever[6];     /* distances of the balls from o where planes move, else 0 */
} equations;

static void turned(const way *w, double t, double *r)
{
    double a = w->angle * t, s = sin(a), c = 1.0 - cos(a), u[3], m[9];
    int i, j;
    if (t >= 1.0 || !(w->angle > 0.0)) {
        copy(t >= 1.0 ? w->end : w->rotation, r, 9);
        return;
    }
    for (i = 0; i < 3; ++i) {
        u[i] = w->turn[i] / w->angle;
    }
    m[0] = 1.0 - c * (u[1] * u[1] + u[2] * u[2]), m[1] = c * u[0] * u[1] - s * u[2], m[2] = c * u[0] * u[2] + s * u[1];
    m[3] = c * u[0] * u[1] + s * u[2], m[4] = 1.0 - c * (u[0] * u[0] + u[2] * u[2]), m[5] = c * u[1] * u[2] - s * u[0];
    m[6] = c * u[0] * u[2] - s * u[1], m[7] = c * u[1] * u[2] + s * u[0], m[8] = 1.0 - c * (u[0] * u[0] + u[1] * u[1]);
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j) {
            r[3 * i + j] = m[3 * i] * w->rotation[j] + m[3 * i + 1] * w->rotation[3 + j]
                    + m[3 * i + 2] * w->rotation[6 + j];
        }
    }
}

static void evaluate(const way *w, double t, const double *balls, equations *e)
{
    double r[9], o[3];
    const double *const in[] = {balls, r, o, LEGS(w->geometry)};
    double *const out[] = {e->errors, e->jacobian, e->curvature, e->tilt, e->lever};
    int i;
    for (i = 0; i < 3; ++i) {
        o[i] = w->position[i] + t * w->shift[i];
    }
    turned(w, t, r);
    closure(in, out);
}

/* Newton's method at t, with steps of at most `most`; returns whether it converged. */
static int solve(const way *w, double t, double most, double *balls)
{
    equations e;
    double rows[42], step[6], last = DBL_MAX, size = w->geometry->dimensions[2] + longest(balls);
    int turn, i;
    for (turn = 0; turn < 40; ++turn) {
        double length, scale;
        evaluate(w, t, balls, &e);
        for (i = 0; i < 6; ++i) {
            copy(e.jacobian + 6 * i, rows + 7 * i, 6);
            rows[7 * i + 6] = -e.errors[i];
        }
        if (!eliminate(rows, 7)) {
            return 0;
        }
        for (i = 0; i < 6; ++i) {
            step[i] = rows[7 * i + 6];
        }
        length = longest(step);
        scale = length > most ? most / length : 1.0;
        for (i = 0; i < 6; ++i) {
            balls[i] += scale * step[i];
        }
        if (length <= 2.0 * DBL_EPSILON * size || (length < 1e-9 * size && length >= 0.5 * last)) {
            return 1;
        }
        if (!(length < DBL_MAX)) {
            return 0;
        }
        last = length;
    }
    return last < 1e-9 * size;
}

/* Return the product of Newton and Kantorovich from t to t + step, at most 1/2 where one solution is near all the way.

   G is the inverse of the derivative at t. The first steps of Newton's method in between are bounded by those at both
   ends, and by how far planes depart from changing in proportion. */
static double kantorovich(const way *w, const equations *e, const double *inverse, const double *balls, double t,
        double step)
{
    equations next;
    double bend[6], tilt[6], angle = w->angle * step, first, change, length = 0.0;
    int i;
    evaluate(w, t + step >= 1.0 ? 1.0 : t + step, balls, &next);
    for (i = 0; i < 3; ++i) {
        length += w->shift[i] * w->shift[i] * step * step;
    }
    length = sqrt(length);
    for (i = 0; i < 6; ++i) {
        tilt[i] = angle * e->tilt[i];
        bend[i] = e->lever[i] > 0.0 ? (angle * angle * (e->lever[i] + length) + 2.0 * angle * length) / 8.0 : 0.0;
    }
    change = image(inverse, tilt, 1);
    first = image(inverse, next.errors, 0) + image(inverse, e->errors, 0) + image(inverse, bend, 1);
    return change <= 0.25 ? 2.0 * image(inverse, e->curvature, 1) * first / ((1.0 - change) * (1.0 - change)) : 1.0;
}

/* Follow the solution that `balls` are at t = 0 to t = 1; returns 0 at a singularity. */
static int follow(const way *w, double *balls)
{
    equations e;
    double inverse[36], t = 0.0, step = 1.0;
    int left = {{most_steps}};
    for (; t < 1.0; t = t + step >= 1.0 ? 1.0 : t + step, step *= 2.0) {
        evaluate(w, t, balls, &e);
        if (!invert(e.jacobian, inverse)) {
            return 0;
        }
        step = step < 1.0 - t ? step : 1.0 - t;
        while (!(kantorovich(w, &e, inverse, balls, t, step) <= 0.25)) {
            step *= 0.5;
            if (--left < 0 || step < {{shortest}}) {
                return 0;
            }
        }
        if (--left < 0 || !solve(w, t + step >= 1.0 ? 1.0 : t + step, INFINITY, balls)) {
            return 0;
        }
    }
    return 1;
}

/* The circles on which the balls of a stage are. */
typedef struct {
    double axes[9], centres[9], radii[3], squares[3];
} circles;

/* Newton's method from near balls; returns whether it converged. */
static int solve_stage(const circles *c, double *balls)
{
    double e[9], size, last = NAN, converged = 0.0, stalled = 0.0;
    const double *const from[] = {balls, c->axes, c->centres}, *const in[] = {e, c->axes, c->centres, c->radii, c->squares};
    const double *const sizes[] = {&size, &last}, *const to[] = {e, c->centres, c->radii};
    double *const out[] = {e, &size}, *const directions[] = {e}, *const flag[] = {&converged}, *const stalls[] = {&stalled};
    double *const end[] = {balls};
    int step;
    directions_to(from, directions);
    for (step = 0; step < {{circles.MOST_STEPS}} && !(converged > 0.0); ++step) {
        newton_step(in, out);
        has_converged(sizes, flag);
        is_stalled(sizes, stalls);
        if (!(converged > 0.0) && stalled > 0.0) {
            is_closed(in, flag);
        }
        if (!(size < (step < {{circles.SEARCH_STEPS}} ? DBL_MAX : {{circles.WANDERING}}))) {
            return 0;
        }
        last = size;
    }
    balls_at(to, end);
    return converged > 0.0 || last < 1e-9;
}

/* Write circles about the centres of others that balls are on, these moved into their planes. */
static void start_at(const circles *c, double *balls, circles *start)
{
    double e[9];
    const double *const in[] = {balls, c->axes, c->centres}, *const to[] = {e, start->centres, start->radii};
    const double *const moved[] = {balls};
    double *const out[] = {e}, *const end[] = {balls}, *const squares[] = {start->squares};
    int i, j;
    *start = *c;
    directions_to(in, out);
    for (i = 0; i < 3; ++i) {
        start->radii[i] = 0.0;
        for (j = 3 * i; j < 3 * i + 3; ++j) {
            start->radii[i] += e[j] * (balls[j] - c->centres[j]);
        }
    }
    balls_at(to, end);
    squared_sides(moved, squares);
}

/* Follow the balls of a stage from circles to others; returns 0 at a singularity. */
static int follow_stage(const circles *start, const circles *end, double *balls)
{
    circles here = *end;
    double t = 0.0, next, step = 1.0, is_safe, tried[9];
    const double *const in[] = {balls, end->axes, start->centres, start->radii, start->squares,
            end->centres, end->radii, end->squares, &t, &next};
    double *const out[] = {&is_safe};
    int left, i;
    for (left = {{most_steps}}; left > 0 && t < 1.0 && step >= {{shortest}}; --left) {
        next = t + step >= 1.0 ? 1.0 : t + step;
        for (i = 0; i < 9; ++i) {
            here.centres[i] = start->centres[i] + next * (end->centres[i] - start->centres[i]);
        }
        for (i = 0; i < 3; ++i) {
            here.radii[i] = start->radii[i] + next * (end->radii[i] - start->radii[i]);
            here.squares[i] = start->squares[i] + next * (end->squares[i] - start->squares[i]);
        }
        copy(balls, tried, 9);
        is_safe_step(in, out);
        if (is_safe > 0.0 && solve_stage(next < 1.0 ? &here : end, tried)) {
            copy(tried, balls, 9);
            t = next;
            step *= 2.0;
        } else {
            step *= 0.5;
        }
    }
    return t >= 1.0;
}

static void put_state_nan({{prefix}}state *state)
{
    put_nan(state->rotation, 9);
    put_nan(state->position, 3);
    put_nan(state->joints, 9);
    put_nan(state->readings, 6);
}

/* Write the readings of a state; return 0 where it is not physical, 1 where it is, 2 where within the limits too. */
static int complete(const {{prefix}}geometry *g, {{prefix}}state *s, double *tilts)
{
    double rank;
    const double *const in[] = {s->joints, s->rotation, s->position, LEGS(g)};
    double *const out[] = {s->readings, &rank, tilts};
    describe(in, out);
    return (int)rank;
}

/* Return whether the legs of a state reach their balls, and with `moves` whether their actuators move them. */
static int check_legs(const {{prefix}}geometry *g, const {{prefix}}state *s, int moves)
{
    double reach, slope;
    const double *const in[] = {s->joints, s->rotation, s->position, LEGS(g)};
    double *const out[] = {&reach, &slope};
    own_limits(in, out);
    return !(reach >= 0.0) ? {{PREFIX}}UNREACHABLE
            : moves && !(slope > SINGULAR_RATIO) ? {{PREFIX}}SINGULAR : {{PREFIX}}OK;
}

/* Write where the lower balls of a state are in the planes of their legs, and the upper balls in {m}. */
static int read_near(const {{prefix}}geometry *g, const {{prefix}}state *near, double *lower, double *upper)
{
    double gap;
    const double *const in[] = {near->joints, near->rotation, near->position, LEGS(g)};
    double *const out[] = {lower, upper, &gap};
    int status = check_state(g, near);
    if (status == {{PREFIX}}OK) {
        own_places(in, out);
        status = gap <= ROUNDED ? {{PREFIX}}OK : {{PREFIX}}BAD_NEAR;
    }
    return status;
}

static void put_lower_balls(const {{prefix}}geometry *g, const double *balls, double *joints)
{
    const double *const in[] = {balls, LEGS(g)};
    double *const out[] = {joints};
    lower_balls(in, out);
}

/* Three quadratic forms of a quaternion, whose common roots are all branches of a pose, and from which equations their
   roots are followed: (1 - t) gamma (x_i^2 - x_4^2) + t x Q_i x. Roots are complex, and those that differ by a factor
   are one: the largest component of a root is 1. */
typedef struct {
    double forms[3][16];
    double gamma[3][2];
} homotopy;

/* Newton's method at t: one step. Returns its size, infinite where it fails. */
static double correct(const homotopy *h, double t, double *x)
{
    double rows[42], size = 0.0, largest = 0.0;
    int held = 0, i, j, k, m;
    for (j = 0; j < 4; ++j) {
        double square = x[2 * j] * x[2 * j] + x[2 * j + 1] * x[2 * j + 1];
        held = square > largest ? j : held;
        largest = square > largest ? square : largest;
    }
    for (i = 0; i < 3; ++i) {
        const double *g = h->gamma[i];
        double error[2] = {0.0, 0.0}, *first = rows + 14 * i, *second = first + 7;
        for (j = 0, k = 0; j < 4; ++j) {
            /* Half the derivative by x_j; the form is their sum with x_j. */
            double sign = (1.0 - t) * (j == i ? 1.0 : j == 3 ? -1.0 : 0.0), a, b;
            a = sign * (g[0] * x[2 * j] - g[1] * x[2 * j + 1]);
            b = sign * (g[0] * x[2 * j + 1] + g[1] * x[2 * j]);
            for (m = 0; m < 4; ++m) {
                a += t * h->forms[i][4 * j + m] * x[2 * m];
                b += t * h->forms[i][4 * j + m] * x[2 * m + 1];
            }
            error[0] += a * x[2 * j] - b * x[2 * j + 1];
            error[1] += a * x[2 * j + 1] + b * x[2 * j];
            if (j != held) {
                first[k] = 2.0 * a, first[k + 1] = -2.0 * b;
                second[k] = 2.0 * b, second[k + 1] = 2.0 * a;
                k += 2;
            }
        }
        first[6] = -error[0], second[6] = -error[1];
    }
    if (!eliminate(rows, 7)) {
        return INFINITY;
    }
    for (j = 0, k = 0; j < 8; ++j) {
        if (j / 2 != held) {
            double step = rows[7 * k++ + 6];
            size += step * step;
            x[j] += step;
        }
    }
    return sqrt(size / largest);
}

/* Make the largest component of a root 1. */
static void scale_root(double *x)
{
    double a = x[0], b = x[1];
    int j;
    for (j = 2; j < 8; j += 2) {
        if (x[j] * x[j] + x[j + 1] * x[j + 1] > a * a + b * b) {
            a = x[j], b = x[j + 1];
        }
    }
    for (j = 0; j < 8; j += 2) {
        double real = (x[j] * a + x[j + 1] * b) / (a * a + b * b);
        x[j + 1] = (x[j + 1] * a - x[j] * b) / (a * a + b * b);
        x[j] = real;
    }
}

/* Follow a root from t = 0 to t = 1; returns whether Newton's method converges there. */
static int follow_root(const homotopy *h, double *x)
{
    double t = 0.0, step = 0.05, last_step = 1.0, tried[8], change[8] = {0.0};
    int left, turn, j;
    for (left = {{root_steps}}; left > 0 && t < 1.0; --left) {
        double next = t + step >= 1.0 ? 1.0 : t + step, last = 0.4, size = 0.0;
        for (j = 0; j < 8; ++j) {
            tried[j] = x[j] + change[j] * (next - t) / last_step;
        }
        for (turn = 0; turn < 3 && size <= last; ++turn) {
            last = turn > 0 ? 0.3 * size : 0.2;
            size = correct(h, next, tried);
        }
        if (size <= last && size <= 1e-3) {
            scale_root(tried);
            for (j = 0; j < 8; ++j) {
                change[j] = tried[j] - x[j];
            }
            last_step = next - t;
            copy(tried, x, 8);
            t = next;
            step *= 2.0;
        } else {
            step *= 0.4;
        }
    }
    for (turn = 0; turn < 4 && t >= 1.0; ++turn) {
        if (correct(h, 1.0, x) <= 1e-12) {
            scale_root(x);
            return 1;
        }
    }
    return 0;
}

/* Return the square of the sine of the angle between two roots. */
static double apart(const double *x, const double *y)
{
    double real = 0.0, imag = 0.0, xx = 0.0, yy = 0.0;
    int j;
    for (j = 0; j < 8; ++j) {
        xx += x[j] * x[j];
        yy += y[j] * y[j];
        real += x[j] * y[j];
        imag += j % 2 ? x[j] * y[j - 1] : -x[j] * y[j + 1];
    }
    return 1.0 - (real * real + imag * imag) / (xx * yy);
}

/* Write where the lower balls are in all real branches of a pose, and how many. Three quadrics meet in eight points:
   where eight are found none is left out. Returns 0 where they cannot be told apart. */
static int solve_all(const {{prefix}}geometry *g, const double *r, const double *o, double *starts, int *count)
{
    static const double turns[6] = {0.7, 2.9, 4.6, 1.9, 5.5, 3.4};
    homotopy h;
    double roots[8][8];
    const double *const in[] = {r, o, LEGS(g)};
    double *const out[] = {h.forms[0]};
    int attempt, i, j, k;
    quadrics(in, out);
    for (attempt = 0; attempt < 4; ++attempt) {
        int whole = are_within(h.forms[0], 48, 2.0);
        for (i = 0; i < 3; ++i) {
            h.gamma[i][0] = cos(turns[i + attempt % 3] + attempt);
            h.gamma[i][1] = sin(turns[i + attempt % 3] + attempt);
        }
        for (k = 0; k < 8 && whole; ++k) {
            for (j = 0; j < 4; ++j) {
                roots[k][2 * j] = k >> j & 1 ? -1.0 : 1.0;
                roots[k][2 * j + 1] = 0.0;
            }
            whole = follow_root(&h, roots[k]);
            for (i = 0; i < k; ++i) {
                whole = whole && apart(roots[i], roots[k]) > 1e-12;
            }
        }
        if (whole) {
            break;
        }
    }
    *count = 0;
    for (k = 0; k < 8 && attempt < 4; ++k) {
        const double *const root[] = {roots[k], r, o, LEGS(g)};
        double *const balls[] = {starts + 6 * *count};
        double imag = 0.0;
        for (j = 0; j < 4; ++j) {
            imag = larger(imag, fabs(roots[k][2 * j + 1]));
            roots[k][j] = roots[k][2 * j];
        }
        if (imag < 1e-6) {
            balls_of_root(root, balls);
            ++*count;
        }
    }
    return attempt < 4;
}

/* The physical branch by the rule: of all branches of a pose, each to rounding by Newton's method. */
static int begin_inverse(const way *w, {{prefix}}state *state)
{
    const {{prefix}}geometry *g = w->geometry;
    double starts[48], is_degenerate = 0.0, best_tilts = 0.0;
    const double *const in[] = {w->end, w->position, LEGS(g)};
    double *const out[] = {starts, &is_degenerate};
    int k, best = 0, count = 2;
    put_state_nan(state);
    if (is_nominal(g)) {
        nominal_branches(in, out);
        if (is_degenerate > 0.0) {
            return {{PREFIX}}DEGENERATE;
        }
    } else if (!solve_all(g, w->end, w->position, starts, &count)) {
        return {{PREFIX}}SINGULAR;
    }
    for (k = 0; k < count; ++k) {
        {{prefix}}state tried;
        double tilts;
        int rank;
        if (!solve(w, 1.0, 0.3 * g->dimensions[2], starts + 6 * k)) {
            continue;
        }
        copy(w->end, tried.rotation, 9);
        copy(w->position, tried.position, 3);
        put_lower_balls(g, starts + 6 * k, tried.joints);
        rank = complete(g, &tried, &tilts);
        if (rank > best || (rank > 0 && rank == best && tilts > best_tilts)) {
            *state = tried;
            best = rank;
            best_tilts = tilts;
        }
    }
    return best > 0 ? {{PREFIX}}OK : {{PREFIX}}UNREACHABLE;
}

/* Write the way from the pose of a state to the end, turning about a fixed axis. */
static int set_out(way *w, const {{prefix}}state *near, const double *position)
{
    double m[9], sine, cosine;
    int i, j;
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j) {
            m[3 * i + j] = w->end[3 * i] * near->rotation[3 * j] + w->end[3 * i + 1] * near->rotation[3 * j + 1]
                    + w->end[3 * i + 2] * near->rotation[3 * j + 2];
        }
    }
    w->turn[0] = 0.5 * (m[7] - m[5]), w->turn[1] = 0.5 * (m[2] - m[6]), w->turn[2] = 0.5 * (m[3] - m[1]);
    sine = sqrt(w->turn[0] * w->turn[0] + w->turn[1] * w->turn[1] + w->turn[2] * w->turn[2]);
    cosine = 0.5 * (m[0] + m[4] + m[8] - 1.0);
    w->angle = atan2(sine, cosine);
    for (i = 0; i < 3; ++i) {
        w->turn[i] *= sine > 0.0 ? w->angle / sine : 0.0;
        w->position[i] = near->position[i];
        w->shift[i] = position[i] - near->position[i];
    }
    copy(near->rotation, w->rotation, 9);
    return w->angle <= 3.0;
}

int {{prefix}}inverse(const {{prefix}}geometry *geometry, const double rotation[9], const double position[3],
        const {{prefix}}state *near, {{prefix}}state *state)
{
    way w = {0};
    double o[3], lower[6], upper[9], tilts;
    int status = read_pose(geometry, rotation, position, w.end, o);
    w.geometry = geometry;
    copy(o, w.position, 3);
    if (status == {{PREFIX}}OK && !near) {
        return begin_inverse(&w, state);
    }
    status = status != {{PREFIX}}OK ? status : read_near(geometry, near, lower, upper);
    if (status == {{PREFIX}}OK) {
        status = set_out(&w, near, o) && follow(&w, lower) ? {{PREFIX}}OK : {{PREFIX}}SINGULAR;
    }
    if (status == {{PREFIX}}OK) {
        copy(w.end, state->rotation, 9);
        copy(o, state->position, 3);
        put_lower_balls(geometry, lower, state->joints);
        (void)complete(geometry, state, &tilts);
        status = check_legs(geometry, state, 0);
    }
    if (status != {{PREFIX}}OK) {
        put_state_nan(state);
    }
    return status;
}

/* Write the state of two stages with these readings, and return what `complete` does, or -1 where a leg is in another
   working mode. */
static int join(const {{prefix}}geometry *g, const double *lower, const double *upper, const double *readings,
        {{prefix}}state *state)
{
    double tilts, slope;
    const double *const in[] = {lower, upper, LEGS(g)};
    const double *const known[] = {state->joints, state->rotation, state->position, readings, LEGS(g)};
    double *const out[] = {state->rotation, state->position}, *const slopes[] = {&slope};
    int rank;
    placed_platform(in, out);
    copy(lower, state->joints, 9);
    rank = complete(g, state, &tilts);
    working_mode(known, slopes);
    return slope > 0.0 ? rank : -1;
}

static void put_circles(const {{prefix}}geometry *g, const double *readings, circles *stages)
{
    double centres[18], radii[6], squares[6];
    const double *const in[] = {readings, LEGS(g)};
    double *const out[] = {centres, radii, squares};
    int k;
    circles_of_readings(in, out);
    for (k = 0; k < 2; ++k) {
        copy(g->axes + 9 * k, stages[k].axes, 9);
        copy(centres + 9 * k, stages[k].centres, 9);
        copy(radii + 3 * k, stages[k].radii, 3);
        copy(squares + 3 * k, stages[k].squares, 3);
    }
}

int {{prefix}}beyond_limits(const {{prefix}}geometry *geometry, const double readings[6])
{
    double hold[6];
    const double *const in[] = {readings, LEGS(geometry)};
    double *const out[] = {hold};
    int i;
    limits_hold(in, out);
    for (i = 0; i < 6; ++i) {
        if (!(hold[i] > 0.0)) {
            return i + 1;
        }
    }
    return 0;
}

int {{prefix}}forward(const {{prefix}}geometry *geometry, const double readings[6], const {{prefix}}state *near,
        {{prefix}}state *state)
{
    circles start, first[2], last[2];
    double coordinates[6], balls[2][9], tried[2][9], from[6], here[6], turn = 0.0;
    const double *const in[] = {readings, LEGS(geometry)};
    double *const out[] = {balls[0], balls[1]};
    int i, k, part, parts, converged = 1, status = check_geometry(geometry);
    copy(near ? near->readings : readings, from, 6);
    status = status != {{PREFIX}}OK ? status : check_numbers(readings, 6, DBL_MAX);
    for (i = 0; i < 6 && status == {{PREFIX}}OK; ++i) {
        const double own = readings[i] - geometry->offsets[i];
        const double most = turns[i] > 0.0 ? MOST_TURNED : farthest(geometry);
        status = own > least[i] && fabs(own) <= most ? {{PREFIX}}OK : {{PREFIX}}OUT_OF_RANGE;
        turn = larger(turns[i] * fabs(readings[i] - from[i]), turn);
    }
    status = status != {{PREFIX}}OK || !near ? status : read_near(geometry, near, coordinates, balls[1]);
    if (status != {{PREFIX}}OK) {
        put_state_nan(state);
        return status;
    }
    put_circles(geometry, from, first);
    if (near) {
        copy(near->joints, balls[0], 9);
    } else {
        level_stages(in, out);
        for (k = 0; k < 2; ++k) {
            copy(balls[k], tried[k], 9);
            converged = solve_stage(&first[k], tried[k]) && converged;
        }
        if (converged && join(geometry, tried[0], tried[1], readings, state) > 0) {
            return {{PREFIX}}OK;
        }
    }
    /* Circles change in proportion from those that the balls are on at the start, centres on the chords of their arcs;
       where Newton's method has converged nowhere there is no state. */
    parts = turn < 4.0 * MOST_TURNED ? 1 + (int)(turn / CHORD) : 1;
    for (part = 1; part <= parts; ++part) {
        for (i = 0; i < 6; ++i) {
            here[i] = part < parts ? from[i] + part * (readings[i] - from[i]) / parts : readings[i];
        }
        put_circles(geometry, here, last);
        for (k = 0; k < 2; ++k) {
            start_at(&first[k], balls[k], &start);
            converged = converged && follow_stage(&start, &last[k], balls[k]);
            first[k] = last[k];
        }
    }
    if (converged && join(geometry, balls[0], balls[1], readings, state) >= (near ? 0 : 1)) {
        return {{PREFIX}}OK;
    }
    put_state_nan(state);
    return near ? {{PREFIX}}SINGULAR : {{PREFIX}}UNREACHABLE;
}

int {{prefix}}all_branches(const {{prefix}}geometry *geometry, const double rotation[9], const double position[3],
        {{prefix}}branches *branches)
{
    double r[9], o[3], real[8], is_degenerate = 0.0;
    const double *const in[] = {r, o, LEGS(geometry)};
    double *const out[] = {branches->joints[0], branches->readings[0], branches->discriminants, real, &is_degenerate};
    int k, count = 0, status = read_pose(geometry, rotation, position, r, o);
    if (status == {{PREFIX}}OK && !is_nominal(geometry)) {
        status = {{PREFIX}}BAD_GEOMETRY;
    }
    if (status == {{PREFIX}}OK) {
        all_drawn_branches(in, out);
    } else {
        put_nan(branches->discriminants, 4);
    }
    for (k = 0; k < 8; ++k) {
        branches->real[k] = status == {{PREFIX}}OK && real[k] > 0.0;
        count += branches->real[k];
        if (!branches->real[k]) {
            put_nan(branches->joints[k], 9);
            put_nan(branches->readings[k], 6);
        }
    }
    return status != {{PREFIX}}OK ? status : is_degenerate > 0.0 ? {{PREFIX}}DEGENERATE
            : count > 0 ? {{PREFIX}}OK : {{PREFIX}}UNREACHABLE;
}

/* Return whether a state is singular to rounding: with `forward` three legs and three axes of a stage, and else the six
   axes, hold nothing against one motion. */
static int is_singular(const {{prefix}}geometry *g, const {{prefix}}state *s, int forward)
{
    double rows[2][2][18], matrix[36], inverse[36];
    const double *const in[] = {s->joints, s->rotation, s->position, LEGS(g)};
    double *const out[] = {rows[0][0], rows[1][0]};
    int stage, i;
    force_rows(in, out);
    for (stage = 0; stage < (forward ? 2 : 1); ++stage) {
        double size = 0.0, inverse_size = 0.0;
        copy(rows[forward ? 0 : 1][stage], matrix, 18);
        copy(rows[1][forward ? stage : 1], matrix + 18, 18);
        if (!invert(matrix, inverse)) {
            return 1;
        }
        for (i = 0; i < 36; ++i) {
            size += matrix[i] * matrix[i];
            inverse_size += inverse[i] * inverse[i];
        }
        if (!(SINGULAR_RATIO * sqrt(size) * sqrt(inverse_size) < 1.0)) {
            return 1;
        }
    }
    return 0;
}
{% for f in functions %}

int {{prefix}}{{f.name}}({{f.parameters(prefix)}})
{
    int status = check_state(geometry, state);
{% for name, x in f.arguments.items() %}
    status = status != {{PREFIX}}OK ? status : check_numbers({{name}}, {{x.size}}, DBL_MAX);
{% endfor %}
    status = status != {{PREFIX}}OK ? status : check_legs(geometry, state, {{(f.singular == "inverse")|int}});
{% if f.singular %}
    if (status == {{PREFIX}}OK && is_singular(geometry, state, {{(f.singular == "forward")|int}})) {
        status = {{PREFIX}}SINGULAR;
    }
{% endif %}
    if (status == {{PREFIX}}OK) {
        const double *const in[] = {state->joints, state->rotation, state->position{% for name in f.arguments %}, {{name}}{% endfor %}, LEGS(geometry)};
        double *const out[] = { {{- f.result -}} };
        {{f.name}}_of(in, out);
        status = are_within({{f.result}}, {{f.count}}, DBL_MAX) ? status : {{PREFIX}}OUT_OF_RANGE;
    }
    if (status != {{PREFIX}}OK) {
        put_nan({{f.result}}, {{f.count}});
    }
    return status;
}
{% endfor %}
