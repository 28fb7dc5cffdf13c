/* What the exported C needs of math.h, for a target that has no C library: what is not one instruction is imported. */
#ifndef MATH_H
#define MATH_H

#define NAN __builtin_nan("")
#define INFINITY __builtin_inf()
#define fabs(x) __builtin_fabs(x)
#define copysign(x, y) __builtin_copysign(x, y)
#define sqrt(x) __builtin_sqrt(x)

double atan2(double y, double x);
double cos(double x);
double sin(double x);

#endif
