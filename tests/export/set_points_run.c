/* Runs the board's side of a serial line for tests: bytes in, readings out. */

#include "set_points.h"

static set_points points;

/* With `readings` as the state to begin at, which limits do not bind, or at home without. */
int begin(stage_real rate, stage_real acceleration, stage_real patience, const stage_real *readings)
{
    stage_state home;
    int status = stage_tilt(&stage_machine, 0, 0, stage_machine.home_height, &home);
    if (status == STAGE_OK && readings) {
        status = stage_forward(&stage_machine, readings, &home, &home);
    }
    if (status == STAGE_OK) {
        set_points_begin(&points, &stage_machine, &home, rate, acceleration, patience);
    }
    return status;
}

/* In each tick `counts` bytes come, and then the command moves on by a time; returns how many frames were answered. */
int run(long ticks, const uint8_t *bytes, const int *counts, const stage_real *times, stage_real *readings, int *status,
        uint8_t *answers)
{
    int answered = 0, i;
    long tick;
    for (tick = 0; tick < ticks; ++tick) {
        for (i = 0; i < counts[tick]; ++i) {
            answered += set_points_take(&points, *bytes++, answers + ANSWER_SIZE * answered);
        }
        set_points_move(&points, times[tick]);
        for (i = 0; i < 3; ++i) {
            readings[3 * tick + i] = points.state.readings[i];
        }
        status[tick] = points.status;
    }
    return answered;
}
