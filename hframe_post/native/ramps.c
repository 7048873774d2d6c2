/* The loops of firmware/klipper/ramps.py. */

#include "kernels.h"

struct limits { /* as StreamLimits, then the junction deviation */
    double velocity, acceleration, z_velocity, z_acceleration, e_velocity, e_acceleration, e_corner,
        deviation;
};
enum { LIMITS = sizeof(struct limits) / sizeof(double), ROUNDS = 3 }; /* as in firmware/ramps.py */

struct segment {
    double d, a, top;        /* length, acceleration, greatest speed */
    double way[3], filament; /* unit vector, mm of filament a mm */
};

/* Segments in a row, with Klipper's ramps. */
struct ramped {
    int64_t k;
    const struct segment *segments; /* (k) */
    const double *caps;             /* (k + 1): greatest speeds at their ends */
    double before;                  /* cruise speed of the segment before them */
};

static struct segment segment(const double *from, const double *to, const struct limits *limits)
{
    double x = to[X] - from[X], y = to[Y] - from[Y], z = to[Z] - from[Z], e = to[E] - from[E];
    double d = sqrt(x * x + y * y + z * z), inverse = 1.0 / d;
    double per_z = d / fabs(z), per_e = e < 0.0 ? d / fabs(e) : INFINITY;
    double a = lesser(per_z * limits->z_acceleration, per_e * limits->e_acceleration);
    double top = lesser(per_z * limits->z_velocity, per_e * limits->e_velocity);
    return (struct segment){
        d, lesser(a, limits->acceleration), lesser(top, limits->velocity),
        {x * inverse, y * inverse, z * inverse}, e / d,
    };
}

/* Return the greatest speed between two segments: junction_speeds of model/constant_acceleration.py */
static double corner(const struct segment *s, const struct segment *t, const struct limits *limits)
{
    double cosine = -(s->way[X] * t->way[X] + s->way[Y] * t->way[Y] + s->way[Z] * t->way[Z]);
    cosine = lesser(greater(cosine, -1.0), 1.0);
    double sin_half = sqrt(0.5 * (1.0 - cosine)), cos_half = sqrt(0.5 * (1.0 + cosine));
    double turn = lesser(limits->deviation * s->a, limits->deviation * t->a);
    double fit = lesser(0.5 * s->d * s->a, 0.5 * t->d * t->a);
    double v2 = fmin(turn * sin_half / (1.0 - sin_half), fit * sin_half / cos_half);
    return fmin(sqrt(v2), limits->e_corner / fabs(t->filament - s->filament));
}

/* Make segments of places at (k + 1, 4), with rest (k + 1), a speed before and one after. */
static struct ramped ramped(const double *at, int64_t k, const uint8_t *rest, double before,
                            double after, const struct limits *limits, double *room)
{
    struct segment *segments = (struct segment *)room; /* takes seven of a segment's twelve */
    double *caps = room + 7 * k;
    for (int64_t i = 0; i < k; i++) {
        segments[i] = segment(at + COLUMNS * i, at + COLUMNS * (i + 1), limits);
        caps[i] = rest[i] ? 0.0 : i ? corner(segments + i - 1, segments + i, limits) : INFINITY;
    }
    caps[k] = rest[k] ? 0.0 : after;
    return (struct ramped){k, segments, caps, before};
}

/* joint (k + 1): speeds at the ends of segments that cruise at v (k). */
static void join(const struct ramped *r, const double *v, double *joint)
{
    double left = r->before;
    for (int64_t i = 0; i < r->k; left = v[i++])
        joint[i] = lesser(lesser(left, v[i]), r->caps[i]);
    joint[r->k] = lesser(left, r->caps[r->k]);
}

/* v (k): cruise speeds for the times T (k). joint (k + 1): room. */
static void find_speeds(const struct ramped *r, const double *T, double *joint, double *v)
{
    for (int64_t i = 0; i < r->k; i++)
        v[i] = r->segments[i].d / T[i];
    for (int round = 0; round < ROUNDS; round++) {
        join(r, v, joint);
        for (int64_t i = 0; i < r->k; i++) {
            double d = r->segments[i].d, a = r->segments[i].a, v_s = joint[i], v_e = joint[i + 1];
            double S = a * T[i] + v_s + v_e, c = 4.0 * ((v_s * v_s + v_e * v_e) / 2.0 + a * d);
            v[i] = greater((S - sqrt(greater(S * S - c, 0.0))) / 2.0, d / T[i]);
        }
    }
}

/* taken (k): the times that segments take at speeds v (k). joint (k + 1), top (k): room. */
static void find_durations(const struct ramped *r, const double *v, double *joint, double *top,
                           double *taken)
{
    for (int64_t i = 0; i < r->k; i++)
        top[i] = lesser(v[i], r->segments[i].top);
    join(r, top, joint);
    for (int64_t i = 0; i < r->k; i++) {
        double up = top[i] - joint[i], down = top[i] - joint[i + 1];
        double ramps = (up * up + down * down) / (2.0 * r->segments[i].a);
        taken[i] = (r->segments[i].d + ramps) / top[i];
    }
}

/* T (k) in place of late (k): shortened after segments that are late by more than ``least``. */
static void make_up(int64_t k, const double *T, double least, double *late)
{
    double total = 0.0, lowest = 0.0, waiting = 0.0;
    for (int64_t i = 0; i < k; i++) {
        double more = late[i] > least ? late[i] : 0.0, waited = waiting;
        total += more - (more > 0.0 ? 0.0 : 0.04 * T[i]);
        lowest = lesser(lowest, total);
        waiting = total - lowest;
        late[i] = T[i] - (waited + more - waiting);
    }
}

/* feeds (k): F to ask for; taken (k): how long segments then take; see feeds. room (12 k + 2). */
static int64_t klipper_feeds(const double *at, int64_t k, const double *T, const uint8_t *rest,
                             double before, double after, const struct limits *limits,
                             double least, double per_feed, double *room, int64_t *feeds,
                             double *taken)
{
    struct ramped r = ramped(at, k, rest, before, after, limits, room);
    double *joint = room + 8 * k + 1, *top = joint + k + 1, *late = top + k, *v = late + k;
    double most = 0.0;
    find_speeds(&r, T, joint, v);
    find_durations(&r, v, joint, top, late);
    for (int64_t i = 0; i < k; i++)
        most = greater(most, late[i] -= T[i]);
    if (most > least) {
        make_up(k, T, least, late);
        find_speeds(&r, late, joint, v);
    }
    for (int64_t i = 0; i < k; i++) {
        feeds[i] = (int64_t)greater(rint(v[i] * per_feed), 1.0);
        v[i] = (double)feeds[i] / per_feed;
    }
    find_durations(&r, v, joint, top, taken);
    return k;
}

LOOP(klipper_feeds, FLOATS(0, COLUMNS * (WHOLE(1) + 1)), WHOLE(1), FLOATS(2, WHOLE(1)),
     BYTES(3, WHOLE(1) + 1), REAL(4), REAL(5), (const struct limits *)FLOATS(6, LIMITS), REAL(7),
     REAL(8), OUT_FLOATS(9, 12 * WHOLE(1) + 2), OUT_INTEGERS(10, WHOLE(1)),
     OUT_FLOATS(11, WHOLE(1)))

/* taken (k): how long segments take at speeds v (k). room (12 k + 2). */
static int64_t klipper_durations(const double *at, int64_t k, const double *v, const uint8_t *rest,
                                 double before, double after, const struct limits *limits,
                                 double *room, double *taken)
{
    struct ramped r = ramped(at, k, rest, before, after, limits, room);
    double *joint = room + 8 * k + 1;
    find_durations(&r, v, joint, joint + k + 1, taken);
    return k;
}

LOOP(klipper_durations, FLOATS(0, COLUMNS * (WHOLE(1) + 1)), WHOLE(1), FLOATS(2, WHOLE(1)),
     BYTES(3, WHOLE(1) + 1), REAL(4), REAL(5), (const struct limits *)FLOATS(6, LIMITS),
     OUT_FLOATS(7, 12 * WHOLE(1) + 2), OUT_FLOATS(8, WHOLE(1)))
