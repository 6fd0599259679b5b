/* The step as a level-2 S-function: mex rths_sfunction.c rths_step.c rths_data.c

   Inputs: samples (V), ground motion (m/s^2, m/s, m), flags came, start, stop.
   Outputs: command (V); state, reason, channel, row, lost; desired motion (m/s^2, m/s, m); corrected samples; base shear
   (N); numbers of case and model. The row of an output is that of the ground motion for the next sample. */

#define S_FUNCTION_NAME rths_sfunction
#define S_FUNCTION_LEVEL 2

#include <string.h>

#include "rths_step.h"
#include "simstruc.h"

enum { SAMPLES, GROUND, FLAGS, INPUTS };
enum { COMMAND, STATE, DESIRED, CORRECTED, SHEAR, CHECKSUMS, OUTPUTS };
static const int_T input_width[INPUTS] = {RTHS_CHANNELS, 3, 3};
static const int_T output_width[OUTPUTS] = {1, 5, 3, RTHS_CHANNELS, 1, 2};

static void mdlInitializeSizes(SimStruct *S)
{
  int_T i;
  ssSetNumSFcnParams(S, 0);
  if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S)) return;
  if (!ssSetNumInputPorts(S, INPUTS) || !ssSetNumOutputPorts(S, OUTPUTS)) return;
  for (i = 0; i < INPUTS; i++) {
    ssSetInputPortWidth(S, i, input_width[i]);
    ssSetInputPortDirectFeedThrough(S, i, 1);
    ssSetInputPortRequiredContiguous(S, i, 1);
  }
  for (i = 0; i < OUTPUTS; i++) ssSetOutputPortWidth(S, i, output_width[i]);
  ssSetNumSampleTimes(S, 1);
  ssSetNumDWork(S, 1);
  ssSetDWorkWidth(S, 0, (int_T)((sizeof(rths_state) + sizeof(real_T) - 1) / sizeof(real_T)));
  ssSetDWorkDataType(S, 0, SS_DOUBLE);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
  ssSetSampleTime(S, 0, rths_data.dt_s);
  ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_START
static void mdlStart(SimStruct *S)
{
  rths_reset((rths_state *)ssGetDWork(S, 0));
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
  const real_T *flags = ssGetInputPortRealSignal(S, FLAGS);
  real_T *told = ssGetOutputPortRealSignal(S, STATE), *sums = ssGetOutputPortRealSignal(S, CHECKSUMS);
  rths_inputs in;
  rths_outputs out;
  (void)tid;
  memcpy(in.samples_v, ssGetInputPortRealSignal(S, SAMPLES), sizeof in.samples_v);
  memcpy(in.ground, ssGetInputPortRealSignal(S, GROUND), sizeof in.ground);
  in.came = flags[0] != 0.0;
  in.start = flags[1] != 0.0;
  in.stop = flags[2] != 0.0;
  rths_step((rths_state *)ssGetDWork(S, 0), &in, &out);
  *ssGetOutputPortRealSignal(S, COMMAND) = out.command_v;
  told[0] = out.state;
  told[1] = out.reason;
  told[2] = out.channel;
  told[3] = out.row;
  told[4] = out.lost;
  memcpy(ssGetOutputPortRealSignal(S, DESIRED), out.desired, sizeof out.desired);
  memcpy(ssGetOutputPortRealSignal(S, CORRECTED), out.corrected, sizeof out.corrected);
  *ssGetOutputPortRealSignal(S, SHEAR) = out.base_shear_n;
  sums[0] = out.case_number;
  sums[1] = out.model_number;
}

static void mdlTerminate(SimStruct *S) { (void)S; }

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
