/* The loops of model/plant.py. */

#include <stddef.h>

#include "kernels.h"

enum { COEFFICIENTS = 6, STATES = 2 };

struct cascade { /* second-order sections (count, 6) one after the other, and their state (count, 2) */
    const double *sections;
    int64_t count;
    double *state;
};

/* Return the output for the next sample: transposed direct form II, as scipy.signal.sosfilt. */
static inline double next(struct cascade f, double value)
{
    for (int64_t k = 0; k < f.count; k++) {
        const double *c = f.sections + COEFFICIENTS * k;
        double *s = f.state + STATES * k, input = value;
        value = c[0] * input + s[0];
        s[0] = c[1] * input - c[4] * value + s[1];
        s[1] = c[2] * input - c[5] * value;
    }
    return value;
}

/* The cascade of count sections that follows another in memory. */
static inline struct cascade after(struct cascade f, int64_t count)
{
    struct cascade following = {f.sections + COEFFICIENTS * f.count, count, f.state + STATES * f.count};
    return following;
}

/* u, y (n): input and output of one transfer function. */
static int64_t filtered(const double *sections, int64_t count, double *state, const double *u,
                        int64_t n, double *y)
{
    struct cascade f = {sections, count, state};
    for (int64_t i = 0; i < n; i++)
        y[i] = next(f, u[i]);
    return n;
}

LOOP(filtered, FLOATS(0, COEFFICIENTS * WHOLE(1)), WHOLE(1), OUT_FLOATS(2, STATES * WHOLE(1)),
     FLOATS(3, WHOLE(4)), WHOLE(4), OUT_FLOATS(5, WHOLE(4)))

struct couplings { /* in memory one after the other; axes (count, 3): of the answer, of the command,
                      and of the lever arm or -1 */
    struct cascade before;
    const int64_t *sections, *axes;
    const double *centre;
    int64_t count;
};

/* Add to the nozzle, which would be at x, y without couplings, what these make of the commands. */
static inline void couple(const struct couplings *all, double u, double v, double x, double y,
                          double *nozzle_x, double *nozzle_y, double *outputs, int64_t shown)
{
    struct cascade G = all->before;
    for (int64_t k = 0; k < all->count; k++) {
        const int64_t *axis = all->axes + 3 * k;
        G = after(G, all->sections[k]);
        double output = next(G, axis[1] == X ? u : v);
        double lever = axis[2] < 0 ? 1.0 : (axis[2] == X ? x : y) - all->centre[k];
        *(axis[0] == X ? nozzle_x : nozzle_y) += lever * output;
        if (k < shown)
            outputs[k] = output;
    }
}

/* Add to added (n) what the couplings make of commands u, v (n), which all answer in one axis. path
 * (n, 2), u and v are relative to the origin. */
static int64_t coupled(const double *sections, int64_t total, double *state, const int64_t *counts,
                       int64_t filters, const int64_t *axes, const double *centre, int64_t count,
                       const double *origin, const double *path, const double *u, const double *v,
                       int64_t n, double *added)
{
    struct couplings all = {{sections, 0, state}, counts, axes, centre, count};
    (void)total, (void)filters;
    for (int64_t i = 0; i < n; i++, path += 2)
        couple(&all, u[i], v[i], path[X] + origin[X], path[Y] + origin[Y], added + i, added + i,
               NULL, 0);
    return n;
}

/* motion (n, columns): the nozzle under a command (n, 2) from a standstill at origin, and what the
 * first couplings' filters give. The filters: Gxx, Gyy and those of the couplings. */
static int64_t response(const double *sections, int64_t total, double *state, const int64_t *counts,
                        int64_t filters, const int64_t *axes, const double *centre, int64_t count,
                        const double *origin, const double *command, int64_t n, double *motion,
                        int64_t columns)
{
    const struct cascade Gxx = {sections, counts[X], state}, Gyy = after(Gxx, counts[Y]);
    struct couplings all = {Gyy, counts + 2, axes, centre, count};
    (void)total, (void)filters;
    for (int64_t i = 0; i < n; i++, command += 2, motion += columns) {
        double u = command[X] - origin[X], v = command[Y] - origin[Y];
        double x = next(Gxx, u) + origin[X], y = next(Gyy, v) + origin[Y];
        double nozzle_x = x, nozzle_y = y;
        couple(&all, u, v, x, y, &nozzle_x, &nozzle_y, motion + 2, columns - 2);
        motion[X] = nozzle_x, motion[Y] = nozzle_y;
    }
    return n;
}

#define FILTERS                                                                               \
    FLOATS(0, COEFFICIENTS * WHOLE(1)), WHOLE(1), OUT_FLOATS(2, STATES * WHOLE(1)),           \
        INTEGERS(3, WHOLE(4)), WHOLE(4), INTEGERS(5, 3 * WHOLE(7)), FLOATS(6, WHOLE(7)),      \
        WHOLE(7), FLOATS(8, 2)
LOOP(coupled, FILTERS, FLOATS(9, 2 * WHOLE(12)), FLOATS(10, WHOLE(12)), FLOATS(11, WHOLE(12)), WHOLE(12),
     OUT_FLOATS(13, WHOLE(12)))
LOOP(response, FILTERS, FLOATS(9, 2 * WHOLE(10)), WHOLE(10), OUT_FLOATS(11, WHOLE(12) * WHOLE(10)),
     WHOLE(12))
