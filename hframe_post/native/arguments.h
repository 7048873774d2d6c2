/* How Python calls a loop. A row below its C function names the arguments in order:
 *
 *     LOOP(smooth, FLOATS(0, WHOLE(1) + 2), WHOLE(1), REAL(2), OUT_FLOATS(3, WHOLE(1)))
 *
 * Argument 0 is an array of float64 with at least n + 2 items, where n is argument 1, an integer;
 * argument 2 is a number, and argument 3 an array with n items to write to. The loop runs without
 * the global interpreter lock. module.c lists the names of all loops. */

#ifndef HFRAME_ARGUMENTS_H
#define HFRAME_ARGUMENTS_H

#include <stdint.h>

struct call; /* the arguments of one call */

/* Each returns argument k. If it is wrong, it notes why and returns 0; then the loop is not run. */
double real_argument(struct call *call, int k);
int64_t whole_argument(struct call *call, int k);
const char *text_argument(struct call *call, int k); /* bytes, followed by a 0 */
void *array_argument(struct call *call, int k, int64_t items, const char *formats, int written);

#define REAL(k) real_argument(call, k)
#define WHOLE(k) whole_argument(call, k)
#define TEXT(k) text_argument(call, k)
#define FLOATS(k, n) ((const double *)array_argument(call, k, n, "d", 0))
#define SINGLES(k, n) ((const float *)array_argument(call, k, n, "f", 0))
#define INTEGERS(k, n) ((const int64_t *)array_argument(call, k, n, "lq", 0))
#define BYTES(k, n) ((const uint8_t *)array_argument(call, k, n, "B?", 0))
#define OUT_FLOATS(k, n) ((double *)array_argument(call, k, n, "d", 1))
#define OUT_INTEGERS(k, n) ((int64_t *)array_argument(call, k, n, "lq", 1))
#define OUT_BYTES(k, n) ((uint8_t *)array_argument(call, k, n, "B?", 1))

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
