/* Reading the `@PREFIX@machine.txt` of an export: one build serves any machine.
 *
 * SPDX-License-Identifier: BSD-2-Clause
 */

#ifndef @PREFIX_UPPER@READ_MACHINE_H
#define @PREFIX_UPPER@READ_MACHINE_H

#include "@PREFIX@kinematics.h"

#include <stdio.h>
#include <string.h>

/* Read a file of seven lines, each with its name first, in this order; returns whether it describes a machine. */
static int @PREFIX@read_machine(const char *path, @PREFIX@geometry *geometry)
{
    double *const fields[7] = {
        geometry->dimensions, geometry->axes, geometry->pivots, geometry->balls, geometry->offsets, geometry->minimum,
        geometry->maximum
    };
    const char *const names[7] = {"dimensions", "axes", "pivots", "balls", "offsets", "minimum", "maximum"};
    const int counts[7] = {3, 18, 18, 18, 6, 6, 6};
    const double level[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, origin[3] = {0.0, 0.0, 0.0};
    FILE *file = fopen(path, "r");
    @PREFIX@state state;
    char name[16];
    int k, i, is_whole = file != NULL;
    for (k = 0; k < 7 && is_whole; ++k) {
        is_whole = fscanf(file, "%15s", name) == 1 && strcmp(name, names[k]) == 0;
        for (i = 0; i < counts[k] && is_whole; ++i) {
            is_whole = fscanf(file, "%lf", fields[k] + i) == 1;
        }
    }
    if (file) {
        fclose(file);
    }
    return is_whole && @PREFIX@inverse(geometry, level, origin, NULL, &state) != @PREFIX_UPPER@BAD_GEOMETRY;
}

#endif
