/* The loops of firmware/klipper/segments.py. */

#include "kernels.h"

/* Bound the distance of samples from the chord that replaces both segments at vertex v. */
static double merged(const double *points, const int64_t *kept, const double *off, int64_t v,
                     double e_weight2)
{
    const double *a = points + COLUMNS * kept[v - 1], *b = points + COLUMNS * kept[v],
                 *c = points + COLUMNS * kept[v + 1];
    double share = (double)(kept[v] - kept[v - 1]) / (double)(kept[v + 1] - kept[v - 1]);
    double apart2[COLUMNS];
    for (int k = 0; k < COLUMNS; k++) {
        double apart = (b[k] - a[k]) - share * (c[k] - a[k]);
        apart2[k] = apart * apart;
    }
    double z_e = greater(apart2[Z], e_weight2 * apart2[E]);
    return greater(off[v - 1], off[v]) + sqrt(greater(apart2[X] + apart2[Y], z_e));
}

/* flags (n): which vertices cost less than their neighbours; of equals every other one. */
static void cheapest(const double *cost, int64_t n, uint8_t *flags)
{
    flags[0] = flags[n - 1] = 0;
    for (int64_t v = 1; v < n - 1; v++) { /* without branches, half of which would be mispredicted */
        double c = cost[v], left = cost[v - 1], right = cost[v + 1];
        int odd = v & 1;
        flags[v] = (uint8_t)((c < INFINITY) & ((c < left) | (odd & (c == left)))
                             & ((c < right) | (odd & (c == right))));
    }
}

/* points (n, 4), forced (n); n vertices to begin with. Returns how many of ``kept`` (n) are.
 * room (3, n), flags (n): to work in. */
static int64_t breakpoints(const double *points, const uint8_t *forced, int64_t n,
                             double tolerance, double shorts, double e_weight2, double alike,
                             int64_t *kept, double *room, uint8_t *flags)
{
    double *off = room;        /* of samples from the chord that begins at a vertex, or more */
    double *joint = room + n;  /* the same of the chords on both sides as one; < 0: not known */
    double *cost = room + 2 * n;
    for (int64_t v = 0; v < n; v++) {
        kept[v] = v;
        off[v] = 0.0;
        joint[v] = -1.0;
    }
    for (int64_t left = 0; left != n;) {
        for (int64_t v = 1; v < n - 1; v++) {
            if (joint[v] >= 0.0)
                continue;
            joint[v] = merged(points, kept, off, v, e_weight2);
            double samples = (double)(kept[v + 1] - kept[v - 1]);
            double c = samples > shorts ? joint[v] * sqrt(samples / shorts) : joint[v];
            cost[v] = forced[kept[v]] || c > tolerance ? INFINITY : rint(c / alike);
        }
        cost[0] = cost[n - 1] = INFINITY;
        cheapest(cost, n, flags);
        int changed = 0;
        left = n, n = 0;
        for (int64_t v = 0; v < left; v++) {
            if (flags[v]) { /* the chord that ended here goes on; check both its ends again */
                off[n - 1] = joint[v];
                joint[n - 1] = -1.0;
                changed = 1;
                continue;
            }
            kept[n] = kept[v], off[n] = off[v], cost[n] = cost[v];
            joint[n] = changed ? -1.0 : joint[v];
            n++, changed = 0;
        }
    }
    return n;
}

LOOP(breakpoints, FLOATS(0, COLUMNS * WHOLE(2)), BYTES(1, WHOLE(2)), WHOLE(2), REAL(3), REAL(4), REAL(5),
     REAL(6), OUT_INTEGERS(7, WHOLE(2)), OUT_FLOATS(8, 3 * WHOLE(2)), OUT_BYTES(9, WHOLE(2)))

/* vertices (k, 4) at ``ends`` (k), of points (n, 4). room (6, k): to work in. */
static int64_t fitted(const double *points, int64_t n, const int64_t *ends, int64_t k, int64_t rounds,
                     double *vertices, double *room)
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
