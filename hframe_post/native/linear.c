/* The loops of model/linear.py. A sum starts at zero and takes its terms in order; several sums
 * are computed at once, never several terms of one. */

#include "kernels.h"

enum { TILE = 4, STRIP = 8 };

/* TILE rows of a (TILE, k) times as many columns of b (k, n), into the same columns of out. */
static void tile(const double *a, const double *b, int64_t k, int64_t n, double *out)
{
    double sum[TILE][TILE] = {{0.0}};
    for (int64_t r = 0; r < k; r++, b += n)
        for (int i = 0; i < TILE; i++)
            for (int j = 0; j < TILE; j++)
                sum[i][j] += a[i * k + r] * b[j];
    for (int i = 0; i < TILE; i++)
        for (int j = 0; j < TILE; j++)
            out[i * n + j] = sum[i][j];
}

/* One row a (k) times ``width`` columns of b (k, n), at most STRIP. */
static void strip(const double *a, const double *b, int64_t k, int64_t n, int64_t width,
                  double *out)
{
    double sum[STRIP] = {0.0};
    if (width == STRIP)
        for (int64_t r = 0; r < k; r++, b += n)
            for (int j = 0; j < STRIP; j++)
                sum[j] += a[r] * b[j];
    else
        for (int64_t r = 0; r < k; r++, b += n)
            for (int64_t j = 0; j < width; j++)
                sum[j] += a[r] * b[j];
    for (int64_t j = 0; j < width; j++)
        out[j] = sum[j];
}

/* out (m, n) = a (m, k) b (k, n). The last tiles overlap those before them. */
static int64_t product(const double *a, const double *b, int64_t m, int64_t k, int64_t n,
                       double *out)
{
    int64_t high = m < TILE || n < TILE ? 1 : TILE, wide = high == 1 ? STRIP : TILE;
    for (int64_t i = 0; i < m; i += high) {
        int64_t top = i < m - high ? i : m - high;
        for (int64_t j = 0; j < n; j += wide) {
            if (high == 1)
                strip(a + top * k, b + j, k, n, n - j < wide ? n - j : wide, out + top * n + j);
            else {
                int64_t left = j < n - wide ? j : n - wide;
                tile(a + top * k, b + left, k, n, out + top * n + left);
            }
        }
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
