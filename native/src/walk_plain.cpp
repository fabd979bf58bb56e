#define INSTRUCTION_SET plain
#include "kernels.inc"
