"""Differentiable, vectorised MPS (Moving Particle Semi-implicit) for incompressible free-surface flow, in JAX."""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from jaxmps import casefile as casefile
    from jaxmps import cases as cases
    from jaxmps import diagnostics as diagnostics
    from jaxmps import io as io
    from jaxmps import models as models
    from jaxmps import motion as motion
    from jaxmps import operators as operators
    from jaxmps import plotting as plotting
    from jaxmps import pressure as pressure
    from jaxmps import schemes as schemes
    from jaxmps.ensembles import ensemble as ensemble
    from jaxmps.flow import Box as Box
    from jaxmps.flow import Case as Case
    from jaxmps.flow import Fluid as Fluid
    from jaxmps.flow import Kind as Kind
    from jaxmps.flow import Outcome as Outcome
    from jaxmps.flow import Particles as Particles
    from jaxmps.flow import SimulationError as SimulationError
    from jaxmps.flow import SimulationWarning as SimulationWarning
    from jaxmps.flow import Status as Status
    from jaxmps.io import gather as gather
    from jaxmps.io import read as read
    from jaxmps.monitor import StepInfo as StepInfo
    from jaxmps.results import Ensemble as Ensemble
    from jaxmps.results import Run as Run
    from jaxmps.running import resume as resume
    from jaxmps.running import rollout as rollout
    from jaxmps.running import simulate as simulate
    from jaxmps.running import start as start
    from jaxmps.scheme import Scheme as Scheme
    from jaxmps.stepping import State as State
    from jaxmps.stepping import step as step
    from jaxmps.tuning import AbstractEstimator as AbstractEstimator
    from jaxmps.tuning import Evolution as Evolution
    from jaxmps.tuning import Forward as Forward
    from jaxmps.tuning import History as History
    from jaxmps.tuning import Pathwise as Pathwise
    from jaxmps.tuning import tune as tune

__version__ = "0.1.0"

# The same names, imported at their first use: `jaxmps --help` does not wait for JAX.
__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submodules=(
        "casefile",
        "cases",
        "diagnostics",
        "io",
        "models",
        "motion",
        "operators",
        "plotting",
        "pressure",
        "schemes",
    ),
    submod_attrs={
        "ensembles": ["ensemble"],
        "flow": [
            "Box",
            "Case",
            "Fluid",
            "Kind",
            "Outcome",
            "Particles",
            "SimulationError",
            "SimulationWarning",
            "Status",
        ],
        "io": ["gather", "read"],
        "monitor": ["StepInfo"],
        "results": ["Ensemble", "Run"],
        "running": ["resume", "rollout", "simulate", "start"],
        "scheme": ["Scheme"],
        "stepping": ["State", "step"],
        "tuning": ["AbstractEstimator", "Evolution", "Forward", "History", "Pathwise", "tune"],
    },
)
