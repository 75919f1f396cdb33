"""Text of the command line made into cases and schemes; `ValueError` says what is wrong with it."""

import dataclasses
import difflib
import inspect
import math
import typing
from collections.abc import Callable, Iterable, Mapping
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxmps import cases, schemes
from jaxmps.description import describe
from jaxmps.flow import Case
from jaxmps.scheme import Scheme
from jaxmps.validation import between, one_of

Factory = Callable[..., Any]


def case_factories() -> dict[str, Factory]:
    """The functions of `jaxmps.cases` that make a case from named arguments alone."""
    return _factories(cases, Case)


def scheme_factories() -> dict[str, Factory]:
    """The functions of `jaxmps.schemes` that make a scheme from named arguments alone."""
    return _factories(schemes, Scheme)


def arguments(factory: Factory) -> dict[str, inspect.Parameter]:
    return dict(inspect.signature(factory).parameters)


def values_of(scheme: Scheme) -> dict[str, Any]:
    """The values of a scheme by their dotted names, without its parts."""
    found = describe(scheme)
    return {k: v for k, v in found.items() if not isinstance(attrgetter(k)(scheme), eqx.Module)}


def build(
    case: str,
    scheme: str,
    spacing: float | None,
    settings: Iterable[str],
    jitter: float = 0.0,
    seed: int = 0,
) -> tuple[Case, Scheme]:
    """Case and scheme of these names with `NAME=VALUE` settings; `jitter` in spacings.

    A name may be an argument of the case, of the scheme or, as `ratio`, of both, of `schemes.stochastic`, which any
    scheme can be given to, or a dotted value of the scheme. The case gets the ratio of the scheme if it is not set.
    """
    known = case_factories()
    make_case = known[one_of("case", case, known)]
    texts = assignments(settings)
    for_case = picked(texts, arguments(make_case))
    if spacing is not None:
        if "spacing" in for_case:
            raise ValueError("spacing must be given once, got --spacing and --set spacing")
        for_case["spacing"] = spacing
    made = build_scheme(scheme, texts, f"--set must name an argument of {case} or {scheme}", arguments(make_case))
    return build_case(make_case, for_case, made.ratio, jitter, seed), made


def build_scheme(scheme: str, texts: Mapping[str, str], rule: str, others: Iterable[str] = ()) -> Scheme:
    """The scheme of that name with values by their names; `others` are names that are not for the scheme.

    `rule` opens the error for any name else.
    """
    known = scheme_factories()
    make_scheme = known[one_of("scheme", scheme, known)]
    for_scheme = picked(texts, arguments(make_scheme))
    made = make_scheme(**for_scheme)
    for_noise = picked(texts, of_noise())
    if for_noise:
        made = schemes.stochastic(made, **for_noise)
    valid = [*others, *arguments(make_scheme), *of_noise(), *values_of(made)]
    for name, text in texts.items():
        if name not in valid:
            raise ValueError(f"{rule}, or a value of the scheme, got {name} ({hint(name, valid)})")
        if not any(name in taken for taken in (others, for_scheme, for_noise)):
            made = _replaced(made, name, name, text)
    return made


def build_case(make: Factory, values: Mapping[str, Any], ratio: float, jitter: float = 0.0, seed: int = 0) -> Case:
    """The built-in case with these arguments, and `ratio`, that of the scheme, if they do not have it."""
    return jittered(make(**({"ratio": ratio} if "ratio" in arguments(make) else {}) | dict(values)), jitter, seed)


def jittered(case: Case, jitter: float, seed: int) -> Case:
    """The case with its fluid displaced by up to `jitter` spacings along each axis."""
    between("jitter", jitter, 0.0, 0.3, "spacings")
    return cases.jitter(case, jitter, jax.random.key(seed)) if jitter else case


def of_noise() -> dict[str, inspect.Parameter]:
    """The arguments of `schemes.stochastic`, which any scheme can be given to."""
    known = arguments(schemes.stochastic)
    return {name: given for name, given in known.items() if given.kind is given.KEYWORD_ONLY}


def _factories(module: Any, result: type) -> dict[str, Factory]:
    found = {}
    for name, function in inspect.getmembers(module, inspect.isfunction):
        signature = inspect.signature(function)
        named = all(p.kind is p.KEYWORD_ONLY for p in signature.parameters.values())
        if named and signature.return_annotation is result and not name.startswith("_"):
            found[name] = function
    return found


def assignments(settings: Iterable[str]) -> dict[str, str]:
    """The names and texts of `NAME=VALUE` settings."""
    texts: dict[str, str] = {}
    for setting in settings:
        name, sign, text = (part.strip() for part in setting.partition("="))
        if not (name and sign and text):
            raise ValueError(f"--set must have the form NAME=VALUE, got {setting!r}")
        if name in texts:
            raise ValueError(f"{name} must be set once, got {texts[name]} and {text}")
        texts[name] = text
    return texts


def picked(texts: Mapping[str, str], known: Mapping[str, inspect.Parameter]) -> dict[str, Any]:
    """The values of those texts that are for a `known` argument."""
    return {
        name: _convert(name, text, _kind(known[name].default, known[name].annotation))
        for name, text in texts.items()
        if name in known
    }


def _kind(default: Any, annotation: Any) -> type:
    """bool, int, str, tuple or float, as the default or, if there is none, the annotation says."""
    if default is None or default is inspect.Parameter.empty:
        options = [typing.get_origin(a) or a for a in (annotation, *typing.get_args(annotation))]
        return next((k for k in (bool, int, float, tuple, str) if k in options), float)
    if isinstance(default, jax.Array):
        return tuple if default.ndim else float
    return next((k for k in (bool, int, str, tuple) if isinstance(default, k)), float)


def _convert(name: str, text: str, kind: type) -> Any:
    if kind is str:
        return text
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError(f"{name} must be true or false, got {text}")
        return text.lower() == "true"
    if kind is tuple:
        return tuple(_number(name, part, "finite numbers with commas in between", text) for part in text.split(","))
    value = _number(name, text, "a whole number" if kind is int else "a finite number", text)
    if kind is int and not value.is_integer():
        raise ValueError(f"{name} must be a whole number, got {text}")
    return int(value) if kind is int else value


def _number(name: str, part: str, rule: str, text: str) -> float:
    try:
        value = float(part)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{name} must be {rule}, got {text}")
    return value


def _replaced(module: Any, path: str, name: str, text: str) -> Any:
    head, _, rest = path.partition(".")
    old = getattr(module, head)
    if rest:
        new = _replaced(old, rest, name, text)
    else:
        new = _convert(name, text, _kind(old, type(old)))
        if isinstance(old, jax.Array):
            new = jnp.asarray(new, old.dtype)
            if new.shape != old.shape:
                raise ValueError(f"{name} must have {old.size} numbers, got {text}")
    return dataclasses.replace(module, **{head: new})


def hint(name: str, valid: Iterable[str]) -> str:
    """What a mistyped name may have meant, or what there is."""
    valid = list(dict.fromkeys(valid))
    close = difflib.get_close_matches(name, valid, n=1)
    return f"did you mean {close[0]}?" if close else "there are " + ", ".join(valid)
