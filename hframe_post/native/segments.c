#include "kernels.h"

static int marked(const uint8_t *forced, int64_t from, int64_t to)
{
    while (from < to && !forced[from])
        from++;
    return from < to;
}

/* places (k, 4), mm, at ``ends`` (k) of points forced (n); per_mm (4): units in a mm; start (4): the
 * place before them, for ``still`` samples. Returns how many segments move; at (k + 1, 4), ended,
 * T and dwell (k): theirs. */
static int64_t motion_segments(const double *places, const int64_t *ends, int64_t k,
                               const uint8_t *forced, int64_t n, const double *per_mm,
                               const int64_t *start, int64_t still, int64_t least_dwell,
                               double interval, int64_t *at, int64_t *ended, double *T,
                               int64_t *dwell)
{
    int64_t count = 0, from = 0, done = -still;
    int extrudes = 0; /* whether what is at rest extrudes with the segment before */
    (void)n;
    for (int c = 0; c < COLUMNS; c++)
        at[c] = start[c];
    for (int64_t i = 0; i < k; from = ends[i++]) {
        int64_t *last = at + COLUMNS * count, *to = last + COLUMNS, idle = from - done;
        for (int c = 0; c < COLUMNS; c++)
            to[c] = (int64_t)rint(places[COLUMNS * i + c] * per_mm[c]);
        if (to[X] == last[X] && to[Y] == last[Y] && to[Z] == last[Z]) {
            extrudes = extrudes && !marked(forced, from, ends[i]);
            if (extrudes)
                last[E] = to[E];
            continue;
        }
        dwell[count] = idle >= least_dwell ? idle : 0;
        T[count] = (double)(ends[i] - from + idle - dwell[count]) * interval;
        ended[count++] = done = ends[i];
        extrudes = 1;
    }
    return count;
}

LOOP(motion_segments, FLOATS(0, COLUMNS * COUNT(2)), INDICES(1, COUNT(2), 0, COUNT(4) + 1), COUNT(2),
     BYTES(3, COUNT(4)), COUNT(4), FLOATS(5, COLUMNS), INTEGERS(6, COLUMNS), WHOLE(7), WHOLE(8), REAL(9),
     OUT_INTEGERS(10, COLUMNS * (COUNT(2) + 1)), OUT_INTEGERS(11, COUNT(2)),
     OUT_FLOATS(12, COUNT(2)), OUT_INTEGERS(13, COUNT(2)))
