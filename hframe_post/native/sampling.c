#include "kernels.h"

enum { PHASES = 7 }; /* of a run; t, j (r, 7) are their durations and jerks */

/* Fill t and j with one change of speed along the whole of each length, and its acceleration (r). */
static int64_t ramps(const double *v0, const double *v1, const double *length, int64_t r, double jerk,
                     double *t, double *j, double *acceleration)
{
    for (int64_t i = 0; i < r; i++, t += PHASES, j += PHASES) {
        double change = v1[i] - v0[i], T = 2.0 * length[i] / (v0[i] + v1[i]);
        double root = sqrt(greater(T * T - 4.0 * fabs(change) / jerk, 0.0));
        double a = 2.0 * fabs(change) / (T + root), ramp = a / jerk;
        for (int k = 0; k < PHASES; k++)
            t[k] = j[k] = 0.0;
        t[0] = t[2] = ramp;
        t[1] = isfinite(T) ? T - 2.0 * ramp : 0.0;
        j[0] = copysign(jerk, change), j[2] = -j[0];
        acceleration[i] = a;
    }
    return r;
}

LOOP(ramps, FLOATS(0, COUNT(3)), FLOATS(1, COUNT(3)), FLOATS(2, COUNT(3)), COUNT(3), REAL(4),
     OUT_FLOATS(5, PHASES * COUNT(3)), OUT_FLOATS(6, PHASES * COUNT(3)), OUT_FLOATS(7, COUNT(3)))

/* Acceleration, speed, path length from the start, and time from the start, when a phase begins. */
struct phase {
    double a, v, s, time;
};

/* Fill in the phases of one run and, behind them, its end. */
static void integrate(const double *t, const double *j, double v0, struct phase *phase)
{
    double gained = 0.0;
    phase[0] = (struct phase){0.0, v0, 0.0, 0.0};
    for (int k = 0; k < PHASES; k++) {
        struct phase now = phase[k];
        double da = j[k] * t[k];
        double step = t[k] * (now.v + t[k] * (now.a / 2.0 + da / 6.0));
        gained += t[k] * (now.a + da / 2.0);
        phase[k + 1] = (struct phase){now.a + da, v0 + gained, now.s + step, now.time + t[k]};
    }
}

/* Note which runs go backwards or miss their length by more than ``drift``; return how many. */
static int64_t misses(const double *t, const double *j, const double *v0, const double *length,
                      int64_t r, double drift, uint8_t *missed)
{
    int64_t count = 0;
    for (int64_t i = 0; i < r; i++) {
        struct phase phase[PHASES + 1];
        integrate(t + PHASES * i, j + PHASES * i, v0[i], phase);
        missed[i] = fabs(phase[PHASES].s - length[i]) > drift;
        for (int k = 0; k < PHASES; k++)
            missed[i] |= phase[k].v < -drift;
        count += missed[i];
    }
    return count;
}

LOOP(misses, FLOATS(0, PHASES * COUNT(4)), FLOATS(1, PHASES * COUNT(4)), FLOATS(2, COUNT(4)),
     FLOATS(3, COUNT(4)), COUNT(4), REAL(5), OUT_BYTES(6, COUNT(4)))

/* speed (r + 1) and s (r + 1) at the ends of runs; samples of ``interval`` s, by a share of which a
 * point of rest may be late. Fill table (6, p) with
 * the phases as below, and end with the time of the end; return p. */
static int64_t phases(const double *t, const double *j, const double *speed, const double *s, int64_t r,
                      double start, double interval, double forgiven, double *table, double *end)
{
    int64_t p = 0, row = 0;
    double spent = 0.0, waited = 0.0, begin = start;
    for (int64_t i = 0; i < PHASES * r; i++)
        p += t[i] > 0.0;
    for (int64_t i = 0; i < r; i++, t += PHASES, j += PHASES) {
        struct phase phase[PHASES + 1];
        integrate(t, j, speed[i], phase);
        for (int k = 0; k < PHASES; k++)
            if (t[k] > 0.0) {
                const double values[] = {begin + phase[k].time, t[k], s[i] + phase[k].s,
                                         phase[k].v, phase[k].a, j[k]};
                for (int column = 0; column < 6; column++)
                    table[p * column + row] = values[column];
                row++;
            }
        spent += phase[PHASES].time;
        double arrival = start + spent + waited;
        if (speed[i + 1] == 0.0)
            waited += greater(ceil(arrival / interval - forgiven) - arrival / interval, 0.0) * interval;
        begin = start + spent + waited;
    }
    *end = begin;
    return p;
}

LOOP(phases, FLOATS(0, PHASES * COUNT(4)), FLOATS(1, PHASES * COUNT(4)), FLOATS(2, COUNT(4) + 1),
     FLOATS(3, COUNT(4) + 1), COUNT(4), REAL(5), REAL(6), REAL(7),
     OUT_FLOATS(8, 6 * PHASES * COUNT(4)), OUT_FLOATS(9, 1))

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

LOOP(path_lengths, FLOATS(0, 6 * COUNT(1)), WITHIN(1, COUNT(3) > 0, MOST_ITEMS), WHOLE(2), COUNT(3),
     REAL(4), REAL(5), OUT_FLOATS(6, COUNT(3)))

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

LOOP(follow, FLOATS(0, COUNT(2) + 1), FLOATS(1, COLUMNS * (COUNT(2) + 1)),
     WITHIN(2, COUNT(4) > 0, MOST_ITEMS), FLOATS(3, COUNT(4)), COUNT(4),
     OUT_FLOATS(5, COLUMNS * COUNT(4)), OUT_INTEGERS(6, COUNT(4)))

/* way: length, speed at the start, acceleration, peak speed, how long it speeds up and slows down, and
 * seconds in all. Places xyze (n, 4) after ``first``, first + 1, … samples of a move between the ends
 * (2, 4), which is done after ``samples``. */
static int64_t move_at_rest(const double *way, const double *ends, int64_t first, int64_t n, int64_t samples,
                     double interval, double *xyze)
{
    double length = way[0], v_s = way[1], a = way[2], peak = way[3], up = way[4], down = way[5],
           seconds = way[6];
    for (int64_t i = 0; i < n; i++, xyze += COLUMNS) {
        double t = lesser(greater((double)(first + i) * interval, 0.0), seconds);
        double begun = lesser(t, up), ending = greater(t - (seconds - down), 0.0);
        double done = begun * (v_s + a * begun / 2.0) + peak * (t - begun) - a * ending * ending / 2.0;
        double share = first + i < samples ? done / length : 1.0;
        for (int c = 0; c < COLUMNS; c++)
            xyze[c] = c < Z ? ends[COLUMNS + c] : ends[c] + share * (ends[COLUMNS + c] - ends[c]);
    }
    return n;
}

LOOP(move_at_rest, FLOATS(0, 7), FLOATS(1, 2 * COLUMNS), WHOLE(2), COUNT(3), WHOLE(4), REAL(5),
     OUT_FLOATS(6, COLUMNS * COUNT(3)))
