/* What the machine can do at best: bandwidth to memory, and throughput of the units a kernel is made of.

   Vectors are GCC's and Clang's own extension; the compiler splits them where the machine's are shorter. */

#include <stdint.h>

#define LANES 8
typedef double lanes __attribute__((vector_size(8 * LANES)));

/* McCalpin's STREAM triad: three arrays pass through the memory. */
void triad(int64_t n, double *restrict a, const double *restrict b, const double *restrict c, double scale)
{
    for (int64_t i = 0; i < n; i++) a[i] = b[i] + scale * c[i];
}

/* Writing alone, as solvers do whose answer is larger than the question. */
void fill(int64_t n, double *restrict a, double value)
{
    for (int64_t i = 0; i < n; i++) a[i] = value + (double)i;
}

/* Independent chains of fused multiply-adds, as many as hide their latency: 2 x 8 x LANES operations a turn. */
double multiply_add(int64_t turns, double start)
{
    lanes sums[8];
    const lanes factor = (lanes){} + 0.9999999, term = (lanes){} + 1e-7;
    for (int k = 0; k < 8; k++) sums[k] = (lanes){} + (start + k);
    for (int64_t i = 0; i < turns; i++)
        for (int k = 0; k < 8; k++) sums[k] = sums[k] * factor + term;
    double total = 0.0;
    for (int k = 0; k < 8; k++)
        for (int l = 0; l < LANES; l++) total += sums[k][l];
    return total;
}

/* Divisions, and square roots, in an array that stays in the cache: n each turn. */
void divide(int64_t turns, int64_t n, double *restrict a)
{
    for (int64_t k = 0; k < turns; k++)
        for (int64_t i = 0; i < n; i++) a[i] = 1.5 / a[i];
}

void square_root(int64_t turns, int64_t n, double *restrict a)
{
    for (int64_t k = 0; k < turns; k++)
        for (int64_t i = 0; i < n; i++) a[i] = __builtin_sqrt(a[i] + 0.5);
}
