/* What the compiled loops share. Each does what a function of the package does with numpy, named
 * in its file, by the same operations in the same order: both give the same bits. So no fused
 * multiply-add, no -ffast-math. Room for results is the caller's; nothing is allocated here. */

#ifndef HFRAME_KERNELS_H
#define HFRAME_KERNELS_H

#include <math.h>
#include <stdint.h>

#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

#define BUILT_FOR 3 /* as in kernels.py: raised whenever a signature changes */

enum { X, Y, Z, E, COLUMNS }; /* of a place */

static inline double greater(double a, double b) { return a > b ? a : b; }
static inline double lesser(double a, double b) { return a < b ? a : b; }

#endif
