/* The loops as functions of the Python module _kernels, through the limited API. A loop gets its
 * arguments as they are, but contiguous copies of arrays with gaps. An argument of the wrong type or
 * layout is a TypeError, one of the wrong length or range a ValueError. */

#define PY_SSIZE_T_CLEAN
#if defined(_WIN32) || __has_include(<Python.h>)
#include <Python.h>
#else
#include "stable_abi.h"
#endif
#include <string.h>

#include "kernels.h"

/* The name of each function that has a LOOP row. */
#define LOOPS(EACH)                                                                           \
    EACH(breakpoints)                                                                         \
    EACH(coarse_filter)                                                                       \
    EACH(distances)                                                                           \
    EACH(draw_pieces)                                                                         \
    EACH(far_off)                                                                             \
    EACH(find_runs)                                                                           \
    EACH(finite_filter)                                                                       \
    EACH(fitted)                                                                              \
    EACH(follow)                                                                              \
    EACH(greatest_speeds)                                                                     \
    EACH(join_pieces)                                                                         \
    EACH(judge_window)                                                                        \
    EACH(klipper_durations)                                                                   \
    EACH(klipper_feeds)                                                                       \
    EACH(limit_moves)                                                                         \
    EACH(line_pieces)                                                                         \
    EACH(lower_moves)                                                                         \
    EACH(marlin_block_times)                                                                  \
    EACH(marlin_blocks)                                                                       \
    EACH(marlin_feed_rates)                                                                   \
    EACH(marlin_slow_ends)                                                                    \
    EACH(marlin_step_times)                                                                   \
    EACH(marlin_times)                                                                        \
    EACH(misplaced)                                                                           \
    EACH(misses)                                                                              \
    EACH(motion_lines)                                                                        \
    EACH(motion_segments)                                                                     \
    EACH(move_at_rest)                                                                        \
    EACH(path_lengths)                                                                        \
    EACH(phases)                                                                              \
    EACH(plain_lines)                                                                         \
    EACH(play)                                                                                \
    EACH(products)                                                                            \
    EACH(profiles)                                                                            \
    EACH(progress_lines)                                                                      \
    EACH(recursion)                                                                           \
    EACH(safe)                                                                                \
    EACH(samples_until)                                                                       \
    EACH(segment_ends)                                                                        \
    EACH(sliding_sums)                                                                        \
    EACH(smoothed_runs)                                                                       \
    EACH(solve_stops)                                                                         \
    EACH(thinned)

enum { MOST_ARGUMENTS = 32, MOST_NEW = 8, CONTIGUOUS = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT };

struct call {
    Py_ssize_t count, used;
    int checked;       /* whether all arguments were */
    int wrong;         /* the first wrong argument found, or -1 */
    const char *cause; /* what it should be; NULL: between these */
    int64_t least, most;
    struct {
        enum { REAL_NUMBER, WHOLE_NUMBER, ARRAY, BYTES_OBJECT } kind;
        double real;
        int64_t whole;
        Py_buffer view;
        int copied;
    } of[MOST_ARGUMENTS];
    struct {
        enum extent extent;
        Py_buffer view; /* its object is NULL if it was not made */
    } new[MOST_NEW];
};

static PyObject *empty; /* numpy's */

static int note(struct call *call, int k, int right, const char *cause)
{
    if (!right && call->wrong < 0)
        call->wrong = k, call->cause = cause;
    return right;
}

static int given(struct call *call, int k)
{
    if (call->used <= k)
        call->used = k + 1;
    return note(call, k, k < call->count, "given");
}

double real_argument(struct call *call, int k)
{
    return given(call, k) && note(call, k, call->of[k].kind <= WHOLE_NUMBER, "a number")
               ? call->of[k].real : 0.0;
}

static int note_range(struct call *call, int k, int right, int64_t least, int64_t most)
{
    if (!right && call->wrong < 0)
        call->least = least, call->most = most;
    return note(call, k, right, NULL);
}

int64_t bounded_value(struct call *call, int k, int64_t value, int64_t least, int64_t most)
{
    return note_range(call, k, value >= least && value <= most, least, most) ? value : 0;
}

int64_t whole_argument(struct call *call, int k, int64_t least, int64_t most)
{
    if (!given(call, k) || !note(call, k, call->of[k].kind == WHOLE_NUMBER, "an integer"))
        return 0;
    return bounded_value(call, k, call->of[k].whole, least, most);
}

int64_t items_of(const struct call *call, int k)
{
    if (k >= call->count || call->of[k].kind < ARRAY || call->of[k].view.itemsize <= 0)
        return 0;
    return call->of[k].view.len / call->of[k].view.itemsize;
}

int64_t extent_of(const struct call *call, int k, int dimension)
{
    if (k >= call->count || call->of[k].kind < ARRAY || call->of[k].view.ndim <= dimension)
        return 0;
    return call->of[k].view.shape[dimension];
}

const char *text_argument(struct call *call, int k)
{
    return given(call, k) && note(call, k, call->of[k].kind == BYTES_OBJECT, "bytes")
               ? call->of[k].view.buf : NULL;
}

void *array_argument(struct call *call, int k, int64_t items, const char *formats, int written)
{
    if (!given(call, k) || !note(call, k, call->of[k].kind >= ARRAY, "an array"))
        return NULL;
    const Py_buffer *view = &call->of[k].view;
    const char *format = view->format ? view->format : "B";
    int right = note(call, k, strlen(format) == 1 && strchr(formats, *format), "an array of the right type")
        && note(call, k, (uintptr_t)view->buf % (size_t)view->itemsize == 0, "an aligned array")
        && note(call, k, !written || !(view->readonly || call->of[k].copied),
                "a contiguous array that can be written to")
        && note_range(call, k, items_of(call, k) >= items, items, INT64_MAX);
    return right ? view->buf : NULL;
}

const int64_t *indices_argument(struct call *call, int k, int64_t items, int64_t least, int64_t end)
{
    const int64_t *index = array_argument(call, k, items, "lq", 0);
    int outside = 0;
    if (call->checked || index == NULL)
        return index;
    for (int64_t i = 0; i < items; i++)
        outside |= (index[i] < least) | (index[i] >= end);
    note_range(call, k, !outside, least, end - 1);
    return index;
}

const int64_t *parts_argument(struct call *call, int k, int64_t items, int64_t whole)
{
    const int64_t *part = array_argument(call, k, items, "lq", 0);
    int64_t left = whole;
    if (call->checked || part == NULL)
        return part;
    for (int64_t i = 0; i < items && left >= 0; i++)
        left = part[i] < 0 || part[i] > left ? -1 : left - part[i];
    note_range(call, k, left >= 0, 0, whole);
    return part;
}

void *new_array(struct call *call, int k, const char *type, int64_t rows, int64_t columns,
                enum extent extent)
{
    Py_buffer *view = &call->new[k].view;
    if (call->checked || call->wrong >= 0) /* made, or never used */
        return call->checked ? view->buf : NULL;
    if (!note(call, (int)call->count, rows >= 0, "longer arrays"))
        return NULL;
    PyObject *array = columns >= 0 ? PyObject_CallFunction(empty, "(LL)s", (long long)rows, (long long)columns, type)
                              : PyObject_CallFunction(empty, "(L)s", (long long)rows, type);
    call->new[k].extent = extent;
    if (array && PyObject_GetBuffer(array, view, PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE) < 0)
        view->obj = NULL;
    Py_XDECREF(array);
    return note(call, (int)call->count, view->obj != NULL, "room for new arrays") ? view->buf : NULL;
}

/* Take one argument; return whether it is a number or an array. */
static int taken(PyObject *value, struct call *call, int k)
{
    if (PyFloat_Check(value)) {
        call->of[k].kind = REAL_NUMBER;
        call->of[k].real = PyFloat_AsDouble(value);
    } else if (PyLong_Check(value)) {
        call->of[k].kind = WHOLE_NUMBER;
        int overflow;
        call->of[k].whole = PyLong_AsLongLongAndOverflow(value, &overflow);
        if (overflow) /* beyond every range */
            call->of[k].whole = overflow > 0 ? INT64_MAX : INT64_MIN;
        call->of[k].real = PyLong_AsDouble(value);
        return !PyErr_Occurred();
    } else {
        call->of[k].kind = PyBytes_Check(value) ? BYTES_OBJECT : ARRAY;
        call->of[k].copied = 0;
        if (PyObject_GetBuffer(value, &call->of[k].view, CONTIGUOUS) == 0)
            return 1;
        PyErr_Clear();
        PyObject *copy = PyObject_CallMethod(value, "copy", NULL); /* of numpy's: contiguous */
        call->of[k].copied = copy && PyObject_GetBuffer(copy, &call->of[k].view, CONTIGUOUS) == 0;
        Py_XDECREF(copy);
        return call->of[k].copied;
    }
    return 1;
}

/* Return the new arrays, in order, those UP_TO the result as long as that; without any, the result. */
static PyObject *returned(struct call *call, int64_t result)
{
    PyObject *arrays[MOST_NEW], *all;
    Py_ssize_t count = 0, failed = 0;
    for (int k = 0; k < MOST_NEW; k++) {
        PyObject *array = call->new[k].view.obj;
        if (array == NULL || call->new[k].extent == ROOM_ONLY)
            continue;
        arrays[count] = call->new[k].extent == ALL ? (Py_IncRef(array), array)
                                                   : PySequence_GetSlice(array, 0, (Py_ssize_t)result);
        failed += arrays[count++] == NULL;
    }
    if (count == 0)
        return PyLong_FromLongLong(result);
    if (count == 1)
        return arrays[0];
    all = PyTuple_New(count);
    for (Py_ssize_t k = 0; k < count; k++)
        if (all)
            PyTuple_SetItem(all, k, arrays[k]); /* takes the reference */
        else
            Py_XDECREF(arrays[k]);
    if (failed)
        Py_CLEAR(all);
    return all;
}

static PyObject *refused(const struct call *call, const char *name)
{
    if (PyErr_Occurred() && PyErr_ExceptionMatches(PyExc_MemoryError))
        return NULL;
    PyErr_Clear();
    if (call->cause)
        return PyErr_Format(PyExc_TypeError, "argument %d of %s must be %s", call->wrong, name, call->cause);
    if (call->most == INT64_MAX)
        return PyErr_Format(PyExc_ValueError, "argument %d of %s must have %lld items or more", call->wrong,
                            name, (long long)call->least);
    return PyErr_Format(PyExc_ValueError, "argument %d of %s must be from %lld to %lld", call->wrong, name,
                        (long long)call->least, (long long)call->most);
}

static PyObject *called(const char *name, int64_t (*loop)(struct call *, int),
                        PyObject *const *arguments, Py_ssize_t given_count)
{
    struct call call;
    PyObject *result = NULL;
    call.used = 0, call.checked = 0, call.wrong = -1, call.cause = "a number or an array";
    for (int k = 0; k < MOST_NEW; k++)
        call.new[k].view.obj = NULL;
    for (call.count = 0; call.count < given_count; call.count++)
        if (call.count == MOST_ARGUMENTS || !taken(arguments[call.count], &call, (int)call.count)) {
            call.wrong = (int)call.count;
            break;
        }
    if (call.wrong < 0) {
        loop(&call, 0);
        note(&call, (int)call.used, call.used == call.count, "left out");
    }
    if (call.wrong < 0) {
        int64_t count;
        call.checked = 1;
        Py_BEGIN_ALLOW_THREADS
        count = loop(&call, 1);
        Py_END_ALLOW_THREADS
        result = returned(&call, count);
    } else {
        refused(&call, name);
    }
    for (Py_ssize_t k = 0; k < call.count; k++)
        if (call.of[k].kind >= ARRAY)
            PyBuffer_Release(&call.of[k].view);
    for (int k = 0; k < MOST_NEW; k++)
        if (call.new[k].view.obj)
            PyBuffer_Release(&call.new[k].view);
    return result;
}

#define FUNCTION(name)                                                                        \
    int64_t call_##name(struct call *, int);                                                  \
    static PyObject *py_##name(PyObject *self, PyObject *const *arguments, Py_ssize_t count)   \
    {                                                                                         \
        (void)self;                                                                           \
        return called(#name, call_##name, arguments, count);                                  \
    }
LOOPS(FUNCTION)

#define ROW(name) {#name, (PyCFunction)(void (*)(void))py_##name, METH_FASTCALL, NULL},
static PyMethodDef methods[] = {LOOPS(ROW){NULL, NULL, 0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernels", NULL, 0, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void)
{
    PyObject *module = PyModule_Create(&definition), *numpy = PyImport_ImportModule("numpy");
    empty = numpy ? PyObject_GetAttrString(numpy, "empty") : NULL;
    Py_XDECREF(numpy);
    if (module && (!empty || PyModule_AddIntConstant(module, "BUILT_FOR", BUILT_FOR) < 0))
        Py_CLEAR(module);
    return module;
}
