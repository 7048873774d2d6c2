/* The loops of planner/sampling.py and planner/profiles.py. */

#include "kernels.h"

/* phases (6, p): start time, duration, path length, speed, acceleration, jerk. Path lengths s (n)
 * at samples first, first + 1, … of ``interval`` s, within 0 … end. */
static int64_t path_lengths(const double *phases, int64_t p, int64_t first, int64_t n,
                              double interval, double end, double *s)
{
    const double *time = phases, *duration = phases + p, *s0 = phases + 2 * p,
                 *v = phases + 3 * p, *a = phases + 4 * p, *j = phases + 5 * p;
    int64_t k = 0;
    for (int64_t i = 0; i < n; i++) {
        double t = interval * (double)(first + i);
        while (k + 1 < p && time[k + 1] <= t)
            k++;
        double dt = lesser(t - time[k], duration[k]);
        double cubic = a[k] / 2.0 + dt * j[k] / 6.0;
        s[i] = lesser(greater(s0[k] + dt * (v[k] + dt * cubic), 0.0), end);
    }
    return n;
}

LOOP(path_lengths, FLOATS(0, 6 * WHOLE(1)), WHOLE(1), WHOLE(2), WHOLE(3), REAL(4), REAL(5),
     OUT_FLOATS(6, WHOLE(3)))

/* lengths (m + 1): path length at the vertices, points (m + 1, 4). Places xyze (n, 4) at s (n) and
 * the move (n) that each lies on. */
static int64_t follow(const double *lengths, const double *points, int64_t m, const double *s,
                        int64_t n, double *xyze, int64_t *move)
{
    int64_t k = 0;
    for (int64_t i = 0; i < n; i++) {
        while (k + 1 < m && lengths[k + 1] <= s[i])
            k++;
        while (k > 0 && lengths[k] > s[i])
            k--;
        double share = (s[i] - lengths[k]) / (lengths[k + 1] - lengths[k]);
        const double *from = points + COLUMNS * k, *to = from + COLUMNS;
        for (int c = 0; c < COLUMNS; c++)
            xyze[COLUMNS * i + c] = from[c] + share * (to[c] - from[c]);
        move[i] = k;
    }
    return n;
}

LOOP(follow, FLOATS(0, WHOLE(2) + 1), FLOATS(1, COLUMNS * (WHOLE(2) + 1)), WHOLE(2), FLOATS(3, WHOLE(4)),
     WHOLE(4), OUT_FLOATS(5, COLUMNS * WHOLE(4)), OUT_INTEGERS(6, WHOLE(4)))
