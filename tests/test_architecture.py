"""The rules of the house, read from the code itself: what may import what, how long a file, how many parameters."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("iris_addon", "operators", "headless", "benchmarks")
ROOMS = (
    "base", "model", "rays", "brdf", "capture", "cameras", "surface", "transport", "response", "lighting", "materials",
    "textures", "results", "edits", "evaluate", "blender",
)  # fmt: skip
"""A room of iris_addon imports rooms before it in this list only."""
LOOSE = {"__init__.py", "config.py", "decide.py", "pipeline.py"}
"""Files that may lie at the root of iris_addon."""
BLENDER_MODULES = {"bpy", "bmesh", "mathutils", "bpy_extras", "gpu"}
MAX_PARAMETERS, MAX_POSITIONAL, MAX_LINES = 8, 4, 520
SHARED_NAMES = {
    "backdrop": "lighting fits it, blender/scene_out builds it as a mesh",
    "files": "base writes any file whole, results names those of a result folder",
    "images": "base decodes and encodes photos, blender wraps those that Blender holds",
    "jobs": "edits parses what a person asks for, blender/worker runs processes",
    "photos": "capture decodes them, blender/synth renders them",
}
"""Names that two modules of iris_addon may have, and why."""


# ---- the code as it lies on disk -----------------------------------------------------------------------------------


def _files(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def _module(path: Path) -> str:
    """Dotted name of a file; a package's is that of its folder."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def _modules() -> dict[str, Path]:
    return {_module(path): path for path in _files(*PACKAGES)}


def _at(path: Path, node: ast.expr | ast.stmt) -> str:
    return f"{path.relative_to(ROOT)}:{node.lineno}"


def _executed(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes below, without what stands under ``if TYPE_CHECKING``."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        yield child
        yield from _executed(child)


def _imports(path: Path) -> Iterator[tuple[str, int]]:
    """Dotted name and line of everything that ``path`` imports, inside functions too; of ours the module, not the
    name in it."""
    package = _module(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in _executed(_tree(path)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield (inner if inner in _modules() else base), node.lineno


@cache
def _import_graph() -> dict[str, set[str]]:
    """Which module of ours imports which."""
    ours = _modules()
    return {name: {found for found, _ in _imports(path) if found in ours} - {name} for name, path in ours.items()}


def _circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of nodes that reach each other."""

    def reached(start: str) -> set[str]:
        found: set[str] = set()
        queue = [start]
        while queue:
            new = graph.get(queue.pop(), set()) - found
            found |= new
            queue += new
        return found

    reach = {node: reached(node) for node in graph}
    groups = {tuple(sorted(other for other in reach[node] if node in reach[other])) for node in graph}
    return [list(group) for group in sorted(groups) if group]


def _folder(module: str) -> str:
    """The folder that stands for a module; the module itself where folders lie beside it."""
    path = _modules()[module]
    has_rooms = any(path.parent.glob("*/__init__.py"))
    return module if has_rooms or path.name == "__init__.py" else module.rpartition(".")[0]


# ---- the rules -----------------------------------------------------------------------------------------------------


def test_no_file_imports_itself_by_way_of_others() -> None:
    assert _circles(_import_graph()) == []


def test_no_folder_imports_itself_by_way_of_others() -> None:
    folders: dict[str, set[str]] = defaultdict(set)
    for module, targets in _import_graph().items():
        folders[_folder(module)] |= {_folder(target) for target in targets} - {_folder(module)}
    assert _circles(folders) == []


def test_a_room_imports_only_rooms_before_it() -> None:
    wrong = []
    for module, targets in _import_graph().items():
        parts = module.split(".")
        if parts[0] != "iris_addon" or len(parts) < 2 or parts[1] not in ROOMS:
            continue
        for target in sorted(targets):
            package, _, inner = target.partition(".")
            room = inner.split(".")[0]
            behind = room in ROOMS and ROOMS.index(room) > ROOMS.index(parts[1])
            if package != "iris_addon" or behind or room == "pipeline":
                wrong.append(f"{module} imports {target}")
    assert wrong == []


def test_every_folder_of_the_package_is_a_room_of_the_list() -> None:
    folders = {path.name for path in (ROOT / "iris_addon").iterdir() if any(path.glob("**/*.py"))}
    assert folders == set(ROOMS)


def test_nothing_lies_loose_at_the_root_of_the_package() -> None:
    assert {path.name for path in (ROOT / "iris_addon").glob("*.py")} <= LOOSE


def test_only_the_rooms_of_blender_import_it() -> None:
    """Operators and the room ``blender`` run inside Blender; benchmarks render in processes of their own. All else
    works in a Python without it."""
    may = (
        "iris_addon/blender/",
        "operators/",
        "benchmarks/perturb",
        "benchmarks/furnished_room",
        "benchmarks/mirror_room",
        "benchmarks/pattern_room",
        "benchmarks/profile_room",
        "benchmarks/sunlit_room",
        "benchmarks/switched_room",
        "benchmarks/moving_plate",
    )
    wrong = []
    for path in _files(*PACKAGES):
        if path.relative_to(ROOT).as_posix().startswith(may):
            continue
        wrong += [
            f"{path.relative_to(ROOT)}:{line}" for name, line in _imports(path) if name.split(".")[0] in BLENDER_MODULES
        ]
    assert wrong == []


def test_headless_modules_load_without_blender() -> None:
    """What a module of ``headless`` imports at once, and what that imports in turn, must not need Blender: the command
    line says what is missing, or hands over to a Python that has it."""
    ours = _modules()

    def at_once(path: Path) -> set[str]:
        """Modules imported when the file is: not those inside functions."""
        lazy = {n for f in ast.walk(_tree(path)) if isinstance(f, ast.FunctionDef) for n in _lines(f)}
        return {name for name, line in _imports(path) if line not in lazy}

    wrong = []
    for start in (name for name in ours if name.split(".")[0] == "headless"):
        seen, queue = {start}, [start]
        while queue:
            module = queue.pop()
            for name in at_once(ours[module]):
                if name.split(".")[0] in BLENDER_MODULES:
                    wrong.append(f"{start} by way of {module}")
                elif name in ours and name not in seen:
                    seen.add(name)
                    queue.append(name)
    assert wrong == []


def _lines(node: ast.FunctionDef) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def test_functions_have_few_parameters() -> None:
    """Compiled loops are exempt: they take arrays one by one."""
    wrong = []
    for path in _files(*PACKAGES):
        for node in ast.walk(_tree(path)):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                continue
            compiled = {"kernel", "inlined"} & {ast.unparse(d) for d in getattr(node, "decorator_list", [])}
            a = node.args
            names = [arg.arg for arg in (*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg) if arg is not None]
            count = len([name for name in names if name not in ("self", "cls")])
            if count > MAX_PARAMETERS and not compiled:
                wrong.append(f"{_at(path, node)} {getattr(node, 'name', 'lambda')} has {count}")
    assert wrong == []


def _dataclasses(tree: ast.Module) -> Iterator[ast.ClassDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and any("dataclass" in ast.unparse(d) for d in node.decorator_list):
            yield node


def test_dataclasses_are_built_by_name() -> None:
    """A reader cannot tell the fifth array of a call from the sixth. An unpacked list counts as one argument."""
    paths = _files(*PACKAGES, "tests")
    known = {node.name for path in paths for node in _dataclasses(_tree(path))}
    wrong = []
    for path in paths:
        own_class = {call: c.name for c in _dataclasses(_tree(path)) for call in ast.walk(c)}
        for node in ast.walk(_tree(path)):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func).rpartition(".")[2]
                name = own_class.get(node, name) if name == "cls" else name
                if name in known and len(node.args) > MAX_POSITIONAL:
                    wrong.append(f"{_at(path, node)} {name} by {len(node.args)} positional arguments")
    assert wrong == []


def test_files_are_of_readable_length() -> None:
    long = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in _files(*PACKAGES)}
    assert {str(path.relative_to(ROOT)): n for path, n in long.items() if n > MAX_LINES} == {}


def test_no_two_modules_of_the_package_share_a_name() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for module, path in _modules().items():
        if path.name != "__init__.py" and module.startswith("iris_addon."):
            places[path.stem].append(module)
    shared = {name: where for name, where in places.items() if len(where) > 1}
    assert {name: where for name, where in shared.items() if name not in SHARED_NAMES} == {}
    assert SHARED_NAMES.keys() <= shared.keys(), "an exception that nothing needs any more"


OPENERS = re.compile(
    r"(^|\.)open$|\.(read_text|read_bytes|ZipFile|loadtxt|genfromtxt|fromfile|memmap|imread)$|^(np|numpy)\.load$"
    r"|^OpenEXR\.File$|^trimesh\.load|^(json|tomllib|pickle|marshal)\.loads?$|^bpy\.data\.images\.load$"
)
"""Calls that open a file or decode what was in one."""
MAY_OPEN = {
    "headless/make_environment.py": "its own list of packages",
    "iris_addon/base/untrusted.py": "the one place that opens files of strangers",
    "iris_addon/base/compiled.py": "the sources of this program",
    "iris_addon/base/files.py": "folders and files of its own writes, to flush them",
    "iris_addon/base/images.py": "an open file whose header was read, and writing",
    "iris_addon/blender/apply/applied_states.py": "its own note in the scene",
    "iris_addon/blender/apply/camera_look.py": "its own note in the scene",
    "iris_addon/blender/apply/looks.py": "its own note in the scene",
    "iris_addon/blender/apply/on_objects.py": "its own note in the scene",
    "iris_addon/blender/apply/photo_cameras.py": "its own note in the scene",
    "iris_addon/blender/apply/review.py": "Blender shows a picture of the report",
    "iris_addon/blender/images.py": "after the header was read",
    "iris_addon/blender/render/light_mixing.py": "its own note in the scene",
    "iris_addon/blender/scene_in/capture_objects.py": "Blender reads a background when it is first drawn",
    "iris_addon/blender/scene_out/scene_state.py": "its own note in the scene",
    "iris_addon/blender/synth/renders.py": "what Cycles has just rendered",
    "iris_addon/blender/worker/process.py": "the log it writes, and messages of its own worker",
    "iris_addon/capture/mesh_files.py": "bytes whose counts were read",
    "iris_addon/capture/photo_files.py": "an open file, sizes checked first",
    "iris_addon/decide.py": "its own array in a checkpoint of the same solve",
    "iris_addon/edits/light_shares.py": "after the header was read, and writing",
    "iris_addon/results/checkpoints.py": "a table of the same solve, mapped",
    "operators/onto_photo.py": "the picture it has just written",
    "headless/child.py": "messages of its own child",
    "headless/side_by_side.py": "a file of the system",
}
"""Files with such calls, and what they may be for."""


def test_files_of_strangers_are_opened_in_one_place() -> None:
    """Elsewhere a pipe blocks, a header allocates a terabyte, and a damaged file is a traceback."""
    found = {}
    for path in _files("iris_addon", "operators", "headless"):
        for node in ast.walk(_tree(path)):
            if isinstance(node, ast.Call) and OPENERS.search(ast.unparse(node.func)):
                found.setdefault(path.relative_to(ROOT).as_posix(), []).append(_at(path, node))
    assert {name: calls for name, calls in found.items() if name not in MAY_OPEN} == {}
    assert MAY_OPEN.keys() <= found.keys(), "an exception that nothing needs any more"


# ---- and of the tests that hold them -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"c"}, "c": {"b"}}, [["b", "c"]]),
        ({"a": {"b"}, "b": {"a"}, "c": {"d"}, "d": {"c"}}, [["a", "b"], ["c", "d"]]),
    ],
)
def test_circles_are_groups_that_reach_each_other(graph: dict[str, set[str]], expected: list[list[str]]) -> None:
    assert _circles(graph) == expected


def test_imports_inside_functions_are_seen_and_those_for_types_are_not() -> None:
    tree = ast.parse("if TYPE_CHECKING:\n    import a\ndef f():\n    import b\n")
    assert [n.names[0].name for n in _executed(tree) if isinstance(n, ast.Import)] == ["b"]
