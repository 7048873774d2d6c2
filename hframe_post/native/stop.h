/* One stop as a least-squares problem, with the symbols of model/stop_solver.py. */

#ifndef HFRAME_STOP_H
#define HFRAME_STOP_H

#include <stddef.h>

#include "kernels.h"

enum {
    SIDE = 100,    /* samples on either side of a dwell in which its command may change */
    RINGING = 100, /* samples after these that are judged too: ringing shows there */
    PIECES = 2 * NEAREST,
    MOST_PIECES = 2 * SIDE + RINGING + 2 * PIECES,
    MOST_ROWS = 148,
    MOST_SAMPLES = 2 * SIDE + 6, /* of the command: two of the dwell, and two more at each end */
    MOST_SPLINES = 37,
    LINE = 8,     /* loops along the columns of a matrix may go on to a multiple of LINE, */
    SPLINES = 40, /* for which its rows have room */
    WIDTH = 2 * SPLINES
};

typedef double vector[2], place[COLUMNS];

struct bounds { /* of one printer */
    vector effort;
    double belts[2][2];
    vector low, high;    /* of the bed */
    double acceleration; /* of the belts, mm per sample2 */
    double x_c;          /* where the lever arm of racking is 0 */
};

struct problem {
    const place *path;
    const struct bounds *bounds;
    int racks;
    int64_t r, k, q;         /* judged samples, which are the rows; splines; samples of the command */
    int64_t dwell[2];        /* rows from one to before another */
    int64_t index[MOST_ROWS];  /* into path */
    int64_t begun[MOST_ROWS];  /* splines that act by then */
    double weight[MOST_ROWS], lever[MOST_ROWS];
    uint8_t extruding[MOST_ROWS];
    vector known[MOST_ROWS]; /* the nozzle without p */
    double by_p[3][MOST_ROWS][SPLINES]; /* outputs of x, y and racking */
    vector command[MOST_SAMPLES];
    double N[MOST_SAMPLES][SPLINES], D[MOST_SAMPLES - 2][SPLINES];
    int64_t bands[MOST_SAMPLES][2]; /* nonzero columns of N, from one to before another */
};

struct search; /* room for it */
size_t size_of_search(void);
void find_best(const struct problem *q, struct search *room, double *best);

#endif
