/* What module.c uses of Python's stable ABI, for systems that have Python without its headers, as
 * Debian without python3-dev. The layouts are those that PEP 384 and PEP 688 promise for every Python
 * from 3.11 on. */

#ifndef HFRAME_STABLE_ABI_H
#define HFRAME_STABLE_ABI_H

#include <stddef.h>
#include <stdint.h>

typedef ptrdiff_t Py_ssize_t;
typedef struct _object PyObject;
typedef struct _typeobject PyTypeObject;
struct _object {
    Py_ssize_t ob_refcnt;
    PyTypeObject *ob_type;
};

typedef struct {
    void *buf;
    PyObject *obj;
    Py_ssize_t len, itemsize;
    int readonly, ndim;
    char *format;
    Py_ssize_t *shape, *strides, *suboffsets;
    void *internal;
} Py_buffer;

typedef PyObject *(*PyCFunction)(PyObject *, PyObject *);
typedef struct {
    const char *ml_name;
    PyCFunction ml_meth;
    int ml_flags;
    const char *ml_doc;
} PyMethodDef;

struct PyModuleDef {
    struct {
        PyObject ob_base;
        PyObject *(*m_init)(void);
        Py_ssize_t m_index;
        PyObject *m_copy;
    } m_base;
    const char *m_name, *m_doc;
    Py_ssize_t m_size;
    PyMethodDef *m_methods;
    void *m_slots, *m_traverse, *m_clear, *m_free;
};

enum { METH_FASTCALL = 0x80, PyBUF_C_CONTIGUOUS = 0x38, PyBUF_FORMAT = 0x4,
       PyBUF_WRITABLE = 0x1, ABI_VERSION = 3 };
#define PyModuleDef_HEAD_INIT {{1, NULL}, NULL, 0, NULL}
#define PyMODINIT_FUNC __attribute__((visibility("default"))) PyObject *

extern PyTypeObject PyFloat_Type;
extern PyObject *PyExc_MemoryError, *PyExc_TypeError, *PyExc_ValueError;
unsigned long PyType_GetFlags(PyTypeObject *);
int PyType_IsSubtype(PyTypeObject *, PyTypeObject *);
double PyFloat_AsDouble(PyObject *);
long long PyLong_AsLongLongAndOverflow(PyObject *, int *);
double PyLong_AsDouble(PyObject *);
PyObject *PyLong_FromLongLong(long long);
int PyObject_GetBuffer(PyObject *, Py_buffer *, int);
void PyBuffer_Release(Py_buffer *);
PyObject *PyImport_ImportModule(const char *);
PyObject *PyObject_GetAttrString(PyObject *, const char *);
PyObject *PyObject_CallFunction(PyObject *, const char *, ...);
PyObject *PyObject_CallMethod(PyObject *, const char *, const char *, ...);
PyObject *PySequence_GetSlice(PyObject *, Py_ssize_t, Py_ssize_t);
PyObject *PyTuple_New(Py_ssize_t);
int PyTuple_SetItem(PyObject *, Py_ssize_t, PyObject *);
PyObject *PyErr_Occurred(void);
void PyErr_Clear(void);
int PyErr_ExceptionMatches(PyObject *);
PyObject *PyErr_Format(PyObject *, const char *, ...);
void *PyEval_SaveThread(void);
void PyEval_RestoreThread(void *);
PyObject *PyModule_Create2(struct PyModuleDef *, int);
int PyModule_AddIntConstant(PyObject *, const char *, long);
void Py_IncRef(PyObject *);
void Py_DecRef(PyObject *);

#define PyFloat_Check(object) \
    ((object)->ob_type == &PyFloat_Type || PyType_IsSubtype((object)->ob_type, &PyFloat_Type))
#define PyLong_Check(object) ((PyType_GetFlags((object)->ob_type) >> 24) & 1)
#define PyBytes_Check(object) ((PyType_GetFlags((object)->ob_type) >> 27) & 1)
#define PyModule_Create(definition) PyModule_Create2(definition, ABI_VERSION)
#define Py_XDECREF(object) Py_DecRef(object)
#define Py_CLEAR(object) (Py_DecRef(object), (object) = NULL)
#define Py_BEGIN_ALLOW_THREADS { void *_save = PyEval_SaveThread();
#define Py_END_ALLOW_THREADS PyEval_RestoreThread(_save); }

#endif
