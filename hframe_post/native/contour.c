#include "kernels.h"

struct vector {
    double x, y;
};

struct path { /* n samples, x and y first */
    const double *places;
    int64_t columns, n;
};

static int64_t within(int64_t k, int64_t n) { return k < 0 ? 0 : k < n ? k : n - 1; }

static double square(struct vector v) { return v.x * v.x + v.y * v.y; }

/* Return the way to a point from sample k. */
INSIDE struct vector from_sample(struct path path, struct vector a, int64_t k)
{
    const double *p = path.places + path.columns * k;
    return (struct vector){a.x - p[X], a.y - p[Y]};
}

/* Return the way to a point from the nearest place on the segment between samples p and q. */
INSIDE struct vector from_segment(struct path path, struct vector a, int64_t p, int64_t q)
{
    const double *from = path.places + path.columns * p, *to = path.places + path.columns * q;
    double dx = to[X] - from[X], dy = to[Y] - from[Y];
    a = from_sample(path, a, p);
    double length2 = dx * dx + dy * dy;
    double share = length2 > 0.0 ? (a.x * dx + a.y * dy) / length2 : 0.0;
    share = lesser(greater(share, 0.0), 1.0);
    return (struct vector){a.x - dx * share, a.y - dy * share};
}

/* Return the sample nearest to the point: try some around ``at``, then the neighbours of the best.
 * inside: whether the path has all of these samples; a constant, so that most calls need no bounds. */
INSIDE int64_t nearest(struct path path, struct vector a, int64_t at, int64_t reach, int64_t coarse,
                       int inside)
{
    int64_t found = at - reach, best_k = 0;
    double best = INFINITY;
    for (int64_t k = at - reach; k <= at + reach; k += coarse) {
        double distance2 = square(from_sample(path, a, inside ? k : within(k, path.n)));
        if (distance2 < best)
            best = distance2, found = k;
    }
    int64_t candidates[] = {found - 1, found, found + 1, at - 1, at, at + 1};
    best = INFINITY;
    for (int i = 0; i < 6; i++) {
        int64_t k = inside ? candidates[i] : within(candidates[i], path.n);
        double distance2 = square(from_sample(path, a, k));
        if (distance2 < best)
            best = distance2, best_k = k;
    }
    return best_k;
}

/* turns (n + 1): how many samples before each change the path's direction. */
static int64_t count_turns(const double *places, int64_t columns, int64_t n, double straight,
                           int64_t *turns)
{
    turns[0] = 0;
    for (int64_t k = 0; k < n; k++) {
        int turning = k == 0 || k == n - 1;
        if (!turning) {
            const double *p = places + columns * (k - 1), *q = p + columns, *r = q + columns;
            double ax = q[X] - p[X], ay = q[Y] - p[Y], bx = r[X] - q[X], by = r[Y] - q[Y];
            double cross = ax * by - ay * bx, dot = ax * bx + ay * by;
            int still = ax == 0.0 && ay == 0.0, still_then = bx == 0.0 && by == 0.0;
            turning = fabs(cross) > straight * fabs(dot) || dot < 0.0 || still != still_then;
        }
        turns[k + 1] = turns[k] + turning;
    }
    return n;
}

LOOP(count_turns, FLOATS(0, COUNT(1) * COUNT(2)), WITHIN(1, 2, MOST_FEW), COUNT(2), REAL(3),
     OUT_INTEGERS(4, COUNT(2) + 1))

/* nozzle (m, width): x and y first, at samples first, first + 1, … of the path; at (count): which of
 * these to judge; off (count): the way to the nozzle from the path. */
static int64_t deviation(const double *places, int64_t columns, int64_t n, const int64_t *turns,
                         const double *nozzle, int64_t width, int64_t m, int64_t first,
                         const int64_t *at, int64_t count, int64_t reach, int64_t coarse,
                         struct vector *off)
{
    struct path path = {places, columns, n};
    for (int64_t i = 0; i < count; i++) {
        const double *point = nozzle + width * within(at[i] - first, m);
        struct vector a = {point[X], point[Y]};
        int64_t low = within(at[i] - reach, n), high = within(at[i] + reach, n);
        if (turns[high] == turns[low + 1]) {
            off[i] = from_segment(path, a, low, high);
            continue;
        }
        int inside = at[i] > reach && at[i] < n - reach - 1;
        int64_t k = inside ? nearest(path, a, at[i], reach, coarse, 1)
                           : nearest(path, a, at[i], reach, coarse, 0);
        struct vector before = from_segment(path, a, k, within(k - 1, n));
        struct vector after = from_segment(path, a, k, within(k + 1, n));
        off[i] = square(before) < square(after) ? before : after;
    }
    return count;
}

LOOP(deviation, FLOATS(0, COUNT(1) * COUNT(2)), WITHIN(1, 2, MOST_FEW), COUNT(2),
     INTEGERS(3, COUNT(2) + 1), FLOATS(4, COUNT(5) * COUNT(6)), WITHIN(5, 2, MOST_FEW),
     WITHIN(6, COUNT(9) > 0, MOST_ITEMS), WHOLE(7), INDICES(8, COUNT(9), 0, COUNT(2)), COUNT(9),
     FEW(10), WITHIN(11, 1, MOST_ITEMS), (struct vector *)OUT_FLOATS(12, 2 * COUNT(9)))

/* xyze (n, 4). Note at which samples the path moves, of every n-th from ``first`` on, and whether it
 * extrudes there; return their number. at, extruding (n): room. */
static int64_t moving(const double *xyze, int64_t n, int64_t first, int64_t every, int64_t *at,
                      uint8_t *extruding)
{
    int64_t count = 0;
    for (int64_t k = first; k < n; k += every) {
        const double *now = xyze + COLUMNS * k, *before = k > 0 ? now - COLUMNS : now;
        if (now[X] != before[X] || now[Y] != before[Y]) {
            extruding[count] = now[E] > before[E];
            at[count++] = k;
        }
    }
    return count;
}

LOOP(moving, FLOATS(0, COLUMNS * COUNT(1)), COUNT(1), COUNT(2),
     WITHIN(3, 1, MOST_ITEMS), OUT_INTEGERS(4, COUNT(1)), OUT_BYTES(5, COUNT(1)))
