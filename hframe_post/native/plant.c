/* The loops of model/plant.py. */

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

/* The cascade of so many sections that follows another in memory. */
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

/* The nozzle (n, 2) under a command (n, 2) from a standstill at origin. The filters, each of so many
 * of the sections: Gxx, Gyy, and one for each coupling. axes (couplings, 3): where it answers, the
 * command, and along which axis its lever arm is, or -1. Further columns of motion are what the
 * first couplings' filters give. */
static int64_t response(const double *sections, int64_t total, double *state, const int64_t *counts,
                        int64_t filters, const int64_t *axes, const double *centre,
                        const double *origin, const double *command, int64_t n, double *motion,
                        int64_t columns)
{
    const struct cascade Gxx = {sections, counts[X], state}, Gyy = after(Gxx, counts[Y]);
    (void)total;
    for (int64_t i = 0; i < n; i++, command += 2, motion += columns) {
        double u = command[X] - origin[X], v = command[Y] - origin[Y];
        double x = next(Gxx, u) + origin[X], y = next(Gyy, v) + origin[Y];
        double nozzle_x = x, nozzle_y = y;
        struct cascade G = Gyy;
        for (int64_t k = 2; k < filters; k++) {
            const int64_t *axis = axes + 3 * (k - 2);
            G = after(G, counts[k]);
            double output = next(G, axis[1] == X ? u : v);
            double lever = axis[2] < 0 ? 1.0 : (axis[2] == X ? x : y) - centre[k - 2];
            if (axis[0] == X)
                nozzle_x += lever * output;
            else
                nozzle_y += lever * output;
            if (k < columns)
                motion[k] = output;
        }
        motion[X] = nozzle_x, motion[Y] = nozzle_y;
    }
    return n;
}

LOOP(response, FLOATS(0, COEFFICIENTS * WHOLE(1)), WHOLE(1), OUT_FLOATS(2, STATES * WHOLE(1)),
     INTEGERS(3, WHOLE(4)), WHOLE(4), INTEGERS(5, 3 * (WHOLE(4) - 2)), FLOATS(6, WHOLE(4) - 2),
     FLOATS(7, 2), FLOATS(8, 2 * WHOLE(9)), WHOLE(9), OUT_FLOATS(10, WHOLE(11) * WHOLE(9)), WHOLE(11))
