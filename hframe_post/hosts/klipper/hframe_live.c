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
#include <string.h>

#include "itersolve.h"
#include "trapq.h"

#define GRID 0.001         // s
#define RING 4096          // samples; a power of two, larger than the longest window
#define AROUND 3           // samples on either side that the spline and its rounding need
#define MOST_TAPS 1024
#define MOST_COUPLINGS 8
#define AT_REST 500.0      // s within a move that stands still, at which its place is asked for

struct taps {
    int ahead, count;
    double h[MOST_TAPS];   // h[0] belongs to the oldest sample of the path
};

struct coupling {
    int answer, command, along;    // axes; along is negative without a lever arm
    double centre;
    struct taps taps;
};

struct hframe_kernel {
    int couplings;
    int ahead, past, axes_ahead, axes_past;    // reach of c[g] into path and target, ms
    double least[2], most[2];      // travel of x and y, mm
    struct taps axis[2];
    struct coupling coupling[MOST_COUPLINGS];
};

// Samples first <= g < end of some axes, twice, so that any window of them is contiguous.
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
    int64_t clamped;               // control points that travel has limited
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

/****************************************************************
 * Rings
 ****************************************************************/

static inline double
get(const struct ring *r, int axis, int64_t g)
{
    return r->at[axis][g & (RING - 1)];
}

static inline const double *
window(const struct ring *r, int axis, int64_t from)
{
    return &r->at[axis][from & (RING - 1)];
}

static inline void
put(struct ring *r, int axis, int64_t g, double value)
{
    r->at[axis][g & (RING - 1)] = r->at[axis][(g & (RING - 1)) + RING] = value;
}

// Return the first sample to compute so that those from `from` are there, and forget what is in
// the way of it.
static inline int64_t
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
convolved(const struct taps *t, const struct ring *r, int axis, int64_t g)
{
    const double *p = window(r, axis, g + t->ahead + 1 - t->count);
    double sum = 0.0;
    for (int i = 0; i < t->count; i++)
        sum += t->h[i] * p[i];
    return sum;
}

/****************************************************************
 * Path, target, control points
 ****************************************************************/

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
    struct ring *r = &live->path;
    int64_t g = missing(r, from, end);
    if (g >= end)
        return;
    double start = fmax(g * GRID, live->begin);
    while (start < m->print_time && !is_first(m))
        m = list_prev_entry(m, node);
    for (; g < end; g++) {
        double t = fmax(g * GRID, live->begin);
        while (t > m->print_time + m->move_t)
            m = list_next_entry(m, node);
        double s = fmax(t - m->print_time, 0.0);
        double distance = (m->start_v + m->half_accel * s) * s;
        put(r, 0, g, m->start_pos.x + m->axes_r.x * distance);
        put(r, 1, g, m->start_pos.y + m->axes_r.y * distance);
    }
}

static void
fill_target(struct hframe_live *live, int64_t from, int64_t end)
{
    const struct hframe_kernel *k = live->kernel;
    struct ring *r = &live->target;
    for (int64_t g = missing(r, from, end); g < end; g++) {
        double target[2] = { get(&live->path, 0, g), get(&live->path, 1, g) };
        for (int i = 0; i < k->couplings; i++) {
            const struct coupling *c = &k->coupling[i];
            if (!moves(live, c->answer))
                continue;
            double lever = c->along < 0 ? 1.0 : get(&live->path, c->along, g) - c->centre;
            target[c->answer] -= lever * convolved(&c->taps, &live->path, c->command, g);
        }
        put(r, 0, g, target[0]);
        put(r, 1, g, target[1]);
    }
}

// The command may not leave travel, unless the path itself is outside.
static double
within_travel(struct hframe_live *live, int axis, int64_t g, double c)
{
    double p = get(&live->path, axis, g);
    double least = fmin(live->kernel->least[axis], p), most = fmax(live->kernel->most[axis], p);
    if (c >= least && c <= most)
        return c;
    live->clamped++;
    return c < least ? least : most;
}

static void
fill_control(struct hframe_live *live, struct move *m, int64_t from, int64_t end)
{
    const struct hframe_kernel *k = live->kernel;
    int64_t first = missing(&live->control, from, end);
    if (first >= end)
        return;
    fill_path(live, m, first - k->past, end + k->ahead);
    struct ring *source = &live->path;
    if (k->couplings) {
        source = &live->target;
        fill_target(live, first - k->axes_past, end + k->axes_ahead);
    }
    for (int axis = 0; axis < 2; axis++)
        for (int64_t g = first; moves(live, axis) && g < end; g++) {
            double c = convolved(&k->axis[axis], source, axis, g);
            put(&live->control, axis, g, within_travel(live, axis, g, c));
        }
}

// Note the spline's polynomials in the millisecond that begins at g.
static void
set_piece(struct hframe_live *live, struct move *m, int64_t g)
{
    fill_control(live, m, g - 1, g + 3);
    for (int axis = 0; axis < 2; axis++) {
        const double *c = window(&live->control, axis, g - 1);
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

/****************************************************************
 * What the host calls
 ****************************************************************/

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
    double u = ms - g;
    live->still.start_pos.x = evaluated(live->polynomial[0], u);
    live->still.start_pos.y = evaluated(live->polynomial[1], u);
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

static void
hand_over(struct stepper_kinematics *from, struct stepper_kinematics *to)
{
    to->commanded_pos = from->commanded_pos;
    to->last_flush_time = from->last_flush_time;
    to->last_move_time = from->last_move_time;
}

// Go on where orig has got to, at rest.
void
hframe_live_begin(struct stepper_kinematics *sk)
{
    hand_over(live_of(sk)->orig, sk);
    hframe_live_reset(sk);
}

// Let orig go on, at rest.
void
hframe_live_end(struct stepper_kinematics *sk)
{
    hand_over(sk, live_of(sk)->orig);
}

double
hframe_live_window(struct stepper_kinematics *sk)
{
    return fmax(sk->gen_steps_pre_active, sk->gen_steps_post_active);
}

int64_t
hframe_live_clamped(struct stepper_kinematics *sk)
{
    return live_of(sk)->clamped;
}

static int
set_taps(struct taps *t, int ahead, int count, const double *h)
{
    if (count < 1 || count > MOST_TAPS || ahead < 0 || ahead >= count)
        return -1;
    t->ahead = ahead;
    t->count = count;
    for (int i = 0; i < count; i++)    // the file begins with the path furthest ahead
        t->h[i] = h[count - 1 - i];
    return 0;
}

// Set the taps of an axis. Return 0, or -1 if there are too many.
int
hframe_kernel_axis(struct hframe_kernel *k, int axis, double least, double most, int ahead
                   , int count, const double *h)
{
    k->least[axis] = least;
    k->most[axis] = most;
    return set_taps(&k->axis[axis], ahead, count, h);
}

// Add a coupling. Return 0, or -1 if there are too many.
int
hframe_kernel_coupling(struct hframe_kernel *k, int answer, int command, int along, double centre
                       , int ahead, int count, const double *h)
{
    if (k->couplings >= MOST_COUPLINGS)
        return -1;
    struct coupling *c = &k->coupling[k->couplings];
    c->answer = answer;
    c->command = command;
    c->along = along;
    c->centre = centre;
    if (set_taps(&c->taps, ahead, count, h))
        return -1;
    k->couplings++;
    return 0;
}

struct hframe_kernel *
hframe_kernel_alloc(void)
{
    return calloc(1, sizeof(struct hframe_kernel));
}

static void
reach(const struct taps *t, int *ahead, int *past)
{
    if (t->ahead > *ahead)
        *ahead = t->ahead;
    if (t->count - 1 - t->ahead > *past)
        *past = t->count - 1 - t->ahead;
}

// Return the kinematics of a motor behind orig, or NULL if it cannot have one or memory is short.
// The kernel must outlive it; free() both.
struct stepper_kinematics *
hframe_live_alloc(struct stepper_kinematics *orig, struct hframe_kernel *k)
{
    int moved = AF_X | AF_Y;
    k->ahead = k->past = k->axes_ahead = k->axes_past = 0;
    for (int axis = 0; axis < 2; axis++)
        reach(&k->axis[axis], &k->axes_ahead, &k->axes_past);
    for (int i = 0; i < k->couplings; i++)
        reach(&k->coupling[i].taps, &k->ahead, &k->past);
    k->ahead += k->axes_ahead;
    k->past += k->axes_past;
    if (!(orig->active_flags & moved) || orig->post_cb || k->ahead + k->past > RING / 2 - 16)
        return NULL;
    struct hframe_live *live = calloc(1, sizeof(*live));
    if (!live)
        return NULL;
    live->orig = orig;
    live->kernel = k;
    live->still.move_t = 2.0 * AT_REST;
    live->sk.calc_position_cb = calc_position;
    live->sk.active_flags = orig->active_flags | (k->couplings ? moved : 0);
    live->sk.gen_steps_pre_active = (k->ahead + AROUND) * GRID;
    live->sk.gen_steps_post_active = (k->past + AROUND) * GRID;
    hframe_live_begin(&live->sk);
    return &live->sk;
}
