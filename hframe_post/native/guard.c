#include "kernels.h"

struct vector {
    double x, y;
};

static struct vector difference(struct vector a, struct vector b)
{
    return (struct vector){a.x - b.x, a.y - b.y};
}

static double faster(const double *belts, struct vector v)
{
    return greater(fabs(belts[0] * v.x + belts[1] * v.y), fabs(belts[2] * v.x + belts[3] * v.y));
}

/* xyze (n, 4), command (n) after the samples before[0], before[1]. limits: lower and upper bounds of
 * z, x, y, then belt velocity and acceleration; belts (2, 2). Return whether all is finite and within
 * the limits; only then before and peaks are updated: of both belts' velocity and acceleration, and
 * of the acceleration in x and in y. */
static int64_t safe(const double *xyze, const struct vector *command, int64_t n,
                    struct vector *before, const double *limits, const double *belts,
                    double interval, double *peaks)
{
    struct vector earlier = before[0], last = before[1], low = last, high = last;
    double z_low = xyze[Z], z_high = z_low, zero = 0.0, most[4] = {0};
    for (int64_t i = 0; i < n; i++) {
        const double *p = xyze + COLUMNS * i;
        struct vector c = command[i], v = difference(c, last);
        struct vector a = difference(v, difference(last, earlier));
        zero += 0.0 * p[X] + 0.0 * p[Y] + 0.0 * p[Z] + 0.0 * p[E] + 0.0 * c.x + 0.0 * c.y;
        z_low = lesser(z_low, p[Z]), z_high = greater(z_high, p[Z]);
        low.x = lesser(low.x, c.x), high.x = greater(high.x, c.x);
        low.y = lesser(low.y, c.y), high.y = greater(high.y, c.y);
        v.x /= interval, v.y /= interval;
        a.x /= interval * interval, a.y /= interval * interval;
        most[0] = greater(most[0], faster(belts, v)), most[1] = greater(most[1], faster(belts, a));
        most[2] = greater(most[2], fabs(a.x)), most[3] = greater(most[3], fabs(a.y));
        earlier = last, last = c;
    }
    if (zero != 0.0 || z_low < limits[0] || z_high > limits[1] || low.x < limits[2] ||
        high.x > limits[3] || low.y < limits[4] || high.y > limits[5] || most[0] > limits[6] ||
        most[1] > limits[7])
        return 0;
    for (int k = 0; k < 4; k++)
        peaks[k] = greater(peaks[k], most[k]);
    before[0] = earlier, before[1] = last;
    return 1;
}

LOOP(safe, FLOATS(0, COLUMNS * COUNT(2)), (const struct vector *)FLOATS(1, 2 * COUNT(2)),
     WITHIN(2, 1, MOST_ITEMS), (struct vector *)OUT_FLOATS(3, 4), FLOATS(4, 8), FLOATS(5, 4),
     REAL(6), OUT_FLOATS(7, 4))

/* Return the sample whose command (n) is farthest from the path xyze (n, 4), or one without a number. */
static int64_t farthest(const double *xyze, const struct vector *command, int64_t n)
{
    double most = -1.0;
    int64_t found = 0;
    for (int64_t i = 0; i < n; i++) {
        double dx = command[i].x - xyze[COLUMNS * i + X], dy = command[i].y - xyze[COLUMNS * i + Y];
        double off2 = dx * dx + dy * dy;
        if (off2 != off2)
            return i;
        if (off2 > most)
            most = off2, found = i;
    }
    return found;
}

LOOP(farthest, FLOATS(0, COLUMNS * COUNT(2)), (const struct vector *)FLOATS(1, 2 * COUNT(2)), COUNT(2))
