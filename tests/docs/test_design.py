"""What the documentation says of the code and of itself is true: functions exist, links resolve, lists are complete."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.rglob("*.md"), *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))])
LINK = re.compile(r"\]\(([^)\s]+)\)")
ROW = re.compile(r"^\| \((\d+)\) \| .+ \| (\S+) \| (\S+\.py) \|$", re.MULTILINE)
MAX_DESIGN_LINES = 400


@cache
def text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def defined_names(file: Path) -> set[str]:
    """Functions, classes and ``Class.method`` that ``file`` defines, at whatever depth."""
    names = set()
    for node in ast.walk(ast.parse(text(file))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{inner.name}" for inner in node.body if isinstance(inner, ast.FunctionDef)}
    return names


@cache
def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and the site make them."""
    without_code = re.sub(r"^```.*?^```", "", text(page), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", without_code, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def equation_rows() -> list[tuple[str, str, str]]:
    table = text(DOCS / "design.md").partition("## Where each equation is computed")[2]
    return ROW.findall(table)


@pytest.mark.parametrize(("equation", "function", "file"), equation_rows())
def test_a_function_of_the_equation_table_is_in_its_file(equation: str, function: str, file: str) -> None:
    assert (ROOT / file).is_file(), f"({equation}): there is no {file}"
    assert function in defined_names(ROOT / file), f"({equation}): {file} defines no {function}"


def test_every_equation_is_in_the_table() -> None:
    numbered = set(re.findall(r"\\tag\{(\d+)\}", text(DOCS / "design.md")))
    assert numbered and {equation for equation, _, _ in equation_rows()} == numbered


def test_the_method_is_told_in_at_most_400_lines() -> None:
    assert len(text(DOCS / "design.md").splitlines()) <= MAX_DESIGN_LINES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_within_the_documentation_resolve(page: Path) -> None:
    broken = []
    for link in LINK.findall(text(page)):
        file, _, anchor = link.partition("#")
        if "://" in file:
            continue
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (anchor and target.suffix == ".md" and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


def test_every_experiment_is_in_the_index_once() -> None:
    files = [path.name for path in sorted((DOCS / "experiments").glob("0*.md"))]
    assert re.findall(r"\]\((0[^)]+\.md)\)", text(DOCS / "experiments" / "index.md")) == files
    for name in files:
        assert text(DOCS / "experiments" / name).startswith(f"# {name[:4]} "), name


def test_every_pinned_package_has_a_line_with_its_licence() -> None:
    project = tomllib.loads(text(ROOT / "pyproject.toml"))["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    rows = {
        line.split("|")[1].strip(): line for line in text(DOCS / "dependencies.md").splitlines() if line[:2] == "| "
    }
    for requirement in (r for group in groups for r in group):
        name, version = re.split("==|;", requirement)[:2]
        assert name in rows, f"docs/dependencies.md has no line on {name}"
        assert version in rows[name], f"docs/dependencies.md has another version of {name} than {version}"
