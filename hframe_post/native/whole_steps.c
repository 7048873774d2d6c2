#include <stdlib.h>

#include "kernels.h"

enum { MOTORS = 2 };

struct steps {
    int64_t n;
    const int64_t *place; /* (n + 1, 2): of the motors, since the first sample */
    const int64_t *path;  /* (n + 1): steps of the leading motor, since then */
    int64_t least;        /* of a segment */
};

static int64_t most(const int64_t *place, const int64_t *from)
{
    int64_t one = llabs(place[0] - from[0]), other = llabs(place[1] - from[1]);
    return one > other ? one : other;
}

/* Mark in stops the first and the last sample of each rest of more than ``idle`` samples. */
static void mark_rests(const struct steps *s, int64_t idle, uint8_t *stops)
{
    for (int64_t i = 1, first = 0; i <= s->n + 1; i++) {
        if (i <= s->n && s->path[i] == s->path[first])
            continue;
        if (i - first > idle)
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
        steps[j] = most(to, from), cancelled[j] = drop[j] = 0;
        if (j > 0)
            cancelled[j - 1] = steps[j - 1] + steps[j] - most(to, before);
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

/* ends (n): the samples at which segments end; returns how many. steps (n, 2); room (6 n + 6). */
static int64_t marlin_segment_ends(const int64_t *steps, int64_t n, int64_t least, int64_t apart,
                                   int64_t idle, int64_t stall, int64_t last, int64_t *room,
                                   int64_t *ends)
{
    int64_t *place = room, *path = place + MOTORS * (n + 1), *one = path + n + 1, *other = one + n + 1;
    uint8_t *stops = (uint8_t *)(other + n + 1), *marks = stops + n + 1;
    struct steps s = {n, place, path, least};
    place[0] = place[1] = path[0] = 0;
    stops[0] = 0;
    for (int64_t i = 0; i < n; i++) {
        int64_t *to = place + MOTORS * (i + 1);
        to[0] = to[-2] + steps[MOTORS * i], to[1] = to[-1] + steps[MOTORS * i + 1];
        path[i + 1] = path[i] + most(to, to - MOTORS);
        stops[i + 1] = 0;
    }
    mark_rests(&s, idle, stops);
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

LOOP(marlin_segment_ends, INTEGERS(0, MOTORS * COUNT(1)), COUNT(1), WHOLE(2), WHOLE(3), WHOLE(4),
     COUNT(5), WHOLE(6), OUT_INTEGERS(7, 6 * (COUNT(1) + 1)), OUT_INTEGERS(8, COUNT(1)))
