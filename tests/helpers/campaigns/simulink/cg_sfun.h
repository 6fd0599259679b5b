/* Runs the block of rths_sfunction.c as Simulink does: sizes, sample times, start, outputs. Prints its ports, then state
   and command of each of argv[1] samples of a table that rests and is started, and at the last sample is no number. */

#include <math.h>
#include <stdio.h>

int main(int count, char **words)
{
  static SimStruct block;
  const int_T steps = count > 1 ? atoi(words[1]) : 0;
  mdlInitializeSizes(&block);
  mdlInitializeSampleTimes(&block);
  block.work = calloc((size_t)block.work_width, sizeof(real_T));
  mdlStart(&block);
  printf("%d %d %d %d %g\n", block.inputs, block.input_width[0], block.outputs, block.output_width[3], block.period);
  for (int_T k = 0; k < steps; k++) {
    block.input[2][0] = block.input[2][1] = 1.0;
    if (k == steps - 1) block.input[0][0] = (real_T)NAN;
    mdlOutputs(&block, 0);
    printf("%g %g %.17g\n", block.output[1][0], block.output[1][1], block.output[0][0]);
  }
  mdlTerminate(&block);
  free(block.work);
  return 0;
}
