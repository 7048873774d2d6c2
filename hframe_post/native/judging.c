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
 * Taps and accelerations are taken in groups, in each of which they follow each other. room (count + m). */
static void filter_coarsely(struct coarse of, const double *u, int64_t count, int64_t groups, float *room,
                            double *y)
{
    const double *from = u + of.late - 2 * of.m - 4;
    for (int64_t i = 0; i < count; i++) {
        const double *at = u + 2 * groups * i;
        y[i] = of.rest * at[0] - 0.5 * of.lag * (at[0] - at[-2]);
    }
    for (int64_t group = 0; group < groups && group < of.m; group++) {
        int64_t own = (of.m - group + groups - 1) / groups;
        const double *now = from + 2 * group;
        float *factors = room, *a = room + own;
        for (int64_t i = 0; i < own; i++)
            factors[i] = (float)of.taps[group + groups * i];
        for (int64_t i = 0; i < count + own - 1; i++, now += 2 * groups)
            a[i] = (float)(0.25 * ((now[5] - now[3]) - (now[3] - now[1])) +
                           0.125 * (((now[4] - now[2]) - (now[2] - now[0])) +
                                    ((now[6] - now[4]) - (now[4] - now[2]))));
        add_single_sums(factors, own, a, count, y);
    }
}

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
     NEW_FLOATS(0, COUNT(6)), ROOM(1, (COUNT(6) + ITEMS(0)) / 2 + 1))

LOOP(sliding_sums, FLOATS(0, COUNT(1)), COUNT(1), FLOATS(2, COUNT(1) - 1 + COUNT(3)), COUNT(3),
     OUT_FLOATS(4, COUNT(3)))

struct vector {
    double x, y;
};

struct path { /* n samples, x and y first */
    const double *places;
    int64_t columns, n;
};

static int64_t within(int64_t k, int64_t n) { return k < 0 ? 0 : k < n ? k : n - 1; }

static double square(struct vector v) { return v.x * v.x + v.y * v.y; }

/* Return the way to a point from sample k. */
INSIDE struct vector from_sample(struct path path, struct vector a, int64_t k)
{
    const double *p = path.places + path.columns * k;
    return (struct vector){a.x - p[X], a.y - p[Y]};
}

/* Return the way to a point from the nearest place on the segment between samples p and q. */
INSIDE struct vector from_segment(struct path path, struct vector a, int64_t p, int64_t q)
{
    const double *from = path.places + path.columns * p, *to = path.places + path.columns * q;
    double dx = to[X] - from[X], dy = to[Y] - from[Y];
    a = from_sample(path, a, p);
    double length2 = dx * dx + dy * dy;
    double share = length2 > 0.0 ? (a.x * dx + a.y * dy) / length2 : 0.0;
    share = lesser(greater(share, 0.0), 1.0);
    return (struct vector){a.x - dx * share, a.y - dy * share};
}

/* Return the sample nearest to the point: try some around ``at``, then the neighbours of the best.
 * inside: whether the path has all of these samples; a constant, so that most calls need no bounds. */
INSIDE int64_t nearest(struct path path, struct vector a, int64_t at, int inside)
{
    enum { COARSE = 3, TRIED = 2 * NEAREST / COARSE + 1 }; /* samples from one to the next; how many */
    int64_t found = at - NEAREST, best_k = 0;
    double distance2[TRIED], best = INFINITY;
    for (int i = 0; i < TRIED; i++) {
        int64_t k = at - NEAREST + COARSE * i;
        distance2[i] = square(from_sample(path, a, inside ? k : within(k, path.n)));
    }
    for (int i = 0; i < TRIED; i++) {
        int nearer = distance2[i] < best;
        best = nearer ? distance2[i] : best;
        found = nearer ? at - NEAREST + COARSE * i : found;
    }
    int64_t candidates[] = {found - 1, found, found + 1, at - 1, at, at + 1};
    best = INFINITY;
    for (int i = 0; i < 6; i++) {
        int64_t k = inside ? candidates[i] : within(candidates[i], path.n);
        double square_of = square(from_sample(path, a, k));
        if (square_of < best)
            best = square_of, best_k = k;
    }
    return best_k;
}

/* turns (n + 1): how many samples before each change the path's direction. */
static int64_t count_turns(const double *places, int64_t columns, int64_t n, int64_t *turns)
{
    const double STRAIGHT = 1e-6; /* sine of an angle below which a path goes straight on */
    turns[0] = 0;
    for (int64_t k = 0; k < n; k++) {
        int turning = k == 0 || k == n - 1;
        if (!turning) {
            const double *p = places + columns * (k - 1), *q = p + columns, *r = q + columns;
            double ax = q[X] - p[X], ay = q[Y] - p[Y], bx = r[X] - q[X], by = r[Y] - q[Y];
            double cross = ax * by - ay * bx, dot = ax * bx + ay * by;
            int still = ax == 0.0 && ay == 0.0, still_then = bx == 0.0 && by == 0.0;
            turning = fabs(cross) > STRAIGHT * fabs(dot) || dot < 0.0 || still != still_then;
        }
        turns[k + 1] = turns[k] + turning;
    }
    return n;
}

/* Return the way to a point from the path near its sample ``at``. */
static struct vector way_off(struct path path, const int64_t *turns, struct vector a, int64_t at)
{
    int64_t low = within(at - NEAREST, path.n), high = within(at + NEAREST, path.n);
    if (turns[high] == turns[low + 1])
        return from_segment(path, a, low, high);
    int inside = at > NEAREST && at < path.n - NEAREST - 1;
    int64_t k = inside ? nearest(path, a, at, 1) : nearest(path, a, at, 0);
    struct vector before = from_segment(path, a, k, within(k - 1, path.n));
    struct vector after = from_segment(path, a, k, within(k + 1, path.n));
    return square(before) < square(after) ? before : after;
}

/* Distances (count) of the nozzle (n) from the path at samples at (count). */
static int64_t distances(const double *places, int64_t columns, int64_t n, const struct vector *nozzle,
                         const int64_t *at, int64_t count, double *distance, double *room)
{
    struct path path = {places, columns, n};
    int64_t *turns = (int64_t *)room;
    count_turns(places, columns, n, turns);
    for (int64_t i = 0; i < count; i++)
        distance[i] = sqrt(square(way_off(path, turns, nozzle[at[i]], at[i])));
    return count;
}

LOOP(distances, FLOATS(0, 0), BOUNDED(0, WIDTH(0), 2, MOST_FEW), ROWS(0),
     (const struct vector *)FLOATS(1, 2 * ROWS(0)), INDICES(2, ITEMS(2), 0, ROWS(0)), ITEMS(2),
     NEW_FLOATS(0, ITEMS(2)), ROOM(1, ROWS(0) + 1))

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

struct piece { /* of a command (n): samples begin, begin + apart, … before ``stop`` */
    const struct vector *command;
    int64_t n, begin, stop, apart;
};

/* Write the output of a response to one coordinate of a command, two apart, at the samples of a piece; room:
 * see judge_window. */
static void respond(struct coarse of, struct piece piece, int axis, double *y, double *room)
{
    int64_t past = of.late < 2 * of.m ? 2 * of.m + 4 - of.late : 4;
    int64_t size = past + (piece.stop - piece.begin) + of.late;
    int64_t halves = piece.apart % 2 ? 2 : 1, step = halves * piece.apart;
    double *u = room, *some = u + size;
    for (int64_t i = 0; i < size; i++) { /* before the first and after the last sample it rests */
        const struct vector *at = piece.command + within(piece.begin - past + i, piece.n);
        u[i] = axis == X ? at->x : at->y;
    }
    for (int64_t half = 0; half < halves; half++) { /* of an odd step, every second output */
        int64_t count = numbers_of(piece.begin + half * piece.apart, piece.stop, step);
        filter_coarsely(of, u + past + half * piece.apart, count, step / 2, (float *)(some + count), some);
        for (int64_t i = 0; i < count; i++)
            y[2 * (half + halves * i)] = some[i];
    }
}

/* xyze (n, 4), commands (strategies, n). Responses of x, of y and, if there are three, of racking: counts of
 * taps, how many samples late, gain at rest and lag of each. Write where the path moves (k) and extrudes;
 * the nozzle (strategies, samples from begin on, apart); the ways to it from the path and their lengths (k,
 * strategies). */
static int64_t judge_window(const double *xyze, int64_t n, const struct vector *commands, int64_t strategies,
                            const double *taps, const int64_t *counts, const int64_t *late,
                            const double *gains, int64_t responses, double x_c, int64_t first, int64_t begin,
                            int64_t stop, int64_t every, int64_t apart, int64_t *at, uint8_t *extruding,
                            struct vector *nozzle, struct vector *off, double *error, double *room)
{
    struct path path = {xyze, COLUMNS, n};
    int64_t k = moving(xyze, stop, first, every, at, extruding), m = numbers_of(begin, stop, apart);
    int64_t *turns = (int64_t *)room;
    double *theta = room + n + 1;
    if (n == 0)
        return 0;
    count_turns(xyze, COLUMNS, n, turns);
    for (int64_t s = 0; s < strategies; s++, nozzle += m, commands += n) {
        struct piece piece = {commands, n, begin, stop, apart};
        const double *own = taps;
        for (int64_t r = 0; r < responses && m > 0; own += counts[r++]) {
            struct coarse of = {own, counts[r], late[r], gains[2 * r], gains[2 * r + 1]};
            respond(of, piece, r == 1 ? Y : X, r < 2 ? &nozzle->x + r : theta, theta + 2 * m);
        }
        for (int64_t i = 0; i < m && responses > 2; i++)
            nozzle[i].y += (nozzle[i].x - x_c) * theta[2 * i];
        for (int64_t i = 0; i < k; i++) {
            struct vector way = way_off(path, turns, nozzle[(at[i] - begin) / apart], at[i]);
            off[strategies * i + s] = way;
            error[strategies * i + s] = sqrt(square(way));
        }
    }
    return k;
}

#define WINDOW_N (ITEMS(0) / COLUMNS)
#define WINDOW_M numbers_of(COUNT(8), COUNT(9), FEW(11))
#define WINDOW_K numbers_of(COUNT(7), COUNT(9), FEW(10))

LOOP(judge_window, FLOATS(0, 0), WINDOW_N, (const struct vector *)FLOATS(1, 2 * ROWS(1) * WINDOW_N), ROWS(1),
     FLOATS(2, 0), PARTS(3, BOUNDED(3, ITEMS(3), 2, 3), ITEMS(2)), INDICES(4, ITEMS(3), 0, 2 * ITEMS(2)),
     FLOATS(5, 2 * ITEMS(3)), ITEMS(3), REAL(6), COUNT(7), WITHIN(8, 0, COUNT(7)), WITHIN(9, 0, WINDOW_N),
     WITHIN(10, 1, MOST_FEW), WITHIN(11, 1, MOST_FEW), UP_TO_INTEGERS(0, WINDOW_K), UP_TO_FLAGS(1, WINDOW_K),
     (struct vector *)NEW_FLOATS(2, 2 * ROWS(1) * WINDOW_M),
     (struct vector *)UP_TO_ROWS(3, WINDOW_K, 2 * ROWS(1)), UP_TO_ROWS(4, WINDOW_K, ROWS(1)),
     ROOM(5, 3 * WINDOW_N + 4 * WINDOW_M + 6 * ITEMS(2) + 16))

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

/* path (n, 4), nozzle (n, 2), laid (n): filament that comes out in the step to each sample. Write how far the line's width is off on each piece that ends, and the
 * sample before which it does; return their number. open (4): of a piece that is open before and after: how far its line is beyond the
 * last end of a piece, and its sums; 0 if no piece is open. at, errors (n): room. */
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

struct table { /* n columns; rows: x, y, the line's, layer's and feature's number, begins, ways */
    const float *values;
    int64_t rows, n;
};

static const float *row(struct table of, int64_t k) { return of.values + of.n * k; }

/* Return whether in each of some rows b is as near to the line from a to c as ``most``. */
static int near_line(struct table of, int64_t low, int64_t high, int64_t a, int64_t b, int64_t c,
                     float share, float most)
{
    for (int64_t k = low; k < high; k++) {
        const float *at = row(of, k);
        if (!(fabsf(at[b] - at[a] - share * (at[c] - at[a])) <= most))
            return 0;
    }
    return 1;
}

/* Return whether piece b may be joined to the next one, c; a is the one before. */
static int straight(struct table of, int64_t numbers, int64_t ways, int64_t a, int64_t b, int64_t c,
                    float length2, float near, float off)
{
    const float *x = row(of, X), *y = row(of, Y);
    const int32_t *begins = (const int32_t *)row(of, ways - 1);
    float dx = x[c] - x[a], dy = y[c] - y[a], square = dx * dx + dy * dy;
    float share = (x[b] - x[a]) * dx + (y[b] - y[a]) * dy;
    share /= square > 1e-12f ? square : 1e-12f;
    if (!(square <= length2 && share >= 0.0f && share <= 1.0f) || begins[b] || begins[c])
        return 0;
    for (int64_t k = numbers; k < ways - 1; k++) {
        const int32_t *number = (const int32_t *)row(of, k);
        if (number[b] != number[c])
            return 0;
    }
    return near_line(of, X, Z, a, b, c, share, near) &&
           near_line(of, ways, of.rows, a, b, c, share, off);
}

/* kept (n): the pieces that are left, whose number is returned, once neighbours were joined pair by
 * pair, up to PASSES times. values (rows, n); the numbers from row ``numbers`` on must be alike;
 * ``ways`` is the first row of the ways off the path. */
static int64_t joined_pieces(const float *values, int64_t rows, int64_t n, int64_t numbers,
                             int64_t ways, double length2, double near, double off, int64_t *kept)
{
    enum { PASSES = 4 }; /* as long as they join an eighth */
    struct table of = {values, rows, n};
    int64_t count = n;
    for (int64_t k = 0; k < n; k++)
        kept[k] = k;
    for (int pass = 0; pass < PASSES && count > 2; pass++) {
        int64_t left = 1, apart = 0, a = kept[0], b = kept[1], before = count;
        for (int64_t k = 1; k < before - 1; k++) {
            int64_t c = kept[k + 1];
            int joined = 0;
            if (straight(of, numbers, ways, a, b, c, (float)length2, (float)near, (float)off))
                joined = (k - apart) % 2 == 1;
            else
                apart = k;
            if (!joined)
                kept[left++] = b;
            a = b, b = c;
        }
        kept[left++] = b;
        count = left;
        if (8 * (before - left) < left)
            break;
    }
    return count;
}

LOOP(joined_pieces, SINGLES(0, COUNT(1) * COUNT(2)), WITHIN(1, 2, MOST_FEW), COUNT(2), COUNT(3),
     WITHIN(4, 1, COUNT(1)), REAL(5), REAL(6), REAL(7), OUT_INTEGERS(8, COUNT(2)))

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
