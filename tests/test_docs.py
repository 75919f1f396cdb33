"""README and the pages of the site: what they link to, show and call is there. `make docs` builds the site itself."""

import ast
import functools
import importlib
import importlib.util
import inspect
import json
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any

import jsonschema
import pytest
import typer
from ruamel.yaml import YAML

import jaxmps
from jaxmps.casefile.arguments import case_factories, scheme_factories
from jaxmps.casefile.models import OwnFile
from jaxmps.command_line import app

ROOT = Path(__file__).parent.parent
SITE = ROOT / "docs" / "site"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(SITE.rglob("*.md"))]
name_of = attrgetter("name")


@pytest.fixture(scope="module")
def pages() -> Any:
    sys.path.insert(0, str(SITE))
    try:
        yield importlib.import_module("pages")
    finally:
        sys.path.remove(str(SITE))


@pytest.fixture(scope="module")
def offline() -> Any:
    sys.path.insert(0, str(SITE))
    try:
        yield importlib.import_module("offline")
    finally:
        sys.path.remove(str(SITE))


def blocks(path: Path, *languages: str) -> list[str]:
    """The code blocks of a page in one of these languages, "" for none."""
    found = re.findall(r"^```(\S*).*?\n(.*?)^```$", path.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [code for language, code in found if language in languages]


def prose(path: Path) -> str:
    """A page without its code blocks."""
    return re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(path: Path) -> set[str]:
    """The anchors of a page: its headings, as GitHub and MyST make them, and its labels."""
    text = prose(path)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r"^\((\S+)\)=$", text, re.MULTILINE))


def documented(name: str, value: Any) -> Iterator[tuple[str, str | None]]:
    """A public name and the public members of a class that belong to the package, with what they say of themselves."""
    yield name, vars(value).get("__doc__") if inspect.isclass(value) else inspect.getdoc(value)
    if not inspect.isclass(value):
        return
    for cls in value.__mro__:
        if not cls.__module__.startswith("jaxmps"):
            continue
        for member, found in vars(cls).items():
            field = type(found).__name__ in ("_tuplegetter", "member_descriptor")
            if not member.startswith("_") and hasattr(found, "__get__") and not field:
                yield f"{name}.{member}", inspect.getdoc(getattr(value, member))


def test_every_public_name_says_what_it_is(pages):
    texts: dict[str, str | None] = {}
    for module in pages.MODULES:
        texts[module] = importlib.import_module(module).__doc__
        for name, value in pages.public(module).items():
            if inspect.isclass(value) or inspect.isroutine(value) or callable(value):
                texts |= documented(f"{module}.{name}", value)
            else:
                texts[f"{module}.{name}"] = pages.constant_docstring(name)
    for module in re.findall(r"^% models: (\S+)$", (SITE / "api" / "models.md").read_text(), re.MULTILINE):
        for name, value in pages.models(module).items():
            texts |= documented(f"{module}.{name}", value)
    assert len(texts) > 200
    # What a class or a dataclass makes of its own signature is no docstring.
    silent = [name for name, text in texts.items() if not text or text.startswith(f"{name.rsplit('.')[-1]}(")]
    assert silent == []


def test_every_public_module_has_a_page_in_the_reference(pages):
    shown = {mark for path in PAGES for mark in re.findall(r"^% api: (\S+)$", path.read_text(), re.MULTILINE)}
    parts = {name for name in jaxmps.__all__ if isinstance(getattr(jaxmps, name), ModuleType)}
    # Models and preconditioners are shown file by file.
    by_file = {"jaxmps.models", "jaxmps.pressure"}
    assert shown == set(pages.MODULES) == {"jaxmps", *(f"jaxmps.{part}" for part in parts)} - by_file
    marks = re.findall(r"^% models: (\S+)$", (SITE / "api" / "models.md").read_text(), re.MULTILINE)
    assert {f"jaxmps.models.{path.stem}" for path in (ROOT / "jaxmps/models").glob("[a-z]*.py")} < set(marks)


def test_every_model_that_a_scheme_can_have_is_in_the_reference(pages):
    shown = re.findall(r"^% models: (\S+)$", (SITE / "api" / "models.md").read_text(), re.MULTILINE)
    there = {name for module in shown for name in pages.models(module)} | set(pages.public("jaxmps.operators"))
    for make in scheme_factories().values():
        scheme = make()
        parts = [value for value in vars(scheme).values() if type(value).__module__.startswith("jaxmps")]
        assert {type(part).__name__ for part in parts} <= there
        assert len(parts) >= 10


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_links_and_pictures_lead_somewhere(path, pages):
    text = path.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(path))
    for _, listed in re.findall(r"^```\{(toctree)\}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        lines = [line for line in listed.splitlines() if line and not line.startswith(":")]
        targets += [re.sub(r".*<(.+)>$", r"\1", line) for line in lines]
    targets += re.findall(r"^```\{literalinclude\} (\S+)$", text, re.MULTILINE)
    for target in targets:
        if re.match(r"https?://", target):
            continue
        name, _, anchor = target.partition("#")
        file = path if not name else path.parent / name
        found = [file.with_name(file.name + suffix) for suffix in ("", ".md", ".ipynb")]
        there = next((one for one in found if one.is_file()), None)
        assert there is not None, f"{path.name} links to {target}"
        assert not anchor or anchor in anchors(there), f"{path.name} links to {target}"
    pages.filled(text)  # raises for a heading that README.md does not have


def test_every_page_is_in_the_contents():
    listed = re.findall(r"^(?:.*<)?([\w/]+)>?$", "\n".join(blocks(SITE / "index.md", "{toctree}")), re.MULTILINE)
    there = [path.relative_to(SITE).with_suffix("").as_posix() for path in SITE.rglob("*.md")]
    there += [f"notebooks/{path.stem}" for path in (ROOT / "notebooks").glob("*.ipynb")]
    assert sorted(listed) == sorted(name for name in there if name != "index")


@pytest.mark.parametrize("path", [path for path in PAGES if blocks(path, "python")], ids=name_of)
def test_python_on_the_pages_calls_what_there_is(path):
    for code in blocks(path, "python"):
        for node in ast.walk(ast.parse(code)):
            resolved(node)
            called = resolved(node.func) if isinstance(node, ast.Call) else None
            if called is not None:
                signature = inspect.signature(called)
                named = {keyword.arg: None for keyword in node.keywords if keyword.arg is not None}
                bind = signature.bind if len(named) == len(node.keywords) else signature.bind_partial
                bind(*node.args, **named)


def resolved(node: ast.AST) -> Any:
    """What `mps.X.Y` is, None for anything else; `AttributeError` if there is no such thing."""
    if not re.fullmatch(r"mps(\.\w+)+", name := ast.unparse(node)):
        return None
    return functools.reduce(getattr, name.split(".")[1:], jaxmps)


def commands(path: Path) -> list[list[str]]:
    """The command lines of `jaxmps` on a page, in blocks and in the text."""
    lines = [line.removeprefix("$ ") for code in blocks(path, "", "console", "bash") for line in code.splitlines()]
    lines += re.findall(r"`(jaxmps [^`]+)`", prose(path).replace("\n", " "))
    found = [shlex.split(line, comments=True) for line in lines if line.startswith("jaxmps ")]
    return [words[1 : words.index(">") if ">" in words else None] for words in found if "COMMAND" not in words]


@pytest.mark.parametrize("path", [path for path in PAGES if commands(path)], ids=name_of)
def test_command_lines_on_the_pages_are_understood(path):
    command = typer.main.get_command(app)
    known = {"case": {"tank", *case_factories()}, "scheme": set(scheme_factories())}
    for name, *words in commands(path):
        if name.startswith("--"):
            assert name in {option for one in command.params for option in one.opts} | {"--help"}
            continue
        one = command.get_command(typer.Context(command), name)  # type: ignore[attr-defined]
        assert one is not None, f"{path.name} shows jaxmps {name}"
        if not words:  # a command is mentioned
            continue
        try:
            given = one.make_context(name, list(words)).params
        except Exception as error:
            pytest.fail(f"{path.name} shows jaxmps {' '.join([name, *words])}: {error!r}")
        for kind, names in known.items():
            value = given.get(kind)
            assert value is None or value in names or str(value).endswith(".toml"), f"{path.name} shows {value}"


@pytest.mark.parametrize("path", [path for path in PAGES if blocks(path, "toml")], ids=name_of)
def test_tables_of_case_files_on_the_pages_are_accepted(path):
    whole = tomllib.loads((ROOT / "examples" / "cases" / "l_shaped_tank.toml").read_text(encoding="utf-8"))
    for code in blocks(path, "toml"):
        tables = tomllib.loads(code)
        OwnFile.model_validate(whole | tables)
        assert tables


def test_a_docstring_keeps_its_signs_and_its_formula(pages):
    lines = ["|u*| of `Case`s, r_⊥ at `n 2`:", "", "    a_i = b*", "", "- `dt` [s]"]
    pages.marked_up(lines)
    assert lines[0] == "\\|u\\*\\| of `Case <jaxmps.Case>`\\ s, r\\_⊥ at ``n 2``:"
    assert lines[2:5] == ["::", "", "    a_i = b*"]
    assert lines[6] == "- ``dt`` [s]"


def test_a_section_of_the_readme_ends_where_the_next_begins(pages, tmp_path, monkeypatch):
    text = pages.readme("Ten lines")
    assert text.startswith("```python") and "Which scheme" not in text
    (tmp_path / "README.md").write_text("## One\n[a](docs/site/gallery.md), ![b](docs/strip.png)\n\n## Two\nc\n")
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    assert pages.readme("One") == "[a](gallery.md), ![b](../strip.png)"
    assert pages.readme("Two") == "c"
    with pytest.raises(ValueError, match="must have the heading '## Nothing'"):
        pages.readme("Nothing")


def test_the_readme_is_short():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 180
    assert [line for line in lines if len(line) > 120] == []


def test_the_reference_opens_with_the_four_names_of_the_first_run(pages):
    listed = re.findall(r"^\.\. \w+:: (\w+)$", pages.filled("% api: jaxmps"), re.MULTILINE)
    assert [name for name in listed if name != "jaxmps"][:4] == ["simulate", "rollout", "ensemble", "tune"]


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=attrgetter("stem"))
def test_a_notebook_of_the_site_hides_the_parameters_that_it_runs_with(path, pages):
    full = json.loads(path.read_text(encoding="utf-8"))
    shown = json.loads(pages.notebook(path.stem, json.dumps(full)))
    hidden, title = shown["cells"][:2]
    assert hidden["metadata"]["tags"] == ["remove-cell"]
    names: dict[str, Any] = {}
    exec(re.sub(r"^%.*$", "", hidden["source"], flags=re.MULTILINE), names)
    assert {name: names[name] for name in pages.SMALL[path.stem]} == pages.SMALL[path.stem]
    assert title["source"].startswith("# ") and "On this page" in title["source"]
    assert shown["cells"][2:] == full["cells"][2:]


def test_a_notebook_with_another_parameter_is_refused(pages):
    content = {"cells": [{"source": "# Parameters\nspeed = 1.0", "metadata": {}}, {"source": "# Title\n"}]}
    with pytest.raises(ValueError, match="01_first_run must have the parameters spacing, until, got speed"):
        pages.notebook("01_first_run", json.dumps(content))


@pytest.mark.parametrize("path", [path for path in PAGES if blocks(path, "python", "toml", "console", "")], ids=name_of)
def test_code_fits_the_column(path):
    lines = "\n".join(blocks(path, "python", "toml", "console", "")).splitlines()
    assert [line for line in lines if len(line) > 120] == []


def test_the_citation_is_what_its_schema_asks_for():
    found = importlib.util.find_spec("check_jsonschema")  # only its files are needed
    assert found is not None and found.origin is not None
    schema = Path(found.origin).parent / "builtin_schemas" / "vendor" / "citation-file-format.json"
    cited = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    jsonschema.validate(cited, json.loads(schema.read_text(encoding="utf-8")))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (cited["version"], cited["license"]) == (project["version"], project["license"])
    assert cited["authors"] == project["authors"]


def test_a_page_with_a_script_from_elsewhere_is_found(offline, tmp_path):
    (tmp_path / "good.html").write_text('<script src="_static/a.js"></script><a href="https://doi.org/1">paper</a>')
    assert offline.loaded(tmp_path) == []
    (tmp_path / "bad.html").write_text('<link rel="stylesheet" href="//elsewhere.org/a.css"><img src="http://b.org/c">')
    (tmp_path / "bad.css").write_text(
        "@import 'https://elsewhere.org/font.css'; a { background: url(https://b.org/d) }"
    )
    found = offline.loaded(tmp_path)
    addresses = {"https://elsewhere.org/font.css", "https://b.org/d", "//elsewhere.org/a.css", "http://b.org/c"}
    assert {line.split(": ")[1] for line in found} == addresses
