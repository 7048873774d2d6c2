#include <string.h>

#include "kernels.h"

enum { BLOCK = 32, WIDER = 64 }; /* sums that are computed together, in registers */

/* BLOCK sums of the m factors in turn, each times a number of u. */
INSIDE void sum_block(const double *factors, int64_t m, const double *u, double *sums)
{
    double sum[BLOCK] = {0.0};
    for (int64_t i = 0; i < m; i++)
        for (int k = 0; k < BLOCK; k++)
            sum[k] += factors[i] * u[i + k];
    memcpy(sums, sum, sizeof sum);
}

/* sums (n), zero at first: of the m factors in turn, each times a number of u; from one sum to the
 * next these go on by one. The last block overlaps with the one before. */
WIDE static int64_t sliding_sums(const double *factors, int64_t m, const double *u, int64_t n,
                                 double *sums)
{
    for (int64_t i = 0; i < m && n < BLOCK; i++)
        for (int64_t k = 0; k < n; k++)
            sums[k] += factors[i] * u[i + k];
    for (int64_t k = 0; k < n && n >= BLOCK; k += BLOCK) {
        int64_t at = k + BLOCK <= n ? k : n - BLOCK;
        sum_block(factors, m, u + at, sums + at);
    }
    return n;
}

/* Add to sums (n) those of the m factors in turn, each times a number of u, in single precision. */
WIDE static void add_single_sums(const float *factors, int64_t m, const float *u, int64_t n, double *sums)
{
    float few[WIDER] = {0.0f}; /* those that fill no register */
    for (int64_t i = 0; i < m; i++)
        for (int64_t k = 0; k < n % WIDER; k++)
            few[k] += factors[i] * u[i + k];
    for (int64_t k = 0; k < n % WIDER; k++)
        sums[k] += (double)few[k];
    for (int64_t k = n % WIDER; k < n; k += WIDER) {
        float sum[WIDER] = {0.0f};
        for (int64_t i = 0; i < m; i++)
            for (int j = 0; j < WIDER; j++)
                sum[j] += factors[i] * u[k + i + j];
        for (int j = 0; j < WIDER; j++)
            sums[k + j] += (double)sum[j];
    }
}

/* Output y (count) of a finite filter at the last count samples of its input u (h): taps (m), that of the
 * oldest acceleration first, then rest times the input ``late`` samples before, less its speed times lag.
 * room (count + m). */
static int64_t finite_filter(const double *taps, int64_t m, const double *u, int64_t h, int64_t late,
                             double rest, double lag, int64_t count, double *room, double *y)
{
    const double *from = u + h - count - m - 1, *then = u + h - count - late;
    for (int64_t i = 0; i < count + m - 1; i++)
        room[i] = (from[i + 2] - from[i + 1]) - (from[i + 1] - from[i]);
    memset(y, 0, sizeof(double) * (size_t)count);
    sliding_sums(taps, m, room, count, y);
    for (int64_t i = 0; i < count; i++)
        y[i] += rest * then[i];
    for (int64_t i = 0; i < count && lag != 0.0; i++)
        y[i] -= lag * (then[i] - then[i - 1]);
    return count;
}

LOOP(finite_filter, FLOATS(0, COUNT(1)), WITHIN(1, 1, MOST_ITEMS), FLOATS(2, COUNT(3)),
     WITHIN(3, COUNT(7) + greater(COUNT(1), WITHIN(4, 0, MOST_FEW)) + 1, MOST_ITEMS), WITHIN(4, 0, MOST_FEW),
     REAL(5), REAL(6), COUNT(7), OUT_FLOATS(8, COUNT(7) + COUNT(1)), OUT_FLOATS(9, COUNT(7)))

struct coarse { /* a response at half the rate: see model/impulse_response.py */
    const double *taps; /* m, two samples apart, the oldest first */
    int64_t m, late;
    double rest, lag;
};

/* Output y (count) at every 2·groups-th sample from u[0] on, in single precision: of accelerations over two
 * samples of the input's means (1, 2, 1)/4, halved, then rest times the input, less its speed times lag.
 * Taps and accelerations are taken in groups, in each of which they follow each other. room: see SUMS_ROOM. */
WIDE static void filter_coarsely(struct coarse of, const double *u, int64_t count, int64_t groups, float *room,
                            double *y)
{
    const double *from = u + of.late - 2 * of.m - 3;
    int64_t needed = groups * (count - 1) + of.m;
    if (count == 0)
        return;
    double *mean = (double *)room;
    room = (float *)(mean + needed + 2);
    for (int64_t i = 0; i < needed + 2; i++)
        mean[i] = 0.125 * ((from[2 * i - 1] + from[2 * i + 1]) + 2.0 * from[2 * i]);
    for (int64_t i = 0; i < count; i++) {
        const double *at = u + 2 * groups * i;
        y[i] = of.rest * at[0] - 0.5 * of.lag * (at[0] - at[-2]);
    }
    for (int64_t group = 0; group < groups && group < of.m; group++) {
        int64_t own = (of.m - group + groups - 1) / groups;
        const double *now = mean + group;
        float *factors = room, *a = room + own;
        for (int64_t i = 0; i < own; i++)
            factors[i] = (float)of.taps[group + groups * i];
        for (int64_t i = 0; i < count + own - 1; i++, now += groups)
            a[i] = (float)((now[2] - now[1]) - (now[1] - now[0]));
        add_single_sums(factors, own, a, count, y);
    }
}

/* Doubles of room that it needs; step: of its outputs. */
#define SUMS_ROOM(count, step, m) (((step) / 2 + 1) * ((count) + 1) + 2 * (m) + 4)

static int64_t coarse_filter(const double *taps, int64_t m, int64_t late, double rest, double lag,
                             const double *u, int64_t first, int64_t count, int64_t every, double *y,
                             double *room)
{
    struct coarse of = {taps, m, late, rest, lag};
    filter_coarsely(of, u + first, count, every / 2, (float *)room, y);
    return count;
}

LOOP(coarse_filter, FLOATS(0, 1), BOUNDED(0, ITEMS(0), 1, MOST_FEW), WITHIN(1, 0, 2 * ITEMS(0)), REAL(2),
     REAL(3), FLOATS(4, WITHIN(5, 0, MOST_ITEMS) + FEW(1) + FEW(7) * (COUNT(6) - 1) + 1),
     WITHIN(5, 2 * ITEMS(0) + 4 - FEW(1), MOST_ITEMS), COUNT(6), WITHIN(7, 2, MOST_FEW),
     NEW_FLOATS(0, COUNT(6)), ROOM(1, SUMS_ROOM(COUNT(6), FEW(7), ITEMS(0))))

LOOP(sliding_sums, FLOATS(0, COUNT(1)), COUNT(1), FLOATS(2, COUNT(1) - 1 + COUNT(3)), COUNT(3),
     OUT_FLOATS(4, COUNT(3)))

struct vector {
    double x, y;
};

enum {
    COARSE = 3, /* samples from one to the next in the first search of the nearest */
    TRIED = 2 * NEAREST / COARSE + 1,
    MARGIN = NEAREST + 2, /* samples of a path around those near which it is looked at */
    AT_ONCE = 1024        /* samples that are laid out together: they stay near the processor */
};

struct path { /* n samples, of which some are laid out; beyond its ends it stays where they are */
    const double *places;
    int64_t columns, n, base; /* base: number of the first that is laid out */
    double x[AT_ONCE + 2 * MARGIN], y[AT_ONCE + 2 * MARGIN];
    double thirds[COARSE][2][AT_ONCE / COARSE + MARGIN]; /* x, y of every third, from each of three on */
    int32_t turns[AT_ONCE + 2 * MARGIN]; /* how many samples before each change the direction */
};

static int64_t within(int64_t k, int64_t n) { return k < 0 ? 0 : k < n ? k : n - 1; }

static double square(struct vector v) { return v.x * v.x + v.y * v.y; }

/* Lay out a path for points near samples first to first + AT_ONCE - 1. */
INSIDE void lay_out(struct path *path, int64_t first)
{
    enum { ALL = AT_ONCE + 2 * MARGIN };
    const double STRAIGHT = 1e-6; /* sine of an angle below which a path goes straight on */
    int32_t turning[ALL];
    double *x = path->x, *y = path->y;
    path->base = first - MARGIN;
    for (int64_t i = 0; i < ALL; i++) {
        const double *at = path->places + path->columns * within(path->base + i, path->n);
        x[i] = at[X], y[i] = at[Y];
    }
    for (int64_t k = 0; k < COARSE; k++)
        for (int64_t i = 0; k + COARSE * i < ALL; i++) {
            path->thirds[k][X][i] = x[k + COARSE * i];
            path->thirds[k][Y][i] = y[k + COARSE * i];
        }
    for (int64_t i = 1; i < ALL - 1; i++) {
        double ax = x[i] - x[i - 1], ay = y[i] - y[i - 1], bx = x[i + 1] - x[i], by = y[i + 1] - y[i];
        double cross = ax * by - ay * bx, dot = ax * bx + ay * by;
        int still = (ax == 0.0) & (ay == 0.0), still_then = (bx == 0.0) & (by == 0.0);
        turning[i] = (fabs(cross) > STRAIGHT * fabs(dot)) | (dot < 0.0) | (still != still_then);
    }
    path->turns[0] = path->turns[1] = 0;
    for (int64_t i = 1; i < ALL - 1; i++)
        path->turns[i + 1] = path->turns[i] + turning[i];
}

/* Return the way to a point from sample k. */
INSIDE struct vector from_sample(const struct path *path, struct vector a, int64_t k)
{
    return (struct vector){a.x - path->x[k - path->base], a.y - path->y[k - path->base]};
}

/* Return the way to a point from the nearest place on the segment between samples p and q. */
INSIDE struct vector from_segment(const struct path *path, struct vector a, int64_t p, int64_t q)
{
    struct vector to = from_sample(path, a, q);
    a = from_sample(path, a, p);
    double dx = a.x - to.x, dy = a.y - to.y;
    double length2 = dx * dx + dy * dy;
    double share = length2 > 0.0 ? (a.x * dx + a.y * dy) / length2 : 0.0;
    share = lesser(greater(share, 0.0), 1.0);
    return (struct vector){a.x - dx * share, a.y - dy * share};
}

enum { LATEST = 31 }; /* bits of a key, which tell of which number it is; the others are those of the number */

/* Return the lesser key, of two. The bits of a positive number grow with it, and integers are sooner compared. */
INSIDE int64_t lesser_key(int64_t least, double number, int64_t which)
{
    int64_t key;
    memcpy(&key, &number, sizeof key);
    key = (key & ~(int64_t)LATEST) | which;
    return key < least ? key : least;
}

/* Return the sample nearest to the point: try some around ``at``, then the neighbours of the best. */
INSIDE int64_t nearest(const struct path *path, struct vector a, int64_t at)
{
    int64_t from = at - NEAREST - path->base, least = INT64_MAX;
    const double *x = path->thirds[from % COARSE][X] + from / COARSE;
    const double *y = path->thirds[from % COARSE][Y] + from / COARSE;
    for (int64_t i = 0; i < TRIED; i++)
        least = lesser_key(least, square((struct vector){a.x - x[i], a.y - y[i]}), i);
    int64_t found = at - NEAREST + COARSE * (least & LATEST);
    int64_t candidates[] = {found - 1, found, found + 1, at - 1, at, at + 1};
    least = INT64_MAX;
    for (int64_t i = 0; i < 6; i++)
        least = lesser_key(least, square(from_sample(path, a, candidates[i])), i);
    return within(candidates[least & LATEST], path->n);
}

/* Return the way to a point from the path near its sample ``at``, one of those laid out. */
INSIDE struct vector way_off(const struct path *path, struct vector a, int64_t at)
{
    int64_t low = within(at - NEAREST, path->n), high = within(at + NEAREST, path->n);
    if (path->turns[high - path->base] == path->turns[low + 1 - path->base])
        return from_segment(path, a, low, high);
    int64_t k = nearest(path, a, at);
    struct vector before = from_segment(path, a, k, k - 1), after = from_segment(path, a, k, k + 1);
    return square(before) < square(after) ? before : after;
}

/* Distances (count) of the nozzle (n) from the path through places (n, columns) at samples at (count). */
WIDE static int64_t distances(const double *places, int64_t columns, int64_t n, const struct vector *nozzle,
                              const int64_t *at, int64_t count, double *distance)
{
    struct path path;
    path.places = places, path.columns = columns, path.n = n;
    for (int64_t i = 0, first = -1; i < count; i++) {
        if (first < 0 || at[i] < first || at[i] >= first + AT_ONCE)
            lay_out(&path, first = at[i]);
        distance[i] = sqrt(square(way_off(&path, nozzle[at[i]], at[i])));
    }
    return count;
}

LOOP(distances, FLOATS(0, 0), BOUNDED(0, WIDTH(0), 2, MOST_FEW), ROWS(0),
     (const struct vector *)FLOATS(1, 2 * ROWS(0)), INDICES(2, ITEMS(2), 0, ROWS(0)), ITEMS(2),
     NEW_FLOATS(0, ITEMS(2)))

/* ends (k), ascending, and places at (k) there: write where the segments between them are at those of
 * samples first … first + n − 1 that are in them, but at the first end. */
static int64_t play(const int64_t *ends, const struct vector *at, int64_t k, int64_t first, int64_t n,
                    struct vector *command)
{
    for (int64_t i = 1; i < k; i++) {
        int64_t begin = ends[i - 1], end = ends[i];
        struct vector from = at[i - 1], to = at[i];
        int64_t low = begin < first ? first : begin + 1, high = end < first + n ? end : first + n - 1;
        for (int64_t s = low; s <= high; s++) {
            double share = (double)(s - begin) / (double)(end - begin);
            command[s - first].x = from.x + share * (to.x - from.x);
            command[s - first].y = from.y + share * (to.y - from.y);
        }
    }
    return n;
}

LOOP(play, INTEGERS(0, COUNT(2)), (const struct vector *)FLOATS(1, 2 * COUNT(2)), COUNT(2), WHOLE(3),
     COUNT(4), (struct vector *)OUT_FLOATS(5, 2 * COUNT(4)))

/* Note at which samples before ``stop`` the path xyze moves, of every n-th from ``first`` on, and whether
 * it extrudes there; return their number. */
static int64_t moving(const double *xyze, int64_t stop, int64_t first, int64_t every, int64_t *at,
                      uint8_t *extruding)
{
    int64_t count = 0;
    for (int64_t k = first; k < stop; k += every) {
        const double *now = xyze + COLUMNS * k, *before = k > 0 ? now - COLUMNS : now;
        if (now[X] != before[X] || now[Y] != before[Y]) {
            extruding[count] = now[E] > before[E];
            at[count++] = k;
        }
    }
    return count;
}

static int64_t numbers_of(int64_t from, int64_t stop, int64_t step)
{
    return stop > from && step > 0 ? (stop - from + step - 1) / step : 0;
}

/* Return which of the samples begin, begin + step, … is k. */
INSIDE int64_t number_of(int64_t k, int64_t begin, int64_t step)
{
    return (uint32_t)(k - begin) / (uint32_t)step; /* half the time of a longer division */
}

struct stretch { /* samples begin, begin + apart, … before ``stop`` of n */
    int64_t n, begin, stop, apart;
};

/* Write the output of a response to one coordinate of a command, whose samples are ``width`` apart, at the
 * samples of a stretch, two apart; room: see judge_window. */
static void respond(struct coarse of, const double *command, int64_t width, struct stretch at, double *y,
                    double *room)
{
    int64_t past = of.late < 2 * of.m ? 2 * of.m + 4 - of.late : 4;
    int64_t size = past + (at.stop - at.begin) + of.late;
    int64_t halves = at.apart % 2 ? 2 : 1, step = halves * at.apart;
    double *u = room, *some = u + size;
    int64_t first = at.begin - past, inside = first < 0 ? -first : 0, after = at.n - first;
    after = after < size ? after : size;
    for (int64_t i = 0; i < inside; i++) /* before the first and after the last sample it rests */
        u[i] = command[0];
    for (int64_t i = inside; i < after; i++)
        u[i] = command[width * (first + i)];
    for (int64_t i = after; i < size; i++)
        u[i] = command[width * (at.n - 1)];
    for (int64_t half = 0; half < halves; half++) { /* of an odd step, every second output */
        int64_t begin = half * at.apart, count = numbers_of(at.begin + begin, at.stop, step);
        filter_coarsely(of, u + past + begin, count, step / 2, (float *)(some + count), some);
        for (int64_t i = 0; i < count; i++)
            y[2 * (half + halves * i)] = some[i];
    }
}

/* xyze (n, 4), commands (given, n, 2), of which the path may be one more, the first. Responses of x, of y and,
 * if there are three, of racking: counts of taps, how many samples late, gain at rest and lag of each. Write
 * where the path moves (k) and extrudes; the nozzle (strategies, samples from begin on, apart); the ways to it
 * from the path and their lengths (k, strategies). */
WIDE static int64_t judge_window(const double *xyze, int64_t n, int sliced, const double *commands,
                                 int64_t given, const double *taps, const int64_t *counts,
                                 const int64_t *late, const double *gains, int64_t responses, double x_c,
                                 int64_t first, struct stretch judged, int64_t every, int64_t *at,
                                 uint8_t *extruding, struct vector *nozzle, struct vector *off,
                                 double *error, double *room)
{
    int64_t k = moving(xyze, judged.stop, first, every, at, extruding), strategies = sliced + given, done = 0;
    int64_t m = numbers_of(judged.begin, judged.stop, judged.apart);
    struct path path;
    double *theta = room;
    path.places = xyze, path.columns = COLUMNS, path.n = n;
    for (int64_t s = 0; s < strategies && m > 0; s++) {
        int64_t width = s < sliced ? COLUMNS : 2;
        const double *own = taps, *command = s < sliced ? xyze : commands + 2 * n * (s - sliced);
        struct vector *places = nozzle + m * s;
        for (int64_t r = 0; r < responses; own += counts[r++]) {
            struct coarse of = {own, counts[r], late[r], gains[2 * r], gains[2 * r + 1]};
            respond(of, command + (r == 1 ? Y : X), width, judged, r < 2 ? &places->x + r : theta,
                    theta + 2 * m);
        }
        for (int64_t i = 0; i < m && responses > 2; i++)
            places[i].y += (places[i].x - x_c) * theta[2 * i];
    }
    while (done < k) {
        int64_t end = at[done] + AT_ONCE;
        lay_out(&path, at[done]);
        for (; done < k && at[done] < end; done++) {
            const struct vector *place = nozzle + number_of(at[done], judged.begin, judged.apart);
            for (int64_t s = 0; s < strategies; s++, off++, place += m) {
                *off = way_off(&path, *place, at[done]);
                *error++ = sqrt(square(*off));
            }
        }
    }
    return k;
}

#define WINDOW_N (ITEMS(0) / COLUMNS)
#define WINDOW_S (FEW(1) + ROWS(2))
#define WINDOW_M numbers_of(COUNT(9), COUNT(10), FEW(12))
#define WINDOW_K numbers_of(COUNT(8), COUNT(10), FEW(11))

LOOP(judge_window, FLOATS(0, 0), WINDOW_N, (int)WITHIN(1, 0, 1), FLOATS(2, 2 * ROWS(2) * WINDOW_N), ROWS(2),
     FLOATS(3, 0), PARTS(4, BOUNDED(4, ITEMS(4), 2, 3), ITEMS(3)), INDICES(5, ITEMS(4), 0, 2 * ITEMS(3)),
     FLOATS(6, 2 * ITEMS(4)), ITEMS(4), REAL(7), COUNT(8),
     ((struct stretch){WINDOW_N, WITHIN(9, 0, COUNT(8)), WITHIN(10, 0, WINDOW_N), WITHIN(12, 1, MOST_FEW)}),
     WITHIN(11, 1, MOST_FEW), UP_TO_INTEGERS(0, WINDOW_K), UP_TO_FLAGS(1, WINDOW_K),
     (struct vector *)NEW_FLOATS(2, 2 * WINDOW_S * WINDOW_M),
     (struct vector *)UP_TO_ROWS(3, WINDOW_K, 2 * WINDOW_S), UP_TO_ROWS(4, WINDOW_K, WINDOW_S),
     ROOM(5, WINDOW_N + 3 * WINDOW_M + 4 * ITEMS(3) + 16 + SUMS_ROOM(WINDOW_M, 2 * FEW(12), ITEMS(3))))

struct sums { /* way of the nozzle, filament laid, filament wanted */
    double way, laid, wanted;
};

struct ended { /* pieces */
    int64_t count, *at;
    double *error;
};

/* Note a piece that ended before sample k, if it counts. */
static void end(struct ended *pieces, int64_t k, struct sums now, struct sums from, double piece)
{
    if (now.way - from.way > 0.5 * piece) {
        pieces->at[pieces->count] = k;
        pieces->error[pieces->count++] = fabs((now.laid - from.laid) / (now.wanted - from.wanted) - 1.0);
    }
}

/* path (n, 4), nozzle (n, 2), laid (n): filament that comes out in the step to each sample. Write how far the
 * line's width is off on each piece that ends, and the sample before which it does; return their number.
 * open (4): of a piece that is open before and after: how far its line is beyond the last end of a piece, and
 * its sums; 0 if no piece is open. at, errors (n): room. */
static int64_t line_pieces(const double *path, const double *nozzle, const double *laid, int64_t n,
                           double piece, double *open, int64_t *at, double *errors)
{
    struct sums now = {open[1], open[2], open[3]}, from = {0.0, 0.0, 0.0};
    double begin = now.way - open[0], number = 0.0;
    struct ended pieces = {0, at, errors};
    int drawing = now.way > 0.0;
    for (int64_t k = 1; k < n; k++) {
        const double *p = path + COLUMNS * k, *q = nozzle + 2 * k;
        double dx = p[X] - p[X - COLUMNS], dy = p[Y] - p[Y - COLUMNS], fed = p[E] - p[E - COLUMNS];
        if (!(fed > 0.0 && (dx != 0.0 || dy != 0.0))) {
            if (drawing)
                end(&pieces, k, now, from, piece);
            drawing = 0;
            continue;
        }
        double passed = (now.way - begin) / piece;
        if (!drawing)
            drawing = 1, from = now, begin = now.way, number = 0.0;
        else if (passed < number || passed >= number + 1.0) { /* seldom, so floor is called seldom */
            end(&pieces, k, now, from, piece);
            from = now, number = floor(passed);
        }
        double vx = q[X] - q[X - 2], vy = q[Y] - q[Y - 2], way = sqrt(vx * vx + vy * vy);
        now.way += way;
        now.laid += laid[k];
        now.wanted += fed / sqrt(dx * dx + dy * dy) * way;
    }
    open[0] = drawing ? now.way - begin - number * piece : 0.0;
    open[1] = drawing ? now.way - from.way : 0.0;
    open[2] = drawing ? now.laid - from.laid : 0.0;
    open[3] = drawing ? now.wanted - from.wanted : 0.0;
    return pieces.count;
}

LOOP(line_pieces, FLOATS(0, COLUMNS * COUNT(3)), FLOATS(1, 2 * COUNT(3)), FLOATS(2, COUNT(3)), COUNT(3), REAL(4),
     OUT_FLOATS(5, 4), OUT_INTEGERS(6, COUNT(3)), OUT_FLOATS(7, COUNT(3)))

/* A piece of a picture: where it ends; the numbers of line, layer and feature, and whether it begins anew, as
 * the bits of an int32; of each strategy the way off the path; the speed; of each where the nozzle is; of each
 * the largest error. */
enum { LINE_NUMBER = Z, LAYER, FEATURE, BEGINS, WAYS };

struct table { /* of n pieces */
    float *values;
    int64_t n, strategies;
};

struct rules { /* of joining: from which number on all must be alike; mm2, mm, mm */
    int64_t alike;
    float length2, near, off;
};

#define SPEED(strategies) (WAYS + 2 * (strategies))
#define ERRORS(strategies) (SPEED(strategies) + 1 + 2 * (strategies))
#define PIECE(strategies) (ERRORS(strategies) + (strategies))

static float *piece_of(struct table of, int64_t k) { return of.values + PIECE(of.strategies) * k; }

/* Return whether some numbers of b are as near to the line from a to c as ``most``. */
static int near_line(const float *a, const float *b, const float *c, int64_t low, int64_t high, float share,
                     float most)
{
    for (int64_t k = low; k < high; k++)
        if (!(fabsf(b[k] - a[k] - share * (c[k] - a[k])) <= most))
            return 0;
    return 1;
}

/* Return whether piece b may be joined to the next one, c; a is the one before. */
static int straight(struct table of, struct rules rules, int64_t first, int64_t second, int64_t third)
{
    const float *a = piece_of(of, first), *b = piece_of(of, second), *c = piece_of(of, third);
    const int32_t *here = (const int32_t *)b, *next = (const int32_t *)c;
    float dx = c[X] - a[X], dy = c[Y] - a[Y], square = dx * dx + dy * dy;
    float share = (b[X] - a[X]) * dx + (b[Y] - a[Y]) * dy;
    share /= square > 1e-12f ? square : 1e-12f;
    if (!(square <= rules.length2 && share >= 0.0f && share <= 1.0f) || here[BEGINS] || next[BEGINS])
        return 0;
    for (int64_t k = rules.alike; k < BEGINS; k++)
        if (here[k] != next[k])
            return 0;
    return near_line(a, b, c, X, Z, share, rules.near) &&
           near_line(a, b, c, WAYS, SPEED(of.strategies), share, rules.off);
}

/* Join neighbours pair by pair, up to PASSES times; once, whatever they are, if no number must be alike. Leave of
 * each the last end and the largest errors. Return how many are left. kept (n): room. */
static int64_t joined(struct table of, struct rules rules, int64_t *kept)
{
    enum { PASSES = 4 }; /* as long as they join an eighth */
    int any = rules.alike == WAYS;
    int64_t count = of.n;
    for (int64_t k = 0; k < of.n; k++)
        kept[k] = k;
    for (int pass = 0; pass < (any ? 1 : PASSES) && count > 2; pass++) {
        int64_t left = 1, apart = 0, a = kept[0], b = kept[1], before = count;
        for (int64_t k = 1; k < before - 1; k++) {
            int64_t c = kept[k + 1];
            int together = 0;
            if (any || straight(of, rules, a, b, c))
                together = (k - apart) % 2 == 1;
            else
                apart = k;
            if (!together)
                kept[left++] = b;
            a = b, b = c;
        }
        kept[left++] = b;
        count = left;
        if (8 * (before - left) < left)
            break;
    }
    for (int64_t i = 0, j = 0; i < count; i++) {
        float *to = piece_of(of, i), *last = piece_of(of, kept[i]);
        for (; j < kept[i]; j++)
            for (int64_t k = ERRORS(of.strategies); k < PIECE(of.strategies); k++)
                last[k] = piece_of(of, j)[k] > last[k] ? piece_of(of, j)[k] : last[k];
        j++;
        memmove(to, last, sizeof(float) * (size_t)PIECE(of.strategies));
    }
    return count;
}

static int64_t join_pieces(float *values, int64_t n, int64_t strategies, int64_t alike, double length,
                           double near, double off, double *room)
{
    struct table of = {values, n, strategies};
    struct rules rules = {alike, (float)(length * length), (float)near, (float)off};
    return joined(of, rules, (int64_t *)room);
}

LOOP(join_pieces, OUT_SINGLES(0, ROWS(0) * PIECE(FEW(1))), ROWS(0), FEW(1), WITHIN(2, LINE_NUMBER, WAYS),
     REAL(3), REAL(4), REAL(5), ROOM(0, ROWS(0)))

/* Fill a table with what was judged of a path xyze with lines (n): samples at (k), from ``start`` on. runs (r):
 * at which of the samples layers and features begin, whose numbers are places (r, 2); begins: whether the first
 * piece does. Join the pieces; return how many are left. sums (r, 2, 1 + strategies): number and squared errors
 * of samples that extrude, then of others, whose feature is 0. The rest: see judge_window. */
static int64_t draw_pieces(const double *xyze, const int64_t *line, const int64_t *at, int64_t k, int64_t start,
                           const uint8_t *extruding, const int64_t *runs, int64_t r, const int64_t *places,
                           int begins, const struct vector *nozzle, int64_t strategies, int64_t m, int64_t begin,
                           int64_t apart, const double *off, const double *errors, int64_t alike, double length,
                           double near, double off_line, double *sums, float *values, double *room)
{
    struct table of = {values, k, strategies};
    struct rules rules = {alike, (float)(length * length), (float)near, (float)off_line};
    int64_t run = 0;
    for (int64_t i = 0; i < k; i++) {
        const double *p = xyze + COLUMNS * (start + at[i]), *q = start + at[i] > 0 ? p - COLUMNS : p;
        double dx = p[X] - q[X], dy = p[Y] - q[Y];
        float *piece = piece_of(of, i);
        int32_t *number = (int32_t *)piece;
        while (run + 1 < r && runs[run + 1] <= at[i])
            run++;
        double *sum = sums + (2 * run + !extruding[i]) * (1 + strategies);
        sum[0] += 1.0;
        piece[X] = (float)p[X], piece[Y] = (float)p[Y];
        number[LINE_NUMBER] = (int32_t)line[start + at[i]];
        number[LAYER] = (int32_t)places[2 * run];
        number[FEATURE] = extruding[i] ? (int32_t)places[2 * run + 1] : 0;
        number[BEGINS] = i == 0 && begins;
        piece[SPEED(strategies)] = (float)(sqrt(dx * dx + dy * dy) / TS);
        const struct vector *place = nozzle + within(number_of(at[i], begin, apart), m);
        for (int64_t s = 0; s < strategies; s++, off += 2, errors++, place += m) {
            sum[1 + s] += *errors * *errors;
            piece[WAYS + 2 * s] = (float)off[X], piece[WAYS + 2 * s + 1] = (float)off[Y];
            piece[SPEED(strategies) + 1 + 2 * s] = (float)(place->x - p[X]);
            piece[SPEED(strategies) + 2 + 2 * s] = (float)(place->y - p[Y]);
            piece[ERRORS(strategies) + s] = (float)*errors;
        }
    }
    return joined(of, rules, (int64_t *)room);
}

LOOP(draw_pieces, FLOATS(0, 0), INTEGERS(1, ITEMS(0) / COLUMNS),
     INDICES(2, ITEMS(2), 0, ITEMS(0) / COLUMNS - COUNT(3)), ITEMS(2), COUNT(3), BYTES(4, ITEMS(2)),
     INTEGERS(5, 1), ITEMS(5), INTEGERS(6, 2 * ITEMS(5)), (int)WITHIN(7, 0, 1),
     (const struct vector *)FLOATS(8, 2 * ROWS(8) * WIDTH(8)), ROWS(8),
     BOUNDED(8, WIDTH(8), ITEMS(2) > 0, MOST_ITEMS), WITHIN(9, 0, MOST_ITEMS), WITHIN(10, 1, MOST_FEW),
     FLOATS(11, 2 * ROWS(8) * ITEMS(2)), FLOATS(12, ROWS(8) * ITEMS(2)), WITHIN(13, LINE_NUMBER, WAYS), REAL(14),
     REAL(15), REAL(16), OUT_FLOATS(17, 2 * ITEMS(5) * (1 + ROWS(8))),
     OUT_SINGLES(18, ITEMS(2) * PIECE(ROWS(8))), ROOM(0, ITEMS(2)))

enum { LANES = 8 }; /* samples that are checked side by side */

struct extremes { /* by lane: of z and of the command; rates of belts, then of x and y; 0, or not finite */
    double low[3][LANES], high[3][LANES], most[4][LANES], zero[LANES];
};

/* Take count samples of a path and of a command, which begins two samples before; rates are by sample. */
INSIDE void take(struct extremes *of, const double *xyze, const double *command, const double *belts,
                 int count)
{
    double x[LANES + 2], y[LANES + 2];
    for (int i = 0; i < count + 2; i++)
        x[i] = command[2 * i + X], y[i] = command[2 * i + Y];
    for (int i = 0; i < count; i++) {
        const double *p = xyze + COLUMNS * i;
        double vx = x[i + 2] - x[i + 1], vy = y[i + 2] - y[i + 1];
        double ax = vx - (x[i + 1] - x[i]), ay = vy - (y[i + 1] - y[i]);
        double places[] = {p[Z], x[i + 2], y[i + 2]};
        of->zero[i] += 0.0 * p[X] + 0.0 * p[Y] + 0.0 * p[Z] + 0.0 * p[E] + 0.0 * x[i + 2] + 0.0 * y[i + 2];
        for (int k = 0; k < 3; k++) {
            of->low[k][i] = lesser(of->low[k][i], places[k]);
            of->high[k][i] = greater(of->high[k][i], places[k]);
        }
        double rates[] = {
            greater(fabs(belts[0] * vx + belts[1] * vy), fabs(belts[2] * vx + belts[3] * vy)),
            greater(fabs(belts[0] * ax + belts[1] * ay), fabs(belts[2] * ax + belts[3] * ay)),
            fabs(ax), fabs(ay),
        };
        for (int k = 0; k < 4; k++)
            of->most[k][i] = greater(of->most[k][i], rates[k]);
    }
}

/* xyze (n, 4), command (n, 2) after the two samples before (2, 2). limits: lower and upper bounds of z,
 * x, y, then belt velocity and acceleration; belts (2, 2). Return whether all is finite and within the
 * limits; only then peaks are filled: of both belts' velocity and acceleration, and of the acceleration in
 * x and in y. */
WIDE static int64_t safe(const double *xyze, const double *command, int64_t n, const double *before,
                         const double *limits, const double *belts, double interval, double *peaks)
{
    struct extremes of = {{{0.0}}, {{0.0}}, {{0.0}}, {0.0}};
    double begin[2 * (LANES + 2)];
    int64_t at = n < LANES ? n : LANES;
    for (int i = 0; i < LANES; i++)
        for (int k = 0; k < 3; k++)
            of.low[k][i] = of.high[k][i] = k == 0 ? xyze[Z] : command[k - 1];
    memcpy(begin, before, 4 * sizeof(double));
    memcpy(begin + 4, command, 2 * sizeof(double) * (size_t)at);
    take(&of, xyze, begin, belts, (int)at);
    for (; at + LANES <= n; at += LANES)
        take(&of, xyze + COLUMNS * at, command + 2 * (at - 2), belts, LANES);
    if (at < n)
        take(&of, xyze + COLUMNS * at, command + 2 * (at - 2), belts, (int)(n - at));
    for (int i = 1; i < LANES; i++) {
        for (int k = 0; k < 3; k++) {
            of.low[k][0] = lesser(of.low[k][0], of.low[k][i]);
            of.high[k][0] = greater(of.high[k][0], of.high[k][i]);
        }
        for (int k = 0; k < 4; k++)
            of.most[k][0] = greater(of.most[k][0], of.most[k][i]);
        of.zero[0] += of.zero[i];
    }
    for (int k = 0; k < 4; k++)
        of.most[k][0] /= k == 0 ? interval : interval * interval;
    for (int k = 0; k < 3; k++)
        if (of.low[k][0] < limits[2 * k] || of.high[k][0] > limits[2 * k + 1])
            return 0;
    if (of.zero[0] != 0.0 || of.most[0][0] > limits[6] || of.most[1][0] > limits[7])
        return 0;
    for (int k = 0; k < 4; k++)
        peaks[k] = of.most[k][0];
    return 1;
}

LOOP(safe, FLOATS(0, COLUMNS * COUNT(2)), FLOATS(1, 2 * COUNT(2)), WITHIN(2, 1, MOST_ITEMS),
     FLOATS(3, 4), FLOATS(4, 8), FLOATS(5, 4),
     REAL(6), OUT_FLOATS(7, 4))

/* Return how many samples of a command (n) are not within a distance of the path xyze (n, 4). */
WIDE static int64_t far_off(const double *xyze, const struct vector *command, int64_t n, double most)
{
    int64_t count = 0;
    for (int64_t i = 0; i < n; i++) {
        double dx = command[i].x - xyze[COLUMNS * i + X], dy = command[i].y - xyze[COLUMNS * i + Y];
        count += !(dx * dx + dy * dy <= most * most);
    }
    return count;
}

LOOP(far_off, FLOATS(0, COLUMNS * COUNT(2)), (const struct vector *)FLOATS(1, 2 * COUNT(2)), COUNT(2), REAL(3))
