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

/* Write n lines of G1: see motion_lines in Python. longest (5): the least numbers that are too
 * long. ends (n): the end of each line. Returns the length of the text, or -1. */
static int64_t motion_lines(const int64_t *at, const int64_t *feeds, int64_t n, int64_t feed,
                            const int64_t *decimals, const int64_t *longest, uint8_t *text,
                            int64_t *ends)
{
    uint8_t *c = text;
    for (int64_t i = 0; i < n; i++, at += COLUMNS) {
        const int64_t *to = at + COLUMNS;
        int64_t values[] = {to[X], to[Y], to[Z], to[E] - at[E], feeds[i]};
        int both = i == 0 && feed == 0;
        int shown[] = {to[X] != at[X] || both, to[Y] != at[Y] || both, to[Z] != at[Z],
                       to[E] != at[E], feeds[i] != (i ? feeds[i - 1] : feed)};
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
        ends[i] = c - text;
    }
    return c - text;
}

LOOP(motion_lines, INTEGERS(0, COLUMNS * (COUNT(2) + 1)), INTEGERS(1, COUNT(2)), COUNT(2), WHOLE(3),
     INDICES(4, WORDS, 0, MOST_DIGITS), INDICES(5, WORDS, 0, ((int64_t)1 << 32) + 1),
     OUT_BYTES(6, LINE * COUNT(2)), OUT_INTEGERS(7, COUNT(2)))

/* ------------------------------------------------------------------------ */

/* Moves as slicers write them, up to the first line that is not one or needs a closer look. It does
 * what gcode/reader.py does, in the same order. */

enum { EXACT_DIGITS = 15, LONGEST_LINE = 512, ROW = 8 };

/* Powers of ten that a double holds exactly: a number of 15 digits over one of them is rounded once,
 * as strtod does. */
static const double TEN_TO[] = {1e0, 1e1, 1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15};

/* Read a number of digits with at most one point; return its end, or NULL if it is anything else. */
static const char *number(const char *c, double *value)
{
    int negative = *c == '-', digits = 0, decimals = -1;
    int64_t mantissa = 0;
    for (c += negative; (*c >= '0' && *c <= '9') || (*c == '.' && decimals < 0); c++) {
        if (*c == '.') {
            decimals = 0;
            continue;
        }
        mantissa = 10 * mantissa + (*c - '0');
        if (decimals >= 0)
            decimals++;
        if (++digits > EXACT_DIGITS)
            return NULL;
    }
    *value = (double)mantissa / TEN_TO[decimals > 0 ? decimals : 0];
    if (negative)
        *value = -*value;
    return digits ? c : NULL;
}

/* Return the end of the line after spaces and a comment, or NULL if anything else comes first. */
static const char *line_end(const char *c, const char *last)
{
    while (*c == ' ' || *c == '\t')
        c++;
    if (*c == ';')
        while (c < last && *c != '\n' && *c != '\r')
            c++;
    c += *c == '\r';
    return *c == '\n' && c < last ? c + 1 : NULL;
}

/* Read the words of a line in the order F X Y Z E F; return its end, or NULL if it is not a plain
 * move. given: a bit for each of x, y, z, e and F. */
static const char *words(const char *c, const char *last, double *value, int *given)
{
    static const char letters[] = "FXYZEF";
    static const int bit[] = {4, 0, 1, 2, 3, 4};
    *given = 0;
    if (c[0] != 'G' || (c[1] != '0' && c[1] != '1'))
        return NULL;
    c += 2;
    for (int k = 0; k < 6; k++) {
        if (c[0] != ' ' || c[1] != letters[k])
            continue;
        if (*given & 1 << bit[k] || (c = number(c + 2, value + bit[k])) == NULL)
            return NULL;
        *given |= 1 << bit[k];
    }
    return line_end(c, last);
}

/* Read the plain moves in a text (size) from ``offset`` on; it ends with a line feed and a 0.
 * state: x, y, z, e (mm), the offset of each from what the file calls it, feed rate, speed (mm/s).
 * rules: mm per unit of the file, factor on the speed, least feed rate, greatest coordinate, greatest
 * filament of a move, least x, y, z, greatest x, y, z, whether E is relative, acceleration, corner
 * velocity, greatest filament per mm of path, least path.
 * rows (most, ROW): line, x, y, z, e, speed, acceleration, corner velocity of each move in which x or
 * y changes. taken: lines, bytes. Returns the number of rows. */
static int64_t plain_moves(const char *text, int64_t size, int64_t offset, int64_t first_line,
                             int64_t most, double *state, const double *rules, double *rows, int64_t *taken)
{
    const char *c = text + offset, *last = text + size, *next;
    double scale = rules[0], farthest = rules[3], *at = state, *origin = state + COLUMNS;
    const double *least = rules + 5, *greatest = rules + 8;
    int64_t count = 0, lines = 0;
    for (; count < most && c < last; c = next, lines++) {
        double value[COLUMNS + 1], to[COLUMNS], rate = state[8], speed = state[9];
        int given, inside = 1;
        if ((next = words(c, last, value, &given)) == NULL || next - c > LONGEST_LINE)
            break;
        if (given & 1 << 4) {
            rate = value[4] * scale / 60.0;
            speed = rate * rules[1];
            if (!(rate >= rules[2]))
                break;
        }
        for (int k = X; k <= E; k++) {
            double from = k == E && rules[11] != 0.0 ? at[E] : origin[k];
            to[k] = given & 1 << k ? from + value[k] * scale : at[k];
            inside &= to[k] > -farthest && to[k] < farthest;
        }
        for (int k = X; k <= Z; k++)
            inside &= least[k] <= to[k] && to[k] <= greatest[k];
        int travels = to[X] != at[X] || to[Y] != at[Y];
        int moves = (given & 15) != 0;
        double dx = to[X] - at[X], dy = to[Y] - at[Y], dz = to[Z] - at[Z], de = fabs(to[E] - at[E]);
        if (moves && (!inside || !travels || de > rules[4]))
            break;
        double path = sqrt(dx * dx + dy * dy + dz * dz);
        if (moves && (de > rules[14] * path || path <= rules[15]))
            break;
        state[8] = rate, state[9] = speed;
        if (!moves)
            continue;
        double *row = rows + ROW * count++;
        row[0] = (double)(first_line + lines);
        for (int k = X; k <= E; k++)
            row[1 + k] = at[k] = to[k];
        row[5] = speed, row[6] = rules[12], row[7] = rules[13];
    }
    taken[0] = lines, taken[1] = c - text - offset;
    return count;
}

LOOP(plain_moves, TEXT(0), WITHIN(1, 0, ITEMS(0)), WITHIN(2, 0, WHOLE(1)), WHOLE(3), COUNT(4),
     OUT_FLOATS(5, 10), FLOATS(6, 16), OUT_FLOATS(7, ROW * COUNT(4)), OUT_INTEGERS(8, 2))
