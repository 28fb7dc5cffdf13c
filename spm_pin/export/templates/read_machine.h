/* Reading the `{{prefix}}machine.txt` of an export: one build serves any machine.
 *
 * SPDX-License-Identifier: BSD-2-Clause
 */

#ifndef {{PREFIX}}READ_MACHINE_H
#define {{PREFIX}}READ_MACHINE_H

#include "{{header}}"

#include <errno.h>
#include <stdio.h>
#include <string.h>

/* The first line of the files that are read here. */
#define {{PREFIX}}MACHINE_FILE "{{machine_file}}"

/* Read a file: the line above, and then one for each member of a geometry, its name first. Returns NULL, or what is wrong,
   and then the geometry is not to be used. */
static const char *{{prefix}}read_machine(const char *path, {{prefix}}geometry *geometry)
{
    static const struct { const char *name; size_t count; } fields[] = {
        {%+ for name, x in fields.items() %}{"{{name}}", {{x.size}}}{{", " if not loop.last}}{% endfor %}

    };
    FILE *file = fopen(path, "r");
    double *to = {{numbers}}; /* the members from here on are numbers alone */
    {{prefix}}state state;
    char first[sizeof {{PREFIX}}MACHINE_FILE + 2] = "", name[16];
    size_t k, i;
    int is_whole = 1;
    if (!file) {
        return strerror(errno);
    }
    if (fgets(first, (int)sizeof first, file)) {
        first[strcspn(first, "\r\n")] = '\0';
    }
    if (strcmp(first, {{PREFIX}}MACHINE_FILE) != 0) {
        fclose(file);
        return "not a machine file of this kind and version: its first line is not '" {{PREFIX}}MACHINE_FILE "'";
    }
    for (k = 0; k < sizeof fields / sizeof fields[0] && is_whole; ++k) {
        is_whole = fscanf(file, "%15s", name) == 1 && strcmp(name, fields[k].name) == 0;
        for (i = 0; i < fields[k].count && is_whole; ++i) {
            is_whole = fscanf(file, "%lf", to++) == 1;
        }
    }
    is_whole = is_whole && fscanf(file, "%15s", name) == EOF;
    fclose(file);
    if (!is_whole) {
        return "not whole: a line or a number is missing, spoiled or too many";
    }
    return {{is_machine}} ? NULL : "numbers that are no machine";
}

#endif
