"""What a run was made of, as plain values for files and tables."""

import dataclasses
import hashlib
import html
import platform
from collections.abc import Iterator, Mapping
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
    for name, value in _fields(module, prefix):
        if isinstance(value, eqx.Module):
            yield name, type(value).__name__
        else:
            yield name, np.asarray(value).tolist() if isinstance(value, jax.Array | np.ndarray) else value


def _fields(module: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(module):
        name, value = prefix + field.name, getattr(module, field.name)
        yield name, value
        if isinstance(value, eqx.Module):
            yield from _fields(value, name + ".")


def fingerprint(module: eqx.Module) -> dict[str, str]:
    """Every part and value of a module by its dotted name, exactly, in a few words each: equal where results are.

    A number is told as it is, an array by its type, its shape and the beginning of its SHA-256 sum.
    """
    return {name: _exactly(value) for name, value in _fields(module, "")}


def differences(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """In words, in what two fingerprints differ: short values first, which say more than the sums of arrays."""
    names = [name for name in {**then, **now} if then.get(name) != now.get(name)]
    found = [f"{name} was {then.get(name, 'nothing')} and is {now.get(name, 'nothing')}" for name in names]
    return sorted(found, key=len)


def _exactly(value: Any) -> str:
    if not isinstance(value, jax.Array | np.ndarray):
        return type(value).__qualname__ if isinstance(value, eqx.Module) else repr(value)
    array = np.asarray(value)
    if array.size <= 4:
        return f"{array.tolist()} ({array.dtype})"
    digest = hashlib.sha256(array.tobytes()).hexdigest()
    return f"{array.dtype}{list(array.shape)} {digest[:16]}"


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


def table(title: str, rows: Mapping[str, Any]) -> str:
    """A small table of names and values, as HTML."""
    cells = "".join(
        f'<tr><th style="text-align:left">{html.escape(str(name))}</th>'
        f'<td style="text-align:left">{html.escape(_shown(value))}</td></tr>'
        for name, value in rows.items()
    )
    return f"<table><caption><b>{html.escape(title)}</b></caption>{cells}</table>"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
