"""Who is near whom: the neighbor table, the one door to jax-md's lists, and the pairs that sums run over."""

from jaxmps.neighbors.pairs import Pairs as Pairs
from jaxmps.neighbors.pairs import pairs as pairs
from jaxmps.neighbors.table import SKIN as SKIN
from jaxmps.neighbors.table import Neighbors as Neighbors
from jaxmps.neighbors.table import allocate as allocate
from jaxmps.neighbors.table import grow as grow
from jaxmps.neighbors.table import update as update
from jaxmps.neighbors.table import usual_capacity as usual_capacity
