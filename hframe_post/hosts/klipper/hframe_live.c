// Compensation inside Klipper's host: the planner's path, convolved with a kernel, makes the steps.
//
// The path is sampled from the planner's moves, p[g] at g ms. Racking is taken off y, then the
// plant's inverse is applied:
//
//     target[g] = p[g] - lever(p[g]) * sum_k q[k] p[g - k]
//     c[g]      = sum_k h[k] target[g - k]            k = -ahead ... past
//
// c[g] are the control points of a uniform cubic B-spline, which is what the motors follow.
//
// Everything is a function of time alone: buffers only remember what was computed, and each stepper
// has its own, since a host may make the steps of each in a thread. Nothing is allocated, locked,
// read or written after hframe_live_alloc.

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include "itersolve.h"
#include "trapq.h"
#include "hframe_live.h"

#define GRID 0.001         // s
#define PAST (TAPS - 1 - AHEAD)
#define BLOCK 20           // samples computed at once; a divisor of AHEAD and PAST
#define SPAN 4000          // control points in memory; a multiple of BLOCK
#define SPLINE 3           // control points around a millisecond, and its rounding

struct hframe_live {
    struct stepper_kinematics sk;
    struct stepper_kinematics *orig;
    const struct hframe_kernel *kernel;
    double way[3];                 // of the motor for 1 mm of each axis
    double begin;                  // s; before, the path is taken to rest
    int64_t piece;                 // ms at which the polynomial of the motor below holds
    double polynomial[4];
    // control[k] is c[first + k], target[k] is PAST samples earlier, path[k] 2 * PAST
    int64_t first;
    int paths, targets, controls;  // samples that are there
    double path[2][2 * (TAPS - 1) + SPAN];
    double target[2][TAPS - 1 + SPAN];
    double control[2][SPAN];
};

static inline struct hframe_live *
live_of(struct stepper_kinematics *sk)
{
    return (struct hframe_live *)((char *)sk - offsetof(struct hframe_live, sk));
}

// Note BLOCK samples of h convolved with p; h[0] belongs to p[0] in the first of them. Apart from
// its callers, gcc keeps all sums in registers.
static __attribute__((noinline)) void
convolve(double *result, const double *h, const double *p)
{
    double sum[BLOCK] = { 0.0 };
    for (int i = 0; i < TAPS; i++)
        for (int j = 0; j < BLOCK; j++)
            sum[j] += h[i] * p[i + j];
    for (int j = 0; j < BLOCK; j++)
        result[j] = sum[j];
}

// Before the planner's first move comes a sentinel at time 0 that lasts no time and has no place.
// Its duration alone does not tell: rounding makes some moves cruise for -1e-18 s.
static inline int
is_first(struct move *m)
{
    struct move *prev = list_prev_entry(m, node);
    return prev->print_time <= 0.0 && prev->move_t <= 0.0;
}

// Fill the path up to end, where m is any move in the list.
static void
fill_path(struct hframe_live *live, struct move *m, int end)
{
    int64_t origin = live->first - 2 * PAST;
    double from = fmax((origin + live->paths) * GRID, live->begin);
    while (from < m->print_time && !is_first(m))
        m = list_prev_entry(m, node);
    for (; live->paths < end; live->paths++) {
        double t = fmax((origin + live->paths) * GRID, live->begin);
        while (t > m->print_time + m->move_t)
            m = list_next_entry(m, node);
        double s = fmax(t - m->print_time, 0.0);
        double distance = (m->start_v + m->half_accel * s) * s;
        live->path[0][live->paths] = m->start_pos.x + m->axes_r.x * distance;
        live->path[1][live->paths] = m->start_pos.y + m->axes_r.y * distance;
    }
}

static void
fill_target(struct hframe_live *live, struct move *m, int end)
{
    const struct hframe_kernel *k = live->kernel;
    for (; live->targets < end; live->targets += BLOCK) {
        int at = live->targets, now = at + PAST;
        fill_path(live, m, now + BLOCK + (k->racks ? AHEAD : 0));
        for (int axis = 0; axis < 2; axis++)
            for (int j = 0; j < BLOCK; j++)
                live->target[axis][at + j] = live->path[axis][now + j];
        if (!k->racks || live->way[1] == 0.0)
            continue;
        double angle[BLOCK];
        convolve(angle, k->racking, &live->path[0][at]);
        for (int j = 0; j < BLOCK; j++)
            live->target[1][at + j] -= (live->path[0][now + j] - k->x_c) * angle[j];
    }
}

// Return a control point that stays in the travel: towards its edge, the command fades into the
// path. A cut would ask far more of the motors than the kernel does.
static double
within_travel(const struct hframe_kernel *k, int axis, double p, double c)
{
    double u = fmin(p - k->least[axis], k->most[axis] - p) / k->edge;
    if (u >= 1.0)
        return c;
    u = fmax(u, 0.0);
    c = p + u * u * (3.0 - 2.0 * u) * (c - p);
    return fmin(fmax(c, fmin(k->least[axis], p)), fmax(k->most[axis], p));
}

static void
fill_control(struct hframe_live *live, struct move *m, int end)
{
    for (; live->controls < end; live->controls += BLOCK) {
        int at = live->controls;
        fill_target(live, m, at + TAPS - 1 + BLOCK);
        for (int axis = 0; axis < 2; axis++) {
            double *c = &live->control[axis][at], *p = &live->path[axis][at + 2 * PAST];
            if (live->way[axis] == 0.0)
                continue;
            convolve(c, live->kernel->axis[axis], &live->target[axis][at]);
            for (int j = 0; j < BLOCK; j++)
                c[j] = within_travel(live->kernel, axis, p[j], c[j]);
        }
    }
}

// Note the polynomial of the motor in the millisecond that begins at g: that of the spline of
// g - 1 ... g + 2.
static void
set_piece(struct hframe_live *live, struct move *m, int64_t g)
{
    if (g - 1 < live->first || g + 3 > live->first + SPAN) {
        live->first = g - 1;
        live->paths = live->targets = live->controls = 0;
    }
    int at = g - 1 - live->first;
    fill_control(live, m, at + 4);
    double c[4], *p = live->polynomial;
    for (int j = 0; j < 4; j++)
        c[j] = live->way[0] * live->control[0][at + j] + live->way[1] * live->control[1][at + j];
    p[0] = (c[0] + 4.0 * c[1] + c[2]) / 6.0;
    p[1] = (c[2] - c[0]) / 2.0;
    p[2] = (c[0] - 2.0 * c[1] + c[2]) / 2.0;
    p[3] = (c[3] - c[0] + 3.0 * (c[1] - c[2])) / 6.0;
    live->piece = g;
}

static double
calc_position(struct stepper_kinematics *sk, struct move *m, double move_time)
{
    struct hframe_live *live = live_of(sk);
    if (!m->node.next)     // in no list: the host asks for the motor's place at a coordinate
        return live->orig->calc_position_cb(live->orig, m, move_time);
    double ms = (m->print_time + move_time) / GRID;
    int64_t g = (int64_t)ms;
    if (g != live->piece)
        set_piece(live, m, g);
    const double u = ms - g, *p = live->polynomial;
    double distance = (m->start_v + m->half_accel * move_time) * move_time;
    return ((p[3] * u + p[2]) * u + p[1]) * u + p[0]
        + live->way[2] * (m->start_pos.z + m->axes_r.z * distance);
}

// Forget the path: before the time to which steps have been made, it rests.
void
hframe_live_reset(struct stepper_kinematics *sk)
{
    struct hframe_live *live = live_of(sk);
    live->begin = sk->last_flush_time;
    live->piece = -1;
    live->first = INT64_MAX;
}

// Let one go on, at rest, where the other has got to.
void
hframe_live_hand_over(struct stepper_kinematics *from, struct stepper_kinematics *to)
{
    to->commanded_pos = from->commanded_pos;
    to->last_flush_time = from->last_flush_time;
    to->last_move_time = from->last_move_time;
}

// Return how long steps depend on the path, s.
double
hframe_live_window(struct stepper_kinematics *sk)
{
    return sk->gen_steps_post_active;
}

// Return the kinematics of a motor behind orig, or NULL if it cannot have one or memory is short.
// orig must be linear. Both arguments must outlive it; free() it.
struct stepper_kinematics *
hframe_live_alloc(struct stepper_kinematics *orig, const struct hframe_kernel *kernel)
{
    int moved = AF_X | AF_Y, reach = kernel->racks ? 2 : 1;
    struct hframe_live *live = calloc(1, sizeof(*live));
    if (!live || !(orig->active_flags & moved) || orig->post_cb) {
        free(live);
        return NULL;
    }
    live->orig = orig;
    live->kernel = kernel;
    for (int axis = 0; axis < 3; axis++) {
        struct move unit = { .start_pos.axis = { 0.0 } };
        unit.start_pos.axis[axis] = 1.0;
        live->way[axis] = orig->calc_position_cb(orig, &unit, 0.0);
    }
    live->sk.calc_position_cb = calc_position;
    live->sk.active_flags = orig->active_flags | (kernel->racks ? moved : 0);
    live->sk.gen_steps_pre_active = (reach * AHEAD + BLOCK + SPLINE) * GRID;
    live->sk.gen_steps_post_active = (reach * PAST + SPLINE) * GRID;
    return &live->sk;
}
