"""What an ensemble gives back: its members' quantities over time, as plain host arrays, and how each of them went."""

import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxmps.flow import Outcome
from jaxmps.results.run import Run


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """M members at m frames, as numpy arrays.

    - `time` (m,) [s]
    - `member` (M,), their numbers
    - `seed` (M, words), the data of their keys
    - `values`, by name what differs between members, such as `noise.alpha` (M,)
    - `series`, by name (M, m, ...) what was observed at each frame, such as `kinetic` [J/kg]
    - `valid` (M, m), whether the member had not failed yet; statistics leave out what is not valid
    - `status`, how each of them ended
    - `frames`, by name (M, m, n, ...), the fields of a `Run`; empty if they were not kept. A member that failed stays
      as it was at its last good step
    - `phase` (n,), `fluid_density` (M, phases) [kg/m³], `spacing` [m] and `metadata` as in a `Run`

    `many[3]` is a member as a `Run`; a slice, a mask or a list of indices gives an ensemble of those.
    """

    time: np.ndarray
    member: np.ndarray
    seed: np.ndarray
    values: dict[str, np.ndarray]
    series: dict[str, np.ndarray]
    valid: np.ndarray
    status: tuple[Outcome, ...]
    frames: dict[str, np.ndarray]
    phase: np.ndarray
    fluid_density: np.ndarray
    spacing: float
    metadata: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """How many members there are."""
        return len(self.member)

    def __repr__(self) -> str:
        lost = sum(not outcome.completed for outcome in self.status)
        names = (self.metadata.get(key, {}).get("name", f"unnamed {key}") for key in ("case", "scheme"))
        differs = f" by {', '.join(self.values)}" if self.values else ""
        return (
            f"Ensemble({', '.join(names)}: {len(self)} members{differs}, {len(self.time)} frames to "
            f"t = {self.time[-1]:.4g} s; {f'{lost} failed' if lost else 'completed'})"
        )

    def __getitem__(self, which: Any) -> Any:
        return self._run(int(which)) if np.ndim(which) == 0 and not isinstance(which, slice) else self._part(which)

    @property
    def position(self) -> np.ndarray:
        """(M, m, n, d) [m], if frames were kept."""
        return self._frames("position")

    @property
    def velocity(self) -> np.ndarray:
        """(M, m, n, d) [m/s], if frames were kept."""
        return self._frames("velocity")

    @property
    def pressure(self) -> np.ndarray:
        """(M, m, n) [Pa], if frames were kept."""
        return self._frames("pressure")

    def of(self, name: str) -> np.ndarray:
        """A series (M, m, ...) as floats, not a number where it is not valid; `energy` is `kinetic` + `potential`.

        Raises `ValueError` for a name that there is not.
        """
        if name == "energy" and {"kinetic", "potential"} <= self.series.keys():
            return self.of("kinetic") + self.of("potential")
        if name not in self.series:
            raise ValueError(f"name must be one of {', '.join(self.series)}, got {name}")
        series = self.series[name]
        valid = self.valid.reshape(self.valid.shape + (1,) * (series.ndim - 2))
        return np.where(valid, series, np.nan)

    def mean(self, name: str) -> np.ndarray:
        """(m, ...): the mean over the members; of `wet` the probability of being wet."""
        return self._over_members(np.nanmean, name)

    def variance(self, name: str) -> np.ndarray:
        """(m, ...): the unbiased variance over the members."""
        count = np.sum(np.isfinite(self.of(name)), axis=0)
        spread = self._over_members(np.nanvar, name)
        return np.where(count > 1, spread * count / np.maximum(count - 1, 1), np.nan)

    def quantile(self, name: str, q: float | Sequence[float]) -> np.ndarray:
        """(m, ...), or (quantiles, m, ...): the value that the fraction `q` of the members does not exceed."""
        return self._over_members(lambda x, axis: np.nanquantile(x, q, axis=axis), name)

    def where(self, name: str, value: Any) -> "Ensemble":
        """The members with this value; `ValueError` if there is none."""
        if name not in self.values:
            raise ValueError(f"name must be one of {', '.join(self.values) or 'no values'}, got {name}")
        chosen = np.isclose(self.values[name], value, rtol=1e-5, atol=0.0)
        if not chosen.any():
            raise ValueError(f"{name} must be one of {np.unique(self.values[name]).tolist()}, got {value:g}")
        return self._part(chosen)

    @classmethod
    def join(cls, parts: Sequence["Ensemble"]) -> "Ensemble":
        """One ensemble of all members, in the order of their numbers. Raises `ValueError` for none."""
        if not parts:
            raise ValueError("parts must hold at least one ensemble, got none")
        first = parts[0]
        if len(parts) == 1:
            return first
        order = np.argsort(np.concatenate([part.member for part in parts]), kind="stable")

        def joined(name: str) -> Any:
            every = [getattr(part, name) for part in parts]
            if isinstance(every[0], dict):
                return {key: np.concatenate([one[key] for one in every])[order] for key in every[0]}
            return np.concatenate(every)[order]

        columns = {name: joined(name) for name in _BY_MEMBER}
        status = [outcome for part in parts for outcome in part.status]
        return dataclasses.replace(first, **columns, status=tuple(status[k] for k in order))

    def _part(self, which: Any) -> "Ensemble":
        chosen = np.arange(len(self))[which]

        def part(name: str) -> Any:
            whole = getattr(self, name)
            return {k: v[chosen] for k, v in whole.items()} if isinstance(whole, dict) else whole[chosen]

        status = tuple(self.status[k] for k in chosen)
        return dataclasses.replace(self, **{name: part(name) for name in _BY_MEMBER}, status=status)

    def _run(self, index: int) -> Run:
        self._frames("position")
        good = self.valid[index]
        fields = {name: column[index][good] for name, column in self.frames.items()}
        energy = np.stack([self.series["kinetic"][index], self.series["potential"][index]], axis=-1)[good]
        values = {name: column[index].tolist() for name, column in self.values.items()}
        return Run(
            time=self.time[good],
            **fields,
            energy=energy,
            phase=self.phase,
            density=self.fluid_density[index][self.phase],
            spacing=self.spacing,
            status=self.status[index],
            summary={name: column[index].tolist() for name, column in self.series.items() if column.ndim == 2},
            metadata={**self.metadata, "member": {"number": int(self.member[index]), **values}},
        )

    def _frames(self, name: str) -> np.ndarray:
        if not self.frames:
            raise ValueError("frames must be kept for the particles of members: ensemble(..., keep_frames=True)")
        return self.frames[name]

    def _over_members(self, statistic: Any, name: str) -> np.ndarray:
        series = self.of(name)
        with warnings.catch_warnings():  # where no member is left, there is no number
            warnings.simplefilter("ignore", RuntimeWarning)
            return statistic(series, axis=0)


_BY_MEMBER = ("member", "seed", "values", "series", "valid", "frames", "fluid_density")
