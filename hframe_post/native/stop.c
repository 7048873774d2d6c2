/* The stops of a stretch, one after the other: each becomes a problem, whose solution is written into
 * the command. Symbols are those of model/stop_solver.py. */

#include <stdlib.h>
#include <string.h>

#include "stop.h"

enum {
    SOON = 25,       /* samples after a dwell in which an extrusion begins that it must be ready for */
    DWELL_ROWS = 2,  /* samples of a dwell that second differences can tell apart */
    SWINGING = 64, EVERY = 4, /* samples of a dwell in which the nozzle swings; of these one is judged */
    LANES = 32       /* terms of a sum that are added side by side */
};

/* Weights of a sample's squared deviation across the path; 1 while it extrudes. */
static const double
    TRAVELLING = 0.03, DWELLING = 0.04,
    ARRIVING = 1.0; /* at the end of a dwell from which an extrusion begins */

struct stop { /* see native/stop.py */
    int64_t a, b, ends, before, after, movable;
};

struct printer {
    const struct bounds *bounds;
    const double *filters; /* (2 or 3, 2 + taps) gain at rest, lag, taps */
    int64_t count, taps, ahead;
    const double *splines, *reach; /* (SIDE, k), (k) */
    int64_t k;
    const double *outputs; /* (2 or 3, length, 2k + 1) */
    int64_t length;
};

struct layout { /* of the splines and rows of a problem; stops are alike */
    int64_t n, from, to; /* samples of the dwell; all splines' columns, from one to before another */
    int64_t at[MOST_ROWS]; /* the judged samples, counted from SIDE before the dwell */
    double counted[MOST_ROWS]; /* samples that each stands for */
};

struct room {
    struct problem problem;
    struct layout layout;
    double p[WIDTH];
};

/* Samples from a judged one to the next, ``off`` samples from the dwell. */
static int64_t step(int64_t off) { return off < 24 ? 1 : off < 60 ? 2 : 4; }

static void judge(struct layout *at, int64_t n, struct problem *q)
{
    int64_t r = 0;
    for (int64_t off = 0; off < SIDE; off += step(off))
        r++;
    q->dwell[0] = r;
    for (int64_t off = 0; off < SIDE; off += step(off)) {
        at->counted[--r] = (double)step(off);
        at->at[r] = SIDE - 1 - off;
    }
    r = q->dwell[0];
    for (int64_t i = EVERY - 1; i < n - 1 && i < SWINGING - 1; i += EVERY)
        at->at[r++] = SIDE + i;
    if (n > 0)
        at->at[r++] = SIDE + n - 1;
    q->dwell[1] = r;
    for (int64_t off = 0; off < SIDE + RINGING; off += step(off)) {
        at->counted[r] = (double)step(off);
        at->at[r++] = SIDE + n + off;
    }
    q->r = r;
}

/* The output of a filter at time t, by one of all splines or by the dwell's own place. The first are
 * counted from SIDE before the dwell, as is the place, which is a step there and one back at its end;
 * the others from SIDE before its end. */
static double output(const struct printer *of, int64_t filter, int64_t t, int64_t c, int64_t n)
{
    int64_t columns = 2 * of->k + 1, last = of->length - 1;
    const double *by_p = of->outputs + filter * of->length * columns + c;
    if (c < of->k)
        return t <= last ? by_p[t * columns] : 0.0;
    double ended = t >= n ? by_p[(t - n < last ? t - n : last) * columns] : 0.0;
    return c > of->k ? ended : by_p[(t < last ? t : last) * columns] - ended;
}

/* N of the command at a row of it, by one of all splines or by the dwell's own place. */
static double spline(const struct printer *of, int64_t row, int64_t dwell, int64_t c)
{
    int64_t before = SIDE + 1 - row, after = row - (SIDE + 2 + dwell), k = of->k;
    if (c == k)
        return before < 0 && after < 0 ? 1.0 : 0.0;
    int64_t off = c < k ? before : after;
    return off >= 0 && off < SIDE ? of->splines[off * k + (c < k ? k - 1 - c : c - k - 1)] : 0.0;
}

/* Bands of N, of columns that begin and end in order. */
static void find_bands(struct problem *q)
{
    int64_t last[SPLINES] = {0}, over = 0, begun = 0;
    for (int64_t c = 0; c < q->k; c++)
        for (int64_t row = 0; row < q->q; row++)
            if (q->N[row][c] != 0.0)
                last[c] = row;
    for (int64_t row = 0; row < q->q; row++) {
        while (over < q->k && last[over] < row)
            over++;
        while (begun < q->k && q->N[row][begun] != 0.0)
            begun++;
        q->bands[row][0] = over, q->bands[row][1] = begun;
    }
}

/* Lay out the splines from one column to before another around a dwell of n samples. */
static void lay_out(const struct printer *of, struct layout *new, struct problem *q)
{
    int64_t n = new->n, dwell = n < DWELL_ROWS ? n : DWELL_ROWS, k = q->k = new->to - new->from;
    judge(new, n, q);
    for (int64_t row = 0, begun = 0; row < q->r; row++) {
        for (int64_t c = 0; c < SPLINES; c++) {
            int acts = 0;
            for (int64_t f = 0; f < of->count; f++) {
                double by_p = c < k ? output(of, f, new->at[row], new->from + c, n) : 0.0;
                q->by_p[f][row][c] = by_p, acts |= by_p != 0.0;
            }
            if (acts && c >= begun)
                begun = c + 1;
        }
        q->begun[row] = begun;
    }
    q->q = 2 * SIDE + dwell + 4;
    for (int64_t row = 0; row < q->q; row++)
        for (int64_t c = 0; c < SPLINES; c++)
            q->N[row][c] = c < k ? spline(of, row, dwell, new->from + c) : 0.0;
    for (int64_t row = 0; row < q->q - 2; row++)
        for (int64_t c = 0; c < SPLINES; c++)
            q->D[row][c] = (q->N[row + 2][c] - q->N[row + 1][c]) - (q->N[row + 1][c] - q->N[row][c]);
    find_bands(q);
}

static int extrudes(const place *path, int64_t at)
{
    const double *now = path[at], *before = path[at - 1];
    return now[E] > before[E] && (now[X] != before[X] || now[Y] != before[Y]);
}

/* The judged rows, with their weights. */
static void weigh_rows(const struct stop *stop, const struct layout *layout, struct problem *q)
{
    for (int64_t i = 0; i < q->r; i++) {
        int64_t at = stop->a - SIDE + layout->at[i];
        int dwells = i >= q->dwell[0] && i < q->dwell[1];
        int left_out = at < stop->a - stop->before || at >= stop->ends || (at >= stop->b && !stop->after);
        q->index[i] = at;
        q->extruding[i] = !dwells && !left_out && extrudes(q->path, at);
        q->weight[i] = layout->counted[i] * (q->extruding[i] ? 1.0 : left_out ? 0.0 : TRAVELLING);
        if (dwells)
            q->weight[i] = DWELLING;
        q->lever[i] = q->path[at][X] - q->bounds->x_c;
    }
    for (int64_t i = 0; i < SOON && stop->b > stop->a; i++)
        if (extrudes(q->path, stop->b + i))
            q->weight[q->dwell[1] - 1] = ARRIVING;
}

/* The product of n numbers with others, of which those from one to before another are 0. */
INSIDE double product(const double *a, const double *b, int64_t n, int64_t zero, int64_t end)
{
    double lanes[LANES] = {0.0}, sum = 0.0;
    int64_t i = 0;
    for (; i + LANES <= n; i += LANES) {
        if (i >= zero && i + LANES <= end)
            continue;
        for (int lane = 0; lane < LANES; lane++)
            lanes[lane] += a[i + lane] * b[i + lane];
    }
    for (; i < n; i++)
        lanes[i % LANES] += a[i] * b[i];
    for (int lane = 0; lane < LANES; lane++)
        sum += lanes[lane];
    return sum;
}

/* The nozzle under the command as it is known, held in the dwell, at the judged samples. room: of four
 * numbers a sample. */
WIDE static void place_nozzle(const struct printer *of, const struct stop *stop, const vector *command,
                              double *room, struct problem *q)
{
    int64_t memory = 1 + (of->taps > of->ahead ? of->taps : of->ahead);
    int64_t begin = stop->a - SIDE + of->ahead - memory;
    int64_t span = stop->b + SIDE + RINGING + of->ahead - begin;
    /* rates are 0 while the command is held */
    int64_t held = stop->a - begin, moved = stop->b - 2 - begin;
    double *u[2] = {room, room + span}, *rates[2] = {room + 2 * span, room + 3 * span};
    for (int axis = 0; axis < 2; axis++) {
        for (int64_t i = 0; i < span; i++) {
            int64_t at = begin + i;
            u[axis][i] = command[at >= stop->a && at < stop->b ? stop->a : at][axis];
        }
        for (int64_t i = 0; i + 2 < span; i++)
            rates[axis][i] = (u[axis][i + 2] - u[axis][i + 1]) - (u[axis][i + 1] - u[axis][i]);
    }
    for (int64_t row = 0; row < q->r; row++) {
        double places[3] = {0.0};
        int64_t at = q->index[row] - begin, first = at + of->ahead - of->taps - 1;
        for (int64_t f = 0; f < of->count; f++) {
            const double *filter = of->filters + f * (2 + of->taps), *now = u[f % 2] + at;
            places[f] = product(filter + 2, rates[f % 2] + first, of->taps, held - first, moved - first);
            places[f] += filter[0] * now[0] - filter[1] * (now[0] - now[-1]);
        }
        q->known[row][X] = places[0];
        q->known[row][Y] = places[1] + q->lever[row] * places[2];
    }
}

/* The command around a stop, with two samples more at each end, and at most two of the dwell. */
static void cut_out(const struct stop *stop, const vector *command, struct problem *q)
{
    int64_t dwell = q->q - 2 * SIDE - 4;
    memcpy(q->command, command + stop->a - SIDE - 2, sizeof(vector) * (SIDE + 2));
    for (int64_t i = 0; i < dwell; i++)
        memcpy(q->command[SIDE + 2 + i], command[stop->a], sizeof(vector));
    memcpy(q->command + SIDE + 2 + dwell, command + stop->b, sizeof(vector) * (SIDE + 2));
}

/* The inverse of cut_out, with what p adds. */
static void put_back(const struct stop *stop, const double *p, struct problem *q, vector *command)
{
    for (int64_t row = 0; row < q->q; row++)
        for (int axis = 0; axis < 2; axis++) {
            double sum = 0.0;
            for (int64_t c = q->bands[row][0]; c < q->bands[row][1]; c++)
                sum += p[axis * q->k + c] * q->N[row][c];
            q->command[row][axis] += sum;
        }
    memcpy(command + stop->a - SIDE, q->command + 2, sizeof(vector) * SIDE);
    for (int64_t at = stop->a; at < stop->b; at++)
        memcpy(command[at], q->command[SIDE + 2], sizeof(vector));
    memcpy(command + stop->b, q->command + q->q - SIDE - 2, sizeof(vector) * SIDE);
}

/* Whether a window of n samples has all that the solution of a stop depends on. */
static int is_inside(const struct stop *stop, const struct printer *of, int64_t n)
{
    int64_t memory = 1 + (of->taps > of->ahead ? of->taps - of->ahead : 0);
    int64_t before = SIDE + (memory > NEAREST ? memory : NEAREST);
    int64_t after = SIDE + RINGING + (of->ahead > NEAREST ? of->ahead : NEAREST);
    return stop->a >= before && stop->b >= stop->a && stop->b <= n - after;
}

static void solve(const struct printer *of, const struct stop *stop, vector *command, double *held,
                  struct search *search, struct room *room)
{
    struct layout *layout = &room->layout;
    struct problem *q = &room->problem;
    int64_t n = stop->b - stop->a, from = of->k, to = of->k + (stop->movable != 0);
    for (int64_t i = 0; i < of->k && of->reach[i] <= (double)stop->before; i++)
        from--;
    for (int64_t i = 0; i < of->k && of->reach[i] <= (double)stop->after; i++)
        to++;
    if (!stop->movable && from == of->k) /* only splines after it, which begin one column later */
        from++, to++;
    if (layout->n != n || layout->from != from || layout->to != to) {
        layout->n = n, layout->from = from, layout->to = to;
        lay_out(of, layout, q);
    }
    weigh_rows(stop, layout, q);
    place_nozzle(of, stop, (const vector *)command, held, q);
    cut_out(stop, (const vector *)command, q);
    find_best(q, search, room->p);
    put_back(stop, room->p, q, command);
}

/* Write the command (n, 2) around stops into that of their stretch, whose path is xyze (n, 4). Return
 * how many are solved: all, unless one is not inside it. */
static int64_t solve_stops(const double *xyze, double *command, int64_t n,
                           const struct stop *stops, int64_t count, const struct bounds *bounds,
                           const double *filters, int64_t axes, int64_t taps, int64_t ahead,
                           const double *splines, const double *reach, int64_t k,
                           const double *outputs, int64_t length)
{
    struct printer of = {bounds, filters, axes, taps, ahead, splines, reach, k, outputs, length};
    int64_t solved = 0, bytes = sizeof(struct room) + sizeof(double) * 4 * (size_t)n;
    struct room *room = malloc((size_t)bytes);
    struct search *search = malloc(size_of_search());
    if (room && search) {
        room->layout.n = -1;
        room->problem.path = (const place *)xyze;
        room->problem.bounds = bounds;
        room->problem.racks = axes > 2;
        for (; solved < count && is_inside(stops + solved, &of, n); solved++)
            solve(&of, stops + solved, (vector *)command, (double *)(room + 1), search, room);
    }
    free(search), free(room);
    return solved;
}

LOOP(solve_stops, FLOATS(0, COLUMNS * ROWS(1)), OUT_FLOATS(1, 2 * ROWS(1)), ROWS(1),
     (const struct stop *)INTEGERS(2, ROWS(2) * (int64_t)(sizeof(struct stop) / sizeof(int64_t))), ROWS(2),
     (const struct bounds *)FLOATS(3, sizeof(struct bounds) / sizeof(double)), FLOATS(4, 0),
     BOUNDED(4, ROWS(4), 2, 3), BOUNDED(4, WIDTH(4) - 2, 0, MOST_FEW), FEW(5), FLOATS(6, SIDE * ITEMS(7)),
     FLOATS(7, 0), BOUNDED(7, ITEMS(7), 1, MOST_SPLINES / 2),
     FLOATS(8, ROWS(4) * WIDTH(8) * (2 * ITEMS(7) + 1)), BOUNDED(8, WIDTH(8), 2 * SIDE + RINGING, MOST_FEW))
