#include "kernels.h"

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
 * last end of a piece, and its sums; no way: none is. at, errors (n): room. */
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
