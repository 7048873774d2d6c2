#include <stdlib.h>

#include "kernels.h"

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

static int64_t leading_steps(const int64_t *from, const int64_t *to)
{
    int64_t one = llabs(to[0] - from[0]), other = llabs(to[1] - from[1]);
    return one > other ? one : other;
}

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

LOOP(marlin_slow_ends, FLOATS(0, AXES * (COUNT(3) + 1)), INTEGERS(1, AXES * (COUNT(3) + 1)),
     INTEGERS(2, AXES * (COUNT(3) + 1)), COUNT(3), PARTS(4, 2 * COUNT(6), COUNT(3)), INTEGERS(5, COUNT(6)),
     COUNT(6), WHOLE(7), WITHIN(8, 1, MOST_ITEMS), OUT_FLOATS(9, (SUMS + 1) * (COUNT(3) + 1)),
     OUT_INTEGERS(10, COUNT(3) + 1), OUT_BYTES(11, COUNT(3) + 1))
