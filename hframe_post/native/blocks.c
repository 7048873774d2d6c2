/* The loops of firmware/marlin/blocks.py and planner.py, with their symbols. */

#include "kernels.h"

#define STRAIGHT 0.999999

struct limits { /* as BlockLimits */
    double belt, z, e, belt_acceleration, z_acceleration, e_acceleration, retraction, deviation;
};
enum { LIMITS = sizeof(struct limits) / sizeof(double) };

struct timer { double hz, extra_tick, smoothing_hz; };

struct ramp { double start, end, a, interrupts, ahead; };

static double between(double x, double least, double most)
{
    return lesser(greater(x, least), most);
}

/* n, d, a: of the block between two places; unit (4): the direction of its way. */
static void block(const double *from, const double *to, const struct limits *limits,
                  const double *matrix, double *n, double *d, double *a, double *unit)
{
    double step[COLUMNS], mm[COLUMNS] = {limits->belt, limits->belt, limits->z, limits->e};
    for (int c = 0; c < COLUMNS; c++)
        step[c] = rint(to[c] / mm[c]) - rint(from[c] / mm[c]);
    double motor[2] = {matrix[0] * step[X] + matrix[1] * step[Y],
                       matrix[2] * step[X] + matrix[3] * step[Y]};
    double xy = greater(fabs(motor[0]), fabs(motor[1])), z = fabs(step[Z]), e = fabs(step[E]);
    *n = greater(greater(xy, z), greater(e, 1.0));
    double x = step[X] * mm[X], y = step[Y] * mm[Y], lift = to[Z] - from[Z], fed = to[E] - from[E];
    *d = sqrt(x * x + y * y + lift * lift);
    if (!(*d > 0.0))
        *d = greater(fabs(fed), limits->belt);
    double of_e = xy + z > 0.0 ? limits->e_acceleration : limits->retraction;
    *a = lesser(limits->z_acceleration / limits->z * *n / z, of_e / limits->e * *n / e);
    *a = lesser(*a, limits->belt_acceleration / limits->belt);
    double way[COLUMNS] = {motor[0] * mm[X], motor[1] * mm[Y], lift, fed};
    double norm = sqrt(way[0] * way[0] + way[1] * way[1] + lift * lift + fed * fed + 1e-30);
    for (int c = 0; c < COLUMNS; c++)
        unit[c] = way[c] / norm;
}

/* Return the greatest speed between blocks, of which the second has acceleration a, mm/s². */
static double corner(const double *unit, const double *next, double a, double deviation)
{
    double cosine = -(unit[0] * next[0] + unit[1] * next[1] + unit[2] * next[2] + unit[3] * next[3]);
    double sin_half = sqrt(0.5 * (1.0 - between(cosine, -STRAIGHT, STRAIGHT)));
    return cosine > STRAIGHT ? 0.0 : sqrt(deviation * a * sin_half / (1.0 - sin_half));
}

/* n, d, a (k), corners (k + 1): of blocks between places at (k + 1, 4). matrix (2, 2): from x, y to
 * the motors. */
static int64_t marlin_blocks(const double *at, int64_t k, const struct limits *limits,
                             const double *matrix, double after, double *n, double *d, double *a,
                             double *corners)
{
    double unit[2][COLUMNS];
    for (int64_t i = 0; i < k; i++) {
        double *last = unit[(i + 1) % 2], *now = unit[i % 2];
        block(at + COLUMNS * i, at + COLUMNS * (i + 1), limits, matrix, n + i, d + i, a + i, now);
        corners[i] = INFINITY;
        if (i && limits->deviation < INFINITY)
            corners[i] = corner(last, now, a[i] * d[i] / n[i], limits->deviation);
    }
    corners[k] = after;
    return k;
}

LOOP(marlin_blocks, FLOATS(0, COLUMNS * (WHOLE(1) + 1)), WHOLE(1),
     (const struct limits *)FLOATS(2, LIMITS), FLOATS(3, 4), REAL(4), OUT_FLOATS(5, WHOLE(1)),
     OUT_FLOATS(6, WHOLE(1)), OUT_FLOATS(7, WHOLE(1)), OUT_FLOATS(8, WHOLE(1) + 1))

static double interrupts(const struct timer *timer, double rate)
{
    int exponent;
    frexp(greater(ceil(timer->smoothing_hz / rate) - 1.0, 1.0), &exponent);
    return ldexp(1.0, exponent - 1);
}

static double seconds(const struct timer *timer, double ticks)
{
    return (ticks + timer->extra_tick) / timer->hz;
}

static double rate_at(double t, const struct ramp *ramp, int64_t s_curve)
{
    double way = ramp->end - ramp->start;
    if (!s_curve) {
        double change = lesser(floor(ramp->a * t), fabs(way));
        return ramp->start + (way < 0.0 ? -change : change);
    }
    double u = way != 0.0 ? between(ramp->a * t / fabs(way), 0.0, 1.0) : 1.0;
    return floor(ramp->start + way * (u * u * u) * (10.0 - 15.0 * u + 6.0 * u * u));
}

/* Return the seconds of a ramp; reached: its last rate. */
static double ramped(const struct ramp *ramp, double shares, const struct timer *timer,
                     int64_t s_curve, double *reached)
{
    double taken = 0.0, t = ramp->ahead / timer->hz;
    *reached = ramp->start;
    for (int64_t k = 0; k < (int64_t)ramp->interrupts; k++) {
        *reached = rate_at(t, ramp, s_curve);
        double ticks = floor(timer->hz / (*reached * shares));
        taken += seconds(timer, ticks);
        t += ticks / timer->hz;
    }
    return taken;
}

/* Return the rate at an end of a block as Marlin rounds it. */
static double rounded(double w, double rate, int64_t development)
{
    w = development ? greater(floor(w + 0.5), 1.0) : greater(ceil(w - 1e-6), 120.0);
    return lesser(w, rate);
}

static double block_seconds(double n, double a, double begin, double rate, double end,
                            const struct timer *timer, double ahead, int64_t development,
                            int64_t s_curve)
{
    begin = rounded(begin, rate, development), end = rounded(end, rate, development);
    double rise = (rate * rate - begin * begin) / (2.0 * a);
    double fall = (rate * rate - end * end) / (2.0 * a), meet = (n + rise - fall) / 2.0;
    double up = ceil(rise), down = development ? ceil(fall) : floor(fall);
    if (up + down > n) {
        up = between(development ? floor(meet + 0.5) : ceil(meet), 0.0, n);
        down = n - up;
    }
    double shares = interrupts(timer, rate), after_first = n * shares - 1.0;
    double rising = between(up * shares - (development ? 1.0 : 0.0), 0.0, after_first);
    double falling = between(down * shares - (development ? 0.0 : 1.0), 0.0, after_first - rising);
    double cruising = after_first - rising - falling;
    double first = floor(timer->hz / (begin * shares)), cruise = floor(timer->hz / (rate * shares));
    double reach = rate, top;
    if (s_curve && !(n - up - down > 0.0))
        reach = lesser(sqrt(begin * begin + 2.0 * a * up), rate);
    struct ramp ramp = {begin, reach, a, rising, ahead * first};
    double climb = ramped(&ramp, shares, timer, s_curve, &top);
    top = s_curve || (development && cruising > 0.0) ? reach : top;
    double lead = cruising > 0.0 ? ahead * cruise : rising > 0.0 ? 0.0 : ahead * first;
    ramp = (struct ramp){greater(top, end), end, a, falling, development ? lead : 0.0};
    double drop = ramped(&ramp, shares, timer, s_curve, &top);
    return seconds(timer, first) + climb + cruising * seconds(timer, cruise) + drop;
}

/* taken (k): the seconds of blocks. timer (3). */
static int64_t marlin_block_times(int64_t k, const double *n, const double *a, const double *begin,
                                  const double *rate, const double *end, const struct timer *timer,
                                  double ahead, int64_t development, int64_t s_curve, double *taken)
{
    for (int64_t i = 0; i < k; i++)
        taken[i] = block_seconds(n[i], a[i], begin[i], rate[i], end[i], timer, ahead, development,
                                 s_curve);
    return k;
}

LOOP(marlin_block_times, WHOLE(0), FLOATS(1, WHOLE(0)), FLOATS(2, WHOLE(0)), FLOATS(3, WHOLE(0)),
     FLOATS(4, WHOLE(0)), FLOATS(5, WHOLE(0)), (const struct timer *)FLOATS(6, 3), REAL(7), WHOLE(8),
     WHOLE(9), OUT_FLOATS(10, WHOLE(0)))
