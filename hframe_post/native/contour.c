/* The loops of prediction/predict.py. */

#include "kernels.h"

/* Return whether the path changes its direction at sample k, which has neighbours. */
static int turns_at(const double *px, const double *py, int64_t k, double straight)
{
    double ax = px[k] - px[k - 1], ay = py[k] - py[k - 1];
    double bx = px[k + 1] - px[k], by = py[k + 1] - py[k];
    double cross = ax * by - ay * bx, dot = ax * bx + ay * by;
    int still = ax == 0.0 && ay == 0.0, still_then = bx == 0.0 && by == 0.0;
    return fabs(cross) > straight * fabs(dot) || dot < 0.0 || still != still_then;
}

struct vector {
    double x, y;
};

static double square(struct vector v) { return v.x * v.x + v.y * v.y; }

/* Return the way to the point from the nearest place on the segment between samples p and q. */
static struct vector from_segment(const double *px, const double *py, double ax, double ay,
                                  int64_t p, int64_t q)
{
    double dx = px[q] - px[p], dy = py[q] - py[p];
    ax -= px[p], ay -= py[p];
    double length2 = dx * dx + dy * dy;
    double share = length2 > 0.0 ? (ax * dx + ay * dy) / length2 : 0.0;
    share = lesser(greater(share, 0.0), 1.0);
    return (struct vector){ax - dx * share, ay - dy * share};
}

static int64_t within(int64_t k, int64_t n) { return k < 0 ? 0 : k < n ? k : n - 1; }

/* Return the sample nearest to the point: try some around ``at``, then the neighbours of the best. */
static int64_t nearest(const double *px, const double *py, int64_t n, double ax, double ay,
                       int64_t at, int64_t reach, int64_t coarse)
{
    int64_t found = at - reach, best_k = 0;
    double best = INFINITY;
    for (int64_t shift = -reach; shift <= reach; shift += coarse) {
        int64_t k = within(at + shift, n);
        double dx = ax - px[k], dy = ay - py[k], distance2 = dx * dx + dy * dy;
        if (distance2 < best)
            best = distance2, found = at + shift;
    }
    int64_t candidates[] = {found - 1, found, found + 1, at - 1, at, at + 1};
    best = INFINITY;
    for (int i = 0; i < 6; i++) {
        int64_t k = within(candidates[i], n);
        double dx = px[k] - ax, dy = py[k] - ay, distance2 = dx * dx + dy * dy;
        if (distance2 < best)
            best = distance2, best_k = k;
    }
    return best_k;
}

/* px, py (n): the path; ax, ay (count): points, at (count): the sample of each; off (count, 2).
 * turns (n + 1): room. */
static int64_t deviation(const double *px, const double *py, int64_t n, const double *ax,
                           const double *ay, const int64_t *at, int64_t count, int64_t reach,
                           int64_t coarse, double straight, struct vector *off, int64_t *turns)
{
    turns[0] = 0;
    for (int64_t k = 0; k < n; k++) /* how many before each sample */
        turns[k + 1] = turns[k] + (k == 0 || k == n - 1 || turns_at(px, py, k, straight));
    for (int64_t i = 0; i < count; i++) {
        int64_t low = within(at[i] - reach, n), high = within(at[i] + reach, n);
        if (turns[high] == turns[low + 1]) {
            off[i] = from_segment(px, py, ax[i], ay[i], low, high);
            continue;
        }
        int64_t k = nearest(px, py, n, ax[i], ay[i], at[i], reach, coarse);
        struct vector before = from_segment(px, py, ax[i], ay[i], k, within(k - 1, n));
        struct vector after = from_segment(px, py, ax[i], ay[i], k, within(k + 1, n));
        off[i] = square(before) < square(after) ? before : after;
    }
    return count;
}

LOOP(deviation, FLOATS(0, WHOLE(2)), FLOATS(1, WHOLE(2)), WHOLE(2), FLOATS(3, WHOLE(6)),
     FLOATS(4, WHOLE(6)), INTEGERS(5, WHOLE(6)), WHOLE(6), WHOLE(7), WHOLE(8), REAL(9),
     (struct vector *)OUT_FLOATS(10, 2 * WHOLE(6)), OUT_INTEGERS(11, WHOLE(2) + 1))
