"""The differential operators of MPS as sums over the neighbor table."""

from jaxmps.operators.density import number_density as number_density
from jaxmps.operators.density import pair_weight as pair_weight
from jaxmps.operators.gradient import AbstractGradient as AbstractGradient
from jaxmps.operators.gradient import MinPressure as MinPressure
from jaxmps.operators.laplacian import laplacian as laplacian
