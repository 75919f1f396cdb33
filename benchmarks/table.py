"""Rows of results as lines of a table."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Column(NamedTuple):
    """What stands above a column, and how a value is written; the width is that of the larger of both."""

    title: str
    form: str
    width: int


STEP = {
    "case": Column("case", "{}", -12),
    "particles": Column("particles", "{}", 9),
    "by": Column("by", "{}", -14),
    "ms_per_step": Column("ms/step", "{:.2f}", 9),
    "list_ms": Column("list", "{:.2f}", 8),
    "operators_ms": Column("operators", "{:.2f}", 9),
    "ppe_ms": Column("PPE", "{:.2f}", 9),
    "rebuilds_per_step": Column("rebuilds", "{:.2f}", 8),
    "operator_applications": Column("products", "{:.1f}", 8),
    "product_ms": Column("of ms", "{:.2f}", 6),
    "product_bandwidth_fraction": Column("at copy", "{:.0%}", 7),
    "particle_steps_per_second": Column("part.-steps/s", "{:.3g}", 13),
    "gb_per_s": Column("GB/s", "{:.1f}", 6),
    "bandwidth_fraction": Column("of copy", "{:.0%}", 7),
    "peak_bytes_per_particle": Column("B/particle", "{:.0f}", 10),
    "compile_s": Column("compile s", "{:.1f}", 9),
}
SOLVE = {
    "case": Column("pressure solve", "{}", -24),
    "particles": Column("particles", "{}", 9),
    "unknowns": Column("unknowns", "{}", 8),
    "precision": Column("precision", "{}", -9),
    "tolerance": Column("tolerance", "{:.0e}", 9),
    "operator_applications": Column("products", "{}", 8),
    "residual": Column("residual", "{:.1e}", 8),
}
GRADIENT = {
    "case": Column("gradient", "{}", -24),
    "particles": Column("particles", "{}", 9),
    "steps": Column("steps", "{}", 6),
    "forward_ms_per_step": Column("forward ms/step", "{:.2f}", 15),
    "value_and_grad_ms_per_step": Column("with gradient", "{:.2f}", 13),
    "relative": Column("times as long", "{:.2f}", 13),
    "peak_bytes_per_particle": Column("B/particle", "{:.0f}", 10),
    "compile_s": Column("compile s", "{:.1f}", 9),
}
ENSEMBLE = {
    "case": Column("ensemble", "{}", -24),
    "particles": Column("particles", "{}", 9),
    "single_ms_per_step": Column("single ms/step", "{:.2f}", 15),
    "ms_per_member_step": Column("per member", "{:.2f}", 13),
    "relative": Column("times as long", "{:.2f}", 13),
    "members": Column("members", "{}", 10),
    "compile_s": Column("compile s", "{:.1f}", 9),
}


def head(columns: Mapping[str, Column]) -> None:
    """Prints the line above the rows."""
    print("\n" + "  ".join(_pad(column.title, column.width) for column in columns.values()), flush=True)


def tell(columns: Mapping[str, Column], row: Mapping[str, Any]) -> None:
    """Prints a row; what it does not have stays empty."""
    cells = (c.form.format(row[key]) if key in row else "" for key, c in columns.items())
    print("  ".join(map(_pad, cells, (c.width for c in columns.values()))).rstrip(), flush=True)


def _pad(text: str, width: int) -> str:
    """Numbers stand to the right, names, of negative width, to the left."""
    return text.ljust(-width) if width < 0 else text.rjust(width)
