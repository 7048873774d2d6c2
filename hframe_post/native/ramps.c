#include "kernels.h"

struct limits {
    double velocity, acceleration, z_velocity, z_acceleration, e_velocity, e_acceleration, e_corner,
        deviation;
};
enum { LIMITS = sizeof(struct limits) / sizeof(double) };

/* Segments in a row, with Klipper's ramps. */
struct ramped {
    int64_t k;
    const double *d, *a, *top; /* (k): length, acceleration, greatest speed */
    const double *caps;        /* (k + 1): greatest speeds at their ends */
    double before;             /* cruise speed of the segment before them */
};

/* Find length, acceleration, greatest speed, mm of filament a mm and unit vector (k, and 3 k) of
 * segments between places at (k + 1, 4). */
INSIDE void find_segments(const double *at, int64_t k, const struct limits *limits,
                          double *restrict d, double *restrict a, double *restrict top,
                          double *restrict filament, double *restrict way)
{
    struct limits to = *limits;
    double *restrict way_y = way + k, *restrict way_z = way_y + k;
    for (int64_t i = 0; i < k; i++) {
        const double *from = at + COLUMNS * i;
        double x = from[COLUMNS + X] - from[X], y = from[COLUMNS + Y] - from[Y];
        double z = from[COLUMNS + Z] - from[Z], e = from[COLUMNS + E] - from[E];
        double length = sqrt(x * x + y * y + z * z), inverse = 1.0 / length;
        double per_z = length / fabs(z), back = length / fabs(e), per_e = e < 0.0 ? back : INFINITY;
        d[i] = length;
        a[i] = lesser(lesser(per_z * to.z_acceleration, per_e * to.e_acceleration), to.acceleration);
        top[i] = lesser(lesser(per_z * to.z_velocity, per_e * to.e_velocity), to.velocity);
        filament[i] = e / length;
        way[i] = x * inverse, way_y[i] = y * inverse, way_z[i] = z * inverse;
    }
}

/* Find the greatest speeds between segments, by Klipper's rules for junctions. */
INSIDE void find_corners(const double *d, const double *a, const double *filament, const double *way,
                         int64_t k, const struct limits *limits, double *restrict caps)
{
    const double *way_y = way + k, *way_z = way_y + k;
    double deviation = limits->deviation, e_corner = limits->e_corner;
    for (int64_t i = 1; i < k; i++) {
        double turn = lesser(deviation * a[i - 1], deviation * a[i]);
        double fit = lesser(0.5 * d[i - 1] * a[i - 1], 0.5 * d[i] * a[i]);
        double v2 = klipper_corner(way[i - 1] * way[i], way_y[i - 1] * way_y[i], way_z[i - 1] * way_z[i],
                                   turn, fit);
        caps[i] = lesser_number(sqrt(v2), e_corner / fabs(filament[i] - filament[i - 1]));
    }
}

/* Make segments of places at (k + 1, 4), with rest (k + 1), a speed before and one after. */
INSIDE struct ramped ramped(const double *at, int64_t k, const uint8_t *rest, double before,
                            double after, const struct limits *limits, double *room)
{
    double *d = room, *a = d + k, *top = a + k, *filament = top + k, *way = filament + k;
    double *caps = way + 3 * k;
    find_segments(at, k, limits, d, a, top, filament, way);
    find_corners(d, a, filament, way, k, limits, caps);
    caps[0] = INFINITY, caps[k] = after;
    for (int64_t i = 0; i <= k; i++)
        caps[i] = rest[i] ? 0.0 : caps[i];
    return (struct ramped){k, d, a, top, caps, before};
}

/* joint (k + 1): speeds at the ends of segments that cruise at v (k). */
INSIDE void join(const struct ramped *r, const double *v, double *restrict joint)
{
    const double *caps = r->caps;
    int64_t k = r->k;
    joint[0] = lesser(lesser(r->before, v[0]), caps[0]);
    for (int64_t i = 1; i < k; i++)
        joint[i] = lesser(lesser(v[i - 1], v[i]), caps[i]);
    joint[k] = lesser(v[k - 1], caps[k]);
}

/* v (k): cruise speeds for the times T (k). joint (k + 1), mean (k): room. */
INSIDE void find_speeds(const struct ramped *r, const double *T, int64_t rounds,
                        double *restrict joint, double *restrict mean, double *restrict v)
{
    const double *d = r->d, *a = r->a;
    for (int64_t i = 0; i < r->k; i++)
        v[i] = mean[i] = d[i] / T[i];
    for (int64_t round = 0; round < rounds; round++) {
        join(r, v, joint);
        for (int64_t i = 0; i < r->k; i++) {
            double v_s = joint[i], v_e = joint[i + 1];
            double S = a[i] * T[i] + v_s + v_e;
            double c = 4.0 * ((v_s * v_s + v_e * v_e) / 2.0 + a[i] * d[i]);
            v[i] = greater((S - sqrt(greater(S * S - c, 0.0))) / 2.0, mean[i]);
        }
    }
}

/* Lower the speeds between segments, joint (k + 1), to those that their accelerations reach. */
INSIDE void reach(const struct ramped *r, double *restrict joint)
{
    const double *d = r->d, *a = r->a;
    for (int64_t i = 0; i < r->k; i++) {
        double most = joint[i] * joint[i] + 2.0 * a[i] * d[i];
        if (joint[i + 1] * joint[i + 1] > most)
            joint[i + 1] = sqrt(most);
    }
    for (int64_t i = r->k; i-- > 0;) {
        double most = joint[i + 1] * joint[i + 1] + 2.0 * a[i] * d[i];
        if (joint[i] * joint[i] > most)
            joint[i] = sqrt(most);
    }
}

/* taken (k): the times that segments take at speeds v (k). joint (k + 1), top (k): room. */
INSIDE void find_durations(const struct ramped *r, const double *v, double *restrict joint,
                           double *restrict top, double *restrict taken)
{
    const double *d = r->d, *a = r->a;
    for (int64_t i = 0; i < r->k; i++)
        top[i] = lesser(v[i], r->top[i]);
    join(r, top, joint);
    reach(r, joint);
    for (int64_t i = 0; i < r->k; i++) {
        double v_s = joint[i], v_e = joint[i + 1];
        double most = (v_s * v_s + v_e * v_e) / 2.0 + a[i] * d[i];
        double peak = top[i] * top[i] > most ? sqrt(most) : top[i];
        double up = peak - v_s, down = peak - v_e;
        double ramps = (up * up + down * down) / (2.0 * a[i]);
        taken[i] = (d[i] + ramps) / peak;
    }
}

static const double LATE = 2e-5; /* s; a segment that is later is made up for by those after it */

/* T (k) in place of late (k): shortened after segments that are late, by those in time. */
INSIDE void make_up(int64_t k, const double *T, double *late)
{
    const double MADE_UP = 0.04; /* share of its time that a segment makes up for */
    double total = 0.0, lowest = 0.0, waiting = 0.0;
    for (int64_t i = 0; i < k; i++) {
        double more = late[i] > LATE ? late[i] : 0.0, waited = waiting;
        total += more - (more > 0.0 ? 0.0 : MADE_UP * T[i]);
        lowest = lesser(lowest, total);
        waiting = total - lowest;
        late[i] = T[i] - (waited + more - waiting);
    }
}

/* feeds (k): F to ask for; taken (k): how long segments then take; see Python. room (12 k + 2). */
WIDE static int64_t klipper_feeds(const double *at, int64_t k, const double *T, const uint8_t *rest,
                                  double before, double after, const struct limits *limits,
                                  int64_t rounds, double per_feed, double *room, int64_t *feeds,
                                  double *taken)
{
    struct ramped r = ramped(at, k, rest, before, after, limits, room);
    double *joint = room + 8 * k + 1, *top = joint + k + 1, *late = top + k, *v = late + k;
    double most = 0.0;
    find_speeds(&r, T, rounds, joint, top, v);
    find_durations(&r, v, joint, top, late);
    for (int64_t i = 0; i < k; i++)
        most = greater(most, late[i] -= T[i]);
    if (most > LATE) {
        make_up(k, T, late);
        find_speeds(&r, late, rounds, joint, top, v);
    }
    for (int64_t i = 0; i < k; i++) {
        feeds[i] = (int64_t)greater(rint(v[i] * per_feed), 1.0);
        v[i] = (double)feeds[i] / per_feed;
    }
    find_durations(&r, v, joint, top, taken);
    return k;
}

LOOP(klipper_feeds, FLOATS(0, COLUMNS * (ITEMS(1) + 1)), ITEMS(1), FLOATS(1, 1), BYTES(2, ITEMS(1) + 1),
     REAL(3), REAL(4), (const struct limits *)FLOATS(5, LIMITS), FEW(6), REAL(7), ROOM(0, 12 * ITEMS(1) + 2),
     NEW_INTEGERS(1, ITEMS(1)), NEW_FLOATS(2, ITEMS(1)))

/* taken (k): how long segments take at speeds v (k). room (12 k + 2). */
WIDE static int64_t klipper_durations(const double *at, int64_t k, const double *v, const uint8_t *rest,
                                      double before, double after, const struct limits *limits,
                                      double *room, double *taken)
{
    struct ramped r = ramped(at, k, rest, before, after, limits, room);
    double *joint = room + 8 * k + 1;
    find_durations(&r, v, joint, joint + k + 1, taken);
    return k;
}

LOOP(klipper_durations, FLOATS(0, COLUMNS * (ITEMS(1) + 1)), ITEMS(1), FLOATS(1, 1), BYTES(2, ITEMS(1) + 1),
     REAL(3), REAL(4), (const struct limits *)FLOATS(5, LIMITS), ROOM(0, 12 * ITEMS(1) + 2),
     NEW_FLOATS(1, ITEMS(1)))
