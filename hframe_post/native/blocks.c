/* The block times of firmware/marlin/planner.py, with its symbols. */

#include "kernels.h"

struct timer { double hz, extra_tick, smoothing_hz; };

struct ramp { double start, end, a, interrupts, ahead; };

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

static double between(double x, double least, double most)
{
    return lesser(greater(x, least), most);
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
