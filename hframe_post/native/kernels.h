/* Definitions that the compiled loops share. All give the same bits on every machine: no fused
 * multiply-add, no -ffast-math. The caller allocates all arrays. module.c makes them functions of
 * Python. */

#ifndef HFRAME_KERNELS_H
#define HFRAME_KERNELS_H

#include <math.h>
#include <stdint.h>

#include "arguments.h"

#define BUILT_FOR 40 /* as in __init__.py: raised whenever a signature changes */

/* WIDE functions are compiled for wider registers, too, with all that is INSIDE them; the processor
 * chooses. Only sums that do not depend on each other share a register: the bits are the same. */
#if defined(__x86_64__) && defined(__GLIBC__)
#define WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#define INSIDE static inline __attribute__((always_inline))
#else
#define WIDE
#define INSIDE static inline
#endif

enum { X, Y, Z, E, COLUMNS }; /* of a position */
enum { NEAREST = 24 }; /* samples to either side in which the path's nearest point is sought */
#define TS 1e-3 /* s from sample to sample, as in arrays.py */

static inline double greater(double a, double b) { return a > b ? a : b; }
static inline double lesser(double a, double b) { return a < b ? a : b; }
static inline double between(double x, double least, double most) { return lesser(greater(x, least), most); }

/* Return the lesser, or the one that is a number: fmin would be called for each. */
INSIDE double lesser_number(double a, double b)
{
    double low = lesser(a, b);
    return b == b ? low : a;
}

/* Return the square of the speed on an arc that is tangent to both moves of a junction and misses it by a
 * deviation, here times the acceleration; cosine: of the angle between the way back and the way on. */
INSIDE double on_arc(double cosine, double deviation)
{
    double sin_half = sqrt(0.5 * (1.0 - cosine));
    return deviation * sin_half / (1.0 - sin_half);
}

/* The same for Klipper, where the arc must fit into half of each move. x, y, z: products of their
 * directions; turn, fit: deviation and half the length, times the acceleration. */
INSIDE double klipper_corner(double x, double y, double z, double turn, double fit)
{
    double cosine = between(-(x + y + z), -1.0, 1.0);
    return lesser_number(on_arc(cosine, turn), fit * sqrt(0.5 * (1.0 - cosine)) / sqrt(0.5 * (1.0 + cosine)));
}

#endif
