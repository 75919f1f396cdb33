"""What a run was made of, as plain values for files and tables."""

import dataclasses
import platform
from collections.abc import Iterator
from importlib import metadata
from typing import Any

import equinox as eqx
import jax
import numpy as np

UNITS = {
    "time": "s",
    "position": "m",
    "velocity": "m/s",
    "pressure": "Pa",
    "number_density": "1",
    "surface": "1",
    "kind": "1",
    "phase": "1",
    "density": "kg/m^3",
    "spacing": "m",
    "energy": "J/kg",
}
"""Of what a `Run` holds."""


def describe(module: eqx.Module) -> dict[str, Any]:
    """Every part and value of a module by its dotted name, such as `source.relaxation`; parts by their class."""
    return dict(_entries(module, ""))


def _entries(module: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(module):
        name, value = prefix + field.name, getattr(module, field.name)
        if isinstance(value, eqx.Module):
            yield name, type(value).__name__
            yield from _entries(value, name + ".")
        elif isinstance(value, jax.Array | np.ndarray):
            yield name, np.asarray(value).tolist()
        else:
            yield name, value


def versions() -> dict[str, str]:
    """Versions of what the numbers of a run may depend on, and the device that made them."""
    packages = ("jaxmps", "jax", "jaxlib", "jax-md", "equinox", "numpy", "h5py")
    found = {package: _version(package) for package in packages}
    device = jax.devices()[0]
    return {**found, "python": platform.python_version(), "device": f"{device.platform}: {device.device_kind}"}


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
