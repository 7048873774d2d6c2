/* The loops of planner/lookahead.py. */

#include "kernels.h"

/* Return the greatest speed reached from v0 within a length. */
static double reachable(double v0, double length, double a, double jerk)
{
    double b = v0 / a + a / (2.0 * jerk), c = length - v0 * a / jerk;
    double full = a * (sqrt(greater(b * b + 2.0 * c / a, 0.0)) - b), least = a * a / jerk;
    if (full >= least)
        return v0 + full;
    double q = length * sqrt(jerk), p = greater(2.0 * v0, 1e-12);
    double fourth = sqrt(sqrt(q)), sixteenth = sqrt(sqrt(fourth));
    double u = lesser(fourth * sixteenth * sqrt(sqrt(sixteenth)), q / p);
    for (int step = 0; step < 5; step++)
        u = (2.0 * u * u * u + q) / (3.0 * u * u + p);
    return v0 + lesser(u * u, least);
}

/* Lower speed (r + 1) along the chain of runs to what can be reached from its start, or its end. new
 * (r + 1), all set: from which speeds that must be found. They are taken in rounds as numpy takes
 * them, since rounding may find a slightly higher speed from a lower one. */
static int64_t lower(double *speed, const double *length, const double *acceleration, int64_t r,
                     double jerk, int64_t from_end, uint8_t *new)
{
    int64_t step = from_end ? -1 : 1, count = r;
    while (count) {
        count = 0;
        for (int64_t i = r - 1; i >= 0; i--) {
            int64_t k = from_end ? r - i : i, run = from_end ? k - 1 : k;
            if (!new[k])
                continue;
            double top = reachable(speed[k], length[run], acceleration[run], jerk);
            new[k] = 0;
            if (top < speed[k + step])
                speed[k + step] = top, new[k + step] = 1, count++;
        }
    }
    return r;
}

LOOP(lower, OUT_FLOATS(0, WHOLE(3) + 1), FLOATS(1, WHOLE(3)), FLOATS(2, WHOLE(3)), WHOLE(3), REAL(4),
     WHOLE(5), OUT_BYTES(6, WHOLE(3) + 1))
