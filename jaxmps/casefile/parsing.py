"""A case file read and checked; every fault in it is told in a line of its own."""

import contextlib
import functools
import inspect
import tomllib
import typing
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ValidationError, create_model
from pydantic.fields import FieldInfo

from jaxmps.casefile.arguments import arguments, case_factories, hint
from jaxmps.casefile.models import BuiltinFile, OwnFile
from jaxmps.casefile.shapes import Table
from jaxmps.validation import one_of


class CaseFileError(ValueError):
    """What is wrong with a case file: `faults`, a line for each."""

    def __init__(self, path: Path, faults: Iterable[str]):
        self.faults = tuple(f"{path}: {fault}" for fault in faults)
        super().__init__("\n".join(self.faults))


def parse(path: Path) -> tuple[OwnFile | BuiltinFile, str]:
    """The tables of the file, and its text. Raises `CaseFileError`."""
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except FileNotFoundError:
        raise CaseFileError(path, ["the file must exist"]) from None
    except OSError as error:
        raise CaseFileError(path, [f"the file must be readable ({error.strerror})"]) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CaseFileError(path, [f"must be TOML: {error}"]) from None
    case = data.get("case")
    model: type[Table] = OwnFile
    if isinstance(case, dict) and "builtin" in case:
        try:
            model = builtin_model(one_of("builtin", case["builtin"], case_factories()))
        except (ValueError, TypeError) as error:
            raise CaseFileError(path, [f"[case]: {error}"]) from None
    try:
        return typing.cast(OwnFile | BuiltinFile, model.model_validate(data)), text
    except ValidationError as error:
        raise CaseFileError(path, faults(error, data, model)) from None


@functools.cache
def builtin_model(name: str) -> type[Table]:
    """The tables of a file for the built-in case `name`, whose arguments are the keys of `[case]`."""
    fields: dict[str, Any] = {"builtin": (Literal[name], ...)}
    for argument, parameter in arguments(case_factories()[name]).items():
        fields[argument] = (parameter.annotation, parameter.default)
    case = create_model(name, __base__=Table, **fields)
    return create_model(f"{name} file", __base__=BuiltinFile, case=(case, ...))


def faults(error: ValidationError, data: dict[str, Any], model: type[BaseModel]) -> list[str]:
    """A line for each key with a fault: table, key, rule and value."""
    lines: dict[tuple[Any, ...], str] = {}
    for entry in error.errors():
        kind = entry["type"]
        path, value = _walk(data, entry["loc"])
        if kind in ("missing", "extra_forbidden") and (not path or path[-1] != entry["loc"][-1]):
            path = (*path, entry["loc"][-1])
        where, key = _place(path)
        if kind == "extra_forbidden":
            rule = f"{key} is not known ({hint(str(path[-1]), _keys(model, path[:-1], data))})"
        elif kind == "missing":
            rule = f"{key} is missing"
        elif kind.startswith("value_error"):
            rule = " ".join(part for part in (key, entry["msg"].removeprefix("Value error, ")) if part)
        else:
            message = entry["msg"].replace("Input should ", "must ").replace("should ", "must ")
            rule = f"{key} {message[0].lower()}{message[1:]}, got {_short(value)}"
        lines.setdefault(path, f"{where}: {rule}" if where else rule)
    return list(lines.values())


def _walk(data: Any, location: tuple[Any, ...]) -> tuple[tuple[Any, ...], Any]:
    """The part of a location that is in the data, without the names of alternatives, and the value there."""
    path: list[Any] = []
    for step in location:
        inside = isinstance(data, dict) and step in data
        inside |= isinstance(data, list) and isinstance(step, int) and step < len(data)
        if inside:
            data = data[step]
            path.append(step)
    return tuple(path), data


def _place(path: tuple[Any, ...]) -> tuple[str, str]:
    """The table, such as `[[fluid]] 1, [[fluid.body]] 2`, and the key in it, of a path."""
    names, tables, rest = "", [], list(path)
    while (
        rest
        and rest[0] in ("case", "fluid", "body", "wall", "motion", "probe", "scheme", "run")
        and len(names.split(".")) < 3
    ):
        names = f"{names}.{rest.pop(0)}".lstrip(".")
        if rest and isinstance(rest[0], int):
            tables.append(f"[[{names}]] {rest.pop(0) + 1}")
        else:
            tables.append(f"[{names}]" if names in ("case", "motion", "scheme", "run") else f"[[{names}]]")
    key = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in rest).lstrip(".")
    return ", ".join(tables), key


def _keys(model: type[BaseModel], path: tuple[Any, ...], data: Any) -> list[str]:
    """The keys of the table at a path."""
    for step in path:
        data = data[step]
        if isinstance(step, str):
            field: FieldInfo = model.model_fields[step]
            found = [a for a in _inner(field.annotation) if inspect.isclass(a) and issubclass(a, BaseModel)]
            alike = [a for a in found if "kind" in a.model_fields]
            model = found[0]
        elif isinstance(data, dict) and alike:
            kinds = {typing.get_args(a.model_fields["kind"].annotation)[0]: a for a in alike}
            model = kinds.get(data.get("kind"), model)
    return list(model.model_fields)


def _inner(annotation: Any) -> list[Any]:
    inner = typing.get_args(annotation)
    return [annotation] if not inner else [found for part in inner for found in _inner(part)]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


@contextlib.contextmanager
def attempted(where: str, faults: list[str]) -> Iterator[None]:
    """A `ValueError` in it becomes one of the faults of the table `where`."""
    try:
        yield
    except ValueError as error:
        faults.append(f"{where}: {error}")


def attributed(path: Path, where: str, make: Callable[[], Any]) -> Any:
    """What `make` gives; its `ValueError` is told with file and table."""
    try:
        return make()
    except ValueError as error:
        raise CaseFileError(path, [f"{where}: {error}"]) from None
