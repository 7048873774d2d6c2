/* The best command around one stop: reweighted least squares, as model/stop_solver.py says.
 *
 * The columns are those of p for x and then for y. A row in time has a prefix of either that is not
 * zero, and these are ``begun`` at it; products skip the rest. */

#include <string.h>

#include "stop.h"

enum { TOGETHER = 8 }; /* rows that are added to one at once */

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
    CLEARANCE = 0.02,     /* mm to the bed's edge for a command that would leave it */
    AT_DWELL = 0.5,       /* share of the belts' bound next to the dwell, where firmware stops in a segment */
    SAME = 1e-9;          /* relative difference of weights that changes nothing */

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

/* The weight of a squared deviation from the path by its direction, and of a row in time. */
struct weight {
    double xx, xy, yy;
};

/* Rows in time whose squares are added at once: outputs of x and y, of x times racking's lever, and
 * what these are weighted to be multiplied with. */
struct rows {
    double x[TOGETHER][SPLINES], y[TOGETHER][SPLINES], racked[TOGETHER][SPLINES];
    double by_x[TOGETHER][SPLINES], by_racked[TOGETHER][SPLINES], by_y[TOGETHER][SPLINES];
};

struct search {
    double squares[WIDTH][WIDTH], gradient[WIDTH], solved[WIDTH][WIDTH];
    struct weight counted[MOST_ROWS]; /* in squares */
    struct rows rows;
    struct pieces pieces;
    vector foot[MOST_ROWS], direction[MOST_ROWS], t[MOST_ROWS];
    double weight[MOST_ROWS], off[MOST_ROWS];
    vector rates[MOST_SAMPLES], place[MOST_SAMPLES], outside[MOST_SAMPLES];
    double share[MOST_SAMPLES], hard[MOST_SAMPLES];
    struct bound_weights weights, kept;
};

size_t size_of_search(void) { return sizeof(struct search); }

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
    return row >= q->dwell[0] && row < q->dwell[1];
}

/* The bound of the belts' second difference at a row of D. */
INSIDE double belts_bound(const struct problem *q, int64_t r)
{
    double share = r >= SIDE && r < q->q - 2 - SIDE ? AT_DWELL : 1.0;
    return share * q->bounds->acceleration;
}

/* The nozzle at a row. p: the splines for x, then those for y. */
INSIDE void moved(const struct problem *q, int64_t row, const double *p, vector at)
{
    const double *by_x = q->by_p[0][row], *by_y = q->by_p[1][row], *by_racking = q->by_p[2][row];
    double x = 0.0, y = 0.0, racked = 0.0;
    for (int64_t c = 0; c < q->begun[row]; c++) {
        x += p[c] * by_x[c];
        y += p[q->k + c] * by_y[c];
    }
    for (int64_t c = 0; q->racks && c < q->begun[row]; c++)
        racked += p[c] * by_racking[c];
    at[X] = q->known[row][X] + x;
    at[Y] = q->known[row][Y] + (y + q->lever[row] * racked);
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
        along[i] = between((to_x * dx[i] + to_y * dy[i]) * share[i], 0.0, 1.0);
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

/* The weight of the deviation at a row: across the path from the foot, along it from the sample's own
 * place. gradient: its derivative without p. */
INSIDE struct weight weigh(const struct problem *q, const struct search *room, int64_t row,
                           vector gradient)
{
    const double *t = room->t[row], *foot = room->foot[row], *nozzle = q->known[row];
    const double *own = q->path[q->index[row]];
    double across2 = room->weight[row], along2 = across2 * (dwells(q, row) ? 1.0 : ALONG);
    double across = across2 * (t[X] * (nozzle[Y] - foot[Y]) - t[Y] * (nozzle[X] - foot[X]));
    double along = along2 * (t[X] * (nozzle[X] - own[X]) + t[Y] * (nozzle[Y] - own[Y]));
    gradient[X] = along * t[X] - across * t[Y];
    gradient[Y] = along * t[Y] + across * t[X];
    return (struct weight){
        across2 * t[Y] * t[Y] + along2 * t[X] * t[X],
        (along2 - across2) * t[X] * t[Y],
        across2 * t[X] * t[X] + along2 * t[Y] * t[Y],
    };
}

/* Take a row in time as number i of those to be added, with a weight. */
INSIDE void take_row(const struct problem *q, int64_t row, struct weight w, struct rows *rows, int i)
{
    for (int64_t c = 0; c < SPLINES; c++) {
        double x = q->by_p[0][row][c], y = q->by_p[1][row][c];
        double racked = q->racks ? q->lever[row] * q->by_p[2][row][c] : 0.0;
        rows->x[i][c] = x, rows->y[i][c] = y, rows->racked[i][c] = racked;
        rows->by_x[i][c] = w.xx * x + w.xy * racked;
        rows->by_racked[i][c] = w.xy * x + w.yy * racked;
        rows->by_y[i][c] = w.yy * y;
    }
}

/* Add to sum some rows, each times its factor, in the columns from low to before high. */
INSIDE void add_rows(const double *factor, const double *rows, int64_t width, int64_t low, int64_t high,
                     double *restrict sum)
{
    for (int64_t j = low; j < high; j++) {
        double so_far = sum[j];
        for (int r = 0; r < TOGETHER; r++)
            so_far += factor[r] * rows[r * width + j];
        sum[j] = so_far;
    }
}

/* Add to sum the products of column i of some rows with the columns from low to before high of others. */
INSIDE void add_products(const double left[][SPLINES], const double right[][SPLINES], int64_t i,
                         int64_t low, int64_t high, double *restrict sum)
{
    double factor[TOGETHER];
    for (int r = 0; r < TOGETHER; r++)
        factor[r] = left[r][i];
    add_rows(factor, right[0], SPLINES, low, high, sum);
}

/* Add the squares of rows, of which ``begun`` columns are not zero, to the upper triangle of H. mixed:
 * whether a product of x with y counts. */
INSIDE void add_squares(const struct rows *rows, int64_t begun, int64_t k, int racks, int mixed,
                        double H[][WIDTH])
{
    int64_t high = (begun + LINE - 1) / LINE * LINE;
    for (int64_t i = 0; i < begun; i++) {
        int64_t low = i / LINE * LINE;
        add_products(rows->x, rows->by_x, i, low, high, H[i]);
        if (racks)
            add_products(rows->racked, rows->by_racked, i, low, high, H[i]);
        if (mixed)
            add_products(rows->by_racked, rows->y, i, 0, high, H[i] + k);
        add_products(rows->by_y, rows->y, i, low, high, H[k + i] + k);
    }
}

/* Bring H up to date, and g: only rows whose weights have changed are added, by the difference. */
INSIDE void sum_squares(const struct problem *q, struct search *room)
{
    int64_t k = q->k, begun = 0;
    int count = 0, mixed = q->racks;
    double by_x[SPLINES] = {0.0}, by_y[SPLINES] = {0.0};
    for (int64_t row = 0; row < q->r; row++) {
        vector slope;
        struct weight w = weigh(q, room, row, slope), *old = &room->counted[row];
        struct weight more = {w.xx - old->xx, w.xy - old->xy, w.yy - old->yy};
        double racked = q->lever[row] * slope[Y];
        for (int64_t c = 0; c < SPLINES; c++) {
            by_x[c] += slope[X] * q->by_p[0][row][c];
            by_y[c] += slope[Y] * q->by_p[1][row][c];
        }
        for (int64_t c = 0; q->racks && c < SPLINES; c++)
            by_x[c] += racked * q->by_p[2][row][c];
        if (fabs(more.xx) + fabs(more.xy) + fabs(more.yy) > SAME * (w.xx + w.yy)) {
            take_row(q, row, more, &room->rows, count++);
            *old = w, begun = q->begun[row], mixed |= more.xy != 0.0;
        }
        if (count < TOGETHER && !(count && row == q->r - 1))
            continue;
        for (; count < TOGETHER; count++)
            take_row(q, 0, (struct weight){0.0, 0.0, 0.0}, &room->rows, count);
        add_squares(&room->rows, begun, k, q->racks, mixed, room->squares);
        count = 0, mixed = q->racks;
    }
    memcpy(room->gradient, by_x, sizeof(double) * (size_t)k);
    memcpy(room->gradient + k, by_y, sizeof(double) * (size_t)k);
}

/* Add a row of weight w, of splines from low to before high, to the squares of one axis and to the
 * gradient, which is their last column. */
INSIDE void add_row(const double *by_p, int64_t low, int64_t high, double w, double residual,
                    int64_t axis, int64_t k, double H[][WIDTH])
{
    for (int64_t i = low; i < high; i++) {
        double weighted = w * by_p[i], *of = H[axis * k + i];
        of[2 * k] += residual * weighted;
        for (int64_t j = i; j < high; j++)
            of[axis * k + j] += weighted * by_p[j];
    }
}

/* [H g] with the effort and the cost of leaving the bed, into room->solved. */
INSIDE void add_bounds(const struct problem *q, struct search *room)
{
    double greatest = 0.0;
    const struct bound_weights *w = &room->weights;
    for (int64_t i = 0; i < 2 * q->k; i++) {
        int64_t low = i / LINE * LINE;
        memcpy(room->solved[i] + low, room->squares[i] + low, sizeof(double) * (size_t)(WIDTH - low));
        room->solved[i][2 * q->k] = room->gradient[i];
    }
    for (int axis = 0; axis < 2; axis++) {
        for (int64_t r = 0; r < q->q - 2; r++)
            add_row(q->D[r], q->bands[r][0], q->bands[r + 2][1], q->bounds->effort[axis] * w->effort[r],
                    room->rates[r][axis], axis, q->k, room->solved);
        for (int64_t r = 0; r < q->q; r++)
            if (w->bed[r][axis] != 0.0)
                add_row(q->N[r], q->bands[r][0], q->bands[r][1], w->bed[r][axis],
                        q->command[r][axis] - w->inside[r][axis], axis, q->k, room->solved);
    }
    for (int64_t i = 0; i < 2 * q->k; i++)
        greatest = greater(greatest, room->solved[i][i]);
    for (int64_t i = 0; i < 2 * q->k; i++)
        room->solved[i][i] += 1e-9 * greatest + 1e-12;
}

/* p by Cholesky's method: [H g] in room->solved becomes [U y] with UᵀU = H. */
INSIDE void solve(int64_t n, struct search *room, double *p)
{
    double(*U)[WIDTH] = room->solved;
    int64_t width = (n + LINE) / LINE * LINE;
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
        for (int64_t row = end; row < n; row++) {
            double factor[TOGETHER];
            for (int r = 0; r < TOGETHER; r++)
                factor[r] = -U[top + r][row];
            add_rows(factor, U[top], WIDTH, row / LINE * LINE, width, U[row]);
        }
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
INSIDE double cost_of(int64_t n, const struct search *room, const double *p)
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

/* Beyond the bounds: the greatest share of the belts' bounds; the sum of what exceeds the belts' limit,
 * as shares of it; the greatest distance outside the bed. */
struct excess {
    double share, hard, outside;
};

INSIDE struct excess measure_bounds(const struct problem *q, struct search *room, const double *p)
{
    struct excess most = {0.0, 0.0, 0.0};
    const struct bounds *bounds = q->bounds;
    for (int64_t r = 0; r < q->q - 2; r++) {
        double u[2] = {0.0, 0.0}, acceleration = 0.0;
        room->share[r] = room->hard[r] = 0.0;
        if (q->bands[r][0] >= q->bands[r + 2][1])
            continue; /* other stops, or what follows this one, decide */
        for (int64_t c = q->bands[r][0]; c < q->bands[r + 2][1]; c++)
            for (int axis = 0; axis < 2; axis++)
                u[axis] += q->D[r][c] * p[axis * q->k + c];
        for (int axis = 0; axis < 2; axis++)
            u[axis] += room->rates[r][axis];
        for (int belt = 0; belt < 2; belt++)
            acceleration = greater(acceleration, fabs(u[X] * bounds->belts[belt][X] +
                                                      u[Y] * bounds->belts[belt][Y]));
        room->share[r] = acceleration / belts_bound(q, r);
        room->hard[r] = acceleration / (HARDEST * bounds->acceleration);
        most.share = greater(most.share, room->share[r]);
        most.hard += greater(room->hard[r] - 1.0, 0.0);
    }
    for (int64_t r = 0; r < q->q; r++)
        for (int axis = 0; axis < 2; axis++) {
            double added = 0.0;
            for (int64_t c = q->bands[r][0]; c < q->bands[r][1]; c++)
                added += q->N[r][c] * p[axis * q->k + c];
            double place = q->command[r][axis] + added;
            room->place[r][axis] = place;
            room->outside[r][axis] = fabs(between(place, bounds->low[axis], bounds->high[axis]) - place);
            most.outside = greater(most.outside, room->outside[r][axis]);
        }
    return most;
}

/* Raise the effort where belts are harder than the target, or only where they exceed their limit. */
INSIDE void raise(const struct problem *q, struct search *room, int only_hard)
{
    struct bound_weights *w = &room->weights;
    for (int64_t r = 0; r < q->q - 2; r++) {
        double share = room->share[r], hard = room->hard[r];
        double factor = share < EASY ? 0.5 : reweighted(share / TARGET, RAISED, MOST_RAISED);
        if (only_hard)
            factor = between(hard / HARD_TARGET, 0.5, MOST_RAISED);
        w->effort[r] = greater(w->effort[r] * factor, 1.0);
    }
    for (int64_t r = 0; r < q->q; r++)
        for (int axis = 0; axis < 2; axis++)
            if (room->outside[r][axis] > 0.0) {
                double low = q->bounds->low[axis] + CLEARANCE, high = q->bounds->high[axis] - CLEARANCE;
                w->bed[r][axis] = greater(10.0 * w->bed[r][axis], 1.0);
                w->inside[r][axis] = between(room->place[r][axis], low, high);
            }
}

/* p (k) within the bounds of belts and bed; room->weights become those that this took. Return the sum of
 * what exceeds the belts' limit. */
INSIDE double bounded(const struct problem *q, struct search *room, double *p)
{
    double tried[WIDTH];
    double least_outside = INFINITY, least_cost = INFINITY, least_hard = INFINITY;
    for (int64_t trial = 0; trial < TRIALS + HARD_TRIALS; trial++) {
        int only_hard = trial >= TRIALS;
        if (only_hard && least_hard == 0.0)
            break;
        if (trial == TRIALS) /* what was raised for the bounds may have moved all too far */
            for (int64_t r = 0; r < q->q - 2; r++)
                room->weights.effort[r] = 1.0;
        add_bounds(q, room);
        solve(2 * q->k, room, tried);
        struct excess most = measure_bounds(q, room, tried);
        double over = greater(most.share, 1.0) - 1.0 + most.outside;
        double cost = 0.0;
        if (over > 0.0 || trial > 0) /* else there is nothing to compare it with */
            cost = cost_of(2 * q->k, room, tried) + EXCESS_COST * over + HARD_COST * most.hard;
        if (most.outside < least_outside || (most.outside == least_outside && cost < least_cost)) {
            memcpy(p, tried, sizeof tried);
            room->kept = room->weights;
            least_outside = most.outside, least_cost = cost, least_hard = most.hard;
        }
        if (over <= 0.0)
            break;
        raise(q, room, only_hard);
    }
    room->weights = room->kept;
    return least_hard;
}

/* Feet of the nozzle, and the path's directions there, for rows that extrude or for the others. Their
 * distances go into room->off. Return the greatest. */
INSIDE double seek_feet(const struct problem *q, struct search *room, const double *p, int extruding)
{
    double most = 0.0;
    for (int64_t row = 0; row < q->r; row++) {
        vector at, step;
        double *foot = room->foot[row];
        if (q->extruding[row] != extruding || dwells(q, row))
            continue;
        moved(q, row, p, at);
        nearest(&room->pieces, room->pieces.of_row[row], at, foot, step);
        unit(step[0], step[1], room->direction[row], room->t[row]);
        double x = at[0] - foot[0], y = at[1] - foot[1];
        room->off[row] = sqrt(x * x + y * y);
        most = greater(most, room->off[row]);
    }
    return most;
}

/* The pieces around the rows outside the dwell. */
INSIDE void cut_path(const struct problem *q, struct pieces *pieces)
{
    int64_t n = 0, next = 0; /* piece, and its place in the path */
    for (int64_t row = 0; row < q->r; row++) {
        int64_t from = q->index[row] - NEAREST;
        if (dwells(q, row))
            continue;
        for (next = next < from ? from : next; next < from + PIECES; next++, n++) {
            const place *path = q->path + next;
            pieces->x[n] = path[0][0], pieces->dx[n] = path[1][0] - path[0][0];
            pieces->y[n] = path[0][1], pieces->dy[n] = path[1][1] - path[0][1];
            double length2 = pieces->dx[n] * pieces->dx[n] + pieces->dy[n] * pieces->dy[n];
            pieces->length2[n] = length2, pieces->share[n] = 1.0 / greater(length2, 1e-18);
        }
        pieces->of_row[row] = n - PIECES;
    }
}

INSIDE void begin(const struct problem *q, struct search *room)
{
    static const vector ahead = {1.0, 0.0};
    for (int64_t row = 0; row < q->r; row++) {
        const place *path = q->path + q->index[row], *next = path + !dwells(q, row);
        unit(next[0][0] - path[0][0], next[0][1] - path[0][1], ahead, room->direction[row]);
        room->weight[row] = q->weight[row];
        for (int axis = 0; axis < 2; axis++) {
            room->foot[row][axis] = path[0][axis];
            room->t[row][axis] = room->direction[row][axis];
        }
    }
    memset(room->squares, 0, sizeof room->squares);
    memset(room->counted, 0, sizeof room->counted);
    memset(&room->weights, 0, sizeof room->weights);
    for (int64_t r = 0; r < q->q - 2; r++) {
        const vector *u = q->command + r;
        room->weights.effort[r] = 1.0;
        for (int axis = 0; axis < 2; axis++)
            room->rates[r][axis] = (u[2][axis] - u[1][axis]) - (u[1][axis] - u[0][axis]);
    }
}

/* Write the best p (2k). */
WIDE void find_best(const struct problem *q, struct search *room, double *best)
{
    double p[WIDTH], least = INFINITY;
    cut_path(q, &room->pieces);
    begin(q, room);
    for (int64_t searched = 1; searched <= SEARCHES + EMPHASES; searched++) {
        sum_squares(q, room);
        double hard = bounded(q, room, p), peak = seek_feet(q, room, p, 1);
        peak += sqrt(HARD_COST * hard);
        if (searched >= SEARCHES) {
            if (peak < least) {
                memcpy(best, p, sizeof p);
                least = peak;
            }
            if (least <= FAR_OFF || searched == SEARCHES + EMPHASES)
                break;
            for (int64_t row = 0; row < q->r; row++)
                if (q->extruding[row])
                    room->weight[row] *= reweighted(room->off[row] / FAR_OFF, EMPHASIS,
                                                    MOST_EMPHASIS);
        }
        seek_feet(q, room, p, 0);
    }
}
