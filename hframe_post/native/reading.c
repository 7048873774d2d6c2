/* Moves as slicers write them, up to the first line that is not one or needs a closer look. It does
 * what gcode/reader.py does, in the same order. */

#include <string.h>

#include "kernels.h"

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
