"""A model of the bytes that a step moves: each pass over the table of pairs reads its inputs and writes its results
once, whole arrays, as their shapes and item sizes say; what is gathered counts once, as if it stayed in the cache.

Passes of a step, with n particles, k slots, d dimensions, floats of s bytes and indices of i bytes, per slot:

- list, in each rebuild: index i written; per particle the (3 (r_e + skin) / l0)^d candidates of the cells around it
  read, i + d s each.
- pairs, twice: list read (i); j, r_ij, distance and presence written (i + d s + s + 1).
- collisions: these four read.
- weight and number density: distance and presence read, weight written (2 s + 1).
- matrix: j and weight read, j and coupling written in the order of the solver (2 (i + s)).
- preconditioner: coupling and r_ij read (s + d s), its own arrays written.
- each product with the matrix: j and coupling read (i + s).
- gradient: j and weight for the minimum, then j, weight, distance and r_ij (2 i + 3 s + d s).
- report: distance and presence read (s + 1).

With each product the preconditioner is applied once and reads its arrays twice, on the way down and up again, and 16 s
are moved per particle: x, diagonal and result, and the vectors of conjugate gradients. The other passes read and write
fields of the particles, position, velocity and pressure, 12 (d + 1) s in all. XLA fuses passes and then moves less;
gathers that miss the cache move more.
"""

import jax

import jaxmps as mps
from benchmarks.equation import prediction
from jaxmps.stepping import pressure_equation


def bytes_per_product(state: mps.State) -> float:
    """The bytes of one product with the matrix: j, coupling, diagonal and x read, the result written."""
    pressure, idx = state.particles.pressure, state.neighbors.table.idx
    s, i = pressure.dtype.itemsize, idx.dtype.itemsize
    return pressure.size * (state.neighbors.capacity * (i + s) + 3 * s)


def bytes_per_step(case: mps.Case, scheme: mps.Scheme, state: mps.State, products: float, rebuilds: float) -> float:
    """The bytes that a step reads and writes with so many products with the matrix and rebuilds of the list."""
    near = jax.eval_shape(prediction, case, scheme, state).near
    equation = jax.eval_shape(lambda *flow: pressure_equation(case, scheme, prediction(*flow)), case, scheme, state)
    own = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(equation.preconditioner))
    (n, slots), dim = near.j.shape, case.dim
    s, i = near.distance.dtype.itemsize, near.j.dtype.itemsize
    reach = scheme.ratio + state.neighbors.skin / case.spacing
    rebuild = n * ((3.0 * reach) ** dim * (i + dim * s) + slots * i)
    pairs = i + dim * s + s + 1
    explicit = 2 * (i + pairs) + pairs + (2 * s + 1)
    implicit = 2 * (i + s) + (s + dim * s) + (2 * i + 3 * s + dim * s) + (s + 1)
    product = bytes_per_product(state) + 13 * n * s + 2 * own
    return rebuilds * rebuild + n * (slots * (explicit + implicit) + 12 * (dim + 1) * s) + own + products * product
