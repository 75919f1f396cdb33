"""Differentiable, vectorised MPS (Moving Particle Semi-implicit) for incompressible free-surface flow, in JAX."""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from jaxmps import casefile as casefile
    from jaxmps import cases as cases
    from jaxmps import diagnostics as diagnostics
    from jaxmps import io as io
    from jaxmps import motion as motion
    from jaxmps import operators as operators
    from jaxmps import plotting as plotting
    from jaxmps import schemes as schemes
    from jaxmps.box import Box as Box
    from jaxmps.case import Case as Case
    from jaxmps.ensembles import ensemble as ensemble
    from jaxmps.estimators import AbstractEstimator as AbstractEstimator
    from jaxmps.estimators import Evolution as Evolution
    from jaxmps.estimators import Forward as Forward
    from jaxmps.estimators import Pathwise as Pathwise
    from jaxmps.io import gather as gather
    from jaxmps.io import read as read
    from jaxmps.monitor import StepInfo as StepInfo
    from jaxmps.particles import Fluid as Fluid
    from jaxmps.particles import Kind as Kind
    from jaxmps.particles import Particles as Particles
    from jaxmps.restart import resume as resume
    from jaxmps.run import Run as Run
    from jaxmps.runs import Ensemble as Ensemble
    from jaxmps.scheme import Scheme as Scheme
    from jaxmps.simulation import simulate as simulate
    from jaxmps.simulation import start as start
    from jaxmps.status import Outcome as Outcome
    from jaxmps.status import SimulationError as SimulationError
    from jaxmps.status import SimulationWarning as SimulationWarning
    from jaxmps.status import Status as Status
    from jaxmps.stepping import State as State
    from jaxmps.stepping import step as step
    from jaxmps.tuning import History as History
    from jaxmps.tuning import tune as tune
    from jaxmps.unrolling import rollout as rollout

__version__ = "0.1.0"

# The same names, imported at their first use: `jaxmps --help` does not wait for JAX.
__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submodules=("casefile", "cases", "diagnostics", "io", "motion", "operators", "plotting", "schemes"),
    submod_attrs={
        "box": ["Box"],
        "case": ["Case"],
        "ensembles": ["ensemble"],
        "estimators": ["AbstractEstimator", "Evolution", "Forward", "Pathwise"],
        "io": ["gather", "read"],
        "monitor": ["StepInfo"],
        "particles": ["Fluid", "Kind", "Particles"],
        "restart": ["resume"],
        "run": ["Run"],
        "runs": ["Ensemble"],
        "scheme": ["Scheme"],
        "simulation": ["simulate", "start"],
        "status": ["Outcome", "SimulationError", "SimulationWarning", "Status"],
        "stepping": ["State", "step"],
        "tuning": ["History", "tune"],
        "unrolling": ["rollout"],
    },
)
