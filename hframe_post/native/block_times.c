#include <stddef.h>

#include "kernels.h"

struct stepper { double hz, extra_tick, smoothing_hz, ahead, development, s_curve, slowest; };
enum { STEPPER = sizeof(struct stepper) / sizeof(double) };

struct ramp { double start, end, a, interrupts, ahead; };

struct blocks { const double *n, *d, *a, *corners; };

/* Return the interrupts a step. */
INSIDE double interrupts(const struct stepper *s, double rate)
{
    int exponent;
    if (s->smoothing_hz == 0.0)
        return 1.0;
    frexp(greater(ceil(s->smoothing_hz / rate) - 1.0, 1.0), &exponent);
    return ldexp(1.0, exponent - 1);
}

INSIDE double seconds(const struct stepper *s, double ticks)
{
    return (ticks + s->extra_tick) / s->hz;
}

INSIDE double rate_at(double t, const struct ramp *ramp, int s_curve)
{
    double way = ramp->end - ramp->start;
    if (!s_curve) {
        double change = lesser(floor(ramp->a * t), fabs(way));
        return ramp->start + (way < 0.0 ? -change : change);
    }
    double u = way != 0.0 ? between(ramp->a * t / fabs(way), 0.0, 1.0) : 1.0;
    return floor(ramp->start + way * (u * u * u) * (10.0 - 15.0 * u + 6.0 * u * u));
}

/* Ticks that have passed, interrupts since the last step, and where the time of the next one goes. */
struct count { double passed, made, *next; };

/* Count an interrupt of so many ticks, if anything counts. */
INSIDE void count(struct count *c, double ticks, double shares, const struct stepper *s)
{
    if (c == NULL)
        return;
    c->passed += ticks + s->extra_tick;
    if (++c->made < shares)
        return;
    *c->next++ = c->passed / s->hz;
    c->made = 0.0;
}

/* Return the seconds of a ramp; reached: its last rate. */
INSIDE double ramped(const struct ramp *ramp, double shares, const struct stepper *s,
                     struct count *c, double *reached)
{
    double taken = 0.0, t = ramp->ahead / s->hz;
    *reached = ramp->start;
    for (int64_t k = 0; k < (int64_t)ramp->interrupts; k++) {
        *reached = rate_at(t, ramp, s->s_curve != 0.0);
        double ticks = floor(s->hz / (*reached * shares)), interval = ticks / s->hz;
        taken += s->extra_tick == 0.0 ? interval : seconds(s, ticks);
        t += interval;
        count(c, ticks, shares, s);
    }
    return taken;
}

/* Return the rate at an end of a block as Marlin rounds it. */
INSIDE double rounded(double w, double rate, const struct stepper *s)
{
    int development = s->development != 0.0;
    w = development ? greater(floor(w + 0.5), 1.0) : greater(ceil(w - 1e-6), s->slowest);
    return lesser(w, rate);
}

INSIDE double block_seconds(double n, double a, double begin, double rate, double end,
                            const struct stepper *s, struct count *c)
{
    int development = s->development != 0.0, s_curve = s->s_curve != 0.0;
    begin = rounded(begin, rate, s), end = rounded(end, rate, s);
    double rise = (rate * rate - begin * begin) / (2.0 * a);
    double fall = (rate * rate - end * end) / (2.0 * a), meet = (n + (rise - fall)) / 2.0;
    double up = ceil(rise), down = development ? ceil(fall) : floor(fall);
    if (up + down > n) {
        up = between(development ? floor(meet + 0.5) : ceil(meet), 0.0, n);
        down = n - up;
    }
    double shares = interrupts(s, rate), after_first = n * shares - 1.0;
    double rising = between(up * shares - (development ? 1.0 : 0.0), 0.0, after_first);
    double falling = between(down * shares - (development ? 0.0 : 1.0), 0.0, after_first - rising);
    double cruising = after_first - rising - falling;
    double first = floor(s->hz / (begin * shares)), cruise = floor(s->hz / (rate * shares));
    double reach = rate, top;
    if (s_curve && !(n - up - down > 0.0))
        reach = lesser(sqrt(begin * begin + 2.0 * a * up), rate);
    struct ramp ramp = {begin, reach, a, rising, s->ahead * first};
    count(c, first, shares, s);
    double climb = ramped(&ramp, shares, s, c, &top);
    for (double k = 0.0; c != NULL && k < cruising; k++)
        count(c, cruise, shares, s);
    top = s_curve || (development && cruising > 0.0) ? reach : top;
    double lead = cruising > 0.0 ? s->ahead * cruise : rising > 0.0 ? 0.0 : s->ahead * first;
    ramp = (struct ramp){greater(top, end), end, a, falling, development ? lead : 0.0};
    double drop = ramped(&ramp, shares, s, c, &top);
    return seconds(s, first) + climb + cruising * seconds(s, cruise) + drop;
}

/* taken (k): the seconds of blocks. */
WIDE static int64_t marlin_block_times(int64_t k, const double *n, const double *a,
                                       const double *begin, const double *rate, const double *end,
                                       const struct stepper *s, double *taken)
{
    for (int64_t i = 0; i < k; i++)
        taken[i] = block_seconds(n[i], a[i], begin[i], rate[i], end[i], s, NULL);
    return k;
}

LOOP(marlin_block_times, ITEMS(0), FLOATS(0, 0), FLOATS(1, ITEMS(0)), FLOATS(2, ITEMS(0)),
     FLOATS(3, ITEMS(0)), FLOATS(4, ITEMS(0)), (const struct stepper *)FLOATS(5, STEPPER),
     NEW_FLOATS(0, ITEMS(0)))

/* t (sum of n): when each step of all blocks is made, s. */
static int64_t marlin_step_times(int64_t k, const int64_t *n, const double *a, const double *begin,
                                 const double *rate, const double *end, const struct stepper *s,
                                 double *t)
{
    struct count c = {0.0, 0.0, t};
    for (int64_t i = 0; i < k; i++)
        if (n[i] > 0)
            block_seconds((double)n[i], a[i], begin[i], rate[i], end[i], s, &c);
    return k;
}

LOOP(marlin_step_times, ITEMS(0), PARTS(0, ITEMS(0), ITEMS(6)), FLOATS(1, ITEMS(0)), FLOATS(2, ITEMS(0)),
     FLOATS(3, ITEMS(0)), FLOATS(4, ITEMS(0)), (const struct stepper *)FLOATS(5, STEPPER), OUT_FLOATS(6, 0))

/* Return the speed between the blocks i - 1 and i, of which one runs at v_s and the other at v. */
INSIDE double joint(const struct blocks *b, int64_t i, double v_s, double v, int free_entry,
                    const struct stepper *s)
{
    double least = free_entry ? v : 0.0;
    if (s->development != 0.0)
        least = lesser(sqrt(b->a[i] / 2.0) * b->d[i] / b->n[i], v);
    return greater(lesser(lesser(v_s, v), b->corners[i]), least);
}

/* taken (k): the seconds of blocks at speeds v (k) and their rates, as rounded. */
WIDE static void find_times(const struct blocks *b, int64_t k, const double *v, const double *rate,
                            double before, int free_entry, const struct stepper *s, double *taken)
{
    if (k == 0)
        return;
    double begin = joint(b, 0, before, v[0], free_entry, s);
    for (int64_t i = 0; i < k; i++) {
        double end = i + 1 < k ? joint(b, i + 1, v[i], v[i + 1], free_entry, s)
                               : lesser(v[i], b->corners[k]);
        double per_mm = s->development != 0.0 ? b->n[i] / b->d[i] : rate[i] / v[i];
        taken[i] = block_seconds(b->n[i], b->a[i], begin * per_mm, rate[i], end * per_mm, s, NULL);
        begin = end;
    }
}

static int64_t marlin_times(int64_t k, const double *n, const double *d, const double *a,
                            const double *corners, const double *v, const double *rate,
                            double before, int64_t free_entry, const struct stepper *s, double *taken)
{
    struct blocks b = {n, d, a, corners};
    find_times(&b, k, v, rate, before, free_entry != 0, s, taken);
    return k;
}

LOOP(marlin_times, ITEMS(0), FLOATS(0, 0), FLOATS(1, ITEMS(0)), FLOATS(2, ITEMS(0)), FLOATS(3, ITEMS(0) + 1),
     FLOATS(4, ITEMS(0)), FLOATS(5, ITEMS(0)), REAL(6), WHOLE(7), (const struct stepper *)FLOATS(8, STEPPER),
     NEW_FLOATS(0, ITEMS(0)))

/* Return a whole rate of whole ticks for the block i. */
INSIDE double dithered(double rate, int64_t i, const struct stepper *s)
{
    double golden = (sqrt(5.0) - 1.0) / 2.0 * (double)(i + 1), threshold = golden - floor(golden);
    double shares = interrupts(s, rate);
    double ticks = floor(s->hz / (rate * shares) - s->extra_tick + threshold);
    int slow = rate * rate * shares < s->hz;
    return greater(floor(slow ? rate + threshold : s->hz / greater(ticks, 1.0) / shares), 1.0);
}

/* Return the share of time that blocks lose to rounding: they take ``taken`` (k). */
INSIDE double lost_share(const double *n, int64_t k, const double *T, const double *rate,
                         const double *taken, double fastest)
{
    const double ROUNDING = 0.05; /* share of a block's time beyond which lateness is not due to rounding */
    const double AT_BOUND = 0.9; /* share of the fastest rate from which on a rate is not free */
    double late = 0.0, total = 0.0;
    for (int64_t i = 0; i < k; i++) {
        double own = taken[i] - T[i];
        int no_rate_fits = fabs(own) > ROUNDING * T[i]
                           || rate[i] > AT_BOUND * fastest * n[i] / T[i];
        late += no_rate_fits ? 0.0 : own;
        total += T[i];
    }
    return late / total;
}

/* v (k): the speeds at which blocks take the time T (k). room (3 k). */
WIDE static int64_t marlin_feed_rates(int64_t k, const double *n, const double *d, const double *a,
                                      const double *corners, const double *T, double before,
                                      int64_t free_entry, const struct stepper *s, int64_t rounds,
                                      double fastest, double *room, double *v)
{
    const double MOST_LOST = 0.01;    /* share of time that rounding can lose */
    const double UNROUNDED_HZ = 1e15; /* of a timer whose ticks are too short for rounding to matter */
    struct blocks b = {n, d, a, corners};
    struct stepper exact = {UNROUNDED_HZ, 0.0, 0.0, s->ahead, s->development, s->s_curve, s->slowest};
    double *rate = room, *whole = rate + k, *taken = whole + k, lost = 0.0;
    for (int64_t i = 0; i < k; i++)
        rate[i] = n[i] / T[i];
    for (int64_t round = 0; round < rounds; round++) {
        for (int64_t step = 0; step < rounds; step++) {
            for (int64_t i = 0; i < k; i++)
                v[i] = rate[i] * d[i] / n[i];
            find_times(&b, k, v, rate, before, free_entry != 0, &exact, taken);
            for (int64_t i = 0; i < k; i++) {
                double mean = n[i] / T[i], found = rate[i] * (taken[i] / (T[i] * (1.0 - lost)));
                rate[i] = between(found, mean / fastest, mean * fastest);
            }
        }
        for (int64_t i = 0; i < k; i++) {
            whole[i] = dithered(rate[i], i, s);
            v[i] = (whole[i] - 0.5) * d[i] / n[i];
        }
        find_times(&b, k, v, whole, before, free_entry != 0, s, taken);
        lost = between(lost + lost_share(n, k, T, rate, taken, fastest), -MOST_LOST, MOST_LOST);
    }
    return k;
}

LOOP(marlin_feed_rates, ITEMS(0), FLOATS(0, 0), FLOATS(1, ITEMS(0)), FLOATS(2, ITEMS(0)),
     FLOATS(3, ITEMS(0) + 1), FLOATS(4, ITEMS(0)), REAL(5), WHOLE(6), (const struct stepper *)FLOATS(7, STEPPER),
     FEW(8), REAL(9), ROOM(0, 3 * ITEMS(0)), NEW_FLOATS(1, ITEMS(0)))
