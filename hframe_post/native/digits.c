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
