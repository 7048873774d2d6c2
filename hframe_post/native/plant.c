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

/* command (n, 2) from a standstill at ox, oy; motion (n, columns): x, y and, in a third, theta. */
static int64_t response(const double *x_sections, int64_t x_count, double *x_state,
                        const double *y_sections, int64_t y_count, double *y_state,
                        const double *t_sections, int64_t t_count, double *t_state, double ox,
                        double oy, double x_c, const double *command, int64_t n, double *motion,
                        int64_t columns)
{
    struct cascade Gxx = {x_sections, x_count, x_state}, Gyy = {y_sections, y_count, y_state},
                   Gxtheta = {t_sections, t_count, t_state};
    for (int64_t i = 0; i < n; i++) {
        double u = command[2 * i] - ox, v = command[2 * i + 1] - oy;
        double x = next(Gxx, u) + ox, theta = next(Gxtheta, u);
        double *row = motion + columns * i;
        row[0] = x, row[1] = next(Gyy, v) + oy + (x - x_c) * theta;
        if (columns > 2)
            row[2] = theta;
    }
    return n;
}

#define CASCADE(k)                                                                            \
    FLOATS(k, COEFFICIENTS * WHOLE(k + 1)), WHOLE(k + 1), OUT_FLOATS(k + 2, STATES * WHOLE(k + 1))
LOOP(response, CASCADE(0), CASCADE(3), CASCADE(6), REAL(9), REAL(10), REAL(11),
     FLOATS(12, 2 * WHOLE(13)), WHOLE(13), OUT_FLOATS(14, WHOLE(15) * WHOLE(13)), WHOLE(15))
