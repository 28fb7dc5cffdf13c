/* Known answers for @PREFIX@kinematics.c, computed by spm_pin. Exits with 0 if all agree.

   @ORIGIN@ */

#include "@PREFIX@kinematics.h"

#include <math.h>
#include <stdio.h>

#define CASES @COUNT@
/* What contraction of products and sums, and another math library, may change. */
#define TOLERANCE 1e-10

static const double rotations[CASES][9] = {
@ROTATIONS@
};
static const double positions[CASES][3] = {
@POSITIONS@
};
/* Of all branches; 0 where one is not real. */
static const double branch_lengths[CASES][8][6] = {
@BRANCH_LENGTHS@
};
/* Of the physical branch, as all that follows; 0 where there is none. */
static const double physical_joints[CASES][9] = {
@JOINTS@
};
static const double jacobians[CASES][36] = {
@JACOBIANS@
};
static const double wrench[6] = {@WRENCH@};
static const double forces[CASES][6] = {
@FORCES@
};

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

static void check_case(int n)
{
    const @PREFIX@geometry *machine = &@PREFIX@machine;
    @PREFIX@branches branches;
    @PREFIX@state state, again, followed;
    double numbers[36];
    int branch, some = 0;
    int status = @PREFIX@inverse(machine, rotations[n], positions[n], &branches);
    for (branch = 0; branch < 8; ++branch) {
        int is_real = branch_lengths[n][branch][0] > 0.0;
        some = some || is_real;
        ++compared;
        if (branches.real[branch] != is_real) {
            printf("wrong: branch %s of case %d is %s\n", @PREFIX@branch_names[branch], n, is_real ? "real" : "not real");
            ++wrong;
        } else if (is_real) {
            compare(@PREFIX@branch_names[branch], n, branches.lengths[branch], branch_lengths[n][branch], 6);
        }
    }
    expect("inverse", n, status, some ? @PREFIX_UPPER@OK : @PREFIX_UPPER@UNREACHABLE);
    status = @PREFIX@inverse_physical(machine, rotations[n], positions[n], &state);
    if (physical_joints[n][1] == 0.0) {
        expect("physical inverse", n, status, some ? @PREFIX_UPPER@NOT_PHYSICAL : @PREFIX_UPPER@UNREACHABLE);
        return;
    }
    expect("physical inverse", n, status, @PREFIX_UPPER@OK);
    compare("ball joints", n, state.joints, physical_joints[n], 9);
    expect("forward", n, @PREFIX@forward_physical(machine, state.lengths, 0, &again), @PREFIX_UPPER@OK);
    compare("position", n, again.position, positions[n], 3);
    compare("rotation", n, again.rotation, rotations[n], 9);
    expect("forward from a seed", n, @PREFIX@forward_physical(machine, state.lengths, &state, &followed),
            @PREFIX_UPPER@OK);
    compare("position from a seed", n, followed.position, positions[n], 3);
    expect("inverse Jacobian", n, @PREFIX@inverse_jacobian(machine, &state, numbers), @PREFIX_UPPER@OK);
    compare("inverse Jacobian", n, numbers, jacobians[n], 36);
    expect("leg forces", n, @PREFIX@leg_forces(machine, &state, wrench, numbers), @PREFIX_UPPER@OK);
    compare("leg forces", n, numbers, forces[n], 6);
}

static void check_errors(void)
{
    const @PREFIX@geometry *machine = &@PREFIX@machine, none = {0.0, 0.0, 0.0, {0.0}, {0.0}};
    const double level[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    const double mirror[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0};
    const double high[3] = {0.0, 0.0, @HEIGHT@}, aside[3] = {@HEIGHT@, 0.0, @HEIGHT@};
    const double unknown[3] = {0.0, 0.0, NAN}, lengths[6] = {-1.0, 1.0, 1.0, 1.0, 1.0, 1.0};
    @PREFIX@branches branches;
    @PREFIX@state state;
    expect("level on the axis", -1, @PREFIX@inverse(machine, level, high, &branches), @PREFIX_UPPER@DEGENERATE);
    expect("level off the axis", -1, @PREFIX@inverse(machine, level, aside, &branches), @PREFIX_UPPER@UNREACHABLE);
    expect("NaN", -1, @PREFIX@inverse(machine, level, unknown, &branches), @PREFIX_UPPER@NOT_FINITE);
    expect("reflection", -1, @PREFIX@inverse_physical(machine, mirror, high, &state), @PREFIX_UPPER@NOT_A_ROTATION);
    expect("no geometry", -1, @PREFIX@inverse_physical(&none, level, high, &state), @PREFIX_UPPER@BAD_GEOMETRY);
    expect("negative length", -1, @PREFIX@forward_physical(machine, lengths, 0, &state), @PREFIX_UPPER@BAD_LENGTH);
}

int main(void)
{
    int n;
    for (n = 0; n < CASES; ++n) {
        check_case(n);
    }
    check_errors();
    printf("%d numbers and statuses of %d poses compared, %d wrong (spm_pin " @PREFIX_UPPER@VERSION ")\n", compared,
            CASES, wrong);
    return wrong != 0;
}
