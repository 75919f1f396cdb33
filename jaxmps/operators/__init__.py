"""The differential operators of MPS as sums over the neighbor table."""

from jaxmps.operators.density import density_rate as density_rate
from jaxmps.operators.density import number_density as number_density
from jaxmps.operators.density import pair_weight as pair_weight
from jaxmps.operators.gradient import CMPS as CMPS
from jaxmps.operators.gradient import AbstractGradient as AbstractGradient
from jaxmps.operators.gradient import Corrected as Corrected
from jaxmps.operators.gradient import MinPressure as MinPressure
from jaxmps.operators.gradient import divergence as divergence
from jaxmps.operators.laplacian import AbstractLaplacian as AbstractLaplacian
from jaxmps.operators.laplacian import HigherOrderLaplacian as HigherOrderLaplacian
from jaxmps.operators.laplacian import KernelLaplacian as KernelLaplacian
from jaxmps.operators.laplacian import laplacian as laplacian
