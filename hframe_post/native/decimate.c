/* The loops of firmware/klipper/segments.py. */

#include "kernels.h"

/* A sample that is still a vertex, in a list by time. */
struct vertex {
    double off;   /* bound on the distance of samples from the chord that begins here */
    double joint; /* the same for the chord that would replace both at this vertex */
    int64_t key;  /* what that costs, then the place among equals; the least goes first */
    int32_t before, after;
};

struct decimation {
    const double *points;
    const uint8_t *forced;
    double tolerance, shorts, e_weight2, alike;
    struct vertex *vertices;
};

#define BARRED ((int64_t)1 << 62) /* the key of a vertex that stays */
#define PLACES 24                 /* bits for the place among equals */

/* Compute what the chord costs that replaces both at a vertex. */
static void judge(const struct decimation *d, int32_t at)
{
    struct vertex *v = d->vertices + at;
    const double *a = d->points + COLUMNS * v->before, *b = d->points + COLUMNS * at,
                 *c = d->points + COLUMNS * v->after;
    double samples = (double)(v->after - v->before), share = (double)(at - v->before) / samples;
    double apart2[COLUMNS];
    for (int k = 0; k < COLUMNS; k++) {
        double apart = (b[k] - a[k]) - share * (c[k] - a[k]);
        apart2[k] = apart * apart;
    }
    double z_e = greater(apart2[Z], d->e_weight2 * apart2[E]);
    v->joint = greater(d->vertices[v->before].off, v->off)
               + sqrt(greater(apart2[X] + apart2[Y], z_e));
    double cost = samples > d->shorts ? v->joint * sqrt(samples / d->shorts) : v->joint;
    int64_t level = (int64_t)((cost <= d->tolerance ? cost : 0.0) / d->alike);
    int64_t place = v->key & (((int64_t)1 << PLACES) - 1);
    int stays = d->forced[at] || !(cost <= d->tolerance);
    v->key = (stays ? BARRED : level << PLACES) | place;
}

/* Remove those of ``count`` vertices that cost less than both neighbours, and list them. */
static int64_t removed(const struct decimation *d, const int32_t *checked, int64_t count,
                       int32_t *gone)
{
    struct vertex *v = d->vertices;
    int64_t n = 0;
    for (int64_t i = 0; i < count; i++) { /* without branches, half of which would be mispredicted */
        const struct vertex *this = v + checked[i];
        gone[n] = checked[i];
        n += (this->key < BARRED) & (this->key < v[this->before].key)
             & (this->key < v[this->after].key);
    }
    for (int64_t i = 0; i < n; i++) {
        const struct vertex *this = v + gone[i];
        v[this->before].off = this->joint;
        v[this->before].after = this->after;
        v[this->after].before = this->before;
    }
    return n;
}

/* Judge the neighbours of removed vertices again; list them and theirs, ascending. */
static int64_t to_check(const struct decimation *d, const int32_t *gone, int64_t count, int32_t last,
                        int32_t *checked)
{
    int64_t n = 0;
    int32_t judged = 0, listed = 0;
    for (int64_t i = 0; i < 2 * count; i++) {
        const struct vertex *from = d->vertices + gone[i / 2];
        int32_t at = i % 2 ? from->after : from->before;
        if (at <= judged || at == last)
            continue;
        judge(d, at);
        judged = at;
        int32_t near[] = {d->vertices[at].before, at, d->vertices[at].after};
        for (int k = 0; k < 3; k++) {
            int fresh = (near[k] > listed) & (near[k] < last);
            checked[n] = near[k];
            n += fresh;
            listed = fresh ? near[k] : listed;
        }
    }
    return n;
}

/* points (n, 4), forced (n); n vertices to begin with. Returns how many of ``kept`` (n) are.
 * room (6, n): to work in. */
static int64_t breakpoints(const double *points, const uint8_t *forced, int64_t n,
                           double tolerance, double shorts, double e_weight2, double alike,
                           int64_t *kept, double *room)
{
    struct vertex *v = (struct vertex *)room; /* takes four of a point's six */
    int32_t *checked = (int32_t *)(room + 4 * n), *gone = checked + n;
    struct decimation all = {points, forced, tolerance, shorts, e_weight2, alike, v};
    const struct decimation *d = &all;
    v[0].key = 0;
    for (int64_t size = 1; size < n; size *= 2) /* the bits of each index in reverse; odd ones first */
        for (int64_t i = 0; i < size; i++) {
            v[i].key = 2 * v[i].key + 1;
            if (i + size < n)
                v[i + size].key = v[i].key - 1;
        }
    for (int32_t i = 0; i < n; i++)
        v[i].before = i - 1, v[i].after = i + 1, v[i].off = 0.0;
    v[0].key = v[n - 1].key = BARRED;
    for (int32_t i = 1; i < n - 1; i++) {
        judge(d, i);
        checked[i - 1] = i;
    }
    int64_t count = n - 2;
    while ((count = removed(d, checked, count, gone)) > 0)
        count = to_check(d, gone, count, (int32_t)n - 1, checked);
    int64_t k = 0;
    for (int32_t i = 0; i < n; i = v[i].after)
        kept[k++] = i;
    return k;
}

LOOP(breakpoints, FLOATS(0, COLUMNS * WHOLE(2)), BYTES(1, WHOLE(2)), WHOLE(2), REAL(3), REAL(4),
     REAL(5), REAL(6), OUT_INTEGERS(7, WHOLE(2)), OUT_FLOATS(8, 6 * WHOLE(2)))

/* vertices (k, 4) at ``ends`` (k), of points (n, 4). room (6, k): to work in. */
static int64_t fitted(const double *points, int64_t n, const int64_t *ends, int64_t k,
                      int64_t rounds, double *vertices, double *room)
{
    double *diagonal = room, *both = room + k, *wanted = room + 2 * k; /* x of all, then y of all */
    double *moved = room + 4 * k;                                      /* likewise */
    for (int64_t i = 0; i < k; i++) {
        int64_t start = i ? ends[i - 1] : 0, samples = ends[i] - start;
        const double *from = points + COLUMNS * start, *to = points + COLUMNS * ends[i];
        double length = (double)samples, all[2] = {0.0, 0.0}, later[2] = {0.0, 0.0};
        for (int64_t j = 1; j <= samples; j++) {
            double share = (double)j / length;
            for (int a = X; a <= Y; a++) {
                double missed = (from[COLUMNS * j + a] - from[a]) - share * (to[a] - from[a]);
                all[a] += missed;
                later[a] += share * missed;
            }
        }
        diagonal[i] = (length + 1.0) * (2.0 * length + 1.0) / (6.0 * length);
        both[i] = (length * length - 1.0) / (6.0 * length);
        for (int a = X; a <= Y; a++) {
            wanted[a * k + i] = later[a];
            moved[a * k + i] = 0.0;
            if (i)
                wanted[a * k + i - 1] += all[a] - later[a];
        }
        if (i)
            diagonal[i - 1] += (length - 1.0) * (2.0 * length - 1.0) / (6.0 * length);
    }
    diagonal[k - 1] += 1.0;
    for (int a = X; a <= Y; a++) {
        double *x = moved + a * k, *w = wanted + a * k;
        for (int64_t round = 0; round < rounds; round++) {
            double before = 0.0; /* of the vertex before, in the round before */
            for (int64_t i = 0; i < k; i++) {
                double now = w[i];
                if (i)
                    now -= both[i] * before;
                if (i + 1 < k)
                    now -= both[i + 1] * x[i + 1];
                before = x[i];
                x[i] = now / diagonal[i];
            }
            x[k - 1] = 0.0;
        }
        double low = points[a], high = points[a];
        for (int64_t i = 1; i < n; i++) {
            low = lesser(low, points[COLUMNS * i + a]);
            high = greater(high, points[COLUMNS * i + a]);
        }
        for (int64_t i = 0; i < k; i++)
            vertices[COLUMNS * i + a] = lesser(greater(points[COLUMNS * ends[i] + a] + x[i], low), high);
    }
    for (int64_t i = 0; i < k; i++)
        for (int a = Z; a <= E; a++)
            vertices[COLUMNS * i + a] = points[COLUMNS * ends[i] + a];
    return k;
}

LOOP(fitted, FLOATS(0, COLUMNS * WHOLE(1)), WHOLE(1), INTEGERS(2, WHOLE(3)), WHOLE(3), WHOLE(4),
     OUT_FLOATS(5, COLUMNS * WHOLE(3)), OUT_FLOATS(6, 6 * WHOLE(3)))
