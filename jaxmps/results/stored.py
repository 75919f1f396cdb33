"""Columns of a run that stay in its file, and are read frame by frame."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin


class Stored(NDArrayOperatorsMixin):
    """What stands for an array (m, n, …) of which `load` reads the frames of any of these `numbers`.

    A frame, or a slice of them, is read when it is asked for, and forgotten; so are frames in a loop. All that needs
    the whole column, as arithmetic does, reads the whole column.
    """

    def __init__(
        self, load: Callable[[np.ndarray], np.ndarray], numbers: np.ndarray, shape: tuple[int, ...], dtype: Any
    ):
        self._load, self._numbers, self.shape, self.dtype = load, numbers, shape, np.dtype(dtype)

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Bytes [B] that it would take in memory."""
        return self.size * self.dtype.itemsize

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[frame] for frame in range(len(self)))

    def __getitem__(self, index: Any) -> Any:
        first, *rest = index if isinstance(index, tuple) else (index,)
        if isinstance(first, (int, np.integer)) and not isinstance(first, bool):
            count = len(self)
            if not -count <= first < count:
                raise IndexError(f"frame must be between {-count} and {count - 1}, got {first}")
            found = self._load(self._numbers[[int(first) % count]])[0]
            return found[tuple(rest)] if rest else found
        if isinstance(first, slice):
            found = self._load(self._numbers[first])
            return found[(slice(None), *rest)] if rest else found
        return np.asarray(self)[index]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy is False:
            raise ValueError("copy must not be False: the column is in a file")
        found = self._load(self._numbers)
        return found if dtype is None else found.astype(dtype, copy=False)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        arrays = [np.asarray(x) if isinstance(x, Stored) else x for x in inputs]
        return getattr(ufunc, method)(*arrays, **keywords)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)

    def __repr__(self) -> str:
        return f"Stored{self.shape} of {self.dtype}"
