"""What a case file says, made into objects: case, scheme, probes and the times of the run."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxmps.casefile.arguments import (
    arguments,
    assignments,
    build_case,
    build_scheme,
    case_factories,
    jittered,
    of_noise,
    picked,
    scheme_factories,
)
from jaxmps.casefile.geometry import Layout, build
from jaxmps.casefile.models import BuiltinFile, OwnFile, RunTable
from jaxmps.casefile.parsing import CaseFileError, attributed, parse
from jaxmps.diagnostics import Probe
from jaxmps.flow import Case
from jaxmps.scheme import Scheme
from jaxmps.validation import one_of


@dataclasses.dataclass(frozen=True)
class Setup:
    """A run as a case file describes it; `layout` tells how an own geometry was filled."""

    case: Case
    scheme: Scheme
    probes: tuple[Probe, ...]
    run: RunTable
    layout: Layout | None = None
    fluids: tuple[str, ...] = ()

    @property
    def times(self) -> dict[str, Any]:
        """`until`, `save_every` and `dt` [s] as arguments of `simulate`."""
        return {"until": self.run.until, "save_every": self.run.save_every, "dt": self.run.dt}


class CaseFile:
    """A case file that was read and checked; `build` makes the objects, in the precision that JAX is set to."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.tables, self.text = parse(self.path)

    @property
    def run(self) -> RunTable:
        """The table `[run]`, with its defaults."""
        return self.tables.run

    def build(
        self,
        scheme: str | None = None,
        spacing: float | None = None,
        settings: Iterable[str] = (),
        run: Mapping[str, Any] | None = None,
    ) -> Setup:
        """The setup, with `scheme`, `spacing` [m], `NAME=VALUE` settings and entries of `run` instead of the file's.

        Of the file's values for its scheme, another scheme takes those that it knows. Raises `CaseFileError` for what
        is wrong in the file and another `ValueError` for what is wrong with the arguments.
        """
        tables, texts = self.tables, assignments(settings)
        times = tables.run.model_copy(update=dict(run or {}))
        builtin = isinstance(tables, BuiltinFile)
        given = tables.case.model_dump(exclude_unset=True) if builtin else {}
        make = case_factories()[given.pop("builtin")] if builtin else None
        names = arguments(make) if make else {}
        method = self._scheme(scheme, texts, names)
        given |= picked(texts, names)
        if spacing is not None:
            if "spacing" in texts:
                raise ValueError("spacing must be given once, got --spacing and --set spacing")
            given["spacing"] = spacing
        layout, fluids = None, ()
        if make:
            changed = bool(texts) or spacing is not None
            put = lambda: build_case(make, given, method.ratio)  # noqa: E731
            case = put() if changed else attributed(self.path, "[case]", put)
        else:
            assert isinstance(tables, OwnFile)
            case, layout = build(tables, self.path, method.ratio, spacing)
            fluids = tuple(table.name or f"fluid {i}" for i, table in enumerate(tables.fluid, 1))
        case = jittered(case, times.jitter, times.seed)
        probes = self._probes(case.dim)
        described = {**dict(case.parameters), "file": self.path.name, "toml": self.text}
        described |= {"fluids": fluids} if fluids else {}
        described |= {"probes": probes} if probes else {}
        case = dataclasses.replace(case, parameters=tuple(described.items()))
        return Setup(case, method, probes, times, layout, fluids)

    def _scheme(self, name: str | None, texts: Mapping[str, str], others: Mapping[str, Any]) -> Scheme:
        table = self.tables.scheme
        known = scheme_factories()
        attributed(self.path, "[scheme]", lambda: one_of("name", table.name, known))
        values = attributed(self.path, "[scheme]", lambda: {k: _text(k, v) for k, v in table.values.items()})
        rule = f"keys must name an argument of {table.name}"
        own = attributed(self.path, "[scheme]", lambda: build_scheme(table.name, values, rule))
        if name is None and not texts:
            return own
        name = table.name if name is None else one_of("scheme", name, known)
        if name != table.name:
            values = {k: v for k, v in values.items() if k in arguments(known[name]) or k in of_noise()}
        rule = f"--set must name an argument of {' or '.join([*(['the case'] if others else []), name])}"
        return build_scheme(name, values | dict(texts), rule, others)

    def _probes(self, dim: int) -> tuple[Probe, ...]:
        found: dict[str, Probe] = {}
        for index, table in enumerate(self.tables.probe, 1):
            name = table.name or f"{table.kind} {index}"
            place: list[Any] = []
            if table.kind == "pressure":
                place = [table.point]
            elif table.kind == "wall_pressure":
                place = table.segment
            elif table.kind == "wave_gauge":
                place = [[table.x] if table.y is None else [table.x, table.y]]
            size = dim - 1 if table.kind == "wave_gauge" else dim
            where = f"[[probe]] {index}"
            if any(len(point) != size for point in place):
                raise CaseFileError(self.path, [f"{where}: places must have {size} components, got {place}"])
            if name in found:
                raise CaseFileError(self.path, [f"{where}: name must be given once, got {name} again"])
            points = tuple(tuple(point) for point in place)
            found[name] = Probe(name, table.kind, points, getattr(table, "radius", None))
        return tuple(found.values())


def read(path: str | Path) -> Setup:
    """The setup in the case file at `path`: `simulate(setup.case, setup.scheme, **setup.times)` runs it.

    Raises `CaseFileError`, a `ValueError`, with a line for each fault.
    """
    return CaseFile(path).build()


def _text(name: str, value: Any) -> str:
    """A value of the table as the command line would have it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list) and value and all(isinstance(x, (int, float)) for x in value):
        return ",".join(map(repr, value))
    if isinstance(value, bool | int | float):
        return repr(value)
    raise ValueError(f"{name} must be a number, true or false, or a list of numbers, got {value!r}")
