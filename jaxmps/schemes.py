"""The named schemes, those of the papers: each a choice of one model of each kind.

All in one file, longer than others, so that they are read side by side.
"""

import dataclasses

from jaxmps._types import ArrayLike, as_array
from jaxmps.models import (
    CorrectedDivergence,
    DensityDeviation,
    DensityThreshold,
    DriftFreeVelocity,
    DynamicStabilization,
    HalfSpacing,
    HigherOrderSource,
    Inviscid,
    NoCollision,
    NoNoise,
    OneSided,
    OwnDensity,
    PairCollision,
    PairedDensity,
    StochasticVelocity,
    Viscous,
)
from jaxmps.operators import CMPS, Corrected, MinPressure
from jaxmps.scheme import Scheme, TimeStep
from jaxmps.validation import between, fixed


def mps(
    *,
    relaxation: ArrayLike = 0.2,
    beta: ArrayLike = 0.97,
    collision_distance: ArrayLike = 0.9,
    restitution: ArrayLike = 0.2,
    courant: ArrayLike = 0.2,
    viscous: bool = True,
    clip_pressure: bool = True,
    ratio: float = 2.1,
    tolerance: float = 1e-4,
) -> Scheme:
    """The standard MPS method ([N11] §2; Koshizuka & Oka 1996) with relaxed source and pair collisions.

    `relaxation` γ of the PPE source (0 to 1), `beta` of the free surface (0 to 1), collisions closer than
    `collision_distance` l0 (0 to 1) with `restitution` (0 to 1), Courant number `courant` (0 to 1). Fluids have the
    viscosity of the case, unless `viscous` is false. `ratio` is r_e / l0 (1.5 to 6), `tolerance` that of the pressure
    solve. Raises `ValueError` for a value out of its range.
    """
    unit = {
        "relaxation": relaxation,
        "beta": beta,
        "collision_distance": collision_distance,
        "restitution": restitution,
        "courant": courant,
    }
    for argument, value in unit.items():
        between(argument, value, 0.0, 1.0)
    between("ratio", fixed("ratio", ratio), 1.5, 6.0, "spacings")
    between("tolerance", fixed("tolerance", tolerance), 1e-15, 0.1)
    return Scheme(
        viscosity=Viscous() if viscous else Inviscid(),
        noise=NoNoise(),
        free_surface=DensityThreshold(beta),
        source=DensityDeviation(relaxation),
        gradient=MinPressure(),
        collision=PairCollision(collision_distance, restitution),
        time_step=TimeStep(courant),
        clip_pressure=clip_pressure,
        ratio=ratio,
        tolerance=tolerance,
        name="mps",
    )


def cmps_hs(
    *,
    beta: ArrayLike = 0.97,
    collision_distance: ArrayLike = 0.9,
    restitution: ArrayLike = 0.2,
    courant: ArrayLike = 0.1,
    own_density: bool = False,
    viscous: bool = True,
    ratio: float = 2.1,
    tolerance: float = 1e-4,
) -> Scheme:
    """CMPS-HS ([T13] §3.2): antisymmetric gradient, every pair repels, pressure not below zero; higher-order source.

    Collisions closer than `collision_distance` l0 (0 to 1) with `restitution` (0 to 1) are not in the paper; without
    them bursts of velocity end a run of two fluids within 0.2 s. The other arguments are those of `mps_hs_gc`. With
    `own_density` pressure forces conserve momentum at any densities, with paired densities only where they are equal.
    """
    between("collision_distance", collision_distance, 0.0, 1.0)
    between("restitution", restitution, 0.0, 1.0)
    return dataclasses.replace(
        mps_hs_gc(
            beta=beta, courant=courant, own_density=own_density, viscous=viscous, ratio=ratio, tolerance=tolerance
        ),
        gradient=CMPS(),
        collision=PairCollision(collision_distance, restitution),
        clip_pressure=True,
        name="cmps_hs",
    )


def mps_hs_gc(
    *,
    beta: ArrayLike = 0.97,
    courant: ArrayLike = 0.1,
    own_density: bool = False,
    viscous: bool = True,
    ratio: float = 2.1,
    tolerance: float = 1e-4,
) -> Scheme:
    """MPS-HS-GC ([T13] §3.2): corrected gradient, which attracts under tension, and higher-order source. It breaks up.

    `beta` of the free surface (0 to 1), Courant number `courant` (0 to 1); `own_density` divides the pressure gradient
    by the particle's own density, as printed in [T13] Eq. 11, instead of that of each pair; without `viscous` the
    viscosity of the case has no effect, as in the papers. `ratio` is r_e / l0 (1.5 to 6), `tolerance` that of the
    pressure solve. Raises `ValueError` for a value out of its range.
    """
    between("beta", beta, 0.0, 1.0)
    between("courant", courant, 0.0, 1.0)
    between("ratio", fixed("ratio", ratio), 1.5, 6.0, "spacings")
    between("tolerance", fixed("tolerance", tolerance), 1e-15, 0.1)
    return Scheme(
        viscosity=Viscous() if viscous else Inviscid(),
        noise=NoNoise(),
        free_surface=DensityThreshold(beta),
        source=HigherOrderSource(),
        gradient=Corrected(),
        collision=NoCollision(),
        interface=OwnDensity() if own_density else PairedDensity(),
        time_step=TimeStep(courant),
        clip_pressure=False,
        ratio=ratio,
        tolerance=tolerance,
        name="mps_hs_gc",
    )


def mps_hs_gc_ds(
    *,
    alpha_ds: ArrayLike | None = None,
    beta: ArrayLike = 0.97,
    courant: ArrayLike = 0.1,
    own_density: bool = False,
    viscous: bool = True,
    ratio: float = 2.1,
    tolerance: float = 1e-4,
) -> Scheme:
    """MPS-HS-GC-DS ([T13] §2): MPS-HS-GC with dynamic stabilization, as published.

    `alpha_ds` in spacings (0 to 1.2), by default 1 − `courant` ([T13] Eq. 9); the others are those of `mps_hs_gc`.
    """
    return dataclasses.replace(
        mps_hs_gc(
            beta=beta, courant=courant, own_density=own_density, viscous=viscous, ratio=ratio, tolerance=tolerance
        ),
        stabilizer=_stabilizer(alpha_ds, courant),
        name="mps_hs_gc_ds",
    )


def mps_cd_gc_ds(
    *,
    alpha_ds: ArrayLike | None = None,
    kept_velocity: ArrayLike = 0.2,
    restoring: ArrayLike = 0.03,
    courant: ArrayLike = 0.1,
    own_density: bool = False,
    viscous: bool = True,
    ratio: float = 2.1,
    tolerance: float = 1e-4,
) -> Scheme:
    """MPS-HS-GC-DS with four changes that keep the pressure free of noise and the surface whole. Not published.

    The source is the divergence of the corrected gradient instead of HS, with the density restored by the fraction
    `restoring` in each step (0 to 1; zero for a body under tension, see `CorrectedDivergence`, CD); surface particles
    are told by the one-sidedness of their neighbors (`OneSided`); the pressure is zero half a spacing outside them
    (`HalfSpacing`); and particles keep only the part `kept_velocity` (0 to 1) of the velocity of the stabilizing
    displacement. The other arguments are those of `mps_hs_gc_ds`.
    """
    between("kept_velocity", kept_velocity, 0.0, 1.0)
    between("restoring", restoring, 0.0, 1.0)
    return dataclasses.replace(
        mps_hs_gc(courant=courant, own_density=own_density, viscous=viscous, ratio=ratio, tolerance=tolerance),
        source=CorrectedDivergence(restoring),
        free_surface=OneSided(),
        surface_condition=HalfSpacing(),
        stabilizer=_stabilizer(alpha_ds, courant, kept_velocity),
        name="mps_cd_gc_ds",
    )


def stochastic(scheme: Scheme, *, alpha: ArrayLike = 0.04, drift_free: bool = False) -> Scheme:
    """`scheme` with the stochastic velocity of [N11] §3, which gives back energy that the scheme loses.

    `alpha` (0 to 1) scales it; the paper takes 0.0009 to 0.003 in a dam break and 0.02 to 0.04 in a standing wave, and
    warns of 0.1 and more. With `drift_free` no momentum is added along periodic axes (see `DriftFreeVelocity`). Raises
    `ValueError` for a value out of its range.
    """
    between("alpha", alpha, 0.0, 1.0)
    noise = DriftFreeVelocity(alpha) if drift_free else StochasticVelocity(alpha)
    return dataclasses.replace(scheme, noise=noise, name=f"stochastic {scheme.name}")


def _stabilizer(alpha_ds: ArrayLike | None, courant: ArrayLike, kept_velocity: ArrayLike = 1.0) -> DynamicStabilization:
    between("courant", courant, 0.0, 1.0)
    alpha_ds = 1.0 - as_array(courant) if alpha_ds is None else alpha_ds
    between("alpha_ds", alpha_ds, 0.0, 1.2, "spacings")
    return DynamicStabilization(alpha_ds, kept_velocity)
