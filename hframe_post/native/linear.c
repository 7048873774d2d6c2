/* The loops of model/linear.py. A sum starts at zero and takes its terms in order; several sums
 * are computed at once, never several terms of one. */

#include <string.h>

#include "kernels.h"

enum { BLOCK = 8 }; /* rows of a for which rows of b stay in the cache */

/* out (m, n) = a (m, k) b (k, n) */
WIDE static int64_t product(const double *a, const double *b, int64_t m, int64_t k, int64_t n,
                            double *out)
{
    memset(out, 0, sizeof(double) * (size_t)(m * n));
    for (int64_t top = 0; top < m; top += BLOCK) {
        int64_t end = top + BLOCK < m ? top + BLOCK : m, r = 0;
        for (; r + 4 <= k; r += 4)
            for (int64_t i = top; i < end; i++)
                add_rows(a + i * k + r, b + r * n, n, 0, n, out + i * n);
        for (; r < k; r++)
            for (int64_t i = top; i < end; i++)
                for (int64_t j = 0; j < n; j++)
                    out[i * n + j] += a[i * k + r] * b[r * n + j];
    }
    return m;
}

LOOP(product, FLOATS(0, WHOLE(2) * WHOLE(3)), FLOATS(1, WHOLE(3) * WHOLE(4)), WHOLE(2), WHOLE(3),
     WHOLE(4), OUT_FLOATS(5, WHOLE(2) * WHOLE(4)))

/* s[k + 1] = s[k] M + w[k], for M (d, d), w (n, d), and s (n + 1, d) with the first row given. */
static int64_t recursion(const double *M, const double *w, int64_t n, int64_t d, double *s)
{
    for (int64_t k = 0; k < n; k++, s += d, w += d) {
        product(s, M, 1, d, d, s + d);
        for (int64_t j = 0; j < d; j++)
            s[d + j] += w[j];
    }
    return n;
}

LOOP(recursion, FLOATS(0, WHOLE(3) * WHOLE(3)), FLOATS(1, WHOLE(2) * WHOLE(3)), WHOLE(2), WHOLE(3),
     OUT_FLOATS(4, (WHOLE(2) + 1) * WHOLE(3)))
