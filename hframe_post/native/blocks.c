#include "kernels.h"

struct limits { /* as BlockLimits */
    double belt, z, e, belt_acceleration, z_acceleration, e_acceleration, retraction, deviation;
};
enum { LIMITS = sizeof(struct limits) / sizeof(double) };

/* row (4): a place in whole steps. */
INSIDE void round_to_steps(const double *at, const struct limits *limits, double *row)
{
    double mm[COLUMNS] = {limits->belt, limits->belt, limits->z, limits->e};
    for (int c = 0; c < COLUMNS; c++)
        row[c] = rint(at[c] / mm[c]);
}

/* n, d, a: of the block between two places, with their rows; unit (4): the direction of its way. */
INSIDE void block(const double *from, const double *to, const double *row, const double *next_row,
                  const struct limits *limits, const double *matrix, double *n, double *d, double *a,
                  double *unit)
{
    double step[COLUMNS];
    for (int c = 0; c < COLUMNS; c++)
        step[c] = next_row[c] - row[c];
    double motor[2] = {matrix[0] * step[X] + matrix[1] * step[Y],
                       matrix[2] * step[X] + matrix[3] * step[Y]};
    double xy = greater(fabs(motor[0]), fabs(motor[1])), z = fabs(step[Z]), e = fabs(step[E]);
    *n = greater(greater(xy, z), greater(e, 1.0));
    double x = step[X] * limits->belt, y = step[Y] * limits->belt, lift = to[Z] - from[Z], fed = to[E] - from[E];
    *d = sqrt(x * x + y * y + lift * lift);
    if (!(*d > 0.0))
        *d = greater(fabs(fed), limits->belt);
    double of_e = xy + z > 0.0 ? limits->e_acceleration : limits->retraction;
    *a = lesser(limits->z_acceleration / limits->z * *n / z, of_e / limits->e * *n / e);
    *a = lesser(*a, limits->belt_acceleration / limits->belt);
    double way[COLUMNS] = {motor[0] * limits->belt, motor[1] * limits->belt, lift, fed};
    double norm = sqrt(way[0] * way[0] + way[1] * way[1] + lift * lift + fed * fed + 1e-30);
    for (int c = 0; c < COLUMNS; c++)
        unit[c] = way[c] / norm;
}

/* Return the greatest speed between blocks, of which the second has acceleration a, mm/s². */
INSIDE double corner(const double *unit, const double *next, double a, double deviation,
                     double straight)
{
    double cosine = -(unit[0] * next[0] + unit[1] * next[1] + unit[2] * next[2] + unit[3] * next[3]);
    double sin_half = sqrt(0.5 * (1.0 - between(cosine, -straight, straight)));
    return cosine > straight ? 0.0 : sqrt(deviation * a * sin_half / (1.0 - sin_half));
}

/* n, d, a (k), corners (k + 1): of blocks between places at (k + 1, 4). matrix (2, 2): from x, y to
 * the motors; straight: cosine from which on blocks turn straight back. */
WIDE static int64_t marlin_blocks(const double *at, int64_t k, const struct limits *limits,
                                  const double *matrix, double after, double straight,
                                  double *n, double *d, double *a, double *corners)
{
    double unit[2][COLUMNS], row[2][COLUMNS];
    round_to_steps(at, limits, row[0]);
    for (int64_t i = 0; i < k; i++) {
        double *last = unit[(i + 1) % 2], *now = unit[i % 2], *from = row[i % 2], *to = row[(i + 1) % 2];
        const double *next = at + COLUMNS * (i + 1);
        round_to_steps(next, limits, to);
        block(next - COLUMNS, next, from, to, limits, matrix, n + i, d + i, a + i, now);
        corners[i] = INFINITY;
        if (i && limits->deviation < INFINITY)
            corners[i] = corner(last, now, a[i] * d[i] / n[i], limits->deviation, straight);
    }
    corners[k] = after;
    return k;
}

LOOP(marlin_blocks, FLOATS(0, COLUMNS * (COUNT(1) + 1)), COUNT(1),
     (const struct limits *)FLOATS(2, LIMITS), FLOATS(3, 4), REAL(4), REAL(5),
     OUT_FLOATS(6, COUNT(1)), OUT_FLOATS(7, COUNT(1)), OUT_FLOATS(8, COUNT(1)),
     OUT_FLOATS(9, COUNT(1) + 1))
