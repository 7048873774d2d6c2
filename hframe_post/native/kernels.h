/* Definitions that the compiled loops share. Each loop does what a numpy function of the package
 * does, by the same operations in the same order, so both give the same bits: no fused
 * multiply-add, no -ffast-math. The caller allocates all arrays. module.c makes them functions of
 * Python. */

#ifndef HFRAME_KERNELS_H
#define HFRAME_KERNELS_H

#include <math.h>
#include <stdint.h>

#include "arguments.h"

#define BUILT_FOR 7 /* as in __init__.py: raised whenever a signature changes */

/* WIDE functions are compiled for wider registers, too, with all that is INSIDE them; the processor
 * chooses. Only sums that do not depend on each other share a register: the bits are the same. */
#if defined(__x86_64__) && defined(__GLIBC__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#define INSIDE static inline __attribute__((always_inline))
#else
#define WIDE
#define INSIDE static inline
#endif

enum { X, Y, Z, E, COLUMNS }; /* of a position */

static inline double greater(double a, double b) { return a > b ? a : b; }
static inline double lesser(double a, double b) { return a < b ? a : b; }

#endif
