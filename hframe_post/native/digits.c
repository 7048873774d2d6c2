/* The loop of writers/stream/digits.py that writes lines. */

#include "kernels.h"

/* Write ``value`` units of 10^-decimals at c, without trailing zeros; return its end. */
static uint8_t *written(uint8_t *c, int64_t value, int64_t decimals)
{
    uint8_t reversed[24];
    int count = 0, seen = 0;
    if (value < 0)
        *c++ = '-', value = -value;
    for (int64_t k = 0; k < decimals; k++, value /= 10) { /* from the last digit on */
        seen |= value % 10 != 0;
        if (seen)
            reversed[count++] = (uint8_t)('0' + value % 10);
    }
    if (seen)
        reversed[count++] = '.';
    do
        reversed[count++] = (uint8_t)('0' + value % 10);
    while ((value /= 10) != 0);
    while (count)
        *c++ = reversed[--count];
    return c;
}

/* Write n lines of a command with w words: values (w, n) in units of 10^-decimals (w) after their
 * letters; shown (w, n): the words to write. ends (n): the end of each line. Returns the length of
 * the text. */
static int64_t command_lines(const char *command, const char *letters, int64_t w, int64_t n,
                               const int64_t *values, const int64_t *decimals,
                               const uint8_t *shown, uint8_t *text, int64_t *ends)
{
    uint8_t *c = text;
    for (int64_t i = 0; i < n; i++) {
        for (const char *name = command; *name; name++)
            *c++ = (uint8_t)*name;
        for (int64_t k = 0; k < w; k++) {
            if (!shown[k * n + i])
                continue;
            *c++ = ' ';
            *c++ = (uint8_t)letters[k];
            c = written(c, values[k * n + i], decimals[k]);
        }
        *c++ = '\n';
        ends[i] = c - text;
    }
    return c - text;
}

LOOP(command_lines, TEXT(0), TEXT(1), WHOLE(2), WHOLE(3), INTEGERS(4, WHOLE(2) * WHOLE(3)),
     INTEGERS(5, WHOLE(2)), BYTES(6, WHOLE(2) * WHOLE(3)), OUT_BYTES(7, WHOLE(3)),
     OUT_INTEGERS(8, WHOLE(3)))
