"""Sizes of batches by the kind of device: blocks that fit a core's cache on a CPU, large ones on an accelerator.

An accelerator (GPU or TPU) runs a program kernel by kernel, and each takes some microseconds at least: it needs all
items of a batch at once, where a CPU is faster with a few thousand of them, whose data stay in its caches.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, TypeVar

import jax

T = TypeVar("T")


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def platform_of(devices: Sequence[Any] = ()) -> str:
    """Platform that programs run on ("cpu", "gpu", "tpu"): of the given devices, by default JAX's default device."""
    if devices:
        return devices[0].platform
    device: Any = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    if device is None:
        return jax.default_backend()
    return jax.devices(device)[0].platform if isinstance(device, str) else device.platform


def on_accelerator(devices: Sequence[Any] = ()) -> bool:
    """Whether programs run on an accelerator, see `platform_of`."""
    return platform_of(devices) != "cpu"


def by_device(cpu: T, accelerator: T, devices: Sequence[Any] = ()) -> T:
    """The value for the kind of device that a program is traced for."""
    return accelerator if on_accelerator(devices) else cpu
