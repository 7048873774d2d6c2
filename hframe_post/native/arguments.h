/* How Python calls a loop. A row below its C function says what it gets:
 *
 *     LOOP(smooth, FLOATS(0, 3), ITEMS(0) - 2, REAL(1), NEW_FLOATS(0, ITEMS(0) - 2))
 *
 * Argument 0 of Python's is an array of float64 with at least 3 items, argument 1 a number. The loop
 * gets how many items the array has, less 2, and a new array of that length, which Python gets: all
 * new arrays, in order, are what a loop returns to it; if it makes none, its result is. All that a
 * loop needs in order to stay within its arrays, and to end, is in its row; the loop itself checks
 * nothing. It runs without the global interpreter lock. module.c lists the names of all loops. */

#ifndef HFRAME_ARGUMENTS_H
#define HFRAME_ARGUMENTS_H

#include <stdint.h>

struct call; /* the arguments of one call */

/* Each returns argument k. If it is wrong, it notes why and returns 0; then the loop is not run. */
double real_argument(struct call *call, int k);
int64_t whole_argument(struct call *call, int k, int64_t least, int64_t most);
const char *text_argument(struct call *call, int k); /* bytes, followed by a 0 */
void *array_argument(struct call *call, int k, int64_t items, const char *formats, int written);
const int64_t *indices_argument(struct call *call, int k, int64_t items, int64_t least, int64_t end);
const int64_t *parts_argument(struct call *call, int k, int64_t items, int64_t whole);
int64_t items_of(const struct call *call, int k);
int64_t extent_of(const struct call *call, int k, int dimension);
int64_t bounded_value(struct call *call, int k, int64_t value, int64_t least, int64_t most);

/* Return new array k, (rows, columns), or (rows,) if columns is negative. */
enum extent { ALL, UP_TO_RESULT, ROOM_ONLY }; /* what of it Python gets: as many rows as the result */
void *new_array(struct call *call, int k, const char *type, int64_t rows, int64_t columns,
                enum extent extent);

#define MOST_ITEMS ((int64_t)1 << 31) /* the product of two does not overflow, nor of three FEW */
#define MOST_FEW ((int64_t)1 << 20)
#define MOST_WHOLE ((int64_t)1 << 53)

#define REAL(k) real_argument(call, k)
#define WHOLE(k) whole_argument(call, k, -MOST_WHOLE, MOST_WHOLE)
#define COUNT(k) whole_argument(call, k, 0, MOST_ITEMS)
#define FEW(k) whole_argument(call, k, 0, MOST_FEW)
#define WITHIN(k, least, most) whole_argument(call, k, least, most)
#define TEXT(k) text_argument(call, k)
#define FLOATS(k, n) ((const double *)array_argument(call, k, n, "d", 0))
#define INTEGERS(k, n) ((const int64_t *)array_argument(call, k, n, "lq", 0))
#define INDICES(k, n, least, end) indices_argument(call, k, n, least, end) /* from least, below end */
#define PARTS(k, n, whole) parts_argument(call, k, n, whole) /* from 0, with a sum of at most whole */
#define ITEMS(k) items_of(call, k) /* how many the array or the bytes have */
#define ROWS(k) extent_of(call, k, 0)
#define WIDTH(k) extent_of(call, k, 1)
#define BOUNDED(k, value, least, most) bounded_value(call, k, value, least, most) /* a value that k gives */
#define BYTES(k, n) ((const uint8_t *)array_argument(call, k, n, "B?", 0))
#define OUT_FLOATS(k, n) ((double *)array_argument(call, k, n, "d", 1))
#define OUT_SINGLES(k, n) ((float *)array_argument(call, k, n, "f", 1))
#define OUT_INTEGERS(k, n) ((int64_t *)array_argument(call, k, n, "lq", 1))
#define OUT_BYTES(k, n) ((uint8_t *)array_argument(call, k, n, "B?", 1))
#define NEW_FLOATS(k, n) ((double *)new_array(call, k, "f8", n, -1, ALL))
#define NEW_ROWS(k, n, columns) ((double *)new_array(call, k, "f8", n, columns, ALL))
#define NEW_INTEGERS(k, n) ((int64_t *)new_array(call, k, "i8", n, -1, ALL))
#define NEW_PLACES(k, n) ((int64_t *)new_array(call, k, "i8", n, COLUMNS, ALL))
#define NEW_FLAGS(k, n) ((uint8_t *)new_array(call, k, "?", n, -1, ALL))
#define UP_TO_FLOATS(k, n) ((double *)new_array(call, k, "f8", n, -1, UP_TO_RESULT)) /* cut to the result */
#define UP_TO_ROWS(k, n, columns) ((double *)new_array(call, k, "f8", n, columns, UP_TO_RESULT))
#define UP_TO_INTEGERS(k, n) ((int64_t *)new_array(call, k, "i8", n, -1, UP_TO_RESULT))
#define UP_TO_FLAGS(k, n) ((uint8_t *)new_array(call, k, "?", n, -1, UP_TO_RESULT))
#define ROOM(k, n) ((double *)new_array(call, k, "f8", n, -1, ROOM_ONLY)) /* for the loop alone */

/* All arguments are evaluated, and thereby checked, before the loop is called with them. */
#define LOOP(name, ...)                                 \
    int64_t call_##name(struct call *call, int checked) \
    {                                                   \
        if (checked)                                    \
            return name(__VA_ARGS__);                   \
        evaluated(call, __VA_ARGS__);                   \
        return 0;                                       \
    }

static inline void evaluated(const struct call *call, ...) { (void)call; }

#endif
