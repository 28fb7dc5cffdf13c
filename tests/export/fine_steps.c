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
        double lower[6], upper[9], tilts;
        int i;
        w.geometry = g;
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
        double balls[2][9], coordinates[6], readings[6], e[9], size;
        int stage, leg, part;
        (void)read_near(g, start + n, coordinates, balls[1]);
        copy(start[n].joints, balls[0], 9);
        for (part = 1; part <= parts; ++part) {
            circles here[2];
            for (leg = 0; leg < 6; ++leg) {
                readings[leg] = start[n].readings[leg] + change[6 * n + leg] * part / parts;
            }
            put_circles(g, readings, here);
            for (stage = 0; stage < 2; ++stage) {
                const circles *c = &here[stage];
                const double *const from[] = {balls[stage], c->axes, c->centres}, *const to[] = {e, c->centres, c->radii};
                const double *const in[] = {e, c->axes, c->centres, c->radii, c->squares};
                double *const directions[] = {e}, *const out[] = {e, &size}, *const moved[] = {balls[stage]};
                directions_to(from, directions);
                newton_step(in, out);
                balls_at(to, moved);
                if (part == parts && !solve_stage(c, balls[stage])) {
                    put_nan(balls[stage], 9);
                }
            }
        }
        (void)join(g, balls[0], balls[1], readings, ends + n);
    }
}
