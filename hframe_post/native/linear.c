/* A sum starts at zero and takes its terms in order; several sums
 * are computed at once, never several terms of one. */

#include <string.h>

#include "kernels.h"

enum { TOGETHER = 4, DEEP = 32 }; /* rows of add_rows; rows of b that stay in the cache */

/* Add to sum (n) one row a (k) times b (k, n). */
INSIDE void add_product(const double *a, const double *b, int64_t k, int64_t n, double *restrict sum)
{
    int64_t r = 0;
    for (; r + TOGETHER <= k; r += TOGETHER)
        add_rows(a + r, b + r * n, n, 0, n, sum);
    for (; r < k; r++)
        for (int64_t j = 0; j < n; j++)
            sum[j] += a[r] * b[r * n + j];
}

/* out (m, n) = a b (k, n), where row i of a (m, k) begins at i·step. */
WIDE static int64_t products(const double *a, int64_t step, int64_t m, const double *b, int64_t k,
                             int64_t n, double *out)
{
    memset(out, 0, sizeof(double) * (size_t)(m * n));
    for (int64_t r = 0; r < k; r += DEEP)
        for (int64_t i = 0; i < m; i++)
            add_product(a + i * step + r, b + r * n, k - r < DEEP ? k - r : DEEP, n, out + i * n);
    return m;
}

LOOP(products, FLOATS(0, (COUNT(2) - 1) * COUNT(1) + ROWS(3)), COUNT(1), COUNT(2), FLOATS(3, 0), ROWS(3),
     WIDTH(3), NEW_ROWS(0, COUNT(2), WIDTH(3)))

/* s (d + m n): the d numbers of begin, then n at a time: those d before them times M (d, n), plus a row of
 * w (m, n). */
WIDE static int64_t recursion(const double *M, const double *w, int64_t m, int64_t d, int64_t n,
                              const double *begin, double *s)
{
    memcpy(s, begin, sizeof(double) * (size_t)d);
    for (int64_t k = 0; k < m; k++, s += n, w += n) {
        double *next = s + d;
        for (int64_t j = 0; j < n; j++)
            next[j] = 0.0;
        add_product(s, M, d, n, next);
        for (int64_t j = 0; j < n; j++)
            next[j] += w[j];
    }
    return m;
}

LOOP(recursion, FLOATS(0, 0), FLOATS(1, ROWS(1) * WIDTH(0)), ROWS(1), ROWS(0), WIDTH(0), FLOATS(2, ROWS(0)),
     NEW_FLOATS(0, ROWS(0) + ROWS(1) * WIDTH(0)))
