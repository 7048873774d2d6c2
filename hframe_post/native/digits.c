#include <string.h>

#include "kernels.h"

enum { WORDS = 5, LINE = 80, MOST_DIGITS = 10 }; /* bytes of a line, at most; digits of a number below 2^32 */

/* Write ``value`` units of 10^-decimals, below 2^32, at c, without trailing zeros; return its end. */
static uint8_t *written(uint8_t *c, int64_t value, int64_t decimals)
{
    uint8_t digits[24], *end = digits + sizeof digits, *first = end, *point = end - decimals;
    if (value < 0)
        *c++ = '-', value = -value;
    for (uint32_t left = (uint32_t)value; left != 0 || first >= point; left /= 10)
        *--first = (uint8_t)('0' + left % 10);
    while (first < point)
        *c++ = *first++;
    while (end > point && end[-1] == '0')
        end--;
    if (end > point)
        *c++ = '.';
    while (first < end)
        *c++ = *first++;
    return c;
}

enum { MOVES, STANDS, BEGINS, JUMPS }; /* kinds of lines, as in digits.py */

/* Copy the lines that come before line i of motion; return the end of the text. */
static uint8_t *inserted(uint8_t *c, const uint8_t *text, const int64_t *between, int64_t m,
                         const char *lines, int64_t i, int64_t *done, int64_t *begun)
{
    for (; *done < m && between[3 * *done] <= i; ++*done) {
        const int64_t *line = between + 3 * *done;
        int64_t size = line[2] - line[1];
        begun[*done] = c - text;
        memcpy(c, lines + line[1], (size_t)size);
        c += size;
    }
    return c;
}

/* Write n lines of G1, and others between them: see motion_lines in Python. longest (5): the least
 * numbers that are too long. room: bytes for the text. Returns the length of the text, or -1. */
static int64_t motion_lines(const int64_t *at, const int64_t *feeds, const uint8_t *kinds, int64_t n,
                            int64_t feed, const int64_t *decimals, const int64_t *longest,
                            const int64_t *between, int64_t m, const char *lines,
                            int64_t size_of_lines, int64_t room, uint8_t *text, int64_t *begun)
{
    uint8_t *c = text;
    int64_t done = 0, all = 0;
    for (int64_t k = 0; k < m; k++) {
        if (between[3 * k + 1] > between[3 * k + 2] || between[3 * k + 2] > size_of_lines)
            return -1;
        all += between[3 * k + 2] - between[3 * k + 1];
    }
    if (LINE * n + all > room)
        return -1;
    for (int64_t i = 0; i < n; i++, at += COLUMNS) {
        c = inserted(c, text, between, m, lines, i, &done, begun);
        const int64_t *to = at + COLUMNS;
        int64_t values[] = {to[X], to[Y], to[Z], to[E] - at[E], feeds[i]};
        if (kinds[i] == JUMPS)
            continue;
        int both = kinds[i] == BEGINS;
        int shown[] = {to[X] != at[X] || both, to[Y] != at[Y] || both, to[Z] != at[Z],
                       to[E] != at[E], feeds[i] != feed || kinds[i] != MOVES};
        feed = feeds[i];
        *c++ = 'G', *c++ = '1';
        for (int k = 0; k < WORDS; k++) {
            if (values[k] <= -longest[k] || values[k] >= longest[k])
                return -1;
            if (shown[k]) {
                *c++ = ' ', *c++ = (uint8_t)"XYZEF"[k];
                c = written(c, values[k], decimals[k]);
            }
        }
        *c++ = '\n';
    }
    return inserted(c, text, between, m, lines, INT64_MAX, &done, begun) - text;
}

LOOP(motion_lines, INTEGERS(0, COLUMNS * (ITEMS(1) + 1)), INTEGERS(1, 0), BYTES(2, ITEMS(1)), ITEMS(1),
     WHOLE(3), INDICES(4, WORDS, 0, MOST_DIGITS), INDICES(5, WORDS, 0, ((int64_t)1 << 32) + 1),
     INDICES(6, ITEMS(6), 0, MOST_ITEMS), ITEMS(6) / 3, TEXT(7), ITEMS(7), ITEMS(8), OUT_BYTES(8, 0),
     OUT_INTEGERS(9, ITEMS(6) / 3))

/* ------------------------------------------------------------------------ times left */

enum { LONGEST = 256 }; /* bytes of a line, with the room behind it */

struct times {
    double gone, left, faster; /* changes of the times that have passed and are left, s; least share of these
                                  that stays */
};

/* Copy a number of a unit (s) to *to, changed by seconds; return its end, or NULL: it has another form. */
static const uint8_t *changed(const uint8_t *c, const uint8_t *last, double unit, double change,
                              double faster, uint8_t **to)
{
    const uint8_t *digits = c;
    double value = 0.0, scale = 1.0;
    int decimals = 0, point = 0;
    for (; c < last && ((*c >= '0' && *c <= '9') || (*c == '.' && !point && c > digits)); c++) {
        if (*c == '.') {
            point = 1;
            continue;
        }
        value = 10.0 * value + (*c - '0');
        if (point)
            decimals++, scale *= 10.0;
    }
    int64_t count = c - digits - point;
    if (count == 0 || count > MOST_DIGITS - 1 || point != (decimals > 0)
        || (count > decimals + 1 && *digits == '0'))
        return NULL;
    double seconds = unit * (value / scale);
    double made = rint(greater(greater(seconds + change, faster * seconds), 0.0) / unit * scale);
    if (made >= 1e9)
        return NULL;
    int64_t whole = (int64_t)(made / scale), rest = (int64_t)made - whole * (int64_t)scale;
    *to = written(*to, whole, 0);
    if (point)
        *(*to)++ = '.';
    for (int64_t ten = (int64_t)scale / 10; ten > 0; ten /= 10)
        *(*to)++ = (uint8_t)('0' + rest / ten % 10);
    return c;
}

/* Copy M73 and its words, with its minutes changed, or Cura's comment of the time that has passed, to
 * ``made``; return its length, 0: it has another form. */
static int64_t progress_line(const uint8_t *c, int64_t size, struct times times, uint8_t *made,
                             int64_t most)
{
    static const char label[] = ";TIME_ELAPSED:";
    enum { LABEL = sizeof label - 1 };
    const uint8_t *last = c + size;
    uint8_t *to = made, *full = made + LONGEST - 2 * MOST_DIGITS - 3;
    if (size > LABEL && memcmp(c, label, LABEL) == 0) {
        memcpy(to, c, LABEL), to += LABEL;
        if ((c = changed(c + LABEL, last, 1.0, times.gone, times.faster, &to)) == NULL)
            return 0;
    } else if (size < 3 || memcmp(c, "M73", 3) != 0) {
        return 0;
    } else {
        memcpy(to, c, 3), to += 3, c += 3;
        while (c < last && *c == ' ' && to < full) {
            *to++ = *c++;
            if (c == last || *c < 'A' || *c > 'Z')
                break;
            uint8_t letter = *to++ = *c++, *digits = to;
            const uint8_t *end = changed(c, last, 60.0, times.left, times.faster, &to);
            if (end == NULL)
                return 0;
            if (letter != 'R' && letter != 'S')
                memcpy(digits, c, (size_t)(end - c)), to = digits + (end - c);
            c = end;
        }
    }
    if (c + 1 == last && *c == '\r' && to < full)
        *to++ = *c++;
    return c == last && to - made <= most ? to - made : 0;
}

/* Change the times in lines at places (n, 2) of a text (size): see progress_lines in Python.
 * Returns how many lines stay; others (n): which. */
static int64_t progress_lines(uint8_t *text, int64_t size, const int64_t *at, int64_t n,
                              const double *elapsed, double before, double after, int64_t room,
                              int64_t *others)
{
    int64_t count = 0;
    for (int64_t i = 0; i < n; i++) {
        uint8_t made[LONGEST];
        int64_t from = at[2 * i], length = at[2 * i + 1] - from, fits = length + room, done = 0;
        double all = after - before, share = after != 0.0 ? elapsed[i] / after : 0.0;
        double faster = before != 0.0 ? lesser(after / before, 1.0) : 1.0;
        struct times times = {all * share, all - all * share, faster};
        if (length > 0 && fits <= LONGEST && from + fits <= size)
            done = progress_line(text + from, length, times, made, fits);
        if (done == 0) {
            others[count++] = i;
            continue;
        }
        memcpy(text + from, made, (size_t)done);
        memset(text + from + done, ' ', (size_t)(fits - done));
    }
    return count;
}

LOOP(progress_lines, OUT_BYTES(0, 0), ITEMS(0), INDICES(1, ITEMS(1), 0, ITEMS(0) + 1), ITEMS(1) / 2,
     FLOATS(2, ITEMS(1) / 2), REAL(3), REAL(4), WITHIN(5, 0, 64), UP_TO_INTEGERS(0, ITEMS(1) / 2))
