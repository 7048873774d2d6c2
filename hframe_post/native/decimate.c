/* A sample that is still a vertex, in a list by time. */

#include "kernels.h"

struct vertex {
    double off;   /* bound on the distance of samples from the chord that begins here */
    double joint; /* the same for the chord that would replace both at this vertex */
    int64_t key;  /* what that costs, then the place among equals; the least goes first */
    int32_t before, after;
};

struct decimation {
    const double *points;
    const uint8_t *forced;
    double tolerance;
    struct vertex *vertices;
};

#define BARRED ((int64_t)1 << 62) /* the key of a vertex that stays */
#define PLACES 24                 /* bits for the place among equals */
#define SHORT 8.0    /* samples; the nozzle follows longer errors, so that they must be smaller */
#define E_WEIGHT 4.0 /* a mm of filament is wider than a mm of path is long */
#define ALIKE 1e-4   /* mm; losses this close count as equal, for evenness */

/* Return the distance of b from the chord from a to c, of which it has passed a share. */
INSIDE double distance(const double *a, const double *b, const double *c, double share)
{
    double apart2[COLUMNS];
    for (int k = 0; k < COLUMNS; k++) {
        double apart = (b[k] - a[k]) - share * (c[k] - a[k]);
        apart2[k] = apart * apart;
    }
    return sqrt(greater(apart2[X] + apart2[Y], greater(apart2[Z], E_WEIGHT * E_WEIGHT * apart2[E])));
}

/* Return the key of a vertex at a place among equals, with the chord that would replace both. */
INSIDE int64_t key(const struct decimation *d, int32_t at, int64_t place, double joint,
                   double samples)
{
    double cost = samples > SHORT ? joint * sqrt(samples / SHORT) : joint;
    int64_t level = (int64_t)(lesser(cost, d->tolerance) / ALIKE);
    int stays = d->forced[at] | !(cost <= d->tolerance);
    return (stays ? BARRED : level << PLACES) | place;
}

/* Compute what the chord costs that replaces both at a vertex. */
INSIDE void price(const struct decimation *d, int32_t at)
{
    struct vertex *v = d->vertices + at;
    const double *a = d->points + COLUMNS * v->before, *b = d->points + COLUMNS * at,
                 *c = d->points + COLUMNS * v->after;
    double samples = (double)(v->after - v->before), share = (double)(at - v->before) / samples;
    v->joint = greater(d->vertices[v->before].off, v->off) + distance(a, b, c, share);
    v->key = key(d, at, v->key & (((int64_t)1 << PLACES) - 1), v->joint, samples);
}

/* Make vertices of all n samples, and price those between. places, far (n): room. */
INSIDE void begin(const struct decimation *d, int64_t n, int32_t *places, double *far)
{
    const double *points = d->points;
    places[0] = 0;
    for (int64_t size = 1; size < n; size *= 2) /* the bits of each index in reverse; odd ones first */
        for (int64_t i = 0; i < size; i++) {
            places[i] = 2 * places[i] + 1;
            if (i + size < n)
                places[i + size] = places[i] - 1;
        }
    for (int64_t i = 1; i < n - 1; i++) {
        const double *a = points + COLUMNS * (i - 1);
        far[i] = distance(a, a + COLUMNS, a + 2 * COLUMNS, 0.5);
    }
    for (int32_t i = 1; i < n - 1; i++)
        d->vertices[i] = (struct vertex){0.0, far[i], key(d, i, places[i], far[i], 2.0), i - 1, i + 1};
    d->vertices[0] = (struct vertex){0.0, 0.0, BARRED, -1, 1};
    d->vertices[n - 1] = (struct vertex){0.0, 0.0, BARRED, (int32_t)n - 2, (int32_t)n};
}

/* Remove those of ``count`` vertices that cost less than both neighbours, and list them. */
INSIDE int64_t removed(const struct decimation *d, const int32_t *checked, int64_t count,
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

struct list { /* ascending */
    int32_t *of, latest;
    int64_t count;
};

INSIDE void add(struct list *list, int32_t at)
{
    int fresh = at > list->latest;
    list->of[list->count] = at;
    list->count += fresh;
    list->latest = fresh ? at : list->latest;
}

/* Judge the neighbours of removed vertices again; list them and theirs. */
INSIDE int64_t to_check(const struct decimation *d, const int32_t *gone, int64_t count, int32_t last,
                        int32_t *checked)
{
    struct list list = {checked, 0, 0};
    int32_t judged = 0;
    for (int64_t i = 0; i < count; i++) {
        int32_t before = d->vertices[gone[i]].before, after = d->vertices[gone[i]].after;
        if (before > judged) {
            price(d, before);
            add(&list, d->vertices[before].before);
            add(&list, before);
        }
        if (after == last)
            break;
        price(d, judged = after);
        add(&list, after);
        if (d->vertices[after].after < last)
            add(&list, d->vertices[after].after);
    }
    return list.count;
}

/* points (n, 4), forced (n); n vertices to begin with. Returns how many of ``kept`` (n) are.
 * room (6, n): to work in. */
WIDE static int64_t breakpoints(const double *points, const uint8_t *forced, int64_t n,
                                double tolerance, int64_t *kept, double *room)
{
    struct vertex *v = (struct vertex *)room; /* takes four of a point's six, both lists one */
    int32_t *checked = (int32_t *)(room + 4 * n), *gone = checked + n;
    struct decimation all = {points, forced, tolerance, v};
    const struct decimation *d = &all;
    begin(d, n, gone, room + 5 * n);
    for (int32_t i = 1; i < n - 1; i++)
        checked[i - 1] = i;
    int64_t count = n - 2;
    while ((count = removed(d, checked, count, gone)) > 0)
        count = to_check(d, gone, count, (int32_t)n - 1, checked);
    int64_t k = 0;
    for (int32_t i = v[0].after; i < n; i = v[i].after)
        kept[k++] = i;
    return k;
}

LOOP(breakpoints, FLOATS(0, COLUMNS * ITEMS(1)), BYTES(1, 0),
     BOUNDED(1, ITEMS(1), 1, (int64_t)1 << PLACES), REAL(2), UP_TO_INTEGERS(0, ITEMS(1)), ROOM(1, 6 * ITEMS(1)))

/* Take one step of Jacobi's method from x (k) to next (k); the last vertex stays. */
INSIDE void relax(const double *wanted, const double *both, const double *diagonal, int64_t k,
                  const double *x, double *restrict next)
{
    if (k > 1)
        next[0] = (wanted[0] - both[1] * x[1]) / diagonal[0];
    for (int64_t i = 1; i < k - 1; i++)
        next[i] = (wanted[i] - both[i] * x[i - 1] - both[i + 1] * x[i + 1]) / diagonal[i];
    next[k - 1] = 0.0;
}

/* vertices (k, 4) at ``ends`` (k), of points (n, 4). room (6, k): to work in. */
WIDE static int64_t fitted(const double *points, int64_t n, const int64_t *ends, int64_t k,
                           double *vertices, double *room)
{
    enum { ROUNDS = 12 }; /* of Jacobi's method, each of which at least halves the error */
    double *diagonal = room, *both = room + k, *wanted = room + 2 * k; /* x of all, then y of all */
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
            if (i)
                wanted[a * k + i - 1] += all[a] - later[a];
        }
        if (i)
            diagonal[i - 1] += (length - 1.0) * (2.0 * length - 1.0) / (6.0 * length);
        for (int c = Z; c <= E; c++)
            vertices[COLUMNS * i + c] = to[c];
    }
    diagonal[k - 1] += 1.0;
    double low[2] = {points[X], points[Y]}, high[2] = {points[X], points[Y]};
    for (int64_t i = 1; i < n; i++)
        for (int a = X; a <= Y; a++) {
            low[a] = lesser(low[a], points[COLUMNS * i + a]);
            high[a] = greater(high[a], points[COLUMNS * i + a]);
        }
    for (int a = X; a <= Y; a++) {
        double *x = room + 4 * k, *next = room + 5 * k;
        for (int64_t i = 0; i < k; i++)
            x[i] = 0.0;
        for (int64_t round = 0; round < ROUNDS; round++) {
            relax(wanted + a * k, both, diagonal, k, x, next);
            double *latest = next;
            next = x, x = latest;
        }
        for (int64_t i = 0; i < k; i++) {
            double to = points[COLUMNS * ends[i] + a] + x[i];
            vertices[COLUMNS * i + a] = lesser(greater(to, low[a]), high[a]);
        }
    }
    return k;
}

LOOP(fitted, FLOATS(0, COLUMNS), ITEMS(0) / COLUMNS, INDICES(1, ITEMS(1), 0, ITEMS(0) / COLUMNS),
     BOUNDED(1, ITEMS(1), 1, MOST_ITEMS), NEW_ROWS(0, ITEMS(1), COLUMNS), ROOM(1, 6 * ITEMS(1)))

/* ``ends`` (k) of segments of points, and more where one is too thick, into kept. Return how many. room
 * (2 k). */
static int64_t thinned(const double *points, const int64_t *ends, int64_t k, int64_t *kept, double *room)
{
    const double FILAMENT = 3.141592653589793 * (1.75 * 1.75) / 4.0; /* mm2, its cross section */
    const double USUAL_NOZZLE = 0.4;                                 /* mm */
    /* mm of filament per mm, with a margin */
    const double ALLOWED = 0.95 * 4.0 * (USUAL_NOZZLE * USUAL_NOZZLE) / FILAMENT;
    double *d = room, *e = room + k, all_d = 0.0, all_e = 0.0;
    for (int64_t i = 0; i < k; i++) {
        const double *from = points + (i ? COLUMNS * ends[i - 1] : 0), *to = points + COLUMNS * ends[i];
        double x = to[X] - from[X], y = to[Y] - from[Y], z = to[Z] - from[Z];
        d[i] = sqrt(x * x + y * y + z * z);
        e[i] = to[E] - from[E];
        if (e[i] > 0.0 && d[i] > 0.0)
            all_d += d[i], all_e += e[i];
    }
    double usual = all_d > 0.0 ? all_e / all_d : INFINITY; /* else nothing is too thick */
    double nozzle = lesser(sqrt(2.0 * FILAMENT * usual), USUAL_NOZZLE);
    double limit = lesser(3.0 * usual, greater(ALLOWED, 1.5 * usual));
    double most = 2.0 * nozzle * (nozzle * nozzle) / FILAMENT; /* mm that Klipper takes in one piece */
    int64_t count = 0, done = 0;
    for (int64_t i = 0; i < k; i++) {
        const double *begun = points + COLUMNS * done + E;
        int thick = e[i] > most && e[i] > limit * d[i];
        for (int64_t j = done + 1; thick && j + 1 < ends[i]; j++) {
            const double *now = points + COLUMNS * j + E;
            if (floor((now[COLUMNS] - *begun) / most) != floor((*now - *begun) / most))
                kept[count++] = j;
        }
        done = kept[count++] = ends[i] > done ? ends[i] : done;
    }
    return count;
}

LOOP(thinned, FLOATS(0, 0), INDICES(1, ITEMS(1), 0, ITEMS(0) / COLUMNS), ITEMS(1),
     UP_TO_INTEGERS(0, ITEMS(0) / COLUMNS + ITEMS(1)), ROOM(1, 2 * ITEMS(1)))

static int marked(const uint8_t *forced, int64_t from, int64_t to)
{
    while (from < to && !forced[from])
        from++;
    return from < to;
}

/* places (k, 4), mm, at ``ends`` (k) of points forced (n); per_mm (4): units in a mm; start (4): the
 * place before them, for ``still`` samples. Returns how many segments move; at (k + 1, 4), ended,
 * T and dwell (k): theirs. */
static int64_t motion_segments(const double *places, const int64_t *ends, int64_t k,
                               const uint8_t *forced, const int64_t *start, int64_t still,
                               const double *per_mm, int64_t *at, int64_t *ended, double *T,
                               int64_t *dwell)
{
    enum { DWELL = 24 }; /* samples; a longer rest is a dwell, a shorter one joins the next segment */
    int64_t count = 0, from = 0, done = -still;
    int extrudes = 0; /* whether what is at rest extrudes with the segment before */
    for (int c = 0; c < COLUMNS; c++)
        at[c] = start[c];
    for (int64_t i = 0; i < k; from = ends[i++]) {
        int64_t *last = at + COLUMNS * count, *to = last + COLUMNS, idle = from - done;
        for (int c = 0; c < COLUMNS; c++)
            to[c] = (int64_t)rint(places[COLUMNS * i + c] * per_mm[c]);
        if (to[X] == last[X] && to[Y] == last[Y] && to[Z] == last[Z]) {
            extrudes = extrudes && !marked(forced, from, ends[i]);
            if (extrudes)
                last[E] = to[E];
            continue;
        }
        dwell[count] = idle >= DWELL ? idle : 0;
        T[count] = (double)(ends[i] - from + idle - dwell[count]) * TS;
        ended[count++] = done = ends[i];
        extrudes = 1;
    }
    return count;
}

LOOP(motion_segments, FLOATS(0, COLUMNS * ITEMS(1)), INDICES(1, ITEMS(1), 0, ITEMS(2) + 1), ITEMS(1),
     BYTES(2, 0), INTEGERS(3, COLUMNS), WHOLE(4), FLOATS(5, COLUMNS), NEW_PLACES(0, ITEMS(1) + 1),
     UP_TO_INTEGERS(1, ITEMS(1)), UP_TO_FLOATS(2, ITEMS(1)), UP_TO_INTEGERS(3, ITEMS(1)))

/* off (m): mm of filament on the wrong side of each of m lines, which precedes segment rows (m) and has the
 * point marked (m): see Python. */
static int64_t misplaced(const double *points, const int64_t *ends, const int64_t *rows,
                         const int64_t *marked, int64_t m, const double *e, double before, double *off)
{
    for (int64_t i = 0; i < m; i++) {
        int64_t row = rows[i], begun = row ? ends[row - 1] : 0;
        double low = points[COLUMNS * begun + E], high = low;
        if (row == 0)
            low = lesser(low, low - before), high = greater(high, high - before);
        for (int64_t j = begun; j <= marked[i]; j++) {
            low = lesser(low, points[COLUMNS * j + E]);
            high = greater(high, points[COLUMNS * j + E]);
        }
        off[i] = greater(low - e[row], e[row] - high);
    }
    return m;
}

LOOP(misplaced, FLOATS(0, 0), INDICES(1, ITEMS(1), 0, ITEMS(0) / COLUMNS),
     INDICES(2, ITEMS(2), 0, ITEMS(1) + 1), INDICES(3, ITEMS(2), 0, ITEMS(0) / COLUMNS), ITEMS(2),
     FLOATS(4, ITEMS(1) + 1), REAL(5), NEW_FLOATS(0, ITEMS(2)))
