"""How XLA compiles what the library compiles itself; within a jit of the caller's, the caller says."""

from typing import Any

from jaxlib.version import __version_info__ as version

# Until 0.10 jaxlib can emit CPU kernels in two ways. The other one than the default takes half the time to compile, and
# the kernels are as fast.
COMPILER_OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False} if version < (0, 11) else {}
