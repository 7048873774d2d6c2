#include <string.h>

#include "kernels.h"

enum { BLOCK = 32 }; /* sums that are computed together, in registers */

/* BLOCK sums of the m factors in turn, each times a number of u. */
INSIDE void sum_block(const double *factors, int64_t m, const double *u, double *sums)
{
    double sum[BLOCK] = {0.0};
    for (int64_t i = 0; i < m; i++)
        for (int k = 0; k < BLOCK; k++)
            sum[k] += factors[i] * u[i + k];
    memcpy(sums, sum, sizeof sum);
}

/* sums (n), zero at first: of the m factors in turn, each times a number of u; from one sum to the
 * next these go on by one. The last block overlaps with the one before. */
WIDE static int64_t sliding_sums(const double *factors, int64_t m, const double *u, int64_t n,
                                 double *sums)
{
    for (int64_t i = 0; i < m && n < BLOCK; i++)
        for (int64_t k = 0; k < n; k++)
            sums[k] += factors[i] * u[i + k];
    for (int64_t k = 0; k < n && n >= BLOCK; k += BLOCK) {
        int64_t at = k + BLOCK <= n ? k : n - BLOCK;
        sum_block(factors, m, u + at, sums + at);
    }
    return n;
}

/* Output y (n) of a finite filter at the last samples of its input u (h): taps (m), that of the oldest
 * acceleration first, then rest times the input ``late`` samples before, less its speed times lag.
 * room (n + m - 1). */
static int64_t finite_filter(const double *taps, int64_t m, const double *u, int64_t h, int64_t n,
                             int64_t late, double rest, double lag, double *room, double *y)
{
    const double *from = u + h - n - m - 1, *then = u + h - n - late;
    for (int64_t i = 0; i < n + m - 1; i++)
        room[i] = (from[i + 2] - from[i + 1]) - (from[i + 1] - from[i]);
    memset(y, 0, sizeof(double) * (size_t)n);
    sliding_sums(taps, m, room, n, y);
    for (int64_t i = 0; i < n; i++)
        y[i] += rest * then[i];
    for (int64_t i = 0; i < n && lag != 0.0; i++)
        y[i] -= lag * (then[i] - then[i - 1]);
    return n;
}

LOOP(finite_filter, FLOATS(0, COUNT(1)), WITHIN(1, 1, MOST_ITEMS), FLOATS(2, COUNT(3)),
     WITHIN(3, COUNT(4) + greater(COUNT(1), WITHIN(5, 0, MOST_FEW)) + 1, MOST_ITEMS), COUNT(4),
     WITHIN(5, 0, MOST_FEW), REAL(6), REAL(7), OUT_FLOATS(8, COUNT(4) + COUNT(1) - 1),
     OUT_FLOATS(9, COUNT(4)))

LOOP(sliding_sums, FLOATS(0, COUNT(1)), COUNT(1), FLOATS(2, COUNT(1) - 1 + COUNT(3)), COUNT(3),
     OUT_FLOATS(4, COUNT(3)))
