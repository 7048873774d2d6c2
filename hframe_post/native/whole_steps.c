#include <stdlib.h>

#include "kernels.h"

enum { MOTORS = 2 };

struct steps {
    int64_t n;
    const int64_t *place; /* (n + 1, 2): of the motors */
    const int64_t *path;  /* (n + 1): steps of the leading motor since the first sample */
    int64_t least;        /* of a segment */
};

/* Return the steps of the motor that makes the most of them from a place to another. */
static int64_t leading_steps(const int64_t *from, const int64_t *to)
{
    int64_t one = llabs(to[0] - from[0]), other = llabs(to[1] - from[1]);
    return one > other ? one : other;
}

/* Mark in stops the first and the last sample of each rest. */
static void mark_rests(const struct steps *s, uint8_t *stops)
{
    enum { IDLE = 24 }; /* samples without a step, more of which are a rest */
    for (int64_t i = 1, first = 0; i <= s->n + 1; i++) {
        if (i <= s->n && s->path[i] == s->path[first])
            continue;
        if (i - first > IDLE)
            stops[first] = stops[i - 1] = 1;
        first = i;
    }
}

/* Find the samples at which a motor turns; return how many. turns (n). */
static int64_t turned(const struct steps *s, int motor, int64_t stall, int64_t *turns)
{
    int64_t count = 0, moving = -1;
    int up = 0;
    for (int64_t i = 0; i < s->n; i++) {
        int64_t step = s->place[MOTORS * (i + 1) + motor] - s->place[MOTORS * i + motor];
        if (step == 0)
            continue;
        if (moving >= 0 && up != (step > 0))
            turns[count++] = moving + 1 > i - stall ? moving + 1 : i - stall;
        moving = i, up = step > 0;
    }
    return count;
}

/* Drop from turns (count) those at both ends of the first of each row of short legs; return how many
 * remain. short_legs (count + 1): room. */
static int64_t without_short_legs(const struct steps *s, int motor, int64_t *turns, int64_t count,
                                  uint8_t *short_legs)
{
    int64_t from = s->place[motor], kept = 0;
    for (int64_t j = 0; j <= count; j++) {
        int64_t to = s->place[MOTORS * (j < count ? turns[j] : s->n) + motor];
        short_legs[j] = llabs(to - from) < s->least;
        from = to;
    }
    for (int64_t j = count; j > 0; j--)
        short_legs[j] &= !short_legs[j - 1];
    for (int64_t j = 0; j < count; j++) /* the last leg ends where motion does, at no turn */
        if (!short_legs[j] && !short_legs[j + 1])
            turns[kept++] = turns[j];
    return kept;
}

/* Mark in stops the turns of a motor with enough steps before and after. */
static void mark_turns(const struct steps *s, int motor, int64_t stall, int64_t *turns,
                       uint8_t *short_legs, uint8_t *stops)
{
    int64_t count = turned(s, motor, stall, turns), before = count + 1;
    while (count > 0 && count < before)
        before = count, count = without_short_legs(s, motor, turns, count, short_legs);
    for (int64_t j = 0; j < count; j++)
        stops[turns[j]] = 1;
}

/* Find ends (n) of segments up to stops (n + 1); return how many. */
static int64_t chain(const struct steps *s, int64_t apart, const uint8_t *stops, int64_t *ends)
{
    int64_t count = 0;
    for (int64_t i = 0, j; i < s->n; ends[count++] = i = j)
        for (j = i + 1; j < s->n && !stops[j]; j++)
            if (j - i >= apart && s->path[j] - s->path[i] >= s->least)
                break;
    return count;
}

/* Mark in drop (k) which ends (k) to drop; return whether there are any. A segment of too few steps
 * joins the one before. It joins the one after if the one before is too short or at rest, if steps
 * there and back cancel out with the one after, or if that is too short, too. The last end stays if
 * motion ends there. Of short segments in a row every other one is handled: call again.
 * steps (k + 1), cancelled (k + 1): room. */
static int superfluous(const struct steps *s, const int64_t *ends, int64_t k, int last,
                       int64_t *steps, int64_t *cancelled, uint8_t *drop)
{
    const int64_t *before = s->place, *from = before;
    int any = 0;
    for (int64_t j = 0; j < k; j++) {
        const int64_t *to = s->place + MOTORS * ends[j];
        steps[j] = leading_steps(from, to), cancelled[j] = drop[j] = 0;
        if (j > 0)
            cancelled[j - 1] = steps[j - 1] + steps[j] - leading_steps(before, to);
        before = from, from = to;
    }
    for (int64_t j = 0, row = 0; j < k; j++) {
        int is_short = steps[j] > 0 && steps[j] < s->least, first = is_short && !row;
        row = is_short;
        if (!first)
            continue;
        int final = last && j == k - 1;
        int next = j + 1 < k && steps[j + 1] > 0 && steps[j + 1] < s->least;
        int onward = j > 0 && cancelled[j - 1] + next <= cancelled[j];
        int joins_before = j > 0 && ((steps[j - 1] >= s->least && onward) || final);
        int64_t dropped = joins_before ? j - 1 : j;
        if (last && dropped == k - 1)
            continue;
        drop[dropped] = 1, any = 1;
    }
    return any;
}

/* ends (n): the samples at which segments end; returns how many. place (n + 1, 2); room (4 n + 4). */
static int64_t segment_ends(const int64_t *place, int64_t n, int64_t least, int64_t apart, int64_t stall,
                            int64_t last, int64_t *room, int64_t *ends)
{
    int64_t *path = room, *one = path + n + 1, *other = one + n + 1;
    uint8_t *stops = (uint8_t *)(other + n + 1), *marks = stops + n + 1;
    struct steps s = {n, place, path, least};
    path[0] = 0;
    stops[0] = 0;
    for (int64_t i = 0; i < n; i++) {
        path[i + 1] = path[i] + leading_steps(place + MOTORS * i, place + MOTORS * (i + 1));
        stops[i + 1] = 0;
    }
    mark_rests(&s, stops);
    for (int motor = 0; motor < MOTORS; motor++)
        mark_turns(&s, motor, stall, one, marks, stops);
    int64_t k = chain(&s, apart, stops, ends);
    while (superfluous(&s, ends, k, last != 0, one, other, marks)) {
        int64_t kept = 0;
        for (int64_t j = 0; j < k; j++)
            if (!marks[j])
                ends[kept++] = ends[j];
        k = kept;
    }
    return k;
}

LOOP(segment_ends, INTEGERS(0, MOTORS), ITEMS(0) / MOTORS - 1, WHOLE(1), WHOLE(2), COUNT(3), WHOLE(4),
     (int64_t *)ROOM(0, 4 * (ITEMS(0) / MOTORS)), UP_TO_INTEGERS(1, ITEMS(0) / MOTORS - 1))

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
INSIDE double corner(const double *unit, const double *next, double a, double deviation)
{
    const double STRAIGHT = 0.999999; /* Marlin's cosine from which on blocks turn straight back */
    double cosine = -(unit[0] * next[0] + unit[1] * next[1] + unit[2] * next[2] + unit[3] * next[3]);
    return cosine > STRAIGHT ? 0.0 : sqrt(on_arc(greater(cosine, -STRAIGHT), deviation * a));
}

/* n, d, a (k), corners (k + 1): of blocks between places at (k + 1, 4). matrix (2, 2): from x, y to
 * the motors. */
WIDE static int64_t marlin_blocks(const double *at, int64_t k, const struct limits *limits,
                                  const double *matrix, double after, double *n,
                                  double *d, double *a, double *corners)
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
            corners[i] = corner(last, now, a[i] * d[i] / n[i], limits->deviation);
    }
    corners[k] = after;
    return k;
}

LOOP(marlin_blocks, FLOATS(0, COLUMNS), ITEMS(0) / COLUMNS - 1, (const struct limits *)FLOATS(1, LIMITS),
     FLOATS(2, 4), REAL(3), NEW_FLOATS(0, ITEMS(0) / COLUMNS - 1), NEW_FLOATS(1, ITEMS(0) / COLUMNS - 1),
     NEW_FLOATS(2, ITEMS(0) / COLUMNS - 1), NEW_FLOATS(3, ITEMS(0) / COLUMNS))

enum { AXES = 2, SUMS = 3 * AXES };

/* A run of segments whose ends are chosen again. Its samples count from its first. */
struct run {
    const double *at;     /* (n + 1, AXES): the command, in steps */
    const int64_t *cells; /* (n + 1, AXES): the whole steps next to it */
    const int64_t *motors; /* (n + 1, AXES): where these put the motors */
    int64_t n, least, apart, reach;
    double *sums; /* (n + 1, SUMS): of the samples before each: the command, by index, squared */
    double *cost; /* (n + 1): least sum of squares up to a segment that ends there */
    int64_t *from;
};

static void add_up(struct run *run)
{
    for (int s = 0; s < SUMS; s++)
        run->sums[s] = 0.0;
    for (int64_t i = 0; i < run->n; i++) {
        const double *before = run->sums + SUMS * i;
        double *sums = run->sums + SUMS * (i + 1);
        for (int axis = 0; axis < AXES; axis++) {
            double c = run->at[AXES * i + axis] - run->at[axis];
            sums[axis] = before[axis] + c;
            sums[AXES + axis] = before[AXES + axis] + c * (double)i;
            sums[2 * AXES + axis] = before[2 * AXES + axis] + c * c;
        }
    }
}

/* Return the squares of what a segment from sample j to i misses in one axis, summed. */
static double missed(const struct run *run, int64_t j, int64_t i, int axis)
{
    const double *before = run->sums + SUMS * j + axis, *sums = run->sums + SUMS * i + axis;
    int64_t begun = run->cells[AXES * j + axis], way = run->cells[AXES * i + axis] - begun;
    double T = (double)(i - j), a = (double)begun - run->at[axis], v = (double)way / T;
    double c = sums[0] - before[0], by_index = sums[AXES] - before[AXES];
    double squared = sums[2 * AXES] - before[2 * AXES], u = T * (T - 1.0) / 2.0;
    double line = (a * a * T + 2.0 * a * v * u) + v * v * u * (2.0 * T - 1.0) / 3.0;
    return (line + squared) - 2.0 * (a * c + v * (by_index - (double)j * c));
}

/* Find the segment that best ends at sample i. */
static void end_at(struct run *run, int64_t i)
{
    double best = INFINITY;
    int64_t last = i < run->reach ? i : run->reach, chosen = -1;
    for (int64_t T = run->apart, longest = last; T <= longest; T++) {
        int64_t j = i - T;
        if (leading_steps(run->motors + AXES * j, run->motors + AXES * i) < run->least)
            continue;
        if (longest == last && T + T < last) /* the shortest possible one */
            longest = T + T;
        if (run->cost[j] >= best)
            continue;
        double cost = run->cost[j] + greater(missed(run, j, i, 0) + missed(run, j, i, 1), 0.0);
        if (cost < best)
            best = cost, chosen = j;
    }
    run->cost[i] = best, run->from[i] = chosen;
}

/* Mark in is_end (n + 1) the best ends of a run, if there are any, between its first and its last. */
static void mark_best(struct run *run, uint8_t *is_end)
{
    add_up(run);
    run->cost[0] = 0.0, run->from[0] = 0;
    for (int64_t i = 1; i <= run->n; i++)
        end_at(run, i);
    if (run->from[run->n] < 0)
        return;
    for (int64_t i = 1; i < run->n; i++)
        is_end[i] = 0;
    for (int64_t i = run->from[run->n]; i > 0; i = run->from[i])
        is_end[i] = 1;
}

/* Mark in is_end (n + 1) the best ends of r runs instead of those that are marked. parts (r, 2): the
 * samples before each run, since the last one, and in it; reach (r): of its segments; room (7 n + 7),
 * from (n + 1): room. */
static int64_t marlin_slow_ends(const double *at, const int64_t *cells, const int64_t *motors,
                                int64_t n, const int64_t *parts, const int64_t *reach,
                                int64_t r, int64_t least, int64_t apart, double *room,
                                int64_t *from, uint8_t *is_end)
{
    int64_t first = 0;
    for (int64_t k = 0; k < r; k++) {
        first += parts[2 * k];
        struct run run = {at + AXES * first, cells + AXES * first, motors + AXES * first, parts[2 * k + 1], least,
                          apart, reach[k], room, room + SUMS * (n + 1), from};
        mark_best(&run, is_end + first);
        first += run.n;
    }
    return 0;
}

LOOP(marlin_slow_ends, FLOATS(0, AXES * ITEMS(7)), INTEGERS(1, AXES * ITEMS(7)), INTEGERS(2, AXES * ITEMS(7)),
     BOUNDED(7, ITEMS(7) - 1, 0, MOST_ITEMS), PARTS(3, 2 * ITEMS(4), ITEMS(7) - 1), INTEGERS(4, 0), ITEMS(4),
     WHOLE(5), WITHIN(6, 1, MOST_ITEMS), ROOM(0, (SUMS + 1) * ITEMS(7)), (int64_t *)ROOM(1, ITEMS(7)),
     OUT_BYTES(7, 0))
