/* Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator; see the header.

   @ORIGIN@

   The functions at the end check arguments and call those before, which were translated from the Python kernels of
   spm_pin operation by operation: where the compiler contracts no products and sums, the bits of the results are the
   same. Each says which function it was. A tile of problems is one problem wide here. */

#include "@PREFIX@kinematics.h"

#include <math.h>

typedef struct { double re, im; } complex_number;

static complex_number complex_of(double re, double im)
{
    complex_number z;
    z.re = re;
    z.im = im;
    return z;
}

static complex_number complex_sum(complex_number a, complex_number b)
{
    return complex_of(a.re + b.re, a.im + b.im);
}

static complex_number complex_difference(complex_number a, complex_number b)
{
    return complex_of(a.re - b.re, a.im - b.im);
}

static complex_number complex_product(complex_number a, complex_number b)
{
    return complex_of(a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re);
}

static complex_number complex_ratio(complex_number a, complex_number b)
{
    double ratio, denominator;
    if (fabs(b.re) >= fabs(b.im)) {
        ratio = b.im / b.re;
        denominator = b.re + b.im * ratio;
        return complex_of((a.re + a.im * ratio) / denominator, (a.im - a.re * ratio) / denominator);
    }
    ratio = b.re / b.im;
    denominator = b.re * ratio + b.im;
    return complex_of((a.re * ratio + a.im) / denominator, (a.im * ratio - a.re) / denominator);
}

static int complex_differ(complex_number a, complex_number b)
{
    return a.re != b.re || a.im != b.im;
}

static double number_square(double x)
{
    return x * x;
}

static double number_maximum(double a, double b)
{
    return b > a ? b : a;
}

static double number_minimum(double a, double b)
{
    return b < a ? b : a;
}

/* As Python has it: of the sign of b. */
static double number_modulo(double a, double b)
{
    double rest = fmod(a, b);
    return rest != 0.0 && (rest < 0.0) != (b < 0.0) ? rest + b : rest;
}

static int index_maximum(int a, int b)
{
    return b > a ? b : a;
}

static int index_minimum(int a, int b)
{
    return b < a ? b : a;
}

@KERNELS@
#define EXACT @EXACT@
#define SINGULAR_RATIO @SINGULAR@
#define ROUNDED 1e-6
#define OPEN_SEED 1e-6
#define LARGEST_LENGTH 1e5
#define VERTICAL @VERTICAL@

const @PREFIX@geometry @PREFIX@machine = {
    @BASE_RADIUS@, @PLATFORM_RADIUS@, @MIDDLE_SIDE@,
    {@MINIMUM@},
    {@MAXIMUM@}
};

const char *const @PREFIX@branch_names[8] = {"TT+", "TT-", "TF+", "TF-", "FT+", "FT-", "FF+", "FF-"};

const char *@PREFIX@status_name(int status)
{
    switch (status) {
    case @PREFIX_UPPER@OK: return "ok";
    case @PREFIX_UPPER@UNREACHABLE: return "unreachable";
    case @PREFIX_UPPER@DEGENERATE: return "degenerate";
    case @PREFIX_UPPER@NOT_PHYSICAL: return "not physical";
    case @PREFIX_UPPER@SINGULAR: return "singular";
    case @PREFIX_UPPER@NOT_FINITE: return "not finite";
    case @PREFIX_UPPER@NOT_A_ROTATION: return "not a rotation";
    case @PREFIX_UPPER@BAD_LENGTH: return "bad length";
    case @PREFIX_UPPER@BAD_GEOMETRY: return "bad geometry";
    case @PREFIX_UPPER@BAD_SEED: return "bad seed";
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

static int are_finite(const double *numbers, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        if (!isfinite(numbers[i])) {
            return 0;
        }
    }
    return 1;
}

static int is_dimension(double length)
{
    return length >= 1e-9 && length <= 1e9;
}

static int check_geometry(const @PREFIX@geometry *geometry)
{
    int i;
    for (i = 0; i < 6; ++i) {
        if (!(geometry->minimum[i] >= 0.0 && geometry->minimum[i] < geometry->maximum[i])) {
            return @PREFIX_UPPER@BAD_GEOMETRY;
        }
    }
    return is_dimension(geometry->base_radius) && is_dimension(geometry->platform_radius)
            && is_dimension(geometry->middle_side) ? @PREFIX_UPPER@OK : @PREFIX_UPPER@BAD_GEOMETRY;
}

/* The circumradius of the middle platform. */
static double middle_radius(const @PREFIX@geometry *geometry)
{
    return geometry->middle_side / sqrt(3.0);
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

static int read_pose(const double *rotation, const double *position, double *r, double *o)
{
    int turn;
    if (!are_finite(rotation, 9) || !are_finite(position, 3)) {
        return @PREFIX_UPPER@NOT_FINITE;
    }
    copy(rotation, r, 9);
    copy(position, o, 3);
    if (@are_rigid@(r, o, EXACT)) {
        return @PREFIX_UPPER@OK;
    }
    for (turn = 0; turn < 2; ++turn) {
        double products[9], from[9], error = products_of_columns(r, products);
        int i, j;
        if (!(error <= ROUNDED)) {
            return @PREFIX_UPPER@NOT_A_ROTATION;
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
            > 0.0 ? @PREFIX_UPPER@OK : @PREFIX_UPPER@NOT_A_ROTATION;
}

static int solve_branches(const @PREFIX@geometry *geometry, double *r, double *o, @PREFIX@branches *branches)
{
    double rotation[9], position[3];
    unsigned char choice[3], flagged;
    signed char status;
    int branch;
    @all_branches@(r, o, middle_radius(geometry), geometry->base_radius, geometry->platform_radius, rotation, position,
            branches->joints[0], branches->lengths[0], branches->discriminants, choice, &status, &flagged);
    for (branch = 0; branch < 8; ++branch) {
        branches->real[branch] = !isnan(branches->joints[branch][0]);
    }
    if (flagged & VERTICAL) {
        unsigned char families[4];
        signed char dimension;
        @continuous_families@(r, o, middle_radius(geometry), families, &dimension);
        return dimension > 0 ? @PREFIX_UPPER@DEGENERATE : @PREFIX_UPPER@UNREACHABLE;
    }
    return flagged ? @PREFIX_UPPER@DEGENERATE : status;
}

int @PREFIX@inverse(const @PREFIX@geometry *geometry, const double rotation[9], const double position[3],
        @PREFIX@branches *branches)
{
    double r[9], o[3];
    int branch, status = check_geometry(geometry);
    if (status == @PREFIX_UPPER@OK) {
        status = read_pose(rotation, position, r, o);
    }
    if (status == @PREFIX_UPPER@OK) {
        return solve_branches(geometry, r, o, branches);
    }
    for (branch = 0; branch < 8; ++branch) {
        put_nan(branches->joints[branch], 9);
        put_nan(branches->lengths[branch], 6);
        branches->real[branch] = 0;
    }
    put_nan(branches->discriminants, 4);
    return status;
}

static void put_state_nan(@PREFIX@state *state)
{
    put_nan(state->rotation, 9);
    put_nan(state->position, 3);
    put_nan(state->joints, 9);
    put_nan(state->lengths, 6);
}

int @PREFIX@inverse_physical(const @PREFIX@geometry *geometry, const double rotation[9], const double position[3],
        @PREFIX@state *state)
{
    double r[9], o[3], limits[12];
    int status = check_geometry(geometry);
    if (status == @PREFIX_UPPER@OK) {
        status = read_pose(rotation, position, r, o);
    }
    if (status != @PREFIX_UPPER@OK) {
        put_state_nan(state);
        return status;
    }
    copy(geometry->minimum, limits, 6);
    copy(geometry->maximum, limits + 6, 6);
    @physical_branches@(r, o, middle_radius(geometry), geometry->base_radius, geometry->platform_radius, limits,
            state->rotation, state->position, state->joints, state->lengths);
    if (isnan(state->joints[0])) {
        @PREFIX@branches branches;
        status = solve_branches(geometry, r, o, &branches);
        return status == @PREFIX_UPPER@OK ? @PREFIX_UPPER@NOT_PHYSICAL : status;
    }
    return @PREFIX_UPPER@OK;
}

/* Write the revolute joints of a stage, in the plane of the platform they are on. */
static void put_revolute_joints(double radius, double joints[9])
{
    double x = sqrt(0.75) * radius, y = -0.5 * radius;
    joints[0] = x, joints[1] = y, joints[2] = 0.0;
    joints[3] = 0.0, joints[4] = radius, joints[5] = 0.0;
    joints[6] = -x, joints[7] = y, joints[8] = 0.0;
}

/* Write the leg vectors, a_i to b_i and then b_i to c_i, and return the length of the shortest. */
static void put_legs(const @PREFIX@geometry *geometry, const @PREFIX@state *state, double legs[18], double lengths[6])
{
    double base[9], platform[9];
    const double *r = state->rotation;
    int i, j;
    put_revolute_joints(geometry->base_radius, base);
    put_revolute_joints(geometry->platform_radius, platform);
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j) {
            double b = state->joints[3 * i + j];
            legs[3 * i + j] = b - base[3 * i + j];
            legs[9 + 3 * i + j] = state->position[j] + r[3 * j] * platform[3 * i] + r[3 * j + 1] * platform[3 * i + 1] - b;
        }
    }
    for (i = 0; i < 6; ++i) {
        const double *leg = legs + 3 * i;
        lengths[i] = sqrt(leg[0] * leg[0] + leg[1] * leg[1] + leg[2] * leg[2]);
    }
}

/* Write the axes of the revolute joints, of the lower legs and then of the upper. */
static void put_axes(const double *r, double axes[18])
{
    const double x[3] = {0.5, 1.0, -0.5}, y[3] = {sqrt(0.75), 0.0, sqrt(0.75)};
    int i, j;
    for (i = 0; i < 3; ++i) {
        axes[3 * i] = x[i], axes[3 * i + 1] = y[i], axes[3 * i + 2] = 0.0;
        for (j = 0; j < 3; ++j) {
            axes[9 + 3 * i + j] = r[3 * j] * x[i] + r[3 * j + 1] * y[i];
        }
    }
}

static int is_state_finite(const @PREFIX@state *state)
{
    return are_finite(state->rotation, 9) && are_finite(state->position, 3) && are_finite(state->joints, 9);
}

/* Return whether the ball joints are in the planes of all legs, and d apart. */
static int closes(const @PREFIX@geometry *geometry, const @PREFIX@state *state)
{
    double axes[18], legs[18], lengths[6], largest = 0.0;
    int i;
    put_axes(state->rotation, axes);
    put_legs(geometry, state, legs, lengths);
    for (i = 0; i < 6; ++i) {
        const double *a = axes + 3 * i, *leg = legs + 3 * i;
        largest = fmax(largest, fabs(a[0] * leg[0] + a[1] * leg[1] + a[2] * leg[2]));
    }
    for (i = 0; i < 3; ++i) {
        const double *b = state->joints + 3 * i, *next = state->joints + 3 * ((i + 1) % 3);
        double x = b[0] - next[0], y = b[1] - next[1], z = b[2] - next[2];
        largest = fmax(largest, fabs(sqrt(x * x + y * y + z * z) - geometry->middle_side));
    }
    return largest <= OPEN_SEED * geometry->middle_side;
}

/* Follow both stages of a seed to leg lengths; return whether both arrived. */
static int follow(const @PREFIX@geometry *geometry, double *lengths, const @PREFIX@state *seed, @PREFIX@state *state)
{
    const double *rotation = seed->rotation;
    double size = middle_radius(geometry), start[6], end[6], corners[18], legs[18], seeds[8], ends[8], stages[2][5];
    double epsilon[2];
    unsigned char half_turned[2], arrived[2];
    int i, j;
    put_legs(geometry, seed, legs, start);
    for (i = 0; i < 6; ++i) {
        start[i] /= size;
        end[i] = lengths[i] / size;
    }
    for (i = 0; i < 3; ++i) {
        const double *b = seed->joints + 3 * i, *o = seed->position;
        for (j = 0; j < 3; ++j) {
            corners[3 * i + j] = b[j];
            corners[9 + 3 * i + j] = (b[0] - o[0]) * rotation[j] + (b[1] - o[1]) * rotation[3 + j]
                    + (b[2] - o[2]) * rotation[6 + j];
        }
    }
    @stage_states@(corners, size, seeds, half_turned);
    epsilon[0] = (half_turned[0] ? -1.0 : 1.0) * geometry->base_radius / size;
    epsilon[1] = (half_turned[1] ? -1.0 : 1.0) * geometry->platform_radius / size;
    @follow_stages@(start, end, epsilon, seeds, ends, arrived);
    for (i = 0; i < 2; ++i) {
        const double *x = ends + 4 * i;
        stages[i][0] = half_turned[i] ? 0.0 : x[0];
        stages[i][1] = half_turned[i] ? x[2] : x[1];
        stages[i][2] = half_turned[i] ? -x[1] : x[2];
        stages[i][3] = half_turned[i] ? x[0] : 0.0;
        stages[i][4] = half_turned[i] ? -x[3] : x[3];
    }
    @compose_all@(stages[0], stages[1], size, state->rotation, state->position, state->joints);
    return arrived[0] && arrived[1];
}

int @PREFIX@forward_physical(const @PREFIX@geometry *geometry, const double lengths[6], const @PREFIX@state *seed,
        @PREFIX@state *state)
{
    double largest = LARGEST_LENGTH * (geometry->base_radius + geometry->platform_radius + geometry->middle_side);
    double q[6], legs[18];
    int i, status = check_geometry(geometry);
    copy(lengths, q, 6);
    for (i = 0; i < 6 && status == @PREFIX_UPPER@OK; ++i) {
        if (!isfinite(q[i])) {
            status = @PREFIX_UPPER@NOT_FINITE;
        } else if (!(q[i] > 0.0 && q[i] <= largest)) {
            status = @PREFIX_UPPER@BAD_LENGTH;
        }
    }
    if (status == @PREFIX_UPPER@OK && seed) {
        @PREFIX@state from = *seed;
        status = !is_state_finite(&from) ? @PREFIX_UPPER@NOT_FINITE
                : !closes(geometry, &from) ? @PREFIX_UPPER@BAD_SEED
                : follow(geometry, q, &from, state) ? @PREFIX_UPPER@OK : @PREFIX_UPPER@SINGULAR;
    } else if (status == @PREFIX_UPPER@OK) {
        double r = middle_radius(geometry);
        unsigned char found;
        @home_modes@(q, r, geometry->base_radius, geometry->platform_radius, state->rotation, state->position,
                state->joints, &found);
        if (!found) {
            @home_modes_of_all@(q, r, geometry->base_radius, geometry->platform_radius, state->rotation,
                    state->position, state->joints);
        }
        status = isnan(state->joints[0]) ? @PREFIX_UPPER@UNREACHABLE : @PREFIX_UPPER@OK;
    }
    if (status != @PREFIX_UPPER@OK) {
        put_state_nan(state);
        return status;
    }
    put_legs(geometry, state, legs, state->lengths);
    return @PREFIX_UPPER@OK;
}

/* Return whether six forces through the ball joints are dependent to rounding; arms in units of d. */
static int are_dependent(const @PREFIX@geometry *geometry, const @PREFIX@state *state, const double *first,
        const double *second)
{
    double rows[36], values[6];
    int i;
    for (i = 0; i < 6; ++i) {
        const double *f = i < 3 ? first + 3 * i : second + 3 * (i - 3), *b = state->joints;
        double arm[3], *row = rows + 6 * i;
        int j;
        for (j = 0; j < 3; ++j) {
            arm[j] = (b[3 * (i % 3) + j] - (b[j] + b[3 + j] + b[6 + j]) / 3.0) / geometry->middle_side;
            row[j] = f[j];
        }
        row[3] = arm[1] * f[2] - arm[2] * f[1];
        row[4] = arm[2] * f[0] - arm[0] * f[2];
        row[5] = arm[0] * f[1] - arm[1] * f[0];
    }
    @singular_values@(rows, values);
    return values[5] <= SINGULAR_RATIO * values[0];
}

/* Decide about a state that may be singular. */
static int is_singular(const @PREFIX@geometry *geometry, const @PREFIX@state *state, int forward)
{
    double axes[18], legs[18], lengths[6];
    int i, j;
    put_axes(state->rotation, axes);
    put_legs(geometry, state, legs, lengths);
    for (i = 0; i < 6; ++i) {
        if (!(lengths[i] > 0.0)) {
            return 1;
        }
        for (j = 0; j < 3; ++j) {
            legs[3 * i + j] /= lengths[i];
        }
    }
    if (!forward) {
        return are_dependent(geometry, state, axes, axes + 9);
    }
    return are_dependent(geometry, state, legs, axes) || are_dependent(geometry, state, legs + 9, axes + 9);
}

int @PREFIX@inverse_jacobian(const @PREFIX@geometry *geometry, const @PREFIX@state *state, double jacobian[36])
{
    @PREFIX@state s = *state;
    unsigned char suspect;
    int status = check_geometry(geometry);
    if (status == @PREFIX_UPPER@OK && !is_state_finite(&s)) {
        status = @PREFIX_UPPER@NOT_FINITE;
    }
    if (status == @PREFIX_UPPER@OK) {
        @inverse_jacobians@(s.joints, s.rotation, s.position, geometry->base_radius, geometry->platform_radius,
                geometry->middle_side, SINGULAR_RATIO, jacobian, &suspect);
        if (suspect && is_singular(geometry, &s, 0)) {
            status = @PREFIX_UPPER@SINGULAR;
        }
    }
    if (status != @PREFIX_UPPER@OK) {
        put_nan(jacobian, 36);
    }
    return status;
}

int @PREFIX@leg_forces(const @PREFIX@geometry *geometry, const @PREFIX@state *state, const double wrench[6],
        double forces[6])
{
    @PREFIX@state s = *state;
    double load[6];
    unsigned char suspect;
    int status = check_geometry(geometry);
    copy(wrench, load, 6);
    if (status == @PREFIX_UPPER@OK && !(is_state_finite(&s) && are_finite(load, 6))) {
        status = @PREFIX_UPPER@NOT_FINITE;
    }
    if (status == @PREFIX_UPPER@OK) {
        @stage_forces@(s.joints, s.rotation, s.position, load, geometry->base_radius, geometry->platform_radius,
                geometry->middle_side, SINGULAR_RATIO, forces, &suspect);
        if (suspect && is_singular(geometry, &s, 1)) {
            status = @PREFIX_UPPER@SINGULAR;
        }
    }
    if (status != @PREFIX_UPPER@OK) {
        put_nan(forces, 6);
    }
    return status;
}
