/* Known answers for {{file}}.h, computed by spm_pin. Exits with 0 if all agree.

   {{origin}} */

#include "{{file}}.h"

#include <stdio.h>

#define CASES {{answers|length}}
#ifdef {{PREFIX}}DOUBLE
#define TOLERANCE 1e-12
#else
#define TOLERANCE 1e-5f
#endif

/* Of each case the normal and the height; x and y of the centre; the readings. */
static const {{prefix}}real cases[CASES][9] = {
{% for row in answers %}
    { {{- reals(row) -}} }{{"," if not loop.last}}
{% endfor %}
};

/* What errors are relative to: of readings and of places. */
static const {{prefix}}real reading_size = {{PREFIX}}R({{reading_size}}), size = {{PREFIX}}R({{size}});

static int compared, wrong;

static void compare(const char *what, int which, {{prefix}}real result, {{prefix}}real expected, {{prefix}}real scale)
{
    {{prefix}}real error = (result - expected) / scale;
    ++compared;
    if (!(error <= TOLERANCE && -error <= TOLERANCE)) {
        printf("wrong: %s of case %d\n", what, which);
        ++wrong;
    }
}

static void expect(const char *what, int which, int status, int expected)
{
    ++compared;
    if (status != expected) {
        printf("wrong: %s of case %d: status %d, not %d\n", what, which, status, expected);
        ++wrong;
    }
}

static void compare_place(const char *what, int which, const {{prefix}}state *state)
{
    int k;
    for (k = 0; k < 3; ++k) {
        compare(what, which, state->rotation[3 * k + 2], cases[which][k], 1);
        compare(what, which, state->position[k], k < 2 ? cases[which][4 + k] : cases[which][3], size);
        compare(what, which, state->readings[k], cases[which][6 + k], reading_size);
    }
}

int main(void)
{
    const {{prefix}}geometry *machine = &{{prefix}}machine;
    const {{prefix}}real zero = 0, turned[3] = {0, 0, -1}, none[3] = {0, 0, 0}, unknown[3] = {({{prefix}}real)NAN, 0, 0};
    {{prefix}}state home, state;
    int n;
    expect("home", 0, {{prefix}}tilt(machine, zero, zero, machine->home_height, &home), {{PREFIX}}OK);
    for (n = 0; n < CASES && wrong == 0; ++n) {
        expect("inverse", n, {{prefix}}inverse(machine, cases[n], cases[n][3], &state), {{PREFIX}}OK);
        compare_place("inverse", n, &state);
        expect("forward", n, {{prefix}}forward(machine, cases[n] + 6, &home, &state), {{PREFIX}}OK);
        compare_place("forward", n, &state);
        expect("forward, near", n, {{prefix}}forward(machine, home.readings, &state, &state), {{PREFIX}}OK);
        compare("height, near", n, state.position[2], home.position[2], size);
    }
    state = home;
    expect("upside down", 0, {{prefix}}inverse(machine, turned, home.position[2], &state), {{PREFIX}}UNREACHABLE);
    expect("no normal", 0, {{prefix}}inverse(machine, none, home.position[2], &state), {{PREFIX}}BAD_INPUT);
    expect("a normal of NaN", 0, {{prefix}}inverse(machine, unknown, home.position[2], &state), {{PREFIX}}BAD_INPUT);
    expect("readings of NaN", 0, {{prefix}}forward(machine, unknown, &home, &state), {{PREFIX}}BAD_INPUT);
    home.readings[0] = ({{prefix}}real)NAN;
    expect("a state of NaN", 0, {{prefix}}forward(machine, cases[0] + 6, &home, &state), {{PREFIX}}BAD_INPUT);
    printf("%d numbers and statuses compared, %d wrong (spm_pin {{version}})\n", compared, wrong);
    return wrong != 0;
}
