/* Known answers for {{prefix}}kinematics.c, computed by spm_pin. Exits with 0 if all agree.

   {{origin}} */

#include "{{prefix}}kinematics.h"

#include <math.h>
#include <stdio.h>

#define CASES {{positions|length}}
#define IS_DRAWN {{is_nominal|int}}
/* What contraction of products and sums, and another math library, may change. */
#define TOLERANCE 1e-10

static const double rotations[CASES][9] = {
{{table(rotations)}}
};
static const double positions[CASES][3] = {
{{table(positions)}}
};
/* Readings of all branches; NAN where one is not real. */
static const double branch_readings[CASES][48] = {
{{table(branch_readings)}}
};
/* Of the physical branch, as all that follows; 0 where there is none. */
static const double physical_joints[CASES][9] = {
{{table(joints)}}
};
{% for f, known in answers %}
{% for name, x in f.arguments.items() %}
static const double {{f.name}}_{{name}}[{{x.size}}] = { {{- numbers(x) -}} };
{% endfor %}
static const double {{f.name}}_answers[CASES][{{f.count}}] = {
{{table(known)}}
};
{% endfor %}

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
        printf("wrong: %s of case %d: %s (%d), not %s (%d)\n", what, which, {{prefix}}status_name(found), found,
                {{prefix}}status_name(expected), expected);
        ++wrong;
    }
}

static void check_branches(int n)
{
    {{prefix}}branches branches;
    int branch, some = 0, status = {{prefix}}all_branches(&{{prefix}}machine, rotations[n], positions[n], &branches);
    if (!IS_DRAWN) {
        expect("all branches", n, status, {{PREFIX}}BAD_GEOMETRY);
        return;
    }
    for (branch = 0; branch < 8; ++branch) {
        const double *readings = branch_readings[n] + 6 * branch;
        int is_real = !isnan(readings[0]);
        some = some || is_real;
        ++compared;
        if (branches.real[branch] != is_real) {
            printf("wrong: branch %s of case %d is %s\n", {{prefix}}branch_names[branch], n, is_real ? "real" : "not real");
            ++wrong;
        } else if (is_real) {
            compare({{prefix}}branch_names[branch], n, branches.readings[branch], readings, 6);
        }
    }
    expect("all branches", n, status, some ? {{PREFIX}}OK : {{PREFIX}}UNREACHABLE);
}

static void check_case(int n)
{
    const {{prefix}}geometry *machine = &{{prefix}}machine;
    {{prefix}}state state, again;
    double numbers[36];
    int status = {{prefix}}inverse(machine, rotations[n], positions[n], 0, &state);
    if (physical_joints[n][1] == 0.0) {
        expect("inverse", n, status, {{PREFIX}}UNREACHABLE);
        return;
    }
    expect("inverse", n, status, {{PREFIX}}OK);
    compare("ball joints", n, state.joints, physical_joints[n], 9);
    expect("forward", n, {{prefix}}forward(machine, state.readings, 0, &again), {{PREFIX}}OK);
    compare("position", n, again.position, positions[n], 3);
    compare("rotation", n, again.rotation, rotations[n], 9);
    expect("forward, near", n, {{prefix}}forward(machine, state.readings, &again, &again), {{PREFIX}}OK);
    compare("position, near", n, again.position, positions[n], 3);
    expect("inverse, near", n, {{prefix}}inverse(machine, rotations[n], positions[n], &again, &again), {{PREFIX}}OK);
    compare("ball joints, near", n, again.joints, physical_joints[n], 9);
{% for f, _ in answers %}
    expect("{{f.name}}", n, {{prefix}}{{f.name}}(machine, &state, {% for name in f.arguments %}{{f.name}}_{{name}}, {% endfor %}numbers), {{PREFIX}}OK);
    compare("{{f.name}}", n, numbers, {{f.name}}_answers[n], {{f.count}});
{% endfor %}
}

static void check_errors(void)
{
    const {{prefix}}geometry *machine = &{{prefix}}machine;
    {{prefix}}geometry none = *machine;
    const double level[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    const double mirror[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0};
    const double high[3] = {0.0, 0.0, {{height}}}, beyond[3] = {0.0, 0.0, 1e160};
    const double unknown[3] = {0.0, 0.0, NAN}, readings[6] = {1e300, 1.0, 1.0, 1.0, 1.0, 1.0};
    {{prefix}}branches branches;
    {{prefix}}state state;
    none.dimensions[2] = 0.0;
    expect("level", -1, {{prefix}}all_branches(machine, level, high, &branches),
            IS_DRAWN ? {{PREFIX}}DEGENERATE : {{PREFIX}}BAD_GEOMETRY);
    expect("far away", -1, {{prefix}}inverse(machine, level, beyond, 0, &state), {{PREFIX}}OUT_OF_RANGE);
    expect("NaN", -1, {{prefix}}inverse(machine, level, unknown, 0, &state), {{PREFIX}}NOT_FINITE);
    expect("reflection", -1, {{prefix}}inverse(machine, mirror, high, 0, &state), {{PREFIX}}NOT_A_ROTATION);
    expect("no geometry", -1, {{prefix}}inverse(&none, level, high, 0, &state), {{PREFIX}}BAD_GEOMETRY);
    expect("far reading", -1, {{prefix}}forward(machine, readings, 0, &state), {{PREFIX}}OUT_OF_RANGE);
}

int main(void)
{
    int n;
    for (n = 0; n < CASES; ++n) {
        check_branches(n);
        check_case(n);
    }
    check_errors();
    printf("%d numbers and statuses of %d poses compared, %d wrong (spm_pin " {{PREFIX}}VERSION ")\n", compared,
            CASES, wrong);
    return wrong != 0;
}
