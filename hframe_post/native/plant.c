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

LOOP(sliding_sums, FLOATS(0, COUNT(1)), COUNT(1), FLOATS(2, COUNT(1) - 1 + COUNT(3)), COUNT(3),
     OUT_FLOATS(4, COUNT(3)))
