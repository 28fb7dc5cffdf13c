/* Known answers for stage.h, computed by spm_pin. Exits with 0 if all agree.

   @ORIGIN@ */

#include "stage.h"

#include <stdio.h>

#define CASES @CASES@
#ifdef STAGE_DOUBLE
#define TOLERANCE 1e-12
#else
#define TOLERANCE 1e-5f
#endif

/* Of each case the normal and the height; x and y of the centre; the readings. */
static const stage_real cases[CASES][9] = {
@ANSWERS@
};

/* What errors are relative to: of readings and of places. */
static const stage_real reading_size = STAGE_R(@READING_SIZE@), size = STAGE_R(@SIZE@);

static int compared, wrong;

static void compare(const char *what, int which, stage_real result, stage_real expected, stage_real scale)
{
    stage_real error = (result - expected) / scale;
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

static void compare_place(const char *what, int which, const stage_state *state)
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
    const stage_geometry *machine = &stage_machine;
    const stage_real zero = 0, turned[3] = {0, 0, -1}, none[3] = {0, 0, 0}, unknown[3] = {(stage_real)NAN, 0, 0};
    stage_state home, state;
    int n;
    expect("home", 0, stage_tilt(machine, zero, zero, machine->home_height, &home), STAGE_OK);
    for (n = 0; n < CASES && wrong == 0; ++n) {
        expect("inverse", n, stage_inverse(machine, cases[n], cases[n][3], &state), STAGE_OK);
        compare_place("inverse", n, &state);
        expect("forward", n, stage_forward(machine, cases[n] + 6, &home, &state), STAGE_OK);
        compare_place("forward", n, &state);
        expect("forward, near", n, stage_forward(machine, home.readings, &state, &state), STAGE_OK);
        compare("height, near", n, state.position[2], home.position[2], size);
    }
    state = home;
    expect("upside down", 0, stage_inverse(machine, turned, home.position[2], &state), STAGE_UNREACHABLE);
    expect("no normal", 0, stage_inverse(machine, none, home.position[2], &state), STAGE_BAD_INPUT);
    expect("a normal of NaN", 0, stage_inverse(machine, unknown, home.position[2], &state), STAGE_BAD_INPUT);
    expect("readings of NaN", 0, stage_forward(machine, unknown, &home, &state), STAGE_BAD_INPUT);
    home.readings[0] = (stage_real)NAN;
    expect("a state of NaN", 0, stage_forward(machine, cases[0] + 6, &home, &state), STAGE_BAD_INPUT);
    printf("%d numbers and statuses compared, %d wrong (spm_pin @VERSION@)\n", compared, wrong);
    return wrong != 0;
}
