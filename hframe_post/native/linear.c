/* A sum starts at zero and takes its terms in order; several sums
 * are computed at once, never several terms of one. */

#include <string.h>

#include "kernels.h"

enum { TOGETHER = 4 }; /* rows of a sum, and terms of each, that are added at once */

/* Add to some rows of sum (n) as many terms each: those of a, which begin ``step`` apart, times b (n). */
INSIDE void add_terms(const double *a, int64_t step, int rows, int terms, const double *b, int64_t n,
                      double *restrict sum)
{
    for (int64_t j = 0; j < n; j++)
        for (int i = 0; i < rows; i++) {
            double so_far = sum[i * n + j];
            for (int r = 0; r < terms; r++)
                so_far += a[i * step + r] * b[r * n + j];
            sum[i * n + j] = so_far;
        }
}

/* Add to sum (m, n) rows of k terms. */
INSIDE void add_product(const double *a, int64_t step, int64_t m, const double *b, int64_t k, int64_t n,
                        double *restrict sum)
{
    for (int64_t r = 0; r < k;) {
        int64_t i = 0, all = r + TOGETHER <= k;
        for (; all && i + TOGETHER <= m; i += TOGETHER)
            add_terms(a + i * step + r, step, TOGETHER, TOGETHER, b + r * n, n, sum + i * n);
        for (; all && i < m; i++)
            add_terms(a + i * step + r, step, 1, TOGETHER, b + r * n, n, sum + i * n);
        for (; i < m; i++)
            add_terms(a + i * step + r, step, 1, 1, b + r * n, n, sum + i * n);
        r += all ? TOGETHER : 1;
    }
}

/* out (m, n) = a b (k, n), where row i of a (m, k) begins at i·step. */
WIDE static int64_t products(const double *a, int64_t step, int64_t m, const double *b, int64_t k,
                             int64_t n, double *out)
{
    memset(out, 0, sizeof(double) * (size_t)(m * n));
    add_product(a, step, m, b, k, n, out);
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
        add_product(s, 0, 1, M, d, n, next);
        for (int64_t j = 0; j < n; j++)
            next[j] += w[j];
    }
    return m;
}

LOOP(recursion, FLOATS(0, 0), FLOATS(1, ROWS(1) * WIDTH(0)), ROWS(1), ROWS(0), WIDTH(0), FLOATS(2, ROWS(0)),
     NEW_FLOATS(0, ROWS(0) + ROWS(1) * WIDTH(0)))
