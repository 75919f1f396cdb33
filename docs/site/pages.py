"""What the pages take from elsewhere: sections of README.md, the public names with their docstrings, the commands.

A line of its own in a page, `% readme: Heading`, `% api: module`, `% models: module`, `% status`
or `% commands`, stands for it. Notebooks are shown without their cell of parameters, as they run with small ones.
"""

import ast
import functools
import importlib
import inspect
import itertools
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox as eqx
import typer

from jaxmps.pressure import AbstractOperator

ROOT = Path(__file__).parent.parent.parent
MODULES = (
    "jaxmps",
    "jaxmps.cases",
    "jaxmps.schemes",
    "jaxmps.operators",
    "jaxmps.diagnostics",
    "jaxmps.plotting",
    "jaxmps.io",
    "jaxmps.casefile",
    "jaxmps.motion",
)
"""The public modules."""
FIRST = ("simulate", "rollout", "ensemble", "tune")
"""The names that the reference opens with; others follow by the alphabet."""
SMALL = {
    "01_first_run": {"spacing": 0.025, "until": 0.8},
    "02_schemes_compared": {"spacing": 0.05, "until": 2.0},
    "03_tuning_alpha_ds": {"spacing": 0.08, "until": 1.0, "updates": 7, "seeds": 3},
    "04_tuning_alpha_stochastic": {
        "spacing": 0.05,
        "until": 2.0,
        "updates": 10,
        "rate": 0.6,
        "pairs": 4,
        "seeds": 3,
    },
    "05_ensembles": {
        "spacing": 0.05,
        "until": 1.2,
        "members": 24,
        "wave_spacing": 0.04,
        "wave_until": 2.0,
        "alphas": 5,
        "seeds": 3,
    },
}
"""Parameters that the notebooks of the site run with: about a minute each, and pictures that still show their point."""
LONG = ("04_tuning_alpha_stochastic",)
"""Those of them that run for longer than it takes to compile them with care."""


def filled(page: str) -> str:
    """A page with its marks replaced by what they stand for."""
    page = re.sub(r"^% readme: (.+)$", lambda mark: readme(mark[1]), page, flags=re.MULTILINE)
    page = re.sub(r"^% api: (.+)$", lambda mark: api(mark[1], public(mark[1])), page, flags=re.MULTILINE)
    page = re.sub(r"^% models: (.+)$", lambda mark: api(mark[1], models(mark[1])), page, flags=re.MULTILINE)
    page = re.sub(r"^% status$", lambda mark: status(), page, flags=re.MULTILINE)
    return re.sub(r"^% commands$", lambda mark: commands(), page, flags=re.MULTILINE)


def readme(heading: str) -> str:
    """The text of README.md under this heading, without it. Links point from the site, pictures are one folder up."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    if found is None:
        raise ValueError(f"README.md must have the heading '## {heading}'")
    return found[1].replace("](docs/site/", "](").replace("](docs/", "](../").strip()


def notebook(name: str, text: str) -> str:
    """A notebook as the site runs and shows it: small, its parameters in a line below the title, not in a cell."""
    content = json.loads(text)
    parameters, title = content["cells"][:2]
    given = [line.split(" = ")[0] for line in "".join(parameters["source"]).splitlines() if " = " in line]
    if given != list(SMALL[name]):
        raise ValueError(f"{name} must have the parameters {', '.join(SMALL[name])}, got {', '.join(given)}")
    values = [f"{key} = {value}" for key, value in SMALL[name].items()]
    hasty = [] if name in LONG else ["%env XLA_FLAGS=--xla_backend_optimization_level=0"]
    parameters["source"] = "\n".join(["%matplotlib inline", *hasty, *values])
    parameters["metadata"] = {"tags": ["remove-cell"]}
    heading, _, rest = "".join(title["source"]).partition("\n")
    note = (
        f"*On this page: `{'`, `'.join(values)}`. {{doc}}`The notebook </notebooks>` itself is finer and takes longer.*"
    )
    title["source"] = f"{heading}\n\n{note}\n{rest}"
    return json.dumps(content)


def public(module: str) -> dict[str, Any]:
    """The public names of a module of the package, without modules; of a single file those that it defines."""
    loaded = importlib.import_module(module)
    if hasattr(loaded, "__all__"):
        names = loaded.__all__
    elif Path(str(loaded.__file__)).name == "__init__.py":
        names = [name for name in vars(loaded) if not name.startswith("_")]
    else:
        names = [name for name, found in vars(loaded).items() if getattr(found, "__module__", "") == module]
        names = [name for name in names if not name.startswith("_")]
    found = {name: getattr(loaded, name) for name in names}
    # `from package.module import name` leaves the module among the names, too.
    return {name: value for name, value in found.items() if not isinstance(value, ModuleType)}


def models(module: str) -> dict[str, Any]:
    """The parts of schemes that a module defines, without those that `jaxmps` itself has."""
    found = {name: value for name, value in public(module).items() if name not in public("jaxmps")}
    parts = {name: value for name, value in found.items() if inspect.isclass(value) and issubclass(value, eqx.Module)}
    return {name: value for name, value in parts.items() if not issubclass(value, AbstractOperator)}


def api(module: str, names: dict[str, Any]) -> str:
    """The docstrings of these names of a module, for autodoc; those of constants are looked up in the source."""
    lines = ["```{eval-rst}", f".. currentmodule:: {module}", ""]
    place = {name: number for number, name in enumerate(FIRST)}
    for name, value in sorted(names.items(), key=lambda item: (place.get(item[0], len(FIRST)), item[0].lower())):
        if inspect.isclass(value):
            call = ["   :special-members: __call__"] if inspect.isabstract(value) else []  # what a model must do
            lines += [f".. autoclass:: {name}", "   :members:", "   :show-inheritance:", *call, ""]
        elif callable(value):
            lines += [f".. autofunction:: {name}", ""]
        else:
            text = constant_docstring(name).splitlines()
            marked_up(text)
            lines += [f".. py:data:: {name}", "", *(f"   {line}" for line in text), ""]
    return "\n".join([*lines, "```"])


@functools.cache
def constant_docstring(name: str) -> str:
    """The text below the assignment of a constant in the package; empty if there is none."""
    for path in sorted((ROOT / "jaxmps").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for first, second in itertools.pairwise(ast.parse(text).body) if name in text else ():
            targets = first.targets if isinstance(first, ast.Assign) else [getattr(first, "target", None)]
            assigned = any(isinstance(target, ast.Name) and target.id == name for target in targets)
            if assigned and isinstance(second, ast.Expr) and isinstance(second.value, ast.Constant):
                return inspect.cleandoc(str(second.value.value))
    return ""


def status() -> str:
    """What each bit of a status means, and what to try."""
    from jaxmps.flow import FATAL, MESSAGES
    from jaxmps.flow.status import advice_on

    rows = [
        f"| `{bit.name}` | {MESSAGES[bit]} | {'yes' if bit & FATAL else ''} | {advice_on(bit)} |" for bit in MESSAGES
    ]
    return "\n".join(["| bit | meaning | ends the run | advice |", "|---|---|---|---|", *rows])


def commands() -> str:
    """Help, arguments and options of each command, from the command line itself."""
    from jaxmps.command_line import app

    command = typer.main.get_command(app)
    context = command.make_context("jaxmps", ["--help"], resilient_parsing=True)
    parts = []
    for name in command.list_commands(context):  # type: ignore[attr-defined]
        one = command.get_command(context, name)  # type: ignore[attr-defined]
        inner = typer.Context(one, info_name=name, parent=context)
        parts += [f"## jaxmps {name}", one.help or "", "```console", f"$ {one.get_usage(inner)[7:]}", "```"]
        rows = [record for option in one.get_params(inner) if (record := option.get_help_record(inner)) is not None]
        parts += ["| | |", "|---|---|", *(f"| `{left}` | {_cell(right)} |" for left, right in rows), ""]
    return "\n".join(parts)


def _cell(text: str) -> str:
    return re.sub(r"([|\[\]<>_*])", r"\\\1", text)


def marked_up(lines: list[str]) -> None:
    """A docstring, changed in place: signs that mean something to Sphinx are text, indented formulas keep their form.

    `name` in backticks is a link where there is such a name, and code else.
    """
    blocks = re.split(r"\n{2,}", "\n".join(lines).strip())
    done = []
    for block in blocks:
        if block.startswith("    "):
            done.append("::\n\n" + block)
        else:
            parts = re.split(r"(`[^`]+`)", block)
            done.append("".join(_escaped(part, parts[k + 1 : k + 2]) for k, part in enumerate(parts)))
    lines[:] = [*"\n\n".join(done).splitlines(), ""]


def _escaped(part: str, after: list[str]) -> str:
    if not part.startswith("`"):
        return re.sub(r"([*|\\_])", r"\\\1", part)
    code = " ".join(part[1:-1].split())
    text = f"`{code} <{_links()[code]}>`" if code in _links() else f"``{code}``"
    return text + "\\ " * bool(after and re.match(r"\w", after[0]))


@functools.cache
def _links() -> dict[str, str]:
    """The full names of what a docstring may mean by a name: one word in lower case is more often an argument."""
    names = {name: f"{module}.{name}" for module in reversed(MODULES) for name in public(module)}
    return {name: full for name, full in names.items() if "_" in name or name[0].isupper()}


def shortened(*signature: str | None) -> tuple[str | None, ...]:
    """Arguments and result without the private modules of types; a default that is made anew is an ellipsis."""
    short = (text and re.sub(r"~?\bjaxlib\._jax\.|~(\w+\.)+", "", text) for text in signature)
    return tuple(text and text.replace("<factory>", "...") for text in short)


def is_foreign(member: Any) -> bool:
    """Whether a member has no docstring of ours: a field of a named tuple, a setting of pydantic."""
    return type(member).__name__ == "_tuplegetter" or isinstance(member, dict)
