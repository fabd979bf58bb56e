"""Options with which XLA compiles in the least time: for what is run once."""

from __future__ import annotations

import platform

# What has to be compiled is not optimised: that takes a quarter of the time, and it rounds differently, so that nothing
# comes to hang on how one compiler does. With XLA_FLAGS in the environment, be it empty, tests run what users run.
QUICK_TO_COMPILE = (
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
    # Without passes that are slow, as in `jaxgeo._compile`.
    " --xla_disable_hlo_passes=while-loop-invariant-code-motion,simplify-while-loops,tree_reduction_rewriter"
)
# Without optimisation, XLA of jaxlib 0.10 gives wrong numbers with AVX2, not the same ones every time.
if platform.machine() in ("x86_64", "AMD64"):
    QUICK_TO_COMPILE += " --xla_cpu_max_isa=SSE4_2"
