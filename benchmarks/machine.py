"""What the measurements were made on."""

import os
import platform
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from benchmarks.timing import compiled

_FLOATS, _PASSES = 2**26, 20


def describe() -> dict[str, Any]:
    """Processor, memory and whether glibc asks for large pages, software and the bandwidth of a copy [GB/s]."""
    return {
        "processor": _processor(),
        "cores": _cores(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "large_pages": "glibc.malloc.hugetlb=1" in os.environ.get("GLIBC_TUNABLES", ""),
        "os": platform.platform(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "device": jax.devices()[0].device_kind,
        "backend": jax.default_backend(),
        "copy_gb_per_s": copy_bandwidth(),
    }


def copy_bandwidth(turns: int = 5) -> float:
    """Bytes read and written per second [GB/s] by x ← a x on an array of 256 MB, the best of some turns.

    The passes are repeated inside one compiled call, so that no page is touched for the first time. XLA does not split
    such a loop among the cores of a CPU: there each core has an array of its own, smaller by their number.
    """
    workers = _cores() if jax.default_backend() == "cpu" else 1
    arrays = [jnp.full(_FLOATS // workers, float(worker), jnp.float32) for worker in range(workers)]
    scale = jnp.float32(1.0 + 1e-6)
    kernel = compiled(lambda x, a: jax.lax.fori_loop(0, _PASSES, lambda _, y: a * y, x), arrays[0], scale)
    moved = 2 * _PASSES * sum(x.nbytes for x in arrays)
    best = 0.0
    with ThreadPoolExecutor(workers) as pool:
        for _ in range(turns):
            began = time.perf_counter()
            list(pool.map(lambda x: kernel(x, scale), arrays))
            best = max(best, moved / (time.perf_counter() - began) / 1e9)
    return best


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
