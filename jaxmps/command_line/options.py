"""Options and arguments that commands share."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

File = Annotated[Path, typer.Argument(help="A file that `jaxmps run` wrote, or its directory.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that exist.")]
Color = Annotated[str, typer.Option(metavar="NAME", help="pressure, speed, phase, number_density, kind or surface.")]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Argument of case or scheme, or value of the scheme such as source.relaxation.",
    ),
]

Types = Annotated[
    str,
    typer.Option(
        metavar="TYPES", help="Meaning of a .prof's types, NUMBER=KIND or NUMBER=KIND:PHASE with commas in between."
    ),
]
USUAL_TYPES = "0=fluid,2=wall,3=dummy,-1=removed"


class _FlagsWithoutType:
    """Help tells what an option takes; a flag takes nothing, but newer releases of typer write `<bool>` behind it."""

    def get_params(self, ctx: Any) -> list[Any]:
        params = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params


class Command(_FlagsWithoutType, TyperCommand):
    """A command of `jaxmps`."""


class Group(_FlagsWithoutType, TyperGroup):
    """`jaxmps` itself."""


def named(metavar: str, text: str) -> Any:
    """An option that takes a name, a file or the like."""
    return typer.Option(metavar=metavar, help=text)


def real(text: str) -> Any:
    """An option that takes a number."""
    return typer.Option(help=text, parser=_parser(float, "a number"), metavar="NUMBER")


def whole(text: str) -> Any:
    """An option that takes a whole number."""
    return typer.Option(help=text, parser=_parser(int, "a whole number"), metavar="INTEGER")


def prepare_jax(precision: str) -> None:
    """JAX in this precision, with what it compiles kept for later commands."""
    if precision not in ("single", "double"):
        raise ValueError(f"precision must be single or double, got {precision}")
    import jax

    from jaxmps._compilation import keep_compiled

    jax.config.update("jax_enable_x64", precision == "double")
    keep_compiled()


def _parser(kind: type, rule: str) -> Callable[[Any], Any]:
    def parse(text: Any) -> Any:
        try:
            return kind(text)
        except ValueError:
            raise typer.BadParameter(f"must be {rule}, got {text}") from None

    return parse
