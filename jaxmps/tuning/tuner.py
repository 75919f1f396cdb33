"""`tune`: a loss on runs, its gradient, and an optimiser of optax that changes leaves of a scheme, case or state."""

import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Key

from jaxmps._compilation import jit
from jaxmps._types import Scalar
from jaxmps.running import tally
from jaxmps.tuning.estimators import AbstractEstimator, Pathwise
from jaxmps.tuning.file import Progressed, read, write
from jaxmps.tuning.selection import Bounds, Selection
from jaxmps.validation import whole

T = TypeVar("T")


class History(NamedTuple):
    """What `tune` has met before each update: the loss, the values of the chosen leaves, the norm of the gradient (in
    the free variables, where there are bounds); and why it ended, in words.
    """

    loss: Float[np.ndarray, " steps"]
    values: tuple[np.ndarray, ...]
    gradient_norm: Float[np.ndarray, " steps"]
    ended: str

    @property
    def best(self) -> int:
        """The number of the step with the smallest loss."""
        return int(np.argmin(self.loss))


def tune(
    loss: Callable[[T, Key[Array, ""]], Scalar],
    start: T,
    where: Callable[[T], Any],
    optimizer: optax.GradientTransformation,
    *,
    steps: int,
    bounds: Sequence[Bounds] | None = None,
    estimator: AbstractEstimator | None = None,
    keys: int = 1,
    key: Key[Array, ""] | None = None,
    fresh_keys: bool = False,
    patience: int | None = None,
    file: str | Path | None = None,
    progress: bool | None = None,
) -> tuple[T, History]:
    """`start` with the leaves that `where` selects at the values of the smallest loss met in `steps` updates, and the
    `History` of these.

    `loss(tree, key)` is a number made of any pytree: a scheme, a case, a state, or a tuple of them; `where` picks one
    leaf or a list of leaves, as in `equinox.tree_at`. The loss that counts is the mean over `keys` keys drawn from
    `key`, the same in each step, so that the optimiser sees one landscape; with `fresh_keys` new ones in each step.
    `bounds`, for each leaf None or a pair (low, high) with None for an open end, hold by transformation: learning rates
    then act on the free variable that stands for the value. The `estimator` makes the gradient: `Pathwise` by default,
    `Forward` for a few numbers, `Evolution` for chaotic runs.

    It ends early when `patience` steps in turn have brought no smaller loss, where loss or gradient is not finite, and
    on Ctrl-C. With a `file` all is kept there after each step, and the same call, with as many `steps` or more, carries
    on from it.

    Raises `ValueError` where the loss does not depend on a chosen leaf at the start, for leaves that are not float
    arrays, for values outside their bounds, and for a file of another tuning.
    """
    for name, value in {"steps": steps, "keys": keys, "patience": patience}.items():
        if value is not None:
            whole(name, value, least=1)
    selection = Selection(start, where, bounds)
    estimator = Pathwise() if estimator is None else estimator
    key = jax.random.key(0) if key is None else key
    update, free = jit(_update_function(loss, selection, optimizer, estimator, keys)), selection.free()
    about = {
        "leaves": selection.names,
        "start": hashlib.sha256(b"".join(np.asarray(x).tobytes() for x in selection.leaves)).hexdigest(),
        "bounds": str(selection.bounds),
        "estimator": str(estimator),
        "keys": keys,
        "fresh_keys": fresh_keys,
        "key": np.asarray(jax.random.key_data(key)).tolist(),
    }
    done, ended = read(file, about, Progressed(free, optimizer.init(free), [], [], [])), ""
    with tally(steps, progress) as show:
        while not ended:
            number = len(done.loss)
            try:
                if ended := _enough(done, steps, patience):
                    break
                here = [np.asarray(x) for x in selection.values(done.free)]
                now = jax.random.fold_in(key, number) if fresh_keys else key
                free, memory, value, norm, felt = update(done.free, done.memory, now)
                if not (math.isfinite(value) and math.isfinite(norm)):
                    what = "gradient" if math.isfinite(value) else "loss"
                    ended = f"the {what} was not finite in step {number}, at {selection.show(here)}"
                    break
                if number == 0:
                    _refuse_constant(selection, here, np.asarray(felt))
                done = done.then(free, memory, float(value), here, float(norm))
                write(file, about, done)
                show(number + 1, float(value), float(norm))
            except KeyboardInterrupt:
                if not done.loss:
                    raise
                ended = "interrupted"
    if not done.loss:
        raise ValueError(ended)
    values = tuple(np.array(each) for each in zip(*done.values, strict=True))
    history = History(np.array(done.loss), values, np.array(done.norm), ended)
    return selection.put([each[history.best] for each in values]), history


def _update_function(
    loss: Callable[..., Scalar],
    selection: Selection,
    optimizer: optax.GradientTransformation,
    estimator: AbstractEstimator,
    keys: int,
) -> Callable[..., Any]:
    """New free variables and memory of the optimiser; loss, norm of the gradient, and which leaves it is felt in."""

    def update(free: list[Array], memory: Any, key: Key[Array, ""]) -> Any:
        for_loss, for_estimate = jax.random.split(key)
        drawn = jax.random.split(for_loss, keys)

        def objective(free: list[Array]) -> Scalar:
            tree = selection.put(selection.values(free))
            if keys == 1:  # under `vmap` the list of neighbors would be rebuilt in each step
                return loss(tree, drawn[0])
            return jnp.mean(jax.vmap(lambda one: loss(tree, one))(drawn))

        value, gradient = estimator(objective, free, for_estimate)
        change, memory = optimizer.update(gradient, memory, free)
        felt = jnp.stack([jnp.any(g != 0) for g in gradient])
        return optax.apply_updates(free, change), memory, value, jnp.linalg.norm(ravel_pytree(gradient)[0]), felt

    return update


def _enough(done: Progressed, steps: int, patience: int | None) -> str:
    """Why to end now, if so."""
    if len(done.loss) >= steps:
        return f"all {steps} steps were taken"
    if patience is not None and done.loss and len(done.loss) - 1 - int(np.argmin(done.loss)) >= patience:
        return f"no smaller loss in {patience} steps"
    return ""


def _refuse_constant(selection: Selection, values: Sequence[np.ndarray], felt: np.ndarray) -> None:
    idle = [f"{name} = {x}" for name, x, any_felt in zip(selection.names, values, felt, strict=True) if not any_felt]
    if idle:
        raise ValueError(
            f"the loss must depend on the leaves to be tuned, but its derivative is exactly zero at {', '.join(idle)}. "
            "Thresholds (beta, the collision distance) have no derivative; alpha_ds acts only while pairs are closer "
            "than alpha_ds spacings, and alpha only after energy has been lost: take more steps or another start, or "
            "the estimator Evolution"
        )
