// Compensation inside Klipper's host: the planner's path, convolved with a kernel, makes the steps.
//
// Once a millisecond the path is sampled from the planner's moves, which gives p[g] at g ms.
// Couplings are taken off it, then the plant's inverse is applied:
//
//     target[g] = p[g] - lever(p[g]) * sum_k q[k] p[g - k]
//     c[g]      = sum_k h[k] target[g - k]            k = -ahead ... past
//
// c[g] are the control points of a uniform cubic B-spline, which is what the motors follow.
//
// Everything is a function of time alone: rings only remember what was computed, and each stepper
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
#define RING 4096          // samples; a power of two, larger than the longest window
#define AROUND 3           // samples on either side that the spline and its rounding need
#define SHOWS 0.001        // mm, the least change that counts
#define AT_REST 500.0      // s within a move that stands still, at which its place is asked for

// Samples first <= g < end of both axes, twice, so that any window of them is contiguous.
struct ring {
    int64_t first, end;
    double at[2][2 * RING];
};

struct hframe_live {
    struct stepper_kinematics sk;
    struct stepper_kinematics *orig;
    const struct hframe_kernel *kernel;
    struct move still;             // where the nozzle's command is, for orig
    double begin;                  // s; before, the path is taken to rest
    int64_t faded;                 // control points that the edge of the travel has changed
    int64_t piece;                 // ms at which the polynomials below hold
    double polynomial[2][4];
    struct ring path, target, control;
};

static inline struct hframe_live *
live_of(struct stepper_kinematics *sk)
{
    return (struct hframe_live *)((char *)sk - offsetof(struct hframe_live, sk));
}

// Return whether the motor moves with an axis.
static inline int
moves(const struct hframe_live *live, int axis)
{
    return live->orig->active_flags & (axis ? AF_Y : AF_X);
}

static inline double *
sample(struct ring *r, int axis, int64_t g)
{
    return &r->at[axis][g & (RING - 1)];
}

static inline void
put(struct ring *r, int axis, int64_t g, double value)
{
    double *at = sample(r, axis, g);
    at[0] = at[RING] = value;
}

// Return the first sample to compute so that those from `from` are there, and forget what is in
// the way of it.
static int64_t
missing(struct ring *r, int64_t from, int64_t end)
{
    if (from < r->first || from > r->end || end - r->end > RING / 2)
        r->first = r->end = from;
    int64_t g = r->end;
    if (end > r->end)
        r->end = end;
    if (r->first < r->end - RING)
        r->first = r->end - RING;
    return g;
}

static double
convolved(const double *h, struct ring *r, int axis, int64_t g)
{
    const double *p = sample(r, axis, g - PAST);
    double sum = 0.0;
    for (int i = 0; i < TAPS; i++)
        sum += h[i] * p[i];
    return sum;
}

// Sentinels around the planner's moves last no time or forever; the first never has a place.
static inline int
is_first(struct move *m)
{
    return list_prev_entry(m, node)->move_t <= 0.0;
}

// Fill the path for the samples from <= g < end, where m is any move in the list.
static void
fill_path(struct hframe_live *live, struct move *m, int64_t from, int64_t end)
{
    int64_t g = missing(&live->path, from, end);
    while (fmax(g * GRID, live->begin) < m->print_time && !is_first(m))
        m = list_prev_entry(m, node);
    for (; g < end; g++) {
        double t = fmax(g * GRID, live->begin);
        while (t > m->print_time + m->move_t)
            m = list_next_entry(m, node);
        double s = fmax(t - m->print_time, 0.0);
        double distance = (m->start_v + m->half_accel * s) * s;
        put(&live->path, 0, g, m->start_pos.x + m->axes_r.x * distance);
        put(&live->path, 1, g, m->start_pos.y + m->axes_r.y * distance);
    }
}

static void
fill_target(struct hframe_live *live, struct move *m, int64_t from, int64_t end)
{
    const struct hframe_kernel *k = live->kernel;
    int64_t g = missing(&live->target, from, end), reach = k->couplings > 0;
    fill_path(live, m, g - reach * PAST, end + reach * AHEAD);
    for (; g < end; g++) {
        double target[2] = { *sample(&live->path, 0, g), *sample(&live->path, 1, g) };
        for (int i = 0; i < k->couplings; i++) {
            const struct hframe_coupling *c = &k->coupling[i];
            if (!moves(live, c->answer))
                continue;
            double lever = c->along < 0 ? 1.0 : *sample(&live->path, c->along, g) - c->centre;
            target[c->answer] -= lever * convolved(c->h, &live->path, c->command, g);
        }
        put(&live->target, 0, g, target[0]);
        put(&live->target, 1, g, target[1]);
    }
}

// Return a control point that stays in the travel: towards its edge, the command fades into the
// path. A cut would ask far more of the motors than the kernel does.
static double
within_travel(struct hframe_live *live, int axis, double p, double c)
{
    const struct hframe_kernel *k = live->kernel;
    double u = fmin(p - k->least[axis], k->most[axis] - p) / k->edge;
    if (u >= 1.0)
        return c;
    live->faded += fabs(c - p) > SHOWS;
    u = fmax(u, 0.0);
    c = p + u * u * (3.0 - 2.0 * u) * (c - p);
    return fmin(fmax(c, fmin(k->least[axis], p)), fmax(k->most[axis], p));
}

static void
fill_control(struct hframe_live *live, struct move *m, int64_t from, int64_t end)
{
    int64_t g = missing(&live->control, from, end);
    if (g < end)
        fill_target(live, m, g - PAST, end + AHEAD);
    for (; g < end; g++)
        for (int axis = 0; axis < 2; axis++) {
            if (!moves(live, axis))
                continue;
            double c = convolved(live->kernel->axis[axis], &live->target, axis, g);
            double p = *sample(&live->path, axis, g);
            put(&live->control, axis, g, within_travel(live, axis, p, c));
        }
}

// Note the spline's polynomials in the millisecond that begins at g.
static void
set_piece(struct hframe_live *live, struct move *m, int64_t g)
{
    fill_control(live, m, g - 1, g + 3);
    for (int axis = 0; axis < 2; axis++) {
        const double *c = sample(&live->control, axis, g - 1);
        double *p = live->polynomial[axis];
        p[0] = (c[0] + 4.0 * c[1] + c[2]) / 6.0;
        p[1] = (c[2] - c[0]) / 2.0;
        p[2] = (c[0] - 2.0 * c[1] + c[2]) / 2.0;
        p[3] = (c[3] - c[0] + 3.0 * (c[1] - c[2])) / 6.0;
    }
    live->piece = g;
}

static inline double
evaluated(const double *p, double u)
{
    return ((p[3] * u + p[2]) * u + p[1]) * u + p[0];
}

static double
calc_position(struct stepper_kinematics *sk, struct move *m, double move_time)
{
    struct hframe_live *live = live_of(sk);
    if (!m->node.next)     // in no list: the host asks for the motor's place at a coordinate
        return live->orig->calc_position_cb(live->orig, m, move_time);
    double ms = (m->print_time + move_time) / GRID;
    int64_t g = (int64_t)floor(ms);
    if (g != live->piece)
        set_piece(live, m, g);
    live->still.start_pos.x = evaluated(live->polynomial[0], ms - g);
    live->still.start_pos.y = evaluated(live->polynomial[1], ms - g);
    live->still.start_pos.z = m->start_pos.z
        + m->axes_r.z * (m->start_v + m->half_accel * move_time) * move_time;
    return live->orig->calc_position_cb(live->orig, &live->still, AT_REST);
}

// Forget the path: before the time to which steps have been made, it rests.
void
hframe_live_reset(struct stepper_kinematics *sk)
{
    struct hframe_live *live = live_of(sk);
    live->begin = sk->last_flush_time;
    live->piece = INT64_MIN;
    struct ring *rings[] = { &live->path, &live->target, &live->control };
    for (int i = 0; i < 3; i++)
        rings[i]->first = rings[i]->end = INT64_MIN / 2;
}

// Let one go on, at rest, where the other has got to.
void
hframe_live_hand_over(struct stepper_kinematics *from, struct stepper_kinematics *to)
{
    to->commanded_pos = from->commanded_pos;
    to->last_flush_time = from->last_flush_time;
    to->last_move_time = from->last_move_time;
}

// Return the farther of the times before and after a step on which it depends, s.
double
hframe_live_window(struct stepper_kinematics *sk)
{
    return fmax(sk->gen_steps_pre_active, sk->gen_steps_post_active);
}

int64_t
hframe_live_faded(struct stepper_kinematics *sk)
{
    return live_of(sk)->faded;
}

// Return the kinematics of a motor behind orig, or NULL if it cannot have one or memory is short.
// Both arguments must outlive it; free() it.
struct stepper_kinematics *
hframe_live_alloc(struct stepper_kinematics *orig, const struct hframe_kernel *kernel)
{
    int moved = AF_X | AF_Y, reach = kernel->couplings ? 2 : 1;
    struct hframe_live *live = calloc(1, sizeof(*live));
    if (!live || !(orig->active_flags & moved) || orig->post_cb) {
        free(live);
        return NULL;
    }
    live->orig = orig;
    live->kernel = kernel;
    live->still.move_t = 2.0 * AT_REST;
    live->sk.calc_position_cb = calc_position;
    live->sk.active_flags = orig->active_flags | (kernel->couplings ? moved : 0);
    live->sk.gen_steps_pre_active = (reach * AHEAD + AROUND) * GRID;
    live->sk.gen_steps_post_active = (reach * PAST + AROUND) * GRID;
    return &live->sk;
}
