/* A controller's loop on a machine that it knows only by its model: each tick a pose is turned into six readings, which
 * the true machine goes to. Prints the errors of the platform's position [m], one line a tick.
 *
 * cc -std=c99 -O2 -Ispm_c follow_path.c spm_c/spm_kinematics.c -lm -o follow_path
 * ./follow_path MODEL TRUE POSES, two files as spm_machine.txt, and rows of a rotation (9 numbers) and a position.
 *
 * SPDX-License-Identifier: BSD-2-Clause
 */

#include "spm_read_machine.h"

#include <math.h>

int main(int count, char **names)
{
    spm_geometry model, machine;
    spm_state wanted, state;
    double row[12];
    const char *error = NULL;
    FILE *poses = count == 4 ? fopen(names[3], "r") : NULL;
    int i, tick, status = SPM_OK;
    if (!poses || (error = spm_read_machine(names[1], &model)) || (error = spm_read_machine(names[2], &machine))) {
        fprintf(stderr, "follow_path: %s\n", error ? error : "expected two machines and poses");
        return 2;
    }
    for (tick = 0; status == SPM_OK; ++tick) {
        const double *position = row + 9;
        for (i = 0; i < 12 && fscanf(poses, "%lf", row + i) == 1; ++i) {
        }
        if (i < 12) {
            break;
        }
        /* The first pose by the rule, all others from the last state: no branch is ever changed. */
        status = spm_inverse(&model, row, position, tick ? &wanted : NULL, &wanted);
        if (status == SPM_OK) {
            status = spm_forward(&machine, wanted.readings, tick ? &state : NULL, &state);
        }
        if (status == SPM_OK) {
            const double x = state.position[0] - position[0], y = state.position[1] - position[1];
            const double z = state.position[2] - position[2];
            printf("%.17g\n", sqrt(x * x + y * y + z * z));
        }
    }
    fclose(poses);
    if (status != SPM_OK) {
        fprintf(stderr, "follow_path: tick %d: %s\n", tick, spm_status_name(status));
    }
    return status != SPM_OK;
}
