"""Which particles lie on the free surface, where the pressure is zero."""

import abc

import equinox as eqx
from jaxtyping import Array, Bool, Float

from jaxmps._types import Scalar, as_array


class AbstractFreeSurface(eqx.Module):
    """A detector of free-surface particles."""

    @abc.abstractmethod
    def __call__(self, n: Float[Array, " n"], n0: float) -> Bool[Array, " n"]:
        """Whether each particle lies on the surface, from its number density n."""


class DensityThreshold(AbstractFreeSurface):
    """n_i < β n0 ([N11] Eq. 12; Koshizuka & Oka 1996, β = 0.97). A mask: its derivative in β is zero.

    With r_e = 2.1 l0 it flags the outermost row alone (n / n0 = 0.68, the next row has 0.99); with larger radii the
    second and third row as well, so n is best computed with 2.1.
    """

    beta: Scalar = eqx.field(converter=as_array, default=0.97)

    def __call__(self, n, n0):
        return n < self.beta * n0
