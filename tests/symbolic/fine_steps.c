/* Ways followed in many equal parts, one step of Newton's method in each: no control of steps, no proof of contraction.
   Only the equations are those of the exported source. */

#include "spm_kinematics.c"

static void follow_finely(const way *w, int parts, double *balls)
{
    equations e;
    double rows[42];
    int part, i, j;
    for (part = 1; part <= parts; ++part) {
        evaluate(w, (double)part / parts, balls, &e);
        for (i = 0; i < 6; ++i) {
            copy(e.jacobian + 6 * i, rows + 7 * i, 6);
            rows[7 * i + 6] = -e.errors[i];
        }
        (void)eliminate(rows, 7);
        for (j = 0; j < 6; ++j) {
            balls[j] += rows[7 * j + 6];
        }
    }
    if (!solve(w, 1.0, INFINITY, balls)) {
        put_nan(balls, 6);
    }
}

void follow_pose(long count, int parts, const spm_geometry *g, const spm_state *start, const double *shift,
        const double *turn, spm_state *ends)
{
    long n;
    for (n = 0; n < count; ++n) {
        way w = {0};
        double lower[6], upper[6], tilts;
        int i;
        w.geometry = g;
        w.kind = CLOSURE;
        copy(start[n].rotation, w.rotation, 9);
        copy(start[n].position, w.position, 3);
        copy(shift + 3 * n, w.shift, 3);
        copy(turn + 3 * n, w.turn, 3);
        w.angle = sqrt(w.turn[0] * w.turn[0] + w.turn[1] * w.turn[1] + w.turn[2] * w.turn[2]);
        turned(&w, 1.0 - DBL_EPSILON, w.end);
        (void)read_near(g, start + n, lower, upper);
        follow_finely(&w, parts, lower);
        copy(w.end, ends[n].rotation, 9);
        for (i = 0; i < 3; ++i) {
            ends[n].position[i] = w.position[i] + w.shift[i];
        }
        put_lower_balls(g, lower, ends[n].joints);
        (void)complete(g, ends + n, &tilts);
    }
}

void follow_readings(long count, int parts, const spm_geometry *g, const spm_state *start, const double *change,
        spm_state *ends)
{
    long n;
    for (n = 0; n < count; ++n) {
        double balls[2][6];
        int stage, leg;
        (void)read_near(g, start + n, balls[0], balls[1]);
        for (stage = 0; stage < 2; ++stage) {
            way w = {0};
            w.geometry = g;
            w.kind = stage;
            for (leg = 0; leg < 3; ++leg) {
                w.lengths[leg] = start[n].readings[3 * stage + leg] - g->offsets[3 * stage + leg];
                w.change[leg] = change[6 * n + 3 * stage + leg];
            }
            follow_finely(&w, parts, balls[stage]);
        }
        (void)join(g, balls[0], balls[1], ends + n);
    }
}
