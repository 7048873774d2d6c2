#include "kernels.h"

struct table { /* n columns; rows: x, y, the line's, layer's and feature's number, begins, ways */
    const float *values;
    int64_t rows, n;
};

static const float *row(struct table of, int64_t k) { return of.values + of.n * k; }

/* Return whether in each of some rows b is as near to the line from a to c as ``most``. */
static int near_line(struct table of, int64_t low, int64_t high, int64_t a, int64_t b, int64_t c,
                     float share, float most)
{
    for (int64_t k = low; k < high; k++) {
        const float *at = row(of, k);
        if (!(fabsf(at[b] - at[a] - share * (at[c] - at[a])) <= most))
            return 0;
    }
    return 1;
}

/* Return whether piece b may be joined to the next one, c; a is the one before. */
static int straight(struct table of, int64_t numbers, int64_t ways, int64_t a, int64_t b, int64_t c,
                    float length2, float near, float off)
{
    const float *x = row(of, X), *y = row(of, Y);
    const int32_t *begins = (const int32_t *)row(of, ways - 1);
    float dx = x[c] - x[a], dy = y[c] - y[a], square = dx * dx + dy * dy;
    float share = (x[b] - x[a]) * dx + (y[b] - y[a]) * dy;
    share /= square > 1e-12f ? square : 1e-12f;
    if (!(square <= length2 && share >= 0.0f && share <= 1.0f) || begins[b] || begins[c])
        return 0;
    for (int64_t k = numbers; k < ways - 1; k++) {
        const int32_t *number = (const int32_t *)row(of, k);
        if (number[b] != number[c])
            return 0;
    }
    return near_line(of, X, Z, a, b, c, share, near) &&
           near_line(of, ways, of.rows, a, b, c, share, off);
}

/* kept (n): the pieces that are left, whose number is returned, once neighbours were joined pair by
 * pair, up to ``passes`` times. values (rows, n); the numbers from row ``numbers`` on must be alike;
 * ``ways`` is the first row of the ways off the path. */
static int64_t joined_pieces(const float *values, int64_t rows, int64_t n, int64_t numbers,
                             int64_t ways, double length2, double near, double off, int64_t passes,
                             int64_t *kept)
{
    struct table of = {values, rows, n};
    int64_t count = n;
    for (int64_t k = 0; k < n; k++)
        kept[k] = k;
    for (; passes > 0 && count > 2; passes--) {
        int64_t left = 1, apart = 0, a = kept[0], b = kept[1], before = count;
        for (int64_t k = 1; k < before - 1; k++) {
            int64_t c = kept[k + 1];
            int joined = 0;
            if (straight(of, numbers, ways, a, b, c, (float)length2, (float)near, (float)off))
                joined = (k - apart) % 2 == 1;
            else
                apart = k;
            if (!joined)
                kept[left++] = b;
            a = b, b = c;
        }
        kept[left++] = b;
        count = left;
        if (8 * (before - left) < left)
            break;
    }
    return count;
}

LOOP(joined_pieces, SINGLES(0, COUNT(1) * COUNT(2)), WITHIN(1, 2, MOST_FEW), COUNT(2), COUNT(3),
     WITHIN(4, 1, COUNT(1)), REAL(5), REAL(6), REAL(7), WHOLE(8), OUT_INTEGERS(9, COUNT(2)))
