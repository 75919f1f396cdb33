"""How many members of an ensemble run at a time."""

import os
from collections.abc import Sequence
from typing import Any

import psutil

from jaxmps.ensembles.members import Member
from jaxmps.flow import Case
from jaxmps.neighbors import SKIN, usual_capacity
from jaxmps.scheme import Scheme
from jaxmps.validation import positive, whole

_NUMBERS_PER_SLOT = 28
"""Numbers that a step holds at a time for each slot of the neighbor table; programs of all schemes take less."""


def sizes(
    member: Member, count: int, devices: Sequence[Any], batch: int | None, memory: float | None
) -> tuple[int, int]:
    """Members in a batch, over all devices, and batches at a time."""
    for_each = bytes_of(member.case, member.scheme)
    processors = devices[0].platform == "cpu"
    room = free_memory(devices) if memory is None else positive("memory", memory, "bytes")
    fitting = max(1, int(room // for_each))
    if batch is None:
        batch = 1 if processors else min(max(1, fitting // len(devices)), -(-count // len(devices)))
    size = whole("batch", batch, least=1) * len(devices)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return size, max(1, min(cores if size == 1 else 1, fitting, count))


def bytes_of(case: Case, scheme: Scheme) -> float:
    """About the memory [bytes] that a member takes while it runs."""
    slots = usual_capacity(scheme.ratio + SKIN, case.dim) * len(case.particles.kind)
    return float(_NUMBERS_PER_SLOT) * slots * case.particles.position.dtype.itemsize


def free_memory(devices: Sequence[Any]) -> float:
    """Most of the memory [bytes] that is free."""
    room = 0.0
    for device in devices:
        told = device.memory_stats() or {}
        if "bytes_limit" in told:
            room += told["bytes_limit"] - told.get("bytes_in_use", 0)
    return 0.8 * (room or psutil.virtual_memory().available)
