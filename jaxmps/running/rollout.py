"""`rollout`: a fixed number of steps as a pure function, whose derivative needs memory for the root of their number."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, overload

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from jaxmps._compilation import jit
from jaxmps._types import ArrayLike
from jaxmps.flow import Case
from jaxmps.monitor import StepInfo
from jaxmps.pressure import SOLUTION
from jaxmps.running.checks import check_start
from jaxmps.scheme import Scheme
from jaxmps.stepping import State, largest_step, step
from jaxmps.validation import whole

T = TypeVar("T")


@overload
def rollout(
    case: Case,
    scheme: Scheme,
    start: State,
    *,
    steps: int,
    dt: ArrayLike | None = None,
    key: Key[Array, ""] | None = None,
    record: None = None,
    segment: int | None = None,
    window: int | None = None,
    from_case: bool = False,
) -> tuple[State, StepInfo]: ...
@overload
def rollout(
    case: Case,
    scheme: Scheme,
    start: State,
    *,
    steps: int,
    dt: ArrayLike | None = None,
    key: Key[Array, ""] | None = None,
    record: Callable[[State], T],
    segment: int | None = None,
    window: int | None = None,
    from_case: bool = False,
) -> tuple[State, StepInfo, T]: ...
def rollout(
    case: Case,
    scheme: Scheme,
    start: State,
    *,
    steps: int,
    dt: ArrayLike | None = None,
    key: Key[Array, ""] | None = None,
    record: Callable[[State], Any] | None = None,
    segment: int | None = None,
    window: int | None = None,
    from_case: bool = False,
) -> Any:
    """The state after a fixed number of steps, and the `StepInfo` of each: pure, for grad, vmap and jit.

    `dt` [s], by default the largest that the scheme allows at each step. The key of step k is `fold_in(key, k)`. The
    capacity of the list is that of `start`: look for `Status.TABLE_FULL` in `info.status`. What `record` makes of the
    state after each step comes third, with a leading axis for the steps; outside `jit`, each new function is compiled.

    The flow begins with the particles of `start`, of which those of `case` are then no argument. With `from_case` it
    begins at t = 0 with the particles of `case`, and `start` lends its list: derivatives by their positions and
    velocities are those by the leaves of `case`.

    Derivatives are those of the discrete steps; nothing is propagated through the neighbor list, the choice of surface
    particles and the pressure that a solve starts from. Reverse mode keeps the state once in each `segment` of steps,
    by default about √`steps` of them, and all pressures, and takes the steps of one segment at a time once more.

    Chaos makes derivatives over many steps grow without bound. With a `window`, the state after each so many steps
    counts as given: a derivative then holds the effects within windows only. Raises `ValueError` for numbers of steps
    below one, a `start` of another case or for another radius, and what was made in another precision.
    """
    for name, value in {"steps": steps, "segment": segment, "window": window}.items():
        if value is not None:
            whole(name, value, least=1)
    check_start(case, scheme, start)
    start = _at_start(case, start) if from_case else start
    key = jax.random.key(0) if key is None else key
    dt = None if dt is None else jnp.asarray(dt, float)
    segment = _segment(steps) if segment is None else min(segment, steps)
    end, info, recorded = _steps(case.undescribed(), scheme, start, dt, key, steps, record, segment, window)
    return (end, info) if record is None else (end, info, recorded)


def _at_start(case: Case, start: State) -> State:
    """The state at t = 0 of the particles of the case, with the list of another."""
    zero = jnp.zeros_like(start.time)
    particles = case.motion.drive(case.particles, case.particles.position, zero)
    where = lambda s: (s.particles, s.time, s.step, s.loss)  # noqa: E731
    return eqx.tree_at(where, start, (particles, zero, jnp.zeros_like(start.step), zero))


def _segment(steps: int) -> int:
    """The divisor of `steps` closest to its root, or the root itself if that is far: a rest is compiled by itself."""
    root = math.sqrt(steps)
    best = min((d for d in range(1, steps + 1) if steps % d == 0), key=lambda d: abs(math.log(d / root)))
    return best if 0.5 * root <= best <= 2.0 * root else round(root)


def _rollout(case, scheme, start, dt, key, steps, record, segment, window):
    def one(state: State, number: Array) -> tuple[State, Any]:
        if window is not None:
            border = (number > 0) & (number % window == 0)
            state = jax.tree.map(lambda x: jnp.where(border, jax.lax.stop_gradient(x), x), state)
        largest = largest_step(case, scheme, state.particles) if dt is None else dt
        state, info = step(case, scheme, state, largest, jax.random.fold_in(key, state.step))
        return state, (info, None if record is None else record(state))

    # Solutions are kept, of all steps: to solve again takes more time than all the rest. Scans need no protection from
    # the elimination of common subexpressions.
    solved = jax.checkpoint_policies.save_only_these_names(SOLUTION)
    once_more = partial(jax.checkpoint, policy=solved, prevent_cse=False)
    one = once_more(one)

    def several(state: State, numbers: Array) -> tuple[State, Any]:
        return jax.lax.scan(one, state, numbers)

    numbers = jnp.arange(steps)
    whole_segments, rest = divmod(steps, segment)
    first = numbers[: steps - rest].reshape(whole_segments, segment)
    state, told = jax.lax.scan(several if segment == steps else once_more(several), start, first)
    told = jax.tree.map(lambda x: x.reshape(steps - rest, *x.shape[2:]), told)
    if rest:
        state, more = several(state, numbers[steps - rest :])
        told = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), told, more)
    return state, *told


_steps = jit(_rollout, static_argnums=(5, 6, 7, 8))
