/* Inverse displacement as one would write it first: the four quadratics, pose after pose, in plain C.

   The yardstick of the benchmarks, compiled there with -O3 -march=native. Formulas and their derivation are those of
   docs/theory/inverse_displacement.md, from top to bottom. Nothing is vectorised by hand, and two special cases are
   left out: where the two Z axes are parallel to rounding, the status is DEGENERATE without further inquiry.

   Compiled as C++ with COUNT_OPERATIONS, the same text counts its floating-point operations. */

#include <math.h>
#include <stdint.h>

#ifdef COUNT_OPERATIONS
#include "counted.hpp"
#else
typedef double real;
#endif

enum { OK = 0, UNREACHABLE = 1, DEGENERATE = 2 };

typedef struct {
    real re, im;
} pair; /* a horizontal vector, or half of a quaternion, as a complex number */

typedef struct {
    real x, y, z;               /* o */
    real c[3][3];               /* c_1, c_2, c_3 in {B} */
    pair s;                     /* the quaternion is (s, w) */
    pair s_unit, w_unit;        /* s and w, scaled to modulus one */
    real cosine, sine;          /* |s| and |w|: of half the tilt */
    pair normal, normal_m;      /* the common normal of the two Z axes, seen from {B} and from {m} */
    real h;                     /* their distance along it */
    real noise;                 /* what a form may be by rounding alone */
} pose;

static const double ROUNDING = 64.0 * 2.220446049250313e-16;
static const double COS[3] = {0.86602540378443865, 0.0, -0.86602540378443865}; /* azimuths of the legs */
static const double SIN[3] = {-0.5, 1.0, -0.5};

static inline pair times(pair a, pair b)
{
    pair product = {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
    return product;
}

static inline pair scaled(pair a, real factor)
{
    pair product = {a.re * factor, a.im * factor};
    return product;
}

static inline pair conjugate(pair a)
{
    pair mirrored = {a.re, -a.im};
    return mirrored;
}

static inline real length(real x, real y, real z) { return sqrt(x * x + y * y + z * z); }

/* Shepperd's method: from the largest of the four components to the others. */
static inline void quaternion(const real R[3][3], pair *s, pair *w)
{
    const real trace = R[0][0] + R[1][1] + R[2][2];
    real q[4];
    int i = 3;
    real largest = trace;
    for (int k = 0; k < 3; k++)
        if (R[k][k] > largest) largest = R[k][k], i = k;
    if (i == 3) {
        const real root = sqrt(1.0 + trace), factor = 0.5 / root;
        q[3] = 0.5 * root;
        for (int k = 0; k < 3; k++) {
            const int j = (k + 1) % 3, l = (k + 2) % 3;
            q[k] = (R[l][j] - R[j][l]) * factor;
        }
    } else {
        const int j = (i + 1) % 3, l = (i + 2) % 3;
        const real root = sqrt(1.0 + R[i][i] - R[j][j] - R[l][l]), factor = 0.5 / root;
        q[i] = 0.5 * root;
        q[3] = (R[l][j] - R[j][l]) * factor;
        q[j] = (R[j][i] + R[i][j]) * factor;
        q[l] = (R[l][i] + R[i][l]) * factor;
    }
    s->re = q[3], s->im = q[2], w->re = q[0], w->im = q[1];
}

/* What the four families share. Returns 0 where the two Z axes are parallel. */
static inline int prepare(const double *matrix, real platform_radius, real r, pose *p)
{
    real R[3][3];
    pair w;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) R[i][j] = matrix[4 * i + j];
    p->x = matrix[3], p->y = matrix[7], p->z = matrix[11];
    for (int k = 0; k < 3; k++) {
        const real cx = platform_radius * COS[k], cy = platform_radius * SIN[k];
        p->c[k][0] = p->x + R[0][0] * cx + R[0][1] * cy;
        p->c[k][1] = p->y + R[1][0] * cx + R[1][1] * cy;
        p->c[k][2] = p->z + R[2][0] * cx + R[2][1] * cy;
    }
    quaternion(R, &p->s, &w);
    p->cosine = sqrt(p->s.re * p->s.re + p->s.im * p->s.im);
    p->sine = sqrt(w.re * w.re + w.im * w.im);
    if (p->cosine * p->sine <= ROUNDING) return 0;
    p->s_unit = scaled(p->s, 1.0 / p->cosine);
    p->w_unit = scaled(w, 1.0 / p->sine);
    p->normal = times(p->s_unit, p->w_unit);
    p->normal_m = times(conjugate(p->s_unit), p->w_unit);
    p->h = p->normal.re * p->x + p->normal.im * p->y;
    p->noise = ROUNDING * (r + sqrt(p->x * p->x + p->y * p->y) / (p->cosine * p->sine));
    return 1;
}

/* One family's two branches: modes T and F of the stages are +1 and -1, `turn` is S' / S, `first` says which root is
   the branch +. Returns its status: OK where the two are real. */
static inline int family(const pose *p, real base_radius, real r, int lower, int upper, pair turn, int first,
                         double *joints, double *lengths)
{
    /* The sign of the quaternion is free: that with kappa >= 0. */
    pair turned = times(p->s, turn), axis = p->w_unit, twist = p->s_unit;
    if (turned.re < 0.0)
        turned = scaled(turned, -1.0), axis = scaled(axis, -1.0), twist = scaled(twist, -1.0);
    const real kappa = turned.re, mu = turned.im;
    const real one_minus = (p->sine * p->sine + mu * mu) / (1.0 + kappa); /* 1 - kappa, without cancellation */
    const real scale_u = sqrt(0.5 / (1.0 + kappa)), scale_v = sqrt(0.5 / one_minus);
    const pair f = {(1.0 + kappa) * scale_u, mu * scale_u}, g = {one_minus * scale_v, -(mu * scale_v)};

    /* The form in (u, v), u^2 + v^2 = 1. */
    const pair cubed = times(times(axis, axis), axis);
    const pair side = {-(r * twist.im), r * twist.re};
    const pair ff = times(side, times(f, f)), fg = times(side, times(f, g)), gg = times(side, times(g, g));
    real uu, uv, vv;
    if (lower == upper) {
        const real even = 2.0 * lower * cubed.re, odd = 2.0 * lower * cubed.im;
        uu = even * ff.re - p->h, uv = odd * fg.im, vv = even * gg.re - p->h;
    } else {
        const real even = -2.0 * upper * cubed.im, odd = -2.0 * upper * cubed.re;
        uu = even * ff.im - p->h, uv = odd * fg.re, vv = even * gg.im - p->h;
    }
    if (fabs(uu) <= p->noise && fabs(uv) <= p->noise && fabs(vv) <= p->noise) return DEGENERATE;
    const real discriminant = uv * uv - uu * vv;
    if (!(discriminant >= 0.0)) return UNREACHABLE;
    const real root = sqrt(discriminant);

    const pair quarter_lower = {0.0, -1.0}, quarter_upper = {0.0, 1.0};
    const pair lower_axis = upper > 0 ? axis : times(axis, quarter_lower);
    const pair upper_axis = lower > 0 ? conjugate(axis) : times(conjugate(axis), quarter_upper);
    for (int branch = 0; branch < 2; branch++) {
        const real signed_root = branch == first ? root : -root;
        /* Both pairs solve the form; the longer one is free of cancellation. */
        const real u1 = signed_root - uv, v1 = uu, u2 = vv, v2 = -uv - signed_root;
        const real square1 = u1 * u1 + v1 * v1, square2 = u2 * u2 + v2 * v2;
        const int longer = square1 >= square2;
        const real unit = 1.0 / sqrt(longer ? square1 : square2);
        const real u = (longer ? u1 : u2) * unit, v = (longer ? v1 : v2) * unit;

        /* The middle platform's quaternions (P, a) from {B} and (Q, b) from {m}. */
        const real P = p->sine * (v * scale_v + u * scale_u);
        const pair from_b = {g.re * v - f.re * u, g.im * v - f.im * u};
        const pair from_m = {g.re * v + f.re * u, g.im * v + f.im * u};
        const pair a = times(lower_axis, from_b), b = times(upper_axis, from_m);

        /* Its centre: horizontal in either frame, then the height in {B}. */
        const real lower_x = -2.0 * r * a.re * a.im, lower_y = r * (a.im * a.im - a.re * a.re);
        const real upper_x = 2.0 * r * b.re * b.im, upper_y = r * (b.im * b.im - b.re * b.re);
        const real along = p->normal.im * (lower_x - p->x) - p->normal.re * (lower_y - p->y);
        const real along_m = p->normal_m.im * upper_x - p->normal_m.re * upper_y;
        const real cos_tilt = p->cosine * p->cosine - p->sine * p->sine, sin_tilt = 2.0 * p->sine * p->cosine;
        const real height = p->z + (cos_tilt * along - along_m) / sin_tilt;

        double *joint = joints + 9 * branch, *leg = lengths + 6 * branch;
        for (int k = 0; k < 3; k++) {
            const real azimuthal = (a.re * a.re - a.im * a.im) * SIN[k] + 2.0 * a.re * a.im * COS[k];
            const real radius = r * (lower * P * P - 2.0 * azimuthal);
            const real lift = lower > 0 ? a.re * SIN[k] - a.im * COS[k] : a.re * COS[k] + a.im * SIN[k];
            const real x = radius * COS[k], y = radius * SIN[k], z = height + 2.0 * r * P * lift;
            joint[3 * k] = (double)x, joint[3 * k + 1] = (double)y, joint[3 * k + 2] = (double)z;
            leg[k] = (double)length(radius - base_radius, 0.0, z);
            leg[3 + k] = (double)length(p->c[k][0] - x, p->c[k][1] - y, p->c[k][2] - z);
        }
    }
    return OK;
}

/* Poses (n, 4, 4) to ball joints (n, 8, 3, 3) and leg lengths (n, 8, 6) [m], NaN where a branch is not real, in the
   order TT+ TT- TF+ TF- FT+ FT- FF+ FF-, and to a status (n,). */
#ifdef __cplusplus
extern "C"
#endif
void inverse_displacement(int64_t n, const double *poses, double base_radius, double platform_radius,
                          double middle_radius, double *joints, double *lengths, int8_t *status)
{
    static const int LOWER[4] = {1, 1, -1, -1}, UPPER[4] = {1, -1, 1, -1}, FIRST[4] = {0, 1, 1, 0};
    static const double TURN[4][2] = {{1.0, 0.0}, {0.0, 1.0}, {0.0, -1.0}, {1.0, 0.0}};
    for (int64_t i = 0; i < n; i++, poses += 16, joints += 72, lengths += 48) {
        pose p;
        const int crossed = prepare(poses, platform_radius, middle_radius, &p);
        status[i] = crossed ? UNREACHABLE : DEGENERATE;
        for (int k = 0; k < 4; k++) {
            const pair turn = {TURN[k][0], TURN[k][1]};
            double *b = joints + 18 * k, *leg = lengths + 12 * k;
            const int answer = crossed ? family(&p, base_radius, middle_radius, LOWER[k], UPPER[k], turn, FIRST[k],
                                                b, leg)
                                       : UNREACHABLE;
            if (answer == OK) {
                if (status[i] == UNREACHABLE) status[i] = OK;
                continue;
            }
            if (answer == DEGENERATE) status[i] = DEGENERATE;
            for (int j = 0; j < 18; j++) b[j] = NAN;
            for (int j = 0; j < 12; j++) leg[j] = NAN;
        }
    }
}
