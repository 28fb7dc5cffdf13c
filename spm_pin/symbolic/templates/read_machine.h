/* Reading the `@PREFIX@machine.txt` of an export: one build serves any machine.
 *
 * SPDX-License-Identifier: BSD-2-Clause
 */

#ifndef @PREFIX_UPPER@READ_MACHINE_H
#define @PREFIX_UPPER@READ_MACHINE_H

#include "@HEADER@"

#include <stdio.h>
#include <string.h>

/* Read a file with a line for each member of a geometry, its name first; returns whether it describes a machine with legs
   of the kinds that the export was for. */
static int @PREFIX@read_machine(const char *path, @PREFIX@geometry *geometry)
{
    static const struct { const char *name; size_t count; } fields[] = {
        @FIELDS@
    };
    FILE *file = fopen(path, "r");
    double *to = @NUMBERS@; /* the members from here on are numbers alone */
    @PREFIX@state state;
    char name[16];
    size_t k, i;
    int is_whole = file != NULL;
    for (k = 0; k < sizeof fields / sizeof fields[0] && is_whole; ++k) {
        is_whole = fscanf(file, "%15s", name) == 1 && strcmp(name, fields[k].name) == 0;
        for (i = 0; i < fields[k].count && is_whole; ++i) {
            is_whole = fscanf(file, "%lf", to++) == 1;
        }
    }
    if (is_whole) {
        is_whole = fscanf(file, "%15s", name) == EOF;
    }
    if (file) {
        fclose(file);
    }
    return is_whole && @IS_MACHINE@;
}

#endif
