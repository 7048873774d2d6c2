#include <string.h>

#include "kernels.h"

struct limited { /* a move; the deviation is that of its junctions; alone: x and y rest; REST: so does
                    * the machine before and after it */
    double length, cruise, acceleration, deviation, alone;
};
enum { OF_MOVE = 5, REST = 2 };

struct rules { /* those of the printer, and of the file for motors A and B, z and e */
    double cruise, acceleration, z_cruise, retraction, melted, z_acceleration, e_acceleration, corner,
        deviation, axis_velocity[COLUMNS], axis_acceleration[COLUMNS], belts[2][2];
};

/* Return the length of a move, of filament if nothing else moves; share: what a mm of it is of motors A
 * and B, of z and of e. */
static double find_shares(const double *points, const double belts[2][2], double *delta, double *share)
{
    for (int c = 0; c < COLUMNS; c++)
        delta[c] = points[COLUMNS + c] - points[c];
    double length = sqrt(delta[X] * delta[X] + delta[Y] * delta[Y] + delta[Z] * delta[Z]);
    length = length > 0.0 ? length : fabs(delta[E]);
    for (int c = 0; c < COLUMNS; c++) {
        const double *belt = belts[c % 2];
        share[c] = fabs(c < Z ? belt[X] * delta[X] + belt[Y] * delta[Y] : delta[c]) / length;
    }
    return length;
}

struct shared { /* limits of motors A and B, z and e, and of the path */
    double velocity[COLUMNS], acceleration[COLUMNS], belts[2][2], path;
};
enum { RULES = sizeof(struct rules) / sizeof(double), SHARED = sizeof(struct shared) / sizeof(double) };

/* Lower speed and acceleration (n) of moves between points (n + 1, 4); return how many were. */
static int64_t lower_moves(const double *points, int64_t n, const struct shared *to, double *speed,
                           double *acceleration)
{
    int64_t count = 0;
    for (int64_t k = 0; k < n; k++, points += COLUMNS) {
        double delta[COLUMNS], share[COLUMNS], v = lesser(to->path, speed[k]), a = acceleration[k];
        find_shares(points, to->belts, delta, share);
        for (int c = 0; c < COLUMNS; c++) {
            v = lesser(to->velocity[c] / share[c], v);
            a = lesser(to->acceleration[c] / share[c], a);
        }
        count += v < speed[k] || a < acceleration[k];
        speed[k] = v, acceleration[k] = a;
    }
    return count;
}

LOOP(lower_moves, FLOATS(0, COLUMNS * (ITEMS(2) + 1)), ITEMS(2), (const struct shared *)FLOATS(1, SHARED),
     OUT_FLOATS(2, 0), OUT_FLOATS(3, ITEMS(2)))

/* points (n + 1, 4); asked (n) for speed, acceleration and speed of corners. */
static int64_t limit_moves(const double *points, const double *speed, const double *acceleration,
                           const double *corner, int64_t n, const struct rules *rules,
                           struct limited *moves)
{
    for (int64_t k = 0; k < n; k++, points += COLUMNS) {
        double delta[COLUMNS], share[COLUMNS], length = find_shares(points, rules->belts, delta, share);
        int alone = delta[X] == 0.0 && delta[Y] == 0.0;
        double cruise = lesser(speed[k], alone ? INFINITY : rules->cruise);
        double a = lesser(acceleration[k], alone ? INFINITY : rules->acceleration);
        double retracting = delta[E] < 0.0 || alone ? share[E] : 0.0, extruding = share[E] - retracting;
        for (int c = 0; c < COLUMNS; c++)
            cruise = lesser(cruise, rules->axis_velocity[c] / share[c]);
        for (int c = 0; c < COLUMNS && !(alone && share[Z] == 0.0); c++) /* filament has its own */
            a = lesser(a, rules->axis_acceleration[c] / share[c]);
        cruise = lesser(cruise, rules->z_cruise / share[Z]);
        cruise = lesser(cruise, rules->retraction / retracting);
        cruise = lesser(cruise, rules->melted / extruding);
        double squared = lesser(corner[k], rules->corner);
        double deviation = (sqrt(2.0) - 1.0) * (squared * squared) / a; /* of x and y, as Klipper's */
        a = lesser(a, lesser(rules->z_acceleration / share[Z], rules->e_acceleration / retracting));
        moves[k] = (struct limited){length, cruise, a, lesser(deviation, rules->deviation), alone};
    }
    return n;
}

LOOP(limit_moves, FLOATS(0, COLUMNS * (ITEMS(1) + 1)), FLOATS(1, 0), FLOATS(2, ITEMS(1)),
     FLOATS(3, ITEMS(1)), ITEMS(1), (const struct rules *)FLOATS(4, RULES),
     (struct limited *)NEW_ROWS(0, ITEMS(1), OF_MOVE))

/* cosine of the turns with which an arc must fit into short moves: Marlin takes √½, with which rounding
 * decides at the 45° of infill */
#define GENTLE 0.71
#define STRAIGHT 0.999999 /* cosine; moves back within it stop */
#define SHORT 1.0 /* mm; only into shorter moves must an arc fit, on a board with junction deviation */
#define CREEP 0.01 /* mm/s; a junction that allows less is a stop */
/* shares of acceleration and jerk, and of the cruise speed at vertices, that keep Ruckig off the edge of
 * what is feasible */
#define FEASIBLE (1.0 - 1e-6)
#define BELOW_CRUISE (1.0 - 1e-4)

/* Return the greatest speed between two moves, as a board with junction deviation finds it: their
 * directions are those of all motors, and the corner has an acceleration that none exceeds. */
static double deviation_speed(const double *one, const double *other, struct limited to,
                              const struct rules *rules)
{
    double unit[2][COLUMNS], size[2], turn[COLUMNS], cosine = 0.0, squared = 0.0, a = to.acceleration;
    for (int k = 0; k < 2; k++) {
        const double *delta = k ? other : one;
        for (int c = 0; c < Z; c++)
            unit[k][c] = rules->belts[c][X] * delta[X] + rules->belts[c][Y] * delta[Y];
        unit[k][Z] = delta[Z], unit[k][E] = delta[E];
        size[k] = 0.0;
        for (int c = 0; c < COLUMNS; c++)
            size[k] += unit[k][c] * unit[k][c];
    }
    double scale = 1.0 / sqrt(size[0] * size[1]);
    for (int c = 0; c < COLUMNS; c++) {
        turn[c] = unit[1][c] / sqrt(size[1]) - unit[0][c] / sqrt(size[0]);
        cosine -= unit[0][c] * unit[1][c] * scale;
        squared += turn[c] * turn[c];
    }
    if (cosine > STRAIGHT)
        return 0.0;
    cosine = greater(cosine, -STRAIGHT);
    for (int c = 0; c < COLUMNS; c++) /* of all motors, one after the other */
        if (fabs(turn[c]) * a > rules->axis_acceleration[c] * sqrt(squared))
            a = rules->axis_acceleration[c] * sqrt(squared) / fabs(turn[c]);
    double v2 = on_arc(cosine, a * to.deviation);
    if (to.length < SHORT && cosine < -GENTLE)
        v2 = lesser(v2, to.length * a / acos(-cosine));
    return sqrt(v2);
}

/* Return the greatest speed between two moves, as Klipper finds it. In a reversal 1 − cosθ consists of
 * rounding, which must be Klipper's: hence not one/length. */
static double junction_speed(const double *one, const double *other, struct limited a,
                             struct limited b, double extruder_corner)
{
    double one_scale = 1.0 / a.length, other_scale = 1.0 / b.length, along[E];
    for (int c = 0; c < E; c++)
        along[c] = (one[c] * one_scale) * (other[c] * other_scale);
    double turn = lesser(a.deviation * a.acceleration, b.deviation * b.acceleration);
    double fit = lesser(0.5 * a.length * a.acceleration, 0.5 * b.length * b.acceleration);
    double v2 = klipper_corner(along[X], along[Y], along[Z], turn, fit);
    return fmin(sqrt(v2), extruder_corner / fabs(other[E] / b.length - one[E] / a.length));
}

static int is_steep(const double *delta, double steep)
{
    return delta[Z] * delta[Z] > steep * steep * (delta[X] * delta[X] + delta[Y] * delta[Y]);
}

/* Fill corners (n + 1), the greatest speed at each vertex of points (n + 1, 4), and caps, those that
 * braking ``late`` by some mm leads to. joins: for a board with junction deviation, which passes from
 * motion into moves while x and y rest. */
static int64_t greatest_speeds(const double *points, const struct limited *moves, int64_t n,
                               const struct rules *rules, double extruder_corner, int64_t joins,
                               double steep, double late, double *corners, double *caps)
{
    double delta[2][COLUMNS];
    for (int64_t k = 0; k < n; k++, points += COLUMNS) {
        double *now = delta[k % 2], *before = delta[1 - k % 2], cruise = BELOW_CRUISE * moves[k].cruise;
        for (int c = 0; c < COLUMNS; c++)
            now[c] = points[COLUMNS + c] - points[c];
        caps[k] = caps[k + 1] = corners[k] = corners[k + 1] = cruise;
        if (k == 0)
            continue;
        double v = joins ? deviation_speed(before, now, moves[k], rules)
                         : junction_speed(before, now, moves[k - 1], moves[k], extruder_corner);
        int stops = (!(joins && moves[k - 1].alone) && is_steep(before, steep)) ||
                    (!(joins && moves[k].alone) && is_steep(now, steep));
        if (stops || moves[k - 1].alone == REST || moves[k].alone == REST || v < CREEP)
            v = 0.0;
        cruise = lesser(BELOW_CRUISE * moves[k - 1].cruise, cruise);
        corners[k] = caps[k] = lesser(v, cruise);
        if (late > 0.0 && corners[k] > 0.0)
            caps[k] = lesser(sqrt(corners[k] * corners[k] + 2.0 * late * moves[k].acceleration), cruise);
    }
    return n;
}

LOOP(greatest_speeds, FLOATS(0, ITEMS(1) / OF_MOVE * COLUMNS + COLUMNS), (const struct limited *)FLOATS(1, 0),
     ITEMS(1) / OF_MOVE, (const struct rules *)FLOATS(2, RULES), REAL(3), WITHIN(4, 0, 1), REAL(5), REAL(6),
     NEW_FLOATS(0, ITEMS(1) / OF_MOVE + 1), NEW_FLOATS(1, ITEMS(1) / OF_MOVE + 1))

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

struct run {
    double length, acceleration;
};

/* Lower speed (r + 1) along the chain of runs to what can be reached from its start, or its end. new
 * (r + 1), all set: from which speeds that must be found. They are taken in rounds, since rounding may find a slightly higher speed from a lower one. */
static void lower(double *speed, const struct run *runs, int64_t r, double jerk, int from_end,
                  uint8_t *new)
{
    int64_t step = from_end ? -1 : 1, count = r;
    for (int64_t k = 0; k <= r; k++)
        new[k] = 1;
    while (count) {
        count = 0;
        for (int64_t i = r - 1; i >= 0; i--) {
            int64_t k = from_end ? r - i : i, run = from_end ? k - 1 : k;
            if (!new[k])
                continue;
            double top = reachable(speed[k], runs[run].length, runs[run].acceleration, jerk);
            new[k] = 0;
            if (top < speed[k + step])
                speed[k + step] = top, new[k + step] = 1, count++;
        }
    }
}

/* Find the squares of speed v2 (n + 1) at which braking and accelerating fit, at constant acceleration.
 * caps2: of the caps; reach2: what v2 could gain or lose since the start. */
static void fit_squares(const double *caps2, const double *reach2, int64_t n, double *v2)
{
    double least = INFINITY;
    for (int64_t k = n; k >= 0; k--) {
        least = lesser(least, caps2[k] + reach2[k]);
        v2[k] = lesser(least - reach2[k], caps2[k]);
    }
    least = INFINITY;
    for (int64_t k = 0; k <= n; k++) {
        least = lesser(least, v2[k] - reach2[k]);
        v2[k] = lesser(greater(least + reach2[k], 0.0), caps2[k]);
    }
}

enum { PLATEAU = 256 }; /* moves at cruise speed in a run */

/* As find_runs, for moves in which the machine does not rest, from a speed to another. */
static int64_t runs_between_rests(const struct limited *moves, const double *caps, int64_t n, double first,
                                  double last, double jerk, double *room, double *s, int64_t *ends,
                                  double *speed)
{
    double *caps2 = room, *reach2 = caps2 + n + 1, *v2 = reach2 + n + 1;
    struct run *runs = (struct run *)(v2 + n + 1);
    int64_t r = 0;
    s[0] = reach2[0] = 0.0;
    for (int64_t k = 0; k < n; k++) {
        s[k + 1] = s[k] + moves[k].length;
        reach2[k + 1] = reach2[k] + 2.0 * (FEASIBLE * moves[k].acceleration) * moves[k].length;
        caps2[k] = caps[k] * caps[k];
    }
    caps2[0] = first * first, caps2[n] = last * last;
    fit_squares(caps2, reach2, n, v2);
    v2[0] = caps2[0];
    double rounding = 1e-15 * reach2[n];
    for (int64_t k = 0; k <= n; k++) {
        if (k > 0 && k < n) {
            struct limited one = moves[k - 1], other = moves[k];
            int slowed = k % PLATEAU == 0 || caps[k] < (1.0 - 2e-4) * lesser(one.cruise, other.cruise);
            int reached = v2[k] >= (1.0 - 1e-6) * caps2[k] - rounding;
            int change = one.cruise != other.cruise || one.acceleration != other.acceleration;
            change |= one.alone || other.alone;
            if (!(slowed && reached) && !change)
                continue;
        }
        if (r > 0)
            runs[r - 1].length = s[k] - s[ends[r - 1]];
        if (k < n)
            runs[r].acceleration = FEASIBLE * moves[k].acceleration;
        speed[r] = sqrt(v2[k]), ends[r++] = k;
    }
    uint8_t *new = (uint8_t *)(runs + n + 1);
    lower(speed, runs, r - 1, jerk, 1, new);
    speed[0] = first; /* final before, with the share of feasible to spare */
    lower(speed, runs, r - 1, jerk, 0, new);
    return r - 1;
}

/* Find the vertices that end runs, and the speeds there; return how many. caps (n): greatest speeds at
 * which moves begin, but the first at a given one. rolling: the last ends at its own speed, not in a stop.
 * s, ends and speed (n + 1); s: path length at the vertices, from 0 on again after a move at which the
 * machine rests: that is a run by itself. room (6, n + 1). */
static int64_t find_runs(const struct limited *moves, const double *caps, int64_t n, double begin,
                         int64_t rolling, double jerk, double *room, double *s, int64_t *ends, double *speed)
{
    int64_t r = 0;
    for (int64_t from = 0, to = 0; from <= n; from = ++to) {
        while (to < n && moves[to].alone != REST)
            to++;
        if (to == from) {
            s[from] = speed[r] = 0.0, ends[r++] = from;
            continue;
        }
        int64_t first = r;
        double last = to == n && rolling ? BELOW_CRUISE * moves[n - 1].cruise : 0.0;
        r += 1 + runs_between_rests(moves + from, caps + from, to - from, from ? caps[from] : begin, last,
                                    FEASIBLE * jerk, room, s + from, ends + r, speed + r);
        for (int64_t i = first; i < r; i++)
            ends[i] += from;
    }
    return r;
}

LOOP(find_runs, (const struct limited *)FLOATS(0, OF_MOVE * ITEMS(1)), FLOATS(1, 1), ITEMS(1), REAL(2),
     WITHIN(3, 0, 1), REAL(4), ROOM(0, 6 * (ITEMS(1) + 1)), NEW_FLOATS(1, ITEMS(1) + 1),
     UP_TO_INTEGERS(2, ITEMS(1) + 1), UP_TO_FLOATS(3, ITEMS(1) + 1))

struct planned { /* a run, without a limit on jerk */
    double length, begun2, ended2, acceleration; /* speeds squared */
};

static struct planned planned(const double *s, const int64_t *ends, const double *speed,
                              const double *acceleration, int64_t i)
{
    return (struct planned){s[ends[i + 1]] - s[ends[i]], speed[i] * speed[i], speed[i + 1] * speed[i + 1],
                            acceleration[i]};
}

/* Return the time of a run whose greatest speed is top. */
static double run_time(struct planned run, double top, double begun, double ended)
{
    double ramped = (2.0 * top * top - run.begun2 - run.ended2) / (2.0 * run.acceleration);
    return (2.0 * top - begun - ended) / run.acceleration + greater(run.length - ramped, 0.0) / top;
}

/* As smoothed_runs, for runs between which the machine does not rest. It plans a second time, where the square of the speed changes by no more than a gain,
 * which is smaller by ratios (r). Where that plan accelerates, the path gets no faster
 * than the plan's next peak; where it brakes all along, no faster than where it begins to. */
static int64_t smoothed_between_rests(const double *s, const int64_t *ends, const double *cruise,
                             const double *acceleration, const double *ratios, int64_t r, double *room,
                             double *speed, double *top, double *seconds)
{
    double *summed = room, *both = summed + r + 1, *gain = both + r + 1, *height = gain + r + 1;
    summed[0] = 0.0;
    for (int64_t i = 0; i < r; i++) {
        struct planned run = planned(s, ends, speed, acceleration, i);
        gain[i] = 2.0 * (1.0 - ratios[i]) * run.acceleration * run.length;
        summed[i + 1] = summed[i] + gain[i];
    }
    for (int64_t i = 0; i <= r; i++)
        height[i] = speed[i] * speed[i];
    fit_squares(height, summed, r, both);
    double rounding = 1e-12 * summed[r], following = INFINITY;
    int climbs_after = 1;
    for (int64_t i = r - 1; i >= 0; i--) { /* height: of the next peak; of no climb, NAN */
        int climbs = both[i] + rounding < both[i + 1] + gain[i];
        int peak = climbs && (both[i] + gain[i] > both[i + 1] + rounding || !climbs_after);
        if (peak)
            following = lesser((both[i] + both[i + 1] + gain[i]) / 2.0, cruise[i] * cruise[i]);
        height[i] = climbs ? following : NAN;
        climbs_after = climbs;
    }
    double before = INFINITY;
    for (int64_t i = 0; i < r; i++) {
        struct planned run = planned(s, ends, speed, acceleration, i);
        int climbs = height[i] == height[i];
        /* the next peak's height is the latest one's behind it */
        before = climbs ? height[i] : before;
        double smooth = climbs ? height[i] : lesser(before, run.begun2);
        double reached = run.acceleration * run.length + (run.begun2 + run.ended2) / 2.0;
        top[i] = sqrt(lesser(lesser(reached, smooth), cruise[i] * cruise[i]));
    }
    for (int64_t i = 0; i < r; i++) {
        speed[i] = lesser(speed[i], top[i]);
        speed[i + 1] = lesser(speed[i + 1], top[i]);
    }
    for (int64_t i = 0; i < r; i++)
        seconds[i] = run_time(planned(s, ends, speed, acceleration, i), top[i], speed[i], speed[i + 1]);
    return r;
}

/* Find the speeds (r + 1) of runs, none above those that are planned, and the greatest speed and the time
 * of each, (r), as Klipper plays them; 0 for runs in which s begins again. room (4, r + 1). */
static int64_t smoothed_runs(const double *s, const int64_t *ends, const double *highest,
                             const double *cruise, const double *acceleration, const double *ratios,
                             int64_t r, double *room, double *speed, double *top, double *seconds)
{
    memcpy(speed, highest, sizeof(double) * (size_t)(r + 1));
    for (int64_t from = 0, to = 0; from < r; from = ++to) {
        while (to < r && s[ends[to + 1]] > s[ends[to]])
            to++;
        if (to > from)
            smoothed_between_rests(s, ends + from, cruise + from, acceleration + from, ratios + from,
                                   to - from, room, speed + from, top + from, seconds + from);
        if (to < r)
            top[to] = seconds[to] = 0.0;
    }
    return r;
}

LOOP(smoothed_runs, FLOATS(0, 0), INDICES(1, ITEMS(3) + 1, 0, ITEMS(0)), FLOATS(2, ITEMS(3) + 1),
     FLOATS(3, 0), FLOATS(4, ITEMS(3)), FLOATS(5, ITEMS(3)), ITEMS(3), ROOM(0, 4 * (ITEMS(3) + 1)),
     NEW_FLOATS(1, ITEMS(3) + 1), NEW_FLOATS(2, ITEMS(3)), NEW_FLOATS(3, ITEMS(3)))

enum { PHASES = 7 }; /* of a run; t, j (r, 7) are their durations and jerks */
#define ALMOST 0.999 /* share of a limit that counts as all of it */
#define DRIFT 1e-6 /* mm by which a profile may miss its run's end through rounding */
#define FORGIVEN 1e-9 /* of a sample, by which a time may be after it */

struct wanted { /* a run: from speed v0 to v1 over a length */
    double v0, v1, length, cruise, most;
};

/* Fill t and j with one change of speed along the whole length; return its acceleration. */
static double ramp(struct wanted run, double jerk, double *t, double *j)
{
    double change = run.v1 - run.v0, T = 2.0 * run.length / (run.v0 + run.v1);
    double root = sqrt(greater(T * T - 4.0 * fabs(change) / jerk, 0.0));
    double a = 2.0 * fabs(change) / (T + root), part = a / jerk;
    for (int k = 0; k < PHASES; k++)
        t[k] = j[k] = 0.0;
    t[0] = t[2] = part;
    t[1] = isfinite(T) ? T - 2.0 * part : 0.0;
    j[0] = copysign(jerk, change), j[2] = -j[0];
    return a;
}

/* Fill three phases with a change of speed; return the way. */
static double change_speed(double slower, double faster, double acceleration, double jerk, double *t)
{
    double gain = faster - slower, full = acceleration / jerk;
    int reached = gain >= acceleration * full;
    t[0] = t[2] = reached ? full : sqrt(gain / jerk);
    t[1] = reached ? gain / acceleration - full : 0.0;
    return (slower + faster) / 2.0 * (t[0] + t[1] + t[2]);
}

/* Fill t with up to a peak, along, and down. Return whether the length is enough. */
static int peaked(struct wanted run, double peak, double jerk, double *t)
{
    double left = run.length - change_speed(run.v0, peak, run.most, jerk, t)
        - change_speed(run.v1, peak, run.most, jerk, t + 4);
    t[3] = greater(left, 0.0) / peak;
    return left >= 0.0;
}

/* Return the peak where the acceleration is reached both ways without a cruise; NAN if it is not. */
static double peak_of(struct wanted run, double jerk)
{
    double a = run.most, square = 1.0 / a, half = a / (2.0 * jerk);
    double rest = (run.v0 * (a / jerk - run.v0 / a) + run.v1 * (a / jerk - run.v1 / a)) / 2.0 - run.length;
    double peak = (sqrt(greater(half * half - square * rest, 0.0)) - half) / square;
    return peak - greater(run.v0, run.v1) >= a * (a / jerk) ? peak : NAN;
}

/* Fill the phases of r runs whose fastest profile has a closed form: at one speed, one change of speed, up
 * to cruise and down, or up and down with the acceleration reached. Note the others, which are one change
 * of speed until they are solved; return how many. */
static int64_t profiles(const double *v0, const double *v1, const double *length, const double *cruise,
                        const double *most, int64_t r, double jerk, double *t, double *j,
                        int64_t *others)
{
    int64_t count = 0;
    for (int64_t i = 0; i < r; i++, t += PHASES, j += PHASES) {
        struct wanted run = {v0[i], v1[i], length[i], cruise[i], most[i]};
        double taken = ramp(run, jerk, t, j), found[PHASES];
        int even = run.v0 == run.v1 && run.v0 >= ALMOST * run.cruise;
        if (even || taken >= ALMOST * run.most)
            continue;
        if (!peaked(run, run.cruise, jerk, found)) {
            double peak = peak_of(run, jerk);
            if (!isfinite(peak)) {
                others[count++] = i;
                continue;
            }
            peaked(run, peak, jerk, found);
        }
        for (int k = 0; k < PHASES; k++)
            t[k] = found[k];
        j[0] = j[6] = jerk, j[2] = j[4] = -jerk;
    }
    return count;
}

LOOP(profiles, FLOATS(0, ITEMS(4)), FLOATS(1, ITEMS(4)), FLOATS(2, ITEMS(4)), FLOATS(3, ITEMS(4)),
     FLOATS(4, 0), ITEMS(4), REAL(5), NEW_ROWS(0, ITEMS(4), PHASES), NEW_ROWS(1, ITEMS(4), PHASES),
     UP_TO_INTEGERS(2, ITEMS(4)))

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

/* Note which runs go backwards or miss their length. */
static int64_t misses(const double *t, const double *j, const double *v0, const double *length, int64_t r,
                      uint8_t *missed)
{
    for (int64_t i = 0; i < r; i++) {
        struct phase phase[PHASES + 1];
        integrate(t + PHASES * i, j + PHASES * i, v0[i], phase);
        missed[i] = fabs(phase[PHASES].s - length[i]) > DRIFT;
        for (int k = 0; k < PHASES; k++)
            missed[i] |= phase[k].v < -DRIFT;
    }
    return r;
}

LOOP(misses, FLOATS(0, PHASES * ITEMS(3)), FLOATS(1, PHASES * ITEMS(3)), FLOATS(2, ITEMS(3)),
     FLOATS(3, 0), ITEMS(3), NEW_FLAGS(0, ITEMS(3)))

/* Return the first whole sample at or after a time. */
static int64_t samples_until(double seconds) { return (int64_t)ceil(seconds / TS - FORGIVEN); }

LOOP(samples_until, REAL(0))

/* Return how many of n phases take time. */
static int64_t lasting(const double *t, int64_t n)
{
    int64_t count = 0;
    for (int64_t i = 0; t && i < n; i++)
        count += t[i] > 0.0;
    return count;
}

/* speed (r + 1) and s (r + 1) at the ends of runs. Fill table (6, p) with the phases as below, and end
 * with the time of the end. */
static int64_t phases(const double *t, const double *j, const double *speed, const double *s, int64_t r,
                      double start, double *table, int64_t p, double *end)
{
    int64_t row = 0;
    double spent = 0.0, waited = 0.0, begin = start;
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
            waited += greater(ceil(arrival / TS - FORGIVEN) - arrival / TS, 0.0) * TS;
        begin = start + spent + waited;
    }
    *end = begin;
    return p;
}

LOOP(phases, FLOATS(0, 0), FLOATS(1, ITEMS(0)), FLOATS(2, ITEMS(0) / PHASES + 1),
     FLOATS(3, ITEMS(0) / PHASES + 1), ITEMS(0) / PHASES, REAL(4),
     NEW_ROWS(0, 6, lasting(FLOATS(0, 0), ITEMS(0))), lasting(FLOATS(0, 0), ITEMS(0)), NEW_FLOATS(1, 1))

/* phases (6, p): start time, duration, path length, speed, acceleration, jerk. Path lengths s (n)
 * at samples first, first + 1, …, within 0 … end. */
static int64_t path_lengths(const double *phases, int64_t p, int64_t first, int64_t n, double end, double *s)
{
    const double *time = phases, *duration = phases + p, *s0 = phases + 2 * p,
                 *v = phases + 3 * p, *a = phases + 4 * p, *j = phases + 5 * p;
    int64_t k = 0;
    for (int64_t i = 0; i < n; i++) {
        double t = TS * (double)(first + i);
        while (k + 1 < p && time[k + 1] <= t)
            k++;
        double dt = lesser(t - time[k], duration[k]);
        double cubic = a[k] / 2.0 + dt * j[k] / 6.0;
        s[i] = lesser(greater(s0[k] + dt * (v[k] + dt * cubic), 0.0), end);
    }
    return n;
}

LOOP(path_lengths, FLOATS(0, 6), ITEMS(0) / 6, WHOLE(1), COUNT(2), REAL(3), NEW_FLOATS(0, COUNT(2)))

/* lengths (m + 1): path length at the vertices, points (m + 1, 4), line (m) of the moves. Fill in the
 * places xyze (n, 4) at s (n) and the line (n) of the move that each lies on. */
static int64_t follow(const double *lengths, const double *points, const int64_t *line, int64_t m,
                      const double *s, int64_t n, double *xyze, int64_t *line_at)
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
        line_at[i] = line[k];
    }
    return n;
}

LOOP(follow, FLOATS(0, 2), FLOATS(1, COLUMNS * ITEMS(0)), INTEGERS(2, ITEMS(0) - 1), ITEMS(0) - 1, FLOATS(3, 0),
     ITEMS(3), OUT_FLOATS(4, COLUMNS * ITEMS(3)), OUT_INTEGERS(5, ITEMS(3)))

/* way: length, speed at the start, acceleration, peak speed, how long it speeds up and slows down, and
 * seconds in all. Fill in the places xyze (n, 4) after ``first``, first + 1, … samples of a move between the
 * ends (2, 4), which is done after ``samples``. */
static int64_t move_at_rest(const double *way, const double *ends, int64_t first, int64_t samples, double *xyze,
                            int64_t n)
{
    double length = way[0], v_s = way[1], a = way[2], peak = way[3], up = way[4], down = way[5],
           seconds = way[6];
    for (int64_t i = 0; i < n; i++, xyze += COLUMNS) {
        double t = lesser(greater((double)(first + i) * TS, 0.0), seconds);
        double begun = lesser(t, up), ending = greater(t - (seconds - down), 0.0);
        double done = begun * (v_s + a * begun / 2.0) + peak * (t - begun) - a * ending * ending / 2.0;
        double share = first + i < samples ? done / length : 1.0;
        for (int c = 0; c < COLUMNS; c++)
            xyze[c] = c < Z ? ends[COLUMNS + c] : ends[c] + share * (ends[COLUMNS + c] - ends[c]);
    }
    return n;
}

LOOP(move_at_rest, FLOATS(0, 7), FLOATS(1, 2 * COLUMNS), WHOLE(2), WHOLE(3), OUT_FLOATS(4, 0),
     ITEMS(4) / COLUMNS)
