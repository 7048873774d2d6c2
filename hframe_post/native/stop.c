/* The least squares of one stop, with the symbols of model/stop_solver.py.
 *
 * The columns are those of p, x and y in turn, and then the residual. A row in time has a prefix of
 * columns that are not zero, and these are ``begun`` at it; products skip the rest. Rows of a matrix
 * begin at multiples of LINE, and loops along them may go on to one. */

#include <stdlib.h>
#include <string.h>

#include "kernels.h"

enum {
    NEAREST = 24, PIECES = 2 * NEAREST,
    MOST_SPLINES = 37, MOST_ROWS = 147, MOST_SAMPLES = 206, MOST_PIECES = 400,
    TOGETHER = 4, /* rows of add_rows */
    LINE = 8, WIDTH = 80 /* columns, in whole lines */
};

typedef double vector[2];

/* Iterations of the steps of model/stop_solver.py, at most: 1, 3 and 2; then more of step 2 while a belt
 * exceeds HARDEST, where rows are raised by their shares, as Lawson does. */
enum { SEARCHES = 2, EMPHASES = 3, TRIALS = 10, HARD_TRIALS = 100 };
static const double
    ALONG = 0.01,         /* weight of a squared deviation along the path, next to that across it */
    FAR_OFF = 0.05,       /* mm off the path beyond which an extruding sample gets more weight, */
    EMPHASIS = 1.5, MOST_EMPHASIS = 10.0, /* times this, at most times that */
    TARGET = 0.7,         /* share of its bound from which on a row of E is raised, to stay below it, */
    RAISED = 2.0, MOST_RAISED = 5.0, /* E squared times this, at most times that */
    EASY = 0.4,           /* share of its bound below which a row of E is lowered again */
    HARDEST = 0.97 / 0.8, /* times its bound, an acceleration that is exceeded only if it must be */
    HARD_TARGET = 0.95,   /* share of HARDEST from which on a row is raised then */
    EXCESS_COST = 0.2,    /* mm2 for exceeding a bound by as much again */
    HARD_COST = 100.0,    /* mm2 for exceeding HARDEST by as much again at one sample */
    SHORT2 = 1e-14,       /* mm2, squared length up to which a vector has no direction */
    CLEARANCE = 0.02;     /* mm to the bed's edge for a command that would leave it */

struct problem {
    const vector *path;
    const int64_t *index; /* (r) into path */
    int64_t r, held_from, held_to;
    const double *weight;      /* (r) */
    const uint8_t *extruding;  /* (r) */
    const vector *known;       /* (r) */
    const double *lever;       /* (r) of racking */
    int racks;
    const double *by_p;        /* (2 or 3, r, k): outputs of x, y and racking */
    const int64_t *first;      /* (k) */
    int64_t k, q;
    const vector *command;     /* (q) */
    const double *N, *D;       /* (q, k), (q - 2, k) */
    const int64_t *bands;      /* (q, 2) */
    const double *limit;       /* (q - 2) */
    const double *effort, *belts, *low, *high;
    double full_limit;
};

struct bound_weights {
    double effort[MOST_SAMPLES];
    vector bed[MOST_SAMPLES], inside[MOST_SAMPLES];
};

/* The path from sample to sample around the rows: from x, y by dx, dy; share: factor from a product
 * with a piece to a share of it. */
struct pieces {
    double x[MOST_PIECES], y[MOST_PIECES], dx[MOST_PIECES], dy[MOST_PIECES];
    double length2[MOST_PIECES], share[MOST_PIECES];
    int64_t of_row[MOST_ROWS]; /* the first of the PIECES around a row */
};

struct room {
    double J[2 * MOST_ROWS + TOGETHER][WIDTH]; /* and some of zeros */
    double squares[WIDTH][WIDTH], gradient[WIDTH], solved[WIDTH][WIDTH];
    struct pieces pieces;
    vector foot[MOST_ROWS], direction[MOST_ROWS], t[MOST_ROWS];
    double weight[MOST_ROWS], off[MOST_ROWS];
    vector rates[MOST_SAMPLES], place[MOST_SAMPLES], outside[MOST_SAMPLES];
    double share[MOST_SAMPLES], hard[MOST_SAMPLES];
    struct bound_weights weights, kept;
};

INSIDE double clipped(double value, double low, double high)
{
    return lesser(greater(value, low), high);
}

INSIDE double reweighted(double ratio, double gain, double most)
{
    return ratio > 1.0 ? lesser(gain * (ratio * ratio), most) : 1.0;
}

INSIDE void unit(double x, double y, const vector otherwise, vector out)
{
    double length2 = x * x + y * y, length = sqrt(length2);
    out[0] = length2 > SHORT2 ? x / length : otherwise[0];
    out[1] = length2 > SHORT2 ? y / length : otherwise[1];
}

INSIDE int dwells(const struct problem *q, int64_t row)
{
    return row >= q->held_from && row < q->held_to;
}

/* The k values of an output at a row. */
INSIDE const double *output(const struct problem *q, int64_t number, int64_t row)
{
    return q->by_p + (number * q->r + row) * q->k;
}

/* The nozzle at a row. */
INSIDE void moved(const struct problem *q, int64_t row, const vector *p, vector at)
{
    const double *by_x = output(q, 0, row), *by_y = output(q, 1, row);
    vector by_p = {0.0, 0.0};
    int64_t begun = 0;
    for (; begun < q->k && q->first[begun] <= row; begun++) {
        by_p[0] += p[begun][0] * by_x[begun];
        by_p[1] += p[begun][1] * by_y[begun];
    }
    if (q->racks) {
        const double *by = output(q, 2, row);
        double sum = 0.0;
        for (int64_t c = 0; c < begun; c++)
            sum += p[c][X] * by[c];
        by_p[Y] += q->lever[row] * sum;
    }
    at[0] = q->known[row][0] + by_p[0];
    at[1] = q->known[row][1] + by_p[1];
}

/* The path's nearest point to the nozzle, and the path's step there, among PIECES from one on. */
INSIDE void nearest(const struct pieces *path, int64_t from, const vector at, vector foot,
                    vector step)
{
    const double *x = path->x + from, *y = path->y + from, *dx = path->dx + from, *dy = path->dy + from;
    const double *length2 = path->length2 + from, *share = path->share + from;
    double along[PIECES], squared[PIECES], least[LINE];
    for (int i = 0; i < PIECES; i++) {
        double to_x = at[0] - x[i], to_y = at[1] - y[i];
        along[i] = clipped((to_x * dx[i] + to_y * dy[i]) * share[i], 0.0, 1.0);
        double off_x = to_x - along[i] * dx[i], off_y = to_y - along[i] * dy[i];
        squared[i] = length2[i] > SHORT2 ? off_x * off_x + off_y * off_y : INFINITY;
    }
    for (int lane = 0; lane < LINE; lane++)
        least[lane] = squared[lane];
    for (int i = LINE; i < PIECES; i += LINE)
        for (int lane = 0; lane < LINE; lane++)
            least[lane] = lesser(least[lane], squared[i + lane]);
    for (int lane = 1; lane < LINE; lane++)
        least[0] = lesser(least[0], least[lane]);
    int best = 0;
    while (best < PIECES - 1 && squared[best] != least[0])
        best++;
    foot[0] = x[best] + along[best] * dx[best];
    foot[1] = y[best] + along[best] * dy[best];
    step[0] = dx[best], step[1] = dy[best];
}

/* J: two rows for each sample, across the path and along it. */
INSIDE void jacobian(const struct problem *q, struct room *room)
{
    int64_t begun = 0, k = q->k;
    for (int64_t row = 0; row < q->r; row++) {
        const double *x = output(q, 0, row), *y = output(q, 1, row);
        const double *t = room->t[row], *known = q->known[row], *place = q->path[q->index[row]];
        double normal = sqrt(room->weight[row]);
        double along = (dwells(q, row) ? 1.0 : sqrt(ALONG)) * normal;
        while (begun < k && q->first[begun] <= row)
            begun++;
        for (int side = 0; side < 2; side++) {
            double *J = room->J[2 * row + side];
            const double *to = side ? place : room->foot[row];
            double n_x = side ? along * t[0] : -normal * t[1];
            double n_y = side ? along * t[1] : normal * t[0];
            for (int64_t c = 0; c < begun; c++) {
                J[2 * c] = n_x * x[c];
                J[2 * c + 1] = n_y * y[c];
            }
            if (q->racks) {
                const double *by = output(q, 2, row);
                double weight = n_y * q->lever[row];
                for (int64_t c = 0; c < begun; c++)
                    J[2 * c] += weight * by[c];
            }
            for (int64_t c = 2 * begun; c < WIDTH; c++)
                J[c] = 0.0;
            J[2 * k] = n_x * (known[0] - to[0]) + n_y * (known[1] - to[1]);
        }
    }
}

/* Add to sum the products of column i with the columns from low to before high, of TOGETHER rows;
 * or subtract them. */
INSIDE void add_products(const double *rows, int64_t i, int64_t low, int64_t high, double sign,
                         double *restrict sum)
{
    double factor[TOGETHER];
    for (int r = 0; r < TOGETHER; r++)
        factor[r] = sign * rows[r * WIDTH + i];
    add_rows(factor, rows, WIDTH, low, high, sum);
}

/* The upper triangle of H, and g. */
INSIDE void sum_squares(const struct problem *q, struct room *room)
{
    int64_t begun = 0, rows = 2 * q->r;
    memset(room->squares, 0, sizeof room->squares);
    memset(room->gradient, 0, sizeof room->gradient);
    memset(room->J[rows], 0, sizeof room->J[0] * TOGETHER);
    for (int64_t row = 0; row < rows; row += TOGETHER) {
        while (begun < 2 * q->k && 2 * q->first[begun / 2] < row + TOGETHER)
            begun++;
        int64_t high = (begun + LINE - 1) / LINE * LINE;
        for (int64_t i = 0; i < begun; i++)
            add_products(room->J[row], i, i / LINE * LINE, high, 1.0, room->squares[i]);
        add_products(room->J[row], 2 * q->k, 0, high, 1.0, room->gradient);
    }
}

/* Add a row of weight w to the squares of one axis, of splines from low to before high. */
INSIDE void add_row(const double *by_p, int64_t low, int64_t high, double w, double residual,
                    double square[][MOST_SPLINES], double *gradient)
{
    for (int64_t i = low; i < high; i++) {
        double weighted = w * by_p[i];
        gradient[i] += residual * weighted;
        for (int64_t j = i; j < high; j++)
            square[i][j] += weighted * by_p[j];
    }
}

INSIDE void add_squares(const struct problem *q, struct room *room, int axis, double factor,
                        double square[][MOST_SPLINES], const double *gradient)
{
    for (int64_t i = 0; i < q->k; i++) {
        for (int64_t j = i; j < q->k; j++)
            room->solved[2 * i + axis][2 * j + axis] += factor * square[i][j];
        room->solved[2 * i + axis][2 * q->k] += factor * gradient[i];
    }
}

/* [H g] with the effort and the cost of leaving the bed, into room->solved. */
INSIDE void add_bounds(const struct problem *q, struct room *room)
{
    double greatest = 0.0;
    memcpy(room->solved, room->squares, sizeof room->solved);
    for (int64_t i = 0; i < 2 * q->k; i++)
        room->solved[i][2 * q->k] = room->gradient[i];
    for (int axis = 0; axis < 2; axis++) {
        double square[MOST_SPLINES][MOST_SPLINES] = {{0.0}}, gradient[MOST_SPLINES] = {0.0};
        for (int64_t r = 0; r < q->q - 2; r++)
            add_row(q->D + r * q->k, q->bands[2 * r], q->bands[2 * (r + 2) + 1],
                    room->weights.effort[r], room->rates[r][axis], square, gradient);
        add_squares(q, room, axis, q->effort[axis], square, gradient);
        int outside = 0;
        for (int64_t r = 0; r < q->q; r++)
            outside |= room->weights.bed[r][axis] != 0.0;
        if (!outside)
            continue;
        memset(square, 0, sizeof square), memset(gradient, 0, sizeof gradient);
        for (int64_t r = 0; r < q->q; r++)
            add_row(q->N + r * q->k, q->bands[2 * r], q->bands[2 * r + 1], room->weights.bed[r][axis],
                    q->command[r][axis] - room->weights.inside[r][axis], square, gradient);
        add_squares(q, room, axis, 1.0, square, gradient);
    }
    for (int64_t i = 0; i < 2 * q->k; i++)
        greatest = greater(greatest, room->solved[i][i]);
    for (int64_t i = 0; i < 2 * q->k; i++)
        room->solved[i][i] += 1e-9 * greatest + 1e-12;
}

/* p by Cholesky's method: [H g] in room->solved becomes [U y] with UᵀU = H. */
INSIDE void solve(int64_t n, struct room *room, double *p)
{
    double(*U)[WIDTH] = room->solved;
    for (int64_t top = 0; top < n; top += TOGETHER) {
        int64_t end = top + TOGETHER < n ? top + TOGETHER : n;
        for (int64_t i = top; i < end; i++) {
            double root = sqrt(U[i][i]);
            for (int64_t j = i; j <= n; j++)
                U[i][j] /= root;
            for (int64_t row = i + 1; row < end; row++)
                for (int64_t j = row; j <= n; j++)
                    U[row][j] -= U[i][row] * U[i][j];
        }
        for (int64_t row = end; row < n; row++)
            add_products(U[top], row, row / LINE * LINE, WIDTH, -1.0, U[row]);
    }
    for (int64_t i = 0; i < n; i++)
        p[i] = -U[i][n];
    for (int64_t i = n - 1; i >= 0; i--) {
        p[i] /= U[i][i];
        for (int64_t j = 0; j < i; j++)
            p[j] -= U[j][i] * p[i];
    }
}

/* ½pᵀHp + gᵀp */
INSIDE double cost_of(int64_t n, const struct room *room, const double *p)
{
    double cost = 0.0;
    for (int64_t i = 0; i < n; i++) {
        const double *H = room->squares[i];
        double others = 0.0;
        for (int64_t j = i + 1; j < n; j++)
            others += p[j] * H[j];
        cost += p[i] * (0.5 * H[i] * p[i] + others + room->gradient[i]);
    }
    return cost;
}

/* Shares of the belts' bounds, and what is outside the bed. over: the greatest of the shares, the sum of
 * what exceeds the belts' limit, as shares of it, and the greatest distance outside. */
INSIDE void measure_bounds(const struct problem *q, struct room *room, const vector *p,
                           double over[3])
{
    over[0] = over[1] = over[2] = 0.0;
    for (int64_t r = 0; r < q->q - 2; r++) {
        double u[2] = {0.0, 0.0}, acceleration = 0.0;
        room->share[r] = room->hard[r] = 0.0;
        if (q->bands[2 * r] >= q->bands[2 * (r + 2) + 1])
            continue; /* other stops, or what follows this one, decide */
        for (int64_t c = q->bands[2 * r]; c < q->bands[2 * (r + 2) + 1]; c++)
            for (int axis = 0; axis < 2; axis++)
                u[axis] += q->D[r * q->k + c] * p[c][axis];
        for (int axis = 0; axis < 2; axis++)
            u[axis] += room->rates[r][axis];
        for (int belt = 0; belt < 2; belt++)
            acceleration = greater(acceleration, fabs(u[0] * q->belts[2 * belt] +
                                                      u[1] * q->belts[2 * belt + 1]));
        room->share[r] = acceleration / q->limit[r];
        room->hard[r] = acceleration / (HARDEST * q->full_limit);
        over[0] = greater(over[0], room->share[r]);
        over[1] += greater(room->hard[r] - 1.0, 0.0);
    }
    for (int64_t r = 0; r < q->q; r++)
        for (int axis = 0; axis < 2; axis++) {
            double added = 0.0;
            for (int64_t c = q->bands[2 * r]; c < q->bands[2 * r + 1]; c++)
                added += q->N[r * q->k + c] * p[c][axis];
            double place = q->command[r][axis] + added;
            room->place[r][axis] = place;
            room->outside[r][axis] = fabs(clipped(place, q->low[axis], q->high[axis]) - place);
            over[2] = greater(over[2], room->outside[r][axis]);
        }
}

/* Raise the effort where belts are harder than the target, or only where they exceed their limit. */
INSIDE void raise(const struct problem *q, struct room *room, int only_hard)
{
    struct bound_weights *w = &room->weights;
    for (int64_t r = 0; r < q->q - 2; r++) {
        double share = room->share[r], hard = room->hard[r];
        double factor = share < EASY ? 0.5 : reweighted(share / TARGET, RAISED, MOST_RAISED);
        if (only_hard)
            factor = clipped(hard / HARD_TARGET, 0.5, MOST_RAISED);
        w->effort[r] = greater(w->effort[r] * factor, 1.0);
    }
    for (int64_t r = 0; r < q->q; r++)
        for (int axis = 0; axis < 2; axis++)
            if (room->outside[r][axis] > 0.0) {
                double low = q->low[axis] + CLEARANCE, high = q->high[axis] - CLEARANCE;
                w->bed[r][axis] = greater(10.0 * w->bed[r][axis], 1.0);
                w->inside[r][axis] = clipped(room->place[r][axis], low, high);
            }
}

/* p (k) within the bounds of belts and bed; room->weights become those that this took. Return the sum of
 * what exceeds the belts' limit. */
INSIDE double bounded(const struct problem *q, struct room *room, vector *p)
{
    vector tried[MOST_SPLINES];
    double least_outside = INFINITY, least_cost = INFINITY, least_hard = INFINITY, over[3];
    for (int64_t trial = 0; trial < TRIALS + HARD_TRIALS; trial++) {
        int only_hard = trial >= TRIALS;
        if (only_hard && least_hard == 0.0)
            break;
        if (trial == TRIALS) /* what was raised for the bounds may have moved all too far */
            for (int64_t r = 0; r < q->q - 2; r++)
                room->weights.effort[r] = 1.0;
        add_bounds(q, room);
        solve(2 * q->k, room, tried[0]);
        measure_bounds(q, room, (const vector *)tried, over);
        double excess = greater(over[0], 1.0) + over[2], cost = cost_of(2 * q->k, room, tried[0]);
        cost += EXCESS_COST * (excess - 1.0) + HARD_COST * over[1];
        if (over[2] < least_outside || (over[2] == least_outside && cost < least_cost)) {
            memcpy(p, tried, sizeof(vector) * (size_t)q->k);
            room->kept = room->weights;
            least_outside = over[2], least_cost = cost, least_hard = over[1];
        }
        if (excess <= 1.0)
            break;
        raise(q, room, only_hard);
    }
    room->weights = room->kept;
    return least_hard;
}

/* Feet of the nozzle, and the path's directions there, for rows that extrude or for the others. Their
 * distances go into room->off. Return the greatest. */
INSIDE double seek_feet(const struct problem *q, struct room *room, const vector *p, int extruding)
{
    double most = 0.0;
    for (int64_t row = 0; row < q->r; row++) {
        vector at, step;
        double *foot = room->foot[row];
        if (q->extruding[row] != extruding || dwells(q, row))
            continue;
        moved(q, row, p, at);
        nearest(&room->pieces, room->pieces.of_row[row], (const double *)at, foot, step);
        unit(step[0], step[1], (const double *)room->direction[row], room->t[row]);
        double x = at[0] - foot[0], y = at[1] - foot[1];
        room->off[row] = sqrt(x * x + y * y);
        most = greater(most, room->off[row]);
    }
    return most;
}

/* The pieces around the rows outside the dwell. Return whether there is room for them. */
INSIDE int cut_path(const struct problem *q, struct pieces *pieces)
{
    int64_t n = 0, next = 0; /* piece, and its place in the path */
    for (int64_t row = 0; row < q->r; row++) {
        int64_t from = q->index[row] - NEAREST;
        if (dwells(q, row))
            continue;
        for (next = next < from ? from : next; next < from + PIECES; next++, n++) {
            const vector *path = q->path + next;
            if (n == MOST_PIECES)
                return 0;
            pieces->x[n] = path[0][0], pieces->dx[n] = path[1][0] - path[0][0];
            pieces->y[n] = path[0][1], pieces->dy[n] = path[1][1] - path[0][1];
            double length2 = pieces->dx[n] * pieces->dx[n] + pieces->dy[n] * pieces->dy[n];
            pieces->length2[n] = length2, pieces->share[n] = 1.0 / greater(length2, 1e-18);
        }
        pieces->of_row[row] = n - PIECES;
    }
    return 1;
}

INSIDE void begin(const struct problem *q, struct room *room)
{
    static const vector ahead = {1.0, 0.0};
    for (int64_t row = 0; row < q->r; row++) {
        const vector *path = q->path + q->index[row], *next = path + !dwells(q, row);
        unit(next[0][0] - path[0][0], next[0][1] - path[0][1], ahead, room->direction[row]);
        room->weight[row] = q->weight[row];
        for (int axis = 0; axis < 2; axis++) {
            room->foot[row][axis] = path[0][axis];
            room->t[row][axis] = room->direction[row][axis];
        }
    }
    memset(&room->weights, 0, sizeof room->weights);
    for (int64_t r = 0; r < q->q - 2; r++) {
        const vector *u = q->command + r;
        room->weights.effort[r] = 1.0;
        for (int axis = 0; axis < 2; axis++)
            room->rates[r][axis] = (u[2][axis] - u[1][axis]) - (u[1][axis] - u[0][axis]);
    }
}

/* The best p. Return whether there is room for the path. */
WIDE static int search(const struct problem *q, struct room *room, vector *best)
{
    vector p[MOST_SPLINES];
    double least = INFINITY;
    if (!cut_path(q, &room->pieces))
        return 0;
    begin(q, room);
    for (int64_t searched = 1; searched <= SEARCHES + EMPHASES; searched++) {
        jacobian(q, room);
        sum_squares(q, room);
        double hard = bounded(q, room, p), peak = seek_feet(q, room, (const vector *)p, 1);
        peak += sqrt(HARD_COST * hard);
        if (searched >= SEARCHES) {
            if (peak < least) {
                memcpy(best, p, sizeof(vector) * (size_t)q->k);
                least = peak;
            }
            if (least <= FAR_OFF || searched == SEARCHES + EMPHASES)
                break;
            for (int64_t row = 0; row < q->r; row++)
                if (q->extruding[row])
                    room->weight[row] *= reweighted(room->off[row] / FAR_OFF, EMPHASIS,
                                                    MOST_EMPHASIS);
        }
        seek_feet(q, room, (const vector *)p, 0);
    }
    return 1;
}

/* A stop in a stretch of samples; see model/stop_cost.py. */
struct stop {
    int64_t a, b, before, after, ends;
};
struct shares { /* weights of samples in travel, in a dwell, and at its end if it extrudes soon */
    double travelling, dwelling, arriving;
};

/* The judged rows with their weights; weight (r) is that of rows that extrude. */
static void weigh(const struct stop *stop, const uint8_t *extrudes, const int64_t *index, int64_t r,
                  int64_t held_from, int64_t held_to, const struct shares *share, int64_t soon,
                  double *weight, uint8_t *extruding)
{
    for (int64_t i = 0; i < r; i++) {
        int held = i >= held_from && i < held_to;
        extruding[i] = !held && extrudes[index[i]];
        if (!extruding[i])
            weight[i] *= share->travelling;
        if ((!stop->after && i >= held_to) || index[i] >= stop->ends || index[i] < stop->a - stop->before)
            weight[i] = 0.0;
        extruding[i] &= weight[i] > 0.0;
        if (held)
            weight[i] = share->dwelling;
    }
    for (int64_t i = 0; i < soon && held_to > held_from; i++)
        if (extrudes[stop->b + i])
            weight[held_to - 1] = share->arriving;
}

/* Write the command (n, 2) around a stop into the command of its stretch. known (r, 2): the nozzle
 * without p; bounds: effort (2), belts (2, 2), the least and the greatest place (2, 2), and the belts'
 * limit where nothing lowers it. q: samples of the command with two more on either side, and at most
 * two of the dwell. Return whether there is room for it. */
static int64_t solve_stop(const double *path, const uint8_t *extrudes, int64_t n, double *command,
                          const int64_t *judged, const double *first_weight, int64_t r,
                          int64_t held_from, int64_t held_to, const struct stop *stop, int64_t beside,
                          const struct shares *share, int64_t soon, const double *known,
                          const double *lever, int64_t racks, const double *by_p, const int64_t *first, int64_t k, const double *N,
                          const double *D, const int64_t *bands, const double *limit, int64_t q,
                          const double *bounds, const double *origin)
{
    int64_t index[MOST_ROWS], a = stop->a, b = stop->b, dwell = q - 2 * beside - 4;
    double weight[MOST_ROWS], own[11];
    uint8_t extruding[MOST_ROWS];
    vector sequence[MOST_SAMPLES], p[MOST_SPLINES], *u = (vector *)command;
    if (r > MOST_ROWS || k > MOST_SPLINES || q > MOST_SAMPLES || dwell < 0 || b < a || dwell > b - a
        || held_to > r || a < beside + 2 || b + beside + 2 > n || b + soon > n)
        return 0;
    for (int64_t i = 0; i < r; i++) {
        index[i] = a - beside + judged[i], weight[i] = first_weight[i];
        if (index[i] < NEAREST || index[i] >= n - NEAREST)
            return 0;
    }
    weigh(stop, extrudes, index, r, held_from, held_to, share, soon, weight, extruding);
    for (int c = 0; c < 11; c++)
        own[c] = c >= 6 && c < 10 ? bounds[c] - origin[c % 2] : bounds[c];
    memcpy(sequence, u + a - beside - 2, sizeof(vector) * (size_t)(beside + 2));
    for (int64_t i = 0; i < dwell; i++)
        memcpy(sequence[beside + 2 + i], u[a], sizeof(vector));
    memcpy(sequence + beside + 2 + dwell, u + b, sizeof(vector) * (size_t)(beside + 2));
    struct problem problem = {
        (const vector *)path, index, r, held_from, held_to, weight, extruding, (const vector *)known,
        lever, racks > 0, by_p, first, k, q,
        (const vector *)sequence, N, D, bands, limit, own, own + 2, own + 6, own + 8, own[10],
    };
    void *room = malloc(sizeof(struct room) + 64);
    uintptr_t line = ((uintptr_t)room + 63) / 64 * 64; /* of the cache */
    int found = room && (k == 0 || search(&problem, (struct room *)line, p));
    free(room);
    if (!found)
        return 0;
    for (int64_t i = 0; i < q; i++)
        for (int axis = 0; axis < 2; axis++) {
            double sum = 0.0;
            for (int64_t c = bands[2 * i]; c < bands[2 * i + 1]; c++)
                sum += p[c][axis] * N[i * k + c];
            sequence[i][axis] += sum;
        }
    memcpy(u + a - beside, sequence + 2, sizeof(vector) * (size_t)beside);
    for (int64_t i = a; i < b; i++)
        memcpy(u[i], sequence[beside + 2], sizeof(vector));
    memcpy(u + b, sequence + q - beside - 2, sizeof(vector) * (size_t)beside);
    return 1;
}

LOOP(solve_stop, FLOATS(0, 2 * COUNT(2)), BYTES(1, COUNT(2)), COUNT(2), OUT_FLOATS(3, 2 * COUNT(2)),
     INTEGERS(4, FEW(6)), FLOATS(5, FEW(6)), FEW(6), FEW(7), FEW(8),
     (const struct stop *)INTEGERS(9, sizeof(struct stop) / sizeof(int64_t)), FEW(10),
     (const struct shares *)FLOATS(11, sizeof(struct shares) / sizeof(double)), FEW(12),
     FLOATS(13, 2 * FEW(6)), FLOATS(14, FEW(6) * WITHIN(15, 0, 1)), WITHIN(15, 0, 1),
     FLOATS(16, (2 + WITHIN(15, 0, 1)) * FEW(6) * FEW(18)), INTEGERS(17, FEW(18)), FEW(18),
     FLOATS(19, FEW(23) * FEW(18)), FLOATS(20, (FEW(23) - 2) * FEW(18)),
     INDICES(21, 2 * FEW(23), 0, FEW(18) + 1), FLOATS(22, FEW(23) - 2), FEW(23), FLOATS(24, 11),
     FLOATS(25, 2))
