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

LOOP(filtered, FLOATS(0, COEFFICIENTS * COUNT(1)), COUNT(1), OUT_FLOATS(2, STATES * COUNT(1)),
     FLOATS(3, COUNT(4)), COUNT(4), OUT_FLOATS(5, COUNT(4)))

struct couplings { /* in memory one after the other; axes (count, 3): of the response, of the command,
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

/* Add to added (n) what the couplings make of commands u, v (n), which all respond in one axis. path
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

/* motion (n, columns): the nozzle under a command (n, 2) from rest at origin, and what the
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

#define FILTERS(others) /* than those of the couplings */                                     \
    FLOATS(0, COEFFICIENTS * COUNT(1)), COUNT(1), OUT_FLOATS(2, STATES * COUNT(1)),           \
        PARTS(3, COUNT(4), COUNT(1)), WITHIN(4, (others) + FEW(7), MOST_FEW),             \
        INTEGERS(5, 3 * FEW(7)), FLOATS(6, FEW(7)), FEW(7), FLOATS(8, 2)
LOOP(coupled, FILTERS(0), FLOATS(9, 2 * COUNT(12)), FLOATS(10, COUNT(12)), FLOATS(11, COUNT(12)), COUNT(12),
     OUT_FLOATS(13, COUNT(12)))
LOOP(response, FILTERS(2), FLOATS(9, 2 * COUNT(10)), COUNT(10), OUT_FLOATS(11, COUNT(12) * COUNT(10)),
     WITHIN(12, 2, MOST_FEW))

enum { LANES = 4 }; /* that are computed together */

/* Four numbers in a register, or in two of them. */
#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wpsabi" /* nothing outside this file passes them */
typedef double four __attribute__((vector_size(32), aligned(8), may_alias));
INSIDE four plus(four a, four b) { return a + b; }
INSIDE four minus(four a, four b) { return a - b; }
INSIDE four times(four a, four b) { return a * b; }
INSIDE double lane(four a, int j) { return a[j]; }
INSIDE four four_of(double a, double b, double c, double d) { return (four){a, b, c, d}; }
#else
typedef struct { double of[4]; } four;
#define EACH_OF(a) four_of(a(0), a(1), a(2), a(3))
#define SUM(j) (a.of[j] + b.of[j])
#define DIFFERENCE(j) (a.of[j] - b.of[j])
#define PRODUCT(j) (a.of[j] * b.of[j])
INSIDE double lane(four a, int j) { return a.of[j]; }
INSIDE four four_of(double a, double b, double c, double d) { four all = {{a, b, c, d}}; return all; }
INSIDE four plus(four a, four b) { return EACH_OF(SUM); }
INSIDE four minus(four a, four b) { return EACH_OF(DIFFERENCE); }
INSIDE four times(four a, four b) { return EACH_OF(PRODUCT); }
#endif

enum { ABREAST = 8, BLOCK = LANES * ABREAST }; /* groups of four sums that are computed together */

/* BLOCK sums of the m factors in turn, each times a number of u. */
INSIDE void sum_block(const double *factors, int64_t m, const double *u, double *sums)
{
    four sum[ABREAST];
    for (int k = 0; k < ABREAST; k++)
        sum[k] = four_of(0.0, 0.0, 0.0, 0.0);
    for (int64_t i = 0; i < m; i++) {
        four factor = four_of(factors[i], factors[i], factors[i], factors[i]);
        for (int k = 0; k < ABREAST; k++)
            sum[k] = plus(sum[k], times(factor, *(const four *)(u + i + LANES * k)));
    }
    for (int k = 0; k < ABREAST; k++)
        *(four *)(sums + LANES * k) = sum[k];
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

LOOP(sliding_sums, FLOATS(0, COUNT(1)), COUNT(1), FLOATS(2, COUNT(1) - 1 + COUNT(3)), COUNT(3),
     OUT_FLOATS(4, COUNT(3)))

/* As ``next``, for a cascade in each lane: sections (count, 6) and their state (count, 2). */
INSIDE four next_of_four(const four *c, int64_t count, four *s, four value)
{
    for (; count > 0; count--, c += COEFFICIENTS, s += STATES) {
        four input = value;
        value = plus(times(c[0], input), s[0]);
        s[0] = plus(minus(times(c[1], input), times(c[4], value)), s[1]);
        s[1] = minus(times(c[2], input), times(c[5], value));
    }
    return value;
}

/* The loop of ``responses`` for one group of lanes. */
INSIDE void respond(const four *sections, four *state, const int64_t *counts, const int64_t *axes,
                    const four *centre, int64_t count, const double *origin,
                    const double *const *command, int64_t n, double *motion, int64_t lanes)
{
    for (int64_t i = 0; i < 2 * n; i += 2) {
        four u[2], at[2], nozzle[2];
        const four *G = sections;
        four *s = state;
        for (int axis = X; axis <= Y; axis++) {
            double o = origin[axis];
            four start = four_of(o, o, o, o);
            const double *const *c = command;
            u[axis] = four_of(c[0][i + axis], c[1][i + axis], c[2][i + axis], c[3][i + axis]);
            u[axis] = minus(u[axis], start);
            nozzle[axis] = at[axis] = plus(next_of_four(G, counts[axis], s, u[axis]), start);
            G += COEFFICIENTS * counts[axis], s += STATES * counts[axis];
        }
        for (int64_t k = 0; k < count; k++) {
            const int64_t *axis = axes + 3 * k;
            four output = next_of_four(G, counts[2 + k], s, axis[1] == X ? u[X] : u[Y]);
            if (axis[2] >= 0)
                output = times(minus(axis[2] == X ? at[X] : at[Y], centre[k]), output);
            if (axis[0] == X)
                nozzle[X] = plus(nozzle[X], output);
            else
                nozzle[Y] = plus(nozzle[Y], output);
            G += COEFFICIENTS * counts[2 + k], s += STATES * counts[2 + k];
        }
        for (int j = 0; j < lanes; j++) {
            motion[2 * n * j + i + X] = lane(nozzle[X], j);
            motion[2 * n * j + i + Y] = lane(nozzle[Y], j);
        }
    }
}

/* motion (lanes, n, 2): what ``response`` gives for each lane; of (lanes): which of the given
 * commands (given, n, 2) it has. Groups of LANES are computed together, the last one with repetitions:
 * sections (groups, total, 6, LANES), state likewise, centre (groups, count, LANES). */
WIDE static int64_t responses(const four *sections, int64_t total, four *state,
                              const int64_t *counts, int64_t filters, const int64_t *axes,
                              const four *centre, int64_t count, const double *origin,
                              const double *commands, int64_t given, const int64_t *of, int64_t n,
                              int64_t lanes, int64_t together, double *motion)
{
    (void)filters, (void)given, (void)together;
    for (; lanes > 0; lanes -= LANES, of += LANES, motion += 2 * n * LANES) {
        const double *command[LANES];
        for (int j = 0; j < LANES; j++)
            command[j] = commands + 2 * n * of[j < lanes ? j : 0];
        respond(sections, state, counts, axes, centre, count, origin, command, n, motion,
                lanes < LANES ? lanes : LANES);
        sections += COEFFICIENTS * total, state += STATES * total, centre += count;
    }
    return n;
}

#define FOURS(count) (LANES * (count) * ((FEW(13) + LANES - 1) / LANES))
LOOP(responses, (const four *)FLOATS(0, COEFFICIENTS * FOURS(FEW(1))), FEW(1),
     (four *)OUT_FLOATS(2, STATES * FOURS(FEW(1))), PARTS(3, COUNT(4), FEW(1)),
     WITHIN(4, 2 + FEW(7), MOST_FEW), INTEGERS(5, 3 * FEW(7)), (const four *)FLOATS(6, FOURS(FEW(7))),
     FEW(7), FLOATS(8, 2), FLOATS(9, 2 * FEW(10) * COUNT(12)), FEW(10), INDICES(11, FEW(13), 0, FEW(10)),
     COUNT(12), FEW(13), WITHIN(14, LANES, LANES), OUT_FLOATS(15, 2 * FEW(13) * COUNT(12)))
