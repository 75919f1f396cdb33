"""The pressure Poisson equation: its matrix, its solution, and how that is preconditioned."""

from jaxmps.pressure.equation import PoissonOperator as PoissonOperator
from jaxmps.pressure.equation import PressureEquation as PressureEquation
from jaxmps.pressure.equation import poisson_operator as poisson_operator
from jaxmps.pressure.equation import solve_pressure as solve_pressure
from jaxmps.pressure.linear import SOLUTION as SOLUTION
from jaxmps.pressure.linear import AbstractOperator as AbstractOperator
from jaxmps.pressure.linear import AbstractPreconditioner as AbstractPreconditioner
from jaxmps.pressure.linear import Convergence as Convergence
from jaxmps.pressure.preconditioning import AbstractPreconditioning as AbstractPreconditioning
from jaxmps.pressure.preconditioning import ByDiagonal as ByDiagonal
from jaxmps.pressure.preconditioning import ByMultigrid as ByMultigrid
