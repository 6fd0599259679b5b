/* What rths_sfunction.c needs of Simulink, written for the tests after the names in MathWorks' documentation: one block
   with its ports and work vector in memory. */

#ifndef SIMSTRUC_H
#define SIMSTRUC_H

#include <stdlib.h>

typedef double real_T;
typedef int int_T;
enum { SS_DOUBLE = 0, PORTS = 8, WIDE = 64 };

typedef struct {
  int_T inputs, outputs, input_width[PORTS], output_width[PORTS], works, work_width, parameters;
  real_T input[PORTS][WIDE], output[PORTS][WIDE], *work, period, offset;
} SimStruct;

static int_T ssSetNumInputPorts(SimStruct *S, int_T n) { S->inputs = n; return 1; }
static int_T ssSetNumOutputPorts(SimStruct *S, int_T n) { S->outputs = n; return 1; }
#define ssSetNumSFcnParams(S, n) ((S)->parameters = (n))
#define ssGetNumSFcnParams(S) ((S)->parameters)
#define ssGetSFcnParamsCount(S) 0
#define ssSetInputPortWidth(S, i, n) ((S)->input_width[i] = (n))
#define ssSetInputPortDirectFeedThrough(S, i, n) ((void)(n))
#define ssSetInputPortRequiredContiguous(S, i, n) ((void)(n))
#define ssSetOutputPortWidth(S, i, n) ((S)->output_width[i] = (n))
#define ssSetNumSampleTimes(S, n) ((void)(n))
#define ssSetNumDWork(S, n) ((S)->works = (n))
#define ssSetDWorkWidth(S, i, n) ((S)->work_width = (n))
#define ssSetDWorkDataType(S, i, n) ((void)(n))
#define ssSetSampleTime(S, i, t) ((S)->period = (t))
#define ssSetOffsetTime(S, i, t) ((S)->offset = (t))
#define ssGetDWork(S, i) ((void *)(S)->work)
#define ssGetInputPortRealSignal(S, i) ((const real_T *)(S)->input[i])
#define ssGetOutputPortRealSignal(S, i) ((S)->output[i])

#endif
