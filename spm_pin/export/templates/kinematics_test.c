/* Known answers for @PREFIX@kinematics.c, computed by spm_pin. Exits with 0 if all agree.

   @ORIGIN@ */

#include "@PREFIX@kinematics.h"

#include <math.h>
#include <stdio.h>

#define CASES @CASES@
#define IS_DRAWN @DRAWN@
/* What contraction of products and sums, and another math library, may change. */
#define TOLERANCE 1e-10

static const double rotations[CASES][9] = {
@ROTATIONS@
};
static const double positions[CASES][3] = {
@POSITIONS@
};
/* Readings of all branches; NAN where one is not real. */
static const double branch_readings[CASES][48] = {
@BRANCH_READINGS@
};
/* Of the physical branch, as all that follows; 0 where there is none. */
static const double physical_joints[CASES][9] = {
@JOINTS@
};
@ANSWERS@

static int compared, wrong;

/* Compare numbers relative to the largest. */
static void compare(const char *what, int which, const double *found, const double *expected, int count)
{
    double largest = 0.0, error = 0.0;
    int i;
    for (i = 0; i < count; ++i) {
        largest = fmax(largest, fabs(expected[i]));
        error = fabs(found[i] - expected[i]) > error || isnan(found[i]) ? fabs(found[i] - expected[i]) : error;
    }
    compared += count;
    if (!(error <= TOLERANCE * largest)) {
        printf("wrong: %s of case %d, off by %.1e\n", what, which, error);
        ++wrong;
    }
}

static void expect(const char *what, int which, int found, int expected)
{
    ++compared;
    if (found != expected) {
        printf("wrong: %s of case %d: %s (%d), not %s (%d)\n", what, which, @PREFIX@status_name(found), found,
                @PREFIX@status_name(expected), expected);
        ++wrong;
    }
}

static void check_branches(int n)
{
    @PREFIX@branches branches;
    int branch, some = 0, status = @PREFIX@all_branches(&@PREFIX@machine, rotations[n], positions[n], &branches);
    if (!IS_DRAWN) {
        expect("all branches", n, status, @PREFIX_UPPER@BAD_GEOMETRY);
        return;
    }
    for (branch = 0; branch < 8; ++branch) {
        const double *readings = branch_readings[n] + 6 * branch;
        int is_real = !isnan(readings[0]);
        some = some || is_real;
        ++compared;
        if (branches.real[branch] != is_real) {
            printf("wrong: branch %s of case %d is %s\n", @PREFIX@branch_names[branch], n, is_real ? "real" : "not real");
            ++wrong;
        } else if (is_real) {
            compare(@PREFIX@branch_names[branch], n, branches.readings[branch], readings, 6);
        }
    }
    expect("all branches", n, status, some ? @PREFIX_UPPER@OK : @PREFIX_UPPER@UNREACHABLE);
}

static void check_case(int n)
{
    const @PREFIX@geometry *machine = &@PREFIX@machine;
    @PREFIX@state state, again;
    double numbers[36];
    int status = @PREFIX@inverse(machine, rotations[n], positions[n], 0, &state);
    if (physical_joints[n][1] == 0.0) {
        expect("inverse", n, status, @PREFIX_UPPER@UNREACHABLE);
        return;
    }
    expect("inverse", n, status, @PREFIX_UPPER@OK);
    compare("ball joints", n, state.joints, physical_joints[n], 9);
    expect("forward", n, @PREFIX@forward(machine, state.readings, 0, &again), @PREFIX_UPPER@OK);
    compare("position", n, again.position, positions[n], 3);
    compare("rotation", n, again.rotation, rotations[n], 9);
    expect("forward, near", n, @PREFIX@forward(machine, state.readings, &again, &again), @PREFIX_UPPER@OK);
    compare("position, near", n, again.position, positions[n], 3);
    expect("inverse, near", n, @PREFIX@inverse(machine, rotations[n], positions[n], &again, &again), @PREFIX_UPPER@OK);
    compare("ball joints, near", n, again.joints, physical_joints[n], 9);
@CALLS@}

static void check_errors(void)
{
    const @PREFIX@geometry *machine = &@PREFIX@machine;
    @PREFIX@geometry none = *machine;
    const double level[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    const double mirror[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0};
    const double high[3] = {0.0, 0.0, @HEIGHT@}, beyond[3] = {0.0, 0.0, 1e160};
    const double unknown[3] = {0.0, 0.0, NAN}, readings[6] = {1e300, 1.0, 1.0, 1.0, 1.0, 1.0};
    @PREFIX@branches branches;
    @PREFIX@state state;
    none.dimensions[2] = 0.0;
    expect("level", -1, @PREFIX@all_branches(machine, level, high, &branches),
            IS_DRAWN ? @PREFIX_UPPER@DEGENERATE : @PREFIX_UPPER@BAD_GEOMETRY);
    expect("far away", -1, @PREFIX@inverse(machine, level, beyond, 0, &state), @PREFIX_UPPER@OUT_OF_RANGE);
    expect("NaN", -1, @PREFIX@inverse(machine, level, unknown, 0, &state), @PREFIX_UPPER@NOT_FINITE);
    expect("reflection", -1, @PREFIX@inverse(machine, mirror, high, 0, &state), @PREFIX_UPPER@NOT_A_ROTATION);
    expect("no geometry", -1, @PREFIX@inverse(&none, level, high, 0, &state), @PREFIX_UPPER@BAD_GEOMETRY);
    expect("far reading", -1, @PREFIX@forward(machine, readings, 0, &state), @PREFIX_UPPER@OUT_OF_RANGE);
}

int main(void)
{
    int n;
    for (n = 0; n < CASES; ++n) {
        check_branches(n);
        check_case(n);
    }
    check_errors();
    printf("%d numbers and statuses of %d poses compared, %d wrong (spm_pin " @PREFIX_UPPER@VERSION ")\n", compared,
            CASES, wrong);
    return wrong != 0;
}
