/* What the exported C needs of math.h, for a target that has no C library: what is not one instruction is imported. */
#ifndef MATH_H
#define MATH_H

#define NAN __builtin_nan("")
#define INFINITY __builtin_inf()
#define isnan(x) __builtin_isnan(x)
#define isfinite(x) __builtin_isfinite(x)
#define fabs(x) __builtin_fabs(x)
#define sqrt(x) __builtin_sqrt(x)
#define rint(x) __builtin_rint(x)

double atan2(double y, double x);
double fmod(double x, double y);
double hypot(double x, double y);
double pow(double x, double y);

static inline double fmax(double x, double y)
{
    return x > y || y != y ? x : y;
}

#endif
