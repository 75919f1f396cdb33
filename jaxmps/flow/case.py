"""A case: everything about a flow that is not a numerical method."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxmps._types import as_array
from jaxmps.flow.box import Box
from jaxmps.flow.motion import AbstractMotion, Still
from jaxmps.flow.particles import Fluid, Kind, Particles
from jaxmps.validation import fixed, positive


def _as_plain(parameters: tuple[tuple[str, Any], ...]) -> tuple[tuple[str, Any], ...]:
    """A description without arrays: what has a value only under a transformation is not told."""

    def plain(value: Any) -> Any:
        if isinstance(value, Tracer):
            return "under a transformation"
        return np.asarray(value).tolist() if isinstance(value, jax.Array) else value

    return tuple((name, plain(value)) for name, value in parameters)


class Case(eqx.Module):
    """Particles at t = 0, materials, gravity [m/s²], spacing l0 [m], domain and `motion` of the walls.

    `name` and `parameters` only describe the case in files and figures. Made by the functions in `jaxmps.cases`, or
    by hand from arrays; the arrays are checked, and `ValueError` names what is wrong with them.
    """

    particles: Particles
    fluids: Fluid
    gravity: Float[Array, " d"] = eqx.field(converter=as_array)
    spacing: float = eqx.field(static=True)
    box: Box
    name: str = eqx.field(static=True, default="custom")
    parameters: tuple[tuple[str, Any], ...] = eqx.field(static=True, default=(), converter=_as_plain)
    motion: AbstractMotion = eqx.field(default_factory=Still)

    def __check_init__(self):
        positive("spacing", fixed("spacing", self.spacing), "m")
        particles, box = self.particles, self.box
        if particles.position.ndim != 2 or particles.position.shape[1] != box.dim:
            raise ValueError(
                f"particles.position must have the shape (particles, {box.dim}) of its box, got "
                f"{particles.position.shape}"
            )
        if self.gravity.shape != (box.dim,):
            raise ValueError(f"gravity must have {box.dim} components, got {self.gravity.shape}")
        if self.fluids.density.shape != self.fluids.viscosity.shape:
            raise ValueError(
                "fluids.density and fluids.viscosity must have one entry for each phase, got "
                f"{self.fluids.density.shape} and {self.fluids.viscosity.shape}"
            )
        jax.eval_shape(self.motion.place, particles.position, jnp.zeros(()))
        _check_values(self)

    def undescribed(self) -> "Case":
        """Without `name` and `parameters`: cases that differ in these alone share what is compiled for one of them."""
        bare = object.__new__(Case)  # not checked again: under a transformation that is not possible
        for field in dataclasses.fields(self):
            object.__setattr__(bare, field.name, getattr(self, field.name))
        object.__setattr__(bare, "name", "custom")
        object.__setattr__(bare, "parameters", ())
        return bare

    @property
    def walls_move(self) -> bool:
        """Whether the case has a motion of its walls."""
        return not isinstance(self.motion, Still)

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return self.box.dim

    @property
    def density(self) -> Float[Array, " n"]:
        """Density of each particle [kg/m³]."""
        return self.fluids.density[self.particles.phase]

    @property
    def distinct_density(self) -> Float[Array, " #n"]:
        """`density`, or its only value where there is one fluid: nothing has to be read for each pair then."""
        return self.fluids.density if len(self.fluids.density) == 1 else self.density

    @property
    def distinct_viscosity(self) -> Float[Array, " #n"]:
        """The kinematic viscosity of each particle [m²/s], or its only value where there is one fluid."""
        viscosity = self.fluids.viscosity
        return viscosity if len(viscosity) == 1 else viscosity[self.particles.phase]


_KINDS = ", ".join(f"{kind} ({kind.name.lower()})" for kind in Kind)


def _check_values(case: Case) -> None:
    particles, fluids = case.particles, case.fluids
    count, dim = particles.position.shape
    if not count:
        raise ValueError("particles must be one at least, got none")
    shapes = {
        "position": (count, dim),
        "velocity": (count, dim),
        "pressure": (count,),
        "kind": (count,),
        "phase": (count,),
    }
    for name, shape in shapes.items():
        given, whole = getattr(particles, name), name in ("kind", "phase")
        if given.shape != shape:
            raise ValueError(f"particles.{name} must have the shape {shape}, got {given.shape}")
        if not jnp.issubdtype(given.dtype, jnp.integer if whole else jnp.floating):
            raise ValueError(
                f"particles.{name} must be {'whole' if whole else 'floating-point'} numbers, got {given.dtype}"
            )
    rules = {
        "fluids.density": (fluids.density, lambda x: x > 0, "greater than zero", "kg/m^3"),
        "fluids.viscosity": (fluids.viscosity, lambda x: x >= 0, "zero or greater", "m^2/s"),
        "gravity": (case.gravity, np.isfinite, "finite", "m/s^2"),
        "particles.velocity": (particles.velocity, np.isfinite, "finite", "m/s"),
        "particles.pressure": (particles.pressure, np.isfinite, "finite", "Pa"),
        "particles.kind": (particles.kind, lambda x: np.isin(x, list(Kind)), f"one of {_KINDS}", ""),
        "particles.phase": (
            particles.phase,
            lambda x: (x >= 0) & (x < fluids.density.size),
            f"between 0 and {fluids.density.size - 1}",
            "",
        ),
    }
    for name, (leaf, rule, words, unit) in rules.items():
        if isinstance(leaf, Tracer):
            continue  # under a transformation there are no values to check
        values = np.asarray(leaf)
        wrong = np.argwhere(~(rule(values) & np.isfinite(values)))
        if len(wrong):
            first, *_ = wrong.tolist()
            place = f" for particle {first[0]}" if name.startswith("particles") else f" in entry {first[0]}"
            raise ValueError(f"{name} must be {words}, got {values[tuple(first)]:g} {unit}".rstrip() + place)
    if isinstance(particles.position, Tracer) or isinstance(particles.kind, Tracer):
        return
    position, kind = np.asarray(particles.position), np.asarray(particles.kind)
    inside = np.asarray(case.box.contains(particles.position))
    outside = np.flatnonzero(~inside & (kind != Kind.REMOVED))
    if outside.size:
        place = tuple(position[outside[0]].tolist())
        raise ValueError(
            f"every particle must lie in the box from {case.box.lower} m to {case.box.upper} m, got particle "
            f"{outside[0]} at {place} m and {outside.size - 1} more"
        )
